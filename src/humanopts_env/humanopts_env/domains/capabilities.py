"""
What a domain may offer beside its rules. The learner and the tools for teaching ask for these.

A domain has a capability by having the method or attribute; nothing is registered.

- ``HasBatchGames``: plays many games at once, so that plans can be made from samples.
- ``HasSearchSpace``: says where subgoals of automatic options are searched for.
- ``HasTeachingDefaults``: says what is taught and when it is learned well enough.
- ``HasBaselines``: says what plans are compared with, and in which variants of the game.

``humanopts_env.contract`` tests each of them in every domain that has it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from humanopts_env.domains.base import Domain, Parameter
from humanopts_env.domains.search_space import SearchSpace
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
THRESHOLDS = ('return_delta', 'initiation_error', 'termination_error')


@dataclass(frozen=True)
class Abstraction:
    """The abstract features of a state abstraction, by their columns (P,)."""

    sizes: tuple[int, ...]  # how many values each has
    context: tuple[int, ...] = ()  # columns that hardly decide which option is better
    mixture: tuple[int, ...] = ()  # those that plans with options and primitive actions get, too


class BatchGames(Protocol):
    """
    Many games of one domain at once; a batch is whatever it likes, N games that step in place.

    Planning sees games through a state abstraction: games with equal abstract features are in one
    abstract state, and these are few enough that each is visited often. Primitive actions need a
    finer abstraction than options, which know their way.
    """

    @property
    def domain(self) -> Domain[Any]:
        """The domain that the games are of."""
        ...

    def batch_reset(self, count: int, rng: np.random.Generator) -> Any:
        """Begin games."""
        ...

    def batch_of(self, states: Sequence[Any]) -> Any:
        """Return games that stand at given states."""
        ...

    def batch_take(self, batch: Any, games: Ints) -> Any:
        """Return copies of chosen games, by their indices (M,)."""
        ...

    def batch_put(self, batch: Any, games: Ints, source: Any) -> None:
        """Set chosen games, by their indices (M,), each once, to the M games of another batch."""
        ...

    def batch_step(self, batch: Any, actions: Ints, rng: np.random.Generator) -> NDArray[Any]:
        """Take one step in every game that is not over, in place; return the rewards (N,)."""
        ...

    def batch_over(self, batch: Any) -> Flags:
        """Return (N,): whether each game is over."""
        ...

    def batch_features(self, batch: Any) -> NDArray[np.int32]:
        """Return (N, F): all features."""
        ...

    def batch_outcome(self, batch: Any) -> Mapping[str, NDArray[Any]]:
        """Return what is reported of games beside their return, each (N,), by its name."""
        ...

    def abstraction(self, *, fine: bool) -> Abstraction:
        """
        Return the abstract features that there are.

        :param fine: those that primitive actions need; False: those that options need. Only the
            latter may have a ``mixture``.
        """
        ...

    def abstract_features(
        self, batch: Any, rows: NDArray[np.int32], *, fine: bool
    ) -> NDArray[np.int32]:
        """
        Return (N, P): the values of the abstract features, from 0.

        :param rows: (N, F) features of the games.
        """
        ...


@runtime_checkable
class HasBatchGames(Protocol):
    """A domain that plays many games at once."""

    def batch_games(self) -> BatchGames:
        """Return what plays them."""
        ...


@runtime_checkable
class HasSearchSpace(Protocol):
    """
    A domain that says where subgoals are searched for.

    In others whose states can be listed, every state is a cell of its own.
    """

    def search_space(self) -> SearchSpace:
        """Return the states that tasks are set in, and what their visits count for."""
        ...


@dataclass(frozen=True)
class TeachingDefaults:
    """What is taught where nobody chooses, and when it is learned well enough."""

    options: tuple[str, ...] = ()  # names of reference options that a demo teaches; none: all
    thresholds: Mapping[str, float] = field(default_factory=dict)
    """
    Of the stopping criteria, by name, one of THRESHOLDS; others are the learner's own.
    ``return_delta`` is in reward units: what one small thing is worth in the game.
    """


@runtime_checkable
class HasTeachingDefaults(Protocol):
    """A domain with teaching defaults of its own."""

    teaching: TeachingDefaults


@dataclass(frozen=True)
class PlanSettings:
    """How to plan from samples; found by hand, on other seeds than anything is reported with."""

    gamma: float  # discount per primitive step
    sampling: Mapping[str, Any]  # numbers by the names of the learner's ``Sampling``


@dataclass(frozen=True)
class Scores:
    """What N games came to."""

    total: NDArray[Any]  # (N,) undiscounted return
    outcomes: Mapping[str, NDArray[Any]]  # (N,) each, as ``BatchGames.batch_outcome``


class Heuristic(Protocol):
    """A rule written by hand that chooses among the reference options."""

    def __call__(self, games: int, seed: int, *, to_end: bool) -> Scores:
        """
        Play games until they are over or cut off.

        :param to_end: an option runs to its end; False: one is chosen at every step.
        """
        ...


@dataclass(frozen=True)
class Baselines:
    """What plans are compared with."""

    variants: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    """Changed parameters of each variant of the game to compare in, by its name."""
    targets: tuple[float, ...] = ()  # mean returns of interest, for these parameters
    fewer_options: tuple[str, ...] = ()  # names of options that are also planned with alone
    primitive: PlanSettings | None = None  # for plans with primitive actions
    interrupted: PlanSettings | None = None  # for plans with options that are interrupted
    interrupted_mixture: PlanSettings | None = None  # and with primitive actions beside them
    heuristic: Heuristic | None = None


@runtime_checkable
class HasBaselines(Protocol):
    """A domain that says what plans are compared with."""

    def baselines(self) -> Baselines:
        """Return what plans are compared with in this variant of the game."""
        ...
