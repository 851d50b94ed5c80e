"""Policies over the columns of an action set, for many games at once."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from humanopts_learner.planning.sampled.columns import Columns
from humanopts_learner.planning.sampled.counts import StateIndex
from humanopts_learner.planning.sampled.games import Flags, Ints, View
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Choice:
    """What to run next in N games."""

    column: Ints  # (N,)
    unknown: Flags  # (N,) an option can start, but none of them was sampled enough


class Policy(Protocol):
    """Chooses what to run."""

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        ...


@dataclass(frozen=True)
class UniformPolicy:
    """Any column that can start, each as likely."""

    columns: Columns

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        can = self.columns.startable(view)
        column = np.where(can, rng.random(can.shape), -1.0).argmax(axis=1)
        none = ~can.any(axis=1)
        column = np.where(none, self.columns.fallback(view), column)
        return Choice(column, np.zeros(len(column), dtype=np.bool_))


@dataclass(frozen=True)
class GreedyPolicy:
    """
    The column of the greatest value among those that can start and were sampled enough.

    Where none of those that can start was, it is the one that is best in most states.
    """

    columns: Columns
    index: StateIndex
    values: NDArray[np.float64]  # (S, O), -inf where not available

    @cached_property
    def preference(self) -> NDArray[np.int64]:
        """(O,) in how many states each column is the best."""
        known = np.isfinite(self.values).any(axis=1)
        best = self.values[known].argmax(axis=1)
        return np.bincount(best, minlength=self.columns.first_fallback)

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        return self.choose(view)

    def choose(self, view: View) -> Choice:
        """Return what to run next in each game; nothing is drawn."""
        can = self.columns.startable(view)
        number, seen = self.index.find(view.codes)
        values = np.where(can & seen[:, None], self.values[number], -np.inf)
        known = np.isfinite(values).any(axis=1)
        column = np.where(
            known, values.argmax(axis=1), np.where(can, self.preference, -1).argmax(axis=1)
        )
        some = np.asarray(can.any(axis=1))
        column = np.where(some, column, self.columns.fallback(view))
        return Choice(column, some & ~known)


@dataclass(frozen=True)
class ExploringPolicy:
    """A greedy policy that now and then runs anything that can start."""

    greedy: GreedyPolicy
    share: float  # of decisions that explore

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        best = self.greedy.choose(view)
        free = UniformPolicy(self.greedy.columns)(view, rng)
        explore = rng.random(len(best.column)) < self.share
        return Choice(np.where(explore, free.column, best.column), best.unknown)
