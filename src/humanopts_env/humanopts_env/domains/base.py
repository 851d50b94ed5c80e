"""What a domain is: named features, named actions, and rules without hidden state."""

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import compress, product
from typing import Any, Generic, Protocol, runtime_checkable, TypeGuard

from humanopts_env.arrays import Flags, Floats, Rows
import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypeVar

S = TypeVar('S', bound=Hashable, default=Any)  # states; ``Domain`` alone is one of any
Parameter = int | float | str | bool


class DomainError(ValueError):
    """The domain lacks what was requested; the text says what and why."""


class StateError(DomainError):
    """A text or an index is not a state of the domain."""


class FeatureKind(Enum):
    """What the values of a feature are."""

    ORDINAL = 'ordinal'  # indices into texts that have an order
    NOMINAL = 'nominal'  # indices into texts that have none; one-hot for the trees
    CONTINUOUS = 'continuous'  # numbers in a range


@dataclass(frozen=True, slots=True)
class Feature:
    """
    One feature; its value in a state is a float64.

    An ordinal or nominal value is an index into ``values``, a continuous one a number from
    ``low`` to ``high``.
    """

    name: str  # snake_case
    question: str  # completes "Does OPTION depend on ...?"
    kind: FeatureKind
    values: tuple[str, ...] = ()  # the text of each ordinal or nominal value, for people
    unit: str = ''  # of a continuous feature, such as m or rad; empty: none
    low: float = 0.0  # range of a continuous feature; both finite
    high: float = 0.0

    @classmethod
    def number(cls, name: str, question: str, count: int, *more: str) -> 'Feature':
        """Return an ordinal feature of the numbers below ``count``, and then of other values."""
        return cls(name, question, FeatureKind.ORDINAL, (*map(str, range(count)), *more))

    @classmethod
    def place(
        cls, name: str, words: str, rows: int, cols: int, *more: str
    ) -> tuple['Feature', 'Feature']:
        """
        Return the row and the column of a thing.

        :param name: begins the names of both; empty: they are row and col.
        :param words: what the thing is: the taxi.
        :param more: other values of both, such as none.
        """
        row, col = (f'{name}_{axis}'.strip('_') for axis in ('row', 'col'))
        return (
            cls.number(row, f'which row {words} is in', rows, *more),
            cls.number(col, f'which column {words} is in', cols, *more),
        )

    @classmethod
    def nominal(cls, name: str, question: str, values: Iterable[str]) -> 'Feature':
        """Return a feature whose values have no order."""
        return cls(name, question, FeatureKind.NOMINAL, tuple(values))

    @classmethod
    def continuous(
        cls, name: str, question: str, low: float, high: float, unit: str = ''
    ) -> 'Feature':
        """Return a feature of the real numbers from ``low`` to ``high``."""
        return cls(name, question, FeatureKind.CONTINUOUS, (), unit, low, high)

    def has(self, value: float) -> bool:
        """Return whether the feature can have a value."""
        if self.kind is FeatureKind.CONTINUOUS:
            return self.low <= value <= self.high
        return 0 <= value < len(self.values) and value == int(value)

    def text(self, value: float) -> str:
        """Return a value as people read it: continuous ones to four digits, with the unit."""
        if self.kind is FeatureKind.CONTINUOUS:
            return f'{value:.4g} {self.unit}'.strip()
        return self.values[int(value)]

    @property
    def span(self) -> float:
        """Highest minus lowest value, at least 1 where these are indices."""
        if self.kind is FeatureKind.CONTINUOUS:
            return self.high - self.low
        return max(len(self.values) - 1, 1)


def check_whole(name: str, value: object, least: int, most: int) -> None:
    """
    Check a parameter of a domain.

    :raises DomainError: it is not a whole number from ``least`` to ``most``.
    """
    if type(value) is not int or not least <= value <= most:
        raise DomainError(
            f'{name} is {value!r}, and must be a whole number from {least} to {most}'
        )


def check_choice(name: str, value: object, known: Iterable[str]) -> None:
    """
    Check a parameter of a domain.

    :raises DomainError: it is not one of the known texts.
    """
    if value not in (choices := tuple(known)):
        raise DomainError(f'{name} is {value!r}, and must be {" or ".join(choices)}')


def subset_names(names: Sequence[str], joint: str = ', ', none: str = 'none') -> list[str]:
    """Return the text of every subset of names, by its bit mask."""
    subsets = product((False, True), repeat=len(names))  # the last name is the highest bit
    return [joint.join(compress(names, subset[::-1])) or none for subset in subsets]


@dataclass(frozen=True, slots=True)
class Action:
    """One primitive action."""

    name: str  # snake_case
    key: str  # one character, or up, down, left, right
    description: str


@dataclass(frozen=True, slots=True)
class Outcome(Generic[S]):
    """The result of one primitive step."""

    state: S
    reward: float
    terminated: bool  # the task is over in ``state``


class ActableDomain(Protocol):
    """
    A domain that can be acted in: its features and actions, and states that it has published.

    This is enough to be taught, to learn, and to run options. ``Domain`` adds the rules.
    """

    name: str  # as registered
    parameters: Mapping[str, Parameter]  # keyword arguments that construct an equal domain
    features: Sequence[Feature]
    actions: Sequence[Action]
    gamma: float  # discount per primitive step
    max_steps: int  # an episode is truncated after this many steps; 0: never

    def is_over(self, state: Any) -> bool:
        """Return whether the task is over in ``state``, so that no step can be taken."""

    def feature_values(self, state: Any) -> Floats:
        """Return the value of every feature, (F,), as ``Feature`` describes it."""

    def encode(self, state: Any) -> str:
        """Return the state in the domain's notation, one line."""


class Domain(ActableDomain, Protocol[S]):
    """
    The rules of one game. Implementations are immutable: all state is in the values passed.

    ``humanopts_env.testing`` states what every implementation must satisfy.
    """

    def reset(self, rng: np.random.Generator) -> S:
        """Draw a start state of the task."""

    def step(self, state: S, action: int, rng: np.random.Generator) -> Outcome[S]:
        """
        Take one primitive action.

        :param action: index into ``actions``.
        :raises DomainError: the action is not in the domain, or the episode is over in ``state``.
        """

    def is_over(self, state: S) -> bool:
        """Return whether the task is over in ``state``, so that no step can be taken."""

    def can_follow(self, state: S, action: int, successor: S) -> bool:
        """Return whether ``step`` can lead from ``state`` by ``action`` to ``successor``."""

    def feature_values(self, state: S) -> Floats:
        """Return the value of every feature, (F,), as ``Feature`` describes it."""

    def encode(self, state: S) -> str:
        """Return the state in the domain's notation, one line."""

    def decode(self, text: str) -> S:
        """
        Return the state that ``encode`` wrote.

        :raises StateError: ``text`` is not a state of this domain.
        """

    def sample_states(self, rng: np.random.Generator, count: int) -> list[S]:
        """Draw states from which a person could be asked to demonstrate (never over)."""


@dataclass(frozen=True, slots=True)
class Transitions:
    """
    Exact one-step transitions of an enumerable domain.

    Axes: S states, A actions, B possible outcomes (1 where the domain is deterministic). Unused
    outcomes have probability 0. From states where the task is over they are defined like any
    other, as in Gymnasium; nothing may be planned from there.
    """

    successor: NDArray[np.int32]  # (S, A, B)
    probability: Floats  # (S, A, B), sums to 1 over B
    reward: Floats  # (S, A, B)
    terminated: Flags  # (S, A, B)

    @property
    def deterministic(self) -> bool:
        """Whether every action has one outcome."""
        return bool(self.successor.shape[2] == 1)


@dataclass(frozen=True, slots=True)
class BoardSlice:
    """States that differ only in the agent's position, laid out as the cells of their board."""

    title: str
    states: NDArray[np.int32]  # (rows, cols) state indices; -1: no state there


@runtime_checkable
class EnumerableDomain(Domain[S], Protocol[S]):
    """A domain whose states can all be listed."""

    @property
    def n_states(self) -> int:
        """Number of states, reachable or not."""

    def index(self, state: S) -> int:
        """
        Return the state's index, 0..n_states-1.

        :raises StateError: it is not a state of this domain.
        """

    def state_at(self, index: int) -> S:
        """
        Return the state of an index.

        :raises StateError: there is no such state.
        """

    def transitions(self) -> Transitions:
        """Return the exact transitions; built once, then shared and read-only."""

    def feature_table(self) -> Rows:
        """Return (S, F): ``feature_values`` of every state; shared and read-only."""

    def start_states(self) -> NDArray[np.int32]:
        """Return the indices that ``reset`` draws from, uniformly."""

    def over(self) -> Flags:
        """Return (S,): ``is_over`` of every state; shared and read-only."""

    def board_slices(self) -> list[BoardSlice]:
        """Return a few layouts for figures of values and policies; by default none."""
        return []


def is_enumerable(domain: ActableDomain) -> TypeGuard[EnumerableDomain]:
    """Return whether the domain's states can all be listed."""
    return isinstance(domain, EnumerableDomain)


def shown_values(
    domain: ActableDomain, state: Any, shown: Collection[str] | None = None
) -> dict[str, str]:
    """
    Return the text of each feature's value in a state.

    :param shown: names of the features that may be revealed; None: all.
    """
    return {
        feature.name: feature.text(value)
        for feature, value in zip(domain.features, domain.feature_values(state).tolist())
        if shown is None or feature.name in shown
    }


def feature_columns(domain: ActableDomain, names: Sequence[str]) -> list[int]:
    """
    Return the indices of features, in the domain's order whatever the order of ``names``.

    :raises DomainError: a name is not a feature of the domain.
    """
    known = [feature.name for feature in domain.features]
    for name in names:
        if name not in known:
            raise DomainError(f'{domain.name} has no feature {name!r}; it has {", ".join(known)}')
    return [column for column, name in enumerate(known) if name in set(names)]


def action_index(domain: ActableDomain, name: str) -> int:
    """
    Return the index of an action.

    :raises DomainError: the domain has no such action.
    """
    names = [action.name for action in domain.actions]
    if name not in names:
        raise DomainError(f'{domain.name} has no action {name!r}; it has {", ".join(names)}')
    return names.index(name)
