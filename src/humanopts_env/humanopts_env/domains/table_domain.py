"""Base classes of enumerable domains, defined by tables or by the rules of single states."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property, wraps
from typing import Any, TypeVar

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import (
    DomainError,
    EnumerableDomain,
    Outcome,
    S,
    StateError,
    Transitions,
)
from humanopts_env.domains.tabular import draw_outcomes, outcome_limits, reachable, read_only
import numpy as np
from numpy.typing import NDArray

T = TypeVar('T')


def built_once(build: Callable[[Any], T]) -> Callable[[Any], T]:
    """Decorate a method without parameters: build its result once per object, and share it."""
    name = f'_{build.__qualname__}'  # an overridden method has a separate result

    @wraps(build)
    def read(domain: Any) -> T:
        known: dict[str, T] = domain.__dict__
        try:
            return known[name]
        except KeyError:
            return known.setdefault(name, build(domain))

    return read


class SharedTables(EnumerableDomain[S], ABC):
    """
    The methods of an ``EnumerableDomain`` that read its tables.

    A subclass defines each table as a ``built_once`` method that returns read-only arrays.
    """

    @property
    @abstractmethod
    def _open(self) -> Ints:
        """Indices of the states that are reachable in an episode and not over."""

    def feature_values(self, state: S) -> Floats:
        values: Floats = self.feature_table()[self.index(state)]
        return values

    def reset(self, rng: np.random.Generator) -> S:
        return self.state_at(int(rng.choice(self.start_states())))

    def step(self, state: S, action: int, rng: np.random.Generator) -> Outcome[S]:
        if not 0 <= action < len(self.actions):
            raise DomainError(
                f'{self.name} has no action {action}; it has 0 to {len(self.actions) - 1}'
            )
        number, table = self.index(state), self.transitions()
        if self.over()[number]:
            raise DomainError(f'the task is over in {self.encode(state)!r}: no step can be taken')
        chosen = 0
        if table.successor.shape[2] > 1:
            chosen = int(draw_outcomes(self._limits, number, action, rng.random()))
        at = number, action, chosen
        successor = self.state_at(int(table.successor[at]))
        return Outcome(successor, float(table.reward[at]), bool(table.terminated[at]))

    def can_follow(self, state: S, action: int, successor: S) -> bool:
        number, table = self.index(state), self.transitions()
        if self.over()[number] or not 0 <= action < len(self.actions):
            return False
        possible = table.probability[number, action] > 0
        return self.index(successor) in table.successor[number, action][possible]

    def sample_states(self, rng: np.random.Generator, count: int) -> list[S]:
        """Draw states uniformly from those that are reachable in an episode and not over."""
        return [self.state_at(int(number)) for number in rng.choice(self._open, count)]

    @cached_property
    def _limits(self) -> Floats:
        return outcome_limits(self.transitions())


class TableDomain(SharedTables[S]):
    """
    An ``EnumerableDomain`` with up to about 100,000 states.

    A subclass sets the attributes of ``Domain``, passes its states to ``__init__`` and implements
    the abstract methods; all tables are built from these on first use.
    """

    def __init__(self, states: Sequence[S]) -> None:
        """
        Number the states.

        :param states: all states, without duplicates.
        """
        self._states = tuple(states)
        self._numbers = {state: number for number, state in enumerate(self._states)}

    @abstractmethod
    def outcomes(self, state: S, action: int) -> Sequence[tuple[float, S, float]]:
        """
        Return the outcomes of an action: the probability, successor and reward of each.

        This is called for every state, even if the task is over. Figures of the board draw the
        first outcome as the intended one.
        """

    @abstractmethod
    def encode(self, state: S) -> str:
        """Return the state as one line, unique per state."""

    @abstractmethod
    def is_over(self, state: S) -> bool:
        """Return whether the task is over in ``state``."""

    @abstractmethod
    def can_begin(self, state: S) -> bool:
        """Return whether an episode can start in ``state``; start states are equally likely."""

    @abstractmethod
    def values_of(self, state: S) -> Sequence[float]:
        """Return the value of every feature; see ``Feature``."""

    @property
    def n_states(self) -> int:
        return len(self._states)

    def index(self, state: S) -> int:
        try:
            return self._numbers[state]
        except (KeyError, TypeError):
            raise StateError(f'{state} is not a state of {self.name}') from None

    def state_at(self, index: int) -> S:
        if not 0 <= index < self.n_states:
            raise StateError(f'{self.name} has no state {index}; it has 0 to {self.n_states - 1}')
        return self._states[index]

    def decode(self, text: str) -> S:
        if text not in self._texts:
            example = next(iter(self._texts))
            raise StateError(f'{text!r} is not a state of {self.name}; write one like {example!r}')
        return self._states[self._texts[text]]

    @cached_property
    def _texts(self) -> dict[str, int]:
        return {self.encode(state): number for number, state in enumerate(self._states)}

    @built_once
    def transitions(self) -> Transitions:
        pairs = [
            list(self.outcomes(state, action))
            for state in self._states
            for action in range(len(self.actions))
        ]
        shape = (len(pairs), max(map(len, pairs)))
        successor, reward = np.zeros(shape, np.int32), np.zeros(shape)
        probability = np.zeros(shape)
        for pair, entries in enumerate(pairs):
            for outcome, (share, state, gain) in enumerate(entries):
                probability[pair, outcome], reward[pair, outcome] = share, gain
                successor[pair, outcome] = self.index(state)
        axes = (self.n_states, len(self.actions), shape[1])
        return Transitions(
            successor=read_only(successor.reshape(axes)),
            probability=read_only(probability.reshape(axes)),
            reward=read_only(reward.reshape(axes)),
            terminated=read_only((self.over()[successor] & (probability > 0)).reshape(axes)),
        )

    @built_once
    def feature_table(self) -> Rows:
        return read_only(np.array([self.values_of(s) for s in self._states], dtype=np.float64))

    @built_once
    def start_states(self) -> NDArray[np.int32]:
        begins = [self.can_begin(state) for state in self._states]
        return read_only(np.flatnonzero(begins).astype(np.int32))

    @built_once
    def over(self) -> Flags:
        return read_only(np.array([self.is_over(s) for s in self._states], dtype=np.bool_))

    @cached_property
    def _open(self) -> Ints:
        return np.flatnonzero(reachable(self) & ~self.over())
