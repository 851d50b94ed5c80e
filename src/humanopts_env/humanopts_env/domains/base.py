"""Domains: named features, named actions, and rules without hidden state."""

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import compress, product
from typing import Any, Generic, Protocol, runtime_checkable, TypeGuard

from humanopts_env.arrays import Flags, Floats, Rows
import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypeVar

S = TypeVar('S', bound=Hashable, default=Any)  # states; a bare ``Domain`` has any type of states
Parameter = int | float | str | bool


class DomainError(ValueError):
    """A domain cannot fulfil a request; the message names the request and the reason."""


class StateError(DomainError):
    """A text or an index is not a state of the domain."""


class FeatureKind(Enum):
    """The kind of a feature's values."""

    ORDINAL = 'ordinal'  # indices into ordered texts
    NOMINAL = 'nominal'  # indices into unordered texts; one-hot for the trees
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
    values: tuple[str, ...] = ()  # text of each ordinal or nominal value
    unit: str = ''  # unit of a continuous feature, such as m or rad; empty if none
    low: float = 0.0  # range of a continuous feature; both finite
    high: float = 0.0

    @classmethod
    def number(cls, name: str, question: str, count: int, *more: str) -> 'Feature':
        """Return an ordinal feature with the numbers below ``count``, then other values."""
        return cls(name, question, FeatureKind.ORDINAL, (*map(str, range(count)), *more))

    @classmethod
    def place(
        cls, name: str, words: str, rows: int, cols: int, *more: str
    ) -> tuple['Feature', 'Feature']:
        """
        Return the row and the column of an object as features.

        :param name: prefix of both names; empty: the names are row and col.
        :param words: the object in questions, such as the taxi.
        :param more: additional values of both, such as none.
        """
        row, col = (f'{name}_{axis}'.strip('_') for axis in ('row', 'col'))
        return (
            cls.number(row, f'which row {words} is in', rows, *more),
            cls.number(col, f'which column {words} is in', cols, *more),
        )

    @classmethod
    def nominal(cls, name: str, question: str, values: Iterable[str]) -> 'Feature':
        """Return a feature with unordered values."""
        return cls(name, question, FeatureKind.NOMINAL, tuple(values))

    @classmethod
    def continuous(
        cls, name: str, question: str, low: float, high: float, unit: str = ''
    ) -> 'Feature':
        """Return a feature of the real numbers from ``low`` to ``high``."""
        # message fields are floats, so decoded bounds are, too
        return cls(name, question, FeatureKind.CONTINUOUS, (), unit, float(low), float(high))

    def has(self, value: float) -> bool:
        """Return whether a value is valid."""
        if self.kind is FeatureKind.CONTINUOUS:
            return self.low <= value <= self.high
        return 0 <= value < len(self.values) and value == int(value)

    def text(self, value: float) -> str:
        """Return the text of a value: continuous values to four digits, with the unit."""
        if self.kind is FeatureKind.CONTINUOUS:
            return f'{value:.4g} {self.unit}'.strip()
        return self.values[int(value)]

    @property
    def span(self) -> float:
        """Highest minus lowest value, at least 1 for indices."""
        if self.kind is FeatureKind.CONTINUOUS:
            return self.high - self.low
        return max(len(self.values) - 1, 1)


def check_whole(name: str, value: object, least: int, most: int) -> None:
    """
    Check a parameter of a domain.

    :raises DomainError: the value is not a whole number from ``least`` to ``most``.
    """
    if type(value) is not int or not least <= value <= most:
        raise DomainError(
            f'{name} is {value!r}, but must be a whole number from {least} to {most}'
        )


def check_choice(name: str, value: object, known: Iterable[str]) -> None:
    """
    Check a parameter of a domain.

    :raises DomainError: the value is not one of the known texts.
    """
    if value not in (choices := tuple(known)):
        raise DomainError(f'{name} is {value!r}, but must be {" or ".join(choices)}')


def subset_names(names: Sequence[str], joint: str = ', ', none: str = 'none') -> list[str]:
    """Return the text of every subset of names, indexed by bit mask."""
    subsets = product((False, True), repeat=len(names))  # the last name is the highest bit
    return [joint.join(compress(names, subset[::-1])) or none for subset in subsets]


@dataclass(frozen=True, slots=True)
class Action:
    """One primitive action."""

    name: str  # snake_case
    key: str  # one character, or up, down, left, right
    description: str
    seconds: float = 0.0  # maximum duration; 0: immediate
    idle: bool = False  # whether it only waits


@dataclass(frozen=True, slots=True)
class Outcome(Generic[S]):
    """The result of one primitive step."""

    state: S
    reward: float
    terminated: bool  # whether the task is over in ``state``


class ActableDomain(Protocol):
    """
    A domain in which actions can be taken: its features, its actions and its published states.

    This is enough to teach, learn and run options. ``Domain`` adds the rules.
    """

    name: str  # registered name
    parameters: Mapping[str, Parameter]  # keyword arguments that construct an equal domain
    features: Sequence[Feature]
    actions: Sequence[Action]
    gamma: float  # discount per primitive step
    max_steps: int  # an episode is truncated after this many steps; 0: never

    def is_over(self, state: Any) -> bool:
        """Return whether the task is over in ``state``, so that no step can be taken."""

    def feature_values(self, state: Any) -> Floats:
        """Return the value of every feature, (F,); see ``Feature``."""

    def encode(self, state: Any) -> str:
        """Return the state in the domain's notation, one line."""


class Domain(ActableDomain, Protocol[S]):
    """
    The rules of one game. Implementations are immutable: all state is passed as arguments.

    ``humanopts_env.testing`` tests the contract of every implementation.
    """

    def reset(self, rng: np.random.Generator) -> S:
        """Draw a start state of the task."""

    def step(self, state: S, action: int, rng: np.random.Generator) -> Outcome[S]:
        """
        Take one primitive action.

        :param action: index into ``actions``.
        :raises DomainError: the action is unknown, or the task is over in ``state``.
        """

    def is_over(self, state: S) -> bool:
        """Return whether the task is over in ``state``, so that no step can be taken."""

    def can_follow(self, state: S, action: int, successor: S) -> bool:
        """Return whether ``action`` can lead from ``state`` to ``successor``."""

    def feature_values(self, state: S) -> Floats:
        """Return the value of every feature, (F,); see ``Feature``."""

    def encode(self, state: S) -> str:
        """Return the state in the domain's notation, one line."""

    def decode(self, text: str) -> S:
        """
        Return the state from the text of ``encode``.

        :raises StateError: ``text`` is not a state of this domain.
        """

    def sample_states(self, rng: np.random.Generator, count: int) -> list[S]:
        """Draw possible start states of demonstrations, none of them over."""


@dataclass(frozen=True, slots=True)
class Transitions:
    """
    Exact one-step transitions of an enumerable domain.

    Axes: S states, A actions, B possible outcomes (1 for a deterministic domain). Unused outcomes
    have probability 0. Transitions are also defined for states where the task is over, as in
    Gymnasium, but must not be used for planning.
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
    """States that differ only in the agent's position, arranged like the cells of the board."""

    title: str
    states: NDArray[np.int32]  # (rows, cols) state indices; -1: no state there


@runtime_checkable
class EnumerableDomain(Domain[S], Protocol[S]):
    """A domain with states that can be listed."""

    @property
    def n_states(self) -> int:
        """Number of states, reachable or not."""

    def index(self, state: S) -> int:
        """
        Return the index of a state, 0..n_states-1.

        :raises StateError: ``state`` is not a state of this domain.
        """

    def state_at(self, index: int) -> S:
        """
        Return the state at an index.

        :raises StateError: there is no such state.
        """

    def transitions(self) -> Transitions:
        """Return the exact transitions, built once, shared and read-only."""

    def feature_table(self) -> Rows:
        """Return (S, F): ``feature_values`` of every state; shared and read-only."""

    def start_states(self) -> NDArray[np.int32]:
        """Return the indices of the start states; ``reset`` draws from them uniformly."""

    def over(self) -> Flags:
        """Return (S,): ``is_over`` of every state; shared and read-only."""

    def board_slices(self) -> list[BoardSlice]:
        """Return a few layouts for figures of values and policies; default: none."""
        return []


def is_enumerable(domain: ActableDomain) -> TypeGuard[EnumerableDomain]:
    """Return whether the states of a domain can be listed."""
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


def action_index(domain: ActableDomain, name: str) -> int:
    """
    Return the index of an action.

    :raises DomainError: the domain has no such action.
    """
    names = [action.name for action in domain.actions]
    if name not in names:
        raise DomainError(f'{domain.name} has no action {name!r}; it has {", ".join(names)}')
    return names.index(name)
