"""A scripted person who knows Taxi's options, for the tests of learning."""

from collections.abc import Callable
from typing import Any

from graph_support.scripted import show
from humanopts_env.domains.base import action_index, is_enumerable
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, make_demonstration
import pytest

TAXI = Taxi()
REFERENCE = reference_options(TAXI)
FETCH = 'go to passenger and pickup'


class Person:
    """Shows one option from any state; among equally good actions always prefers the same."""

    def __init__(self, option: str = FETCH, seed: int = 0, error_rate: float = 0.0) -> None:
        self.option, self.seed, self.error_rate = option, seed, error_rate
        self.reference = REFERENCE[option]
        self.features = self.reference.features
        self.preference = generator(seed, 'preference').permutation(len(TAXI.actions)).tolist()
        self.shown: list[Demonstration] = []

    def show(self, state: TaxiState) -> Demonstration:
        """Show the option from a state, or say "not here"; an error is another action."""
        rng = generator(self.seed, 'person', self.option, len(self.shown))

        def choose(taken: int, here: TaxiState) -> str | None:
            if not self.reference.can_start(here):
                return None
            return TAXI.actions[self._choose(self.reference.optimal_actions(here), rng)].name

        demo = show(
            TAXI,
            state,
            choose,
            rng,
            participant=f'person {self.seed}',
            session='morning',
            option_name=self.option,
            number=len(self.shown) + 1,
            chosen_features=tuple(self.features),
        )
        self.shown.append(demo)
        return demo

    def walk(self, start: TaxiState, *names: str) -> Demonstration:
        """Show actions by name, whatever the person would do."""
        states, rng = [start], generator(0, 'no chance')
        for name in names:
            states.append(TAXI.step(states[-1], action_index(TAXI, name), rng).state)
        demo = make_demonstration(
            TAXI,
            self.option,
            states,
            names,
            features=self.features,
            participant=f'person {self.seed}',
            number=len(self.shown) + 1,
        )
        self.shown.append(demo)
        return demo

    def show_random(self, count: int) -> list[Demonstration]:
        """Show the option from random start states of the task."""
        rng = generator(self.seed, 'starts', self.option)
        starts = [TAXI.state_at(int(i)) for i in rng.choice(REFERENCE_STARTS[self.option], count)]
        return [self.show(state) for state in starts]

    def _choose(self, best: tuple[int, ...], rng: Any) -> int:
        if rng.random() < self.error_rate:
            return int(rng.choice([a for a in range(len(TAXI.actions)) if a not in best]))
        return min(best, key=self.preference.index)


class PlainTaxi:
    """Taxi through the methods of ``Domain`` alone, as a domain that cannot be enumerated."""

    name, parameters, gamma, max_steps = TAXI.name, TAXI.parameters, TAXI.gamma, TAXI.max_steps
    features, actions = TAXI.features, TAXI.actions
    reset, step, is_over, can_follow = TAXI.reset, TAXI.step, TAXI.is_over, TAXI.can_follow
    feature_values, encode, decode = TAXI.feature_values, TAXI.encode, TAXI.decode
    sample_states = TAXI.sample_states


REFERENCE_STARTS = {name: r.initiation.nonzero()[0] for name, r in REFERENCE.items()}


@pytest.fixture(scope='session')
def person() -> Callable[..., Person]:
    """Return the class of scripted people."""
    return Person


@pytest.fixture(scope='session')
def plain_taxi() -> Any:
    """Return Taxi without its tables."""
    assert not is_enumerable(PlainTaxi())
    return PlainTaxi()


@pytest.fixture(scope='session')
def fetching() -> list[Demonstration]:
    """Return 30 demonstrations of fetching the passenger, from random starts."""
    return Person().show_random(30)
