"""Our domains keep the contract, and domains that break a promise of it are refused."""

from collections.abc import Callable, Collection
from pathlib import Path
import time
from typing import Any, cast

from humanopts_env.contract import check_domain, ContractError, DomainContract
from humanopts_env.domains.base import Domain, Feature, FeatureKind, is_enumerable, Outcome
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi, TaxiState
import numpy as np
from numpy.typing import NDArray
import pytest

FOUR_GHOSTS = str(Path(__file__).with_name('four_ghosts.lay'))
NO_GHOST = '%%%%%\n%P..%\n%%%%%'


class TestTaxi(DomainContract):
    """The 5 x 5 grid."""

    def make(self) -> Domain[Any]:
        """Return the original grid."""
        return Taxi()


class TestWiderTaxi(DomainContract):
    """A grid of another shape."""

    def make(self) -> Domain[Any]:
        """Return a grid of 6 rows and 7 columns."""
        return Taxi(6, 7)


class TestRooms(DomainContract):
    """The goal in a doorway."""

    def make(self) -> Domain[Any]:
        """Return the rooms of the first experiments."""
        return Rooms()


class TestRoomsWithTheGoalInARoom(DomainContract):
    """The goal in a cell of a room."""

    def make(self) -> Domain[Any]:
        """Return the rooms of the other experiments."""
        return Rooms('G2')


@pytest.mark.heavy
class TestPacMan(DomainContract):
    """Our own maze."""

    def make(self) -> Domain[Any]:
        """Return the default."""
        domain: Domain[Any] = PacMan()
        assert not is_enumerable(domain)
        return domain


@pytest.mark.heavy
class TestChasedPacMan(DomainContract):
    """A small maze with one ghost that chases."""

    def make(self) -> Domain[Any]:
        """Return a game with one life."""
        return PacMan('yard', ghosts='chase', lives=1, max_steps=100)


@pytest.mark.heavy
class TestPacManWithThePapersFeatures(DomainContract):
    """Positions and no directions, in a small maze."""

    def make(self) -> Domain[Any]:
        """Return a game whose features are a part of all."""
        return PacMan('yard', features='paper')


@pytest.mark.heavy
class TestCrowdedPacMan(DomainContract):
    """Numbered ghosts and three pills, from a file."""

    def make(self) -> Domain[Any]:
        """Return four ghosts."""
        return PacMan(FOUR_GHOSTS)


class TestLonelyPacMan(DomainContract):
    """No ghost and no pill."""

    def make(self) -> Domain[Any]:
        """Return a corridor."""
        return PacMan(NO_GHOST)


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


class Obliging(Taxi):
    """Actions that are not there."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Take the last for any."""
        return super().step(state, min(max(action, 0), 5), rng)


class Silent(Taxi):
    """No drawing."""

    def render(self, state: TaxiState, shown: Any = None) -> str:
        """Draw nothing."""
        return ''


class Reader(Taxi):
    """Any text is a state."""

    def decode(self, text: str) -> TaxiState:
        """Read what cannot be read as some state."""
        return super().decode(text) if text.startswith('taxi') else self.state_at(0)


class Jumpy(Taxi):
    """A rule that forgets its own steps."""

    def can_follow(self, state: TaxiState, action: int, successor: TaxiState) -> bool:
        """Deny everything."""
        return False


class Sudden(Taxi):
    """An end that is not announced."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Say that the task is over."""
        outcome = super().step(state, action, rng)
        return Outcome(outcome.state, outcome.reward, True)


class Raising(Taxi):
    """A domain that fails."""

    def feature_values(self, state: TaxiState) -> Any:
        """Fail."""
        raise ZeroDivisionError('division by zero')


class Worthless(Taxi):
    """A reward that is no number."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Give nan."""
        outcome = super().step(state, action, rng)
        return Outcome(outcome.state, float('nan'), outcome.terminated)


class TwoKeys(Taxi):
    """Two actions of one key."""

    def __init__(self) -> None:
        """Repeat an action under another name."""
        super().__init__()
        again = type(self.actions[0])('souther', 'down', 'again')
        self.actions = [*self.actions[:5], again]


@pytest.mark.parametrize(
    ('broken', 'test', 'text'),
    [
        (Dice, 'the_same_seed_plays_the_same_game', 'not the same again with the same generator'),
        (Dice, 'steps_agree_with_the_transitions', ''),
        (Endless, 'no_step_is_taken_after_the_end', 'it takes a step after the end'),
        (Unnamed, 'names_keys_and_questions_are_distinct_and_well_formed', 'have one name'),
        (TwoKeys, 'names_keys_and_questions_are_distinct_and_well_formed', 'have one key'),
        (
            Narrow,
            'a_state_has_feature_values_and_a_text',
            r'taxi_row is 4 in .* out of its range 0\.\.3',
        ),
        (Raising, '', 'it raised ZeroDivisionError: division by zero'),
        (Reader, 'text_that_is_no_state_is_refused', 'it reads "no state at all" as a state'),
        (Lenient, 'text_that_is_no_state_is_refused', ''),
        (Obliging, 'an_action_that_is_not_in_the_domain_is_refused', 'takes the action -1, of 6'),
        (Jumpy, 'what_a_step_did_can_follow', 'can_follow denies'),
        (Credulous, 'what_a_step_did_can_follow', ''),
        (Sudden, 'what_a_step_did_can_follow', 'is_over disagree'),
        (Worthless, 'what_a_step_did_can_follow', 'has the reward nan'),
        (Telltale, 'the_drawing_shows_nothing_else', ''),
        (Silent, 'a_state_has_feature_values_and_a_text', 'is drawn as nothing'),
        (Blind, 'the_drawing_shows_all_that_may_be_seen', ''),
        (Mutable, 'tables_have_their_shapes_and_cannot_be_changed', ''),
        (Torn, 'tables_agree_with_the_states', ''),
    ],
)
def test_a_broken_promise_is_found(
    broken: Callable[[], Domain[Any]], test: str, text: str
) -> None:
    """
    Each breach fails the test that is named for it, and gross ones are refused by name.

    :param test: of the contract; empty: the error ends the tests as it is.
    :param text: of the refusal; empty: the quick check does not see it.
    """
    if test:
        suite = DomainContract()
        suite.make = broken  # type: ignore[method-assign]
        with pytest.raises(AssertionError):
            getattr(suite, f'test_{test}')()
    if text:
        with pytest.raises(ContractError, match=f'^taxi breaks the contract of domains: .*{text}'):
            check_domain(broken(), 'taxi')


def test_a_domain_that_calls_itself_otherwise_is_refused() -> None:
    """A recording names the game by what it calls itself."""
    with pytest.raises(ContractError, match="it calls itself 'taxi'"):
        check_domain(Taxi(), 'cab')


def test_a_thing_that_is_no_domain_is_refused() -> None:
    """With all that is missing."""
    with pytest.raises(ContractError, match=r'it has no parameters, features, .*render'):
        check_domain(object(), 'thing')  # type: ignore[arg-type]


@pytest.mark.parametrize('domain', [Taxi(), Rooms()], ids=lambda domain: domain.name)
def test_a_good_domain_is_checked_in_the_blink_of_an_eye(domain: Any) -> None:
    """The best of three looks takes less than 50 ms of the processor."""
    times = []
    for _ in range(3):
        began = time.process_time()
        check_domain(domain, domain.name)
        times.append(time.process_time() - began)
    assert is_enumerable(domain)
    assert min(times) < 0.05
