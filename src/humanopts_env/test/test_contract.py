"""The contract refuses domains that break a promise, and asks no tables of those without any."""

from collections.abc import Callable, Collection
from typing import Any, cast

from humanopts_env.contract import DomainContract
from humanopts_env.domains.base import Domain, Feature, FeatureKind, is_enumerable, Outcome
from humanopts_env.domains.taxi import Taxi, TaxiState
import numpy as np
from numpy.typing import NDArray
import pytest


class Dice(Taxi):
    """Chance that does not come from the generator."""

    counter = 0

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Take another action at every call."""
        Dice.counter += 1
        return super().step(state, (action + Dice.counter % 7) % 6, rng)


class Endless(Taxi):
    """A game that goes on after its end."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Stay where the task is over."""
        return Outcome(state, 0, True) if self.is_over(state) else super().step(state, action, rng)


class Unnamed(Taxi):
    """Two features of one name."""

    def __init__(self, rows: int = 5, cols: int = 5) -> None:
        """Repeat a name."""
        super().__init__(rows, cols)
        self.features = [*self.features[:9], Feature('taxi_row', 'a', FeatureKind.NOMINAL, ('b',))]


class Narrow(Taxi):
    """A feature value without a name."""

    def __init__(self, rows: int = 5, cols: int = 5) -> None:
        """Leave out the last row's name."""
        super().__init__(rows, cols)
        row = Feature('taxi_row', 'the row', FeatureKind.ORDINAL, ('0', '1', '2', '3'))
        self.features = [row, *self.features[1:]]


class Lenient(Taxi):
    """Text that is read although it was never written."""

    def decode(self, text: str) -> TaxiState:
        """Ignore blanks around a state."""
        return super().decode(text.strip())


class Credulous(Taxi):
    """Trajectories that may jump."""

    def can_follow(self, state: TaxiState, action: int, successor: TaxiState) -> bool:
        """Believe everything."""
        return True


class Telltale(Taxi):
    """A drawing that shows too much."""

    def render(self, state: TaxiState, shown: Collection[str] | None = None) -> str:
        """Draw everything."""
        return super().render(state)


class Blind(Taxi):
    """A drawing that shows too little."""

    def render(self, state: TaxiState, shown: Collection[str] | None = None) -> str:
        """Draw the same board always."""
        return super().render(state, ())


class Mutable(Taxi):
    """Shared arrays that anyone can change."""

    def over(self) -> NDArray[np.bool_]:
        """Return a copy."""
        return super().over().copy()


class Torn(Taxi):
    """Tables of another game than the one played."""

    def feature_values(self, state: TaxiState) -> NDArray[np.int32]:
        """Return the values of another state."""
        values: NDArray[np.int32] = self.feature_table()[self.index(state) - 1]
        return values


@pytest.mark.parametrize(
    ('broken', 'test'),
    [
        (Dice, 'test_the_same_seed_plays_the_same_game'),
        (Dice, 'test_steps_agree_with_the_transitions'),
        (Endless, 'test_no_step_is_taken_after_the_end'),
        (Unnamed, 'test_names_keys_and_questions_are_distinct_and_well_formed'),
        (Narrow, 'test_features_are_in_range'),
        (Lenient, 'test_text_that_is_no_state_is_refused'),
        (Credulous, 'test_what_a_step_did_can_follow'),
        (Telltale, 'test_the_drawing_shows_nothing_else'),
        (Blind, 'test_the_drawing_shows_all_that_may_be_seen'),
        (Mutable, 'test_tables_have_their_shapes_and_cannot_be_changed'),
        (Torn, 'test_tables_agree_with_the_states'),
    ],
)
def test_a_broken_promise_is_found(broken: Callable[[], Domain[Any]], test: str) -> None:
    """Each breach fails the test that is named for it."""
    suite = DomainContract()
    suite.make = broken  # type: ignore[method-assign]
    with pytest.raises(AssertionError):
        getattr(suite, test)()


class WithoutTables:
    """Taxi as a domain whose states cannot be listed."""

    def __init__(self, rows: int = 5, cols: int = 5) -> None:
        """Keep the domain whose rules are used."""
        self._taxi = Taxi(rows, cols)

    def __getattr__(self, name: str) -> Any:
        """Lend everything but the tables."""
        if name in ('n_states', 'index', 'state_at', 'transitions', 'over', 'board_slices'):
            raise AttributeError(name)
        return getattr(self._taxi, name)


class TestWithoutTables(DomainContract):
    """The contract needs no tables."""

    def make(self) -> Domain[Any]:
        """Return a domain that is not enumerable."""
        domain: Domain[Any] = cast(Domain[Any], WithoutTables())
        assert not is_enumerable(domain)
        return domain
