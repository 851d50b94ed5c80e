"""Policies over the columns of an action set, for many games at once."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from humanopts_learner.planning.arbitration import Execution, greatest_mass, stops, strongest
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

    def stops(self, view: View, column: Ints, rng: np.random.Generator) -> Flags:
        """Tell where what runs, column (N,), is stopped; not asked before its first step."""
        ...


class RunningToEnd:
    """A policy that stops nothing."""

    def stops(self, view: View, column: Ints, rng: np.random.Generator) -> Flags:
        """Stop nothing."""
        return np.zeros(len(column), dtype=np.bool_)


@dataclass(frozen=True)
class UniformPolicy(RunningToEnd):
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
class GreedyPolicy(RunningToEnd):
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
        return self.choose_among(view, self.columns.startable(view))

    def choose_among(self, view: View, can: Flags) -> Choice:
        """Return what to run next in each game of the columns that can start there, (N, O)."""
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
class ArbitratedPolicy:
    """
    A greedy policy whose options are interrupted, or run as modules.

    :ivar continuation_values: (S, O) value of going on with each column where it cannot start;
        where it can, that is the value of choosing it. -inf where not available.
    :ivar execution: not RUN_TO_END.
    :ivar interruption_margin: nothing is stopped for a gain up to this, reward units.
    """

    greedy: GreedyPolicy
    continuation_values: NDArray[np.float64]
    execution: Execution
    interruption_margin: float

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        choice = self.greedy.choose(view)
        if self.execution is Execution.INTERRUPTED:
            return choice
        values = self._values(view, self.greedy.columns.startable(view))
        known = np.isfinite(values).any(axis=1)
        if self.execution is Execution.MODULAR_STRONGEST:
            winner = strongest(values)
        else:
            winner = greatest_mass(values, self._actions(view), self.greedy.columns.n_actions)
        return Choice(np.where(known, winner, choice.column), choice.unknown & ~known)

    def stops(self, view: View, column: Ints, rng: np.random.Generator) -> Flags:
        """Tell where what runs is stopped; modules run for one step."""
        if self.execution is not Execution.INTERRUPTED:
            return column >= 0
        if not (column >= 0).any():
            return np.zeros(len(column), dtype=np.bool_)
        can = self.greedy.columns.startable(view)
        values, choice = self._values(view, can), self.greedy.choose_among(view, can)
        column = np.where(column < values.shape[1], column, -1)
        anew = choice.column < values.shape[1]
        best = values[np.arange(len(column)), np.where(anew, choice.column, 0)]
        return stops(values, np.where(anew, best, -np.inf), column, self.interruption_margin)

    def _values(self, view: View, can: Flags) -> NDArray[np.float64]:
        """Return what each column wants to act by, (N, O); -inf: it does not, or unknown."""
        number, seen = self.greedy.index.find(view.codes)
        found = np.where(can, self.greedy.values[number], -np.inf)
        if self.execution is not Execution.MODULAR_MASS:
            found = np.where(can, found, self.continuation_values[number])
        return np.where(seen[:, None], found, -np.inf)

    def _actions(self, view: View) -> Ints:
        """Return what each column does, (N, O)."""
        columns = self.greedy.columns
        each = [np.full(len(view.codes), c) for c in range(columns.first_fallback)]
        return np.stack([columns.actions(view, column) for column in each], axis=1)


def executed(
    greedy: GreedyPolicy,
    continuation_values: NDArray[np.float64],
    execution: Execution,
    interruption_margin: float,
) -> GreedyPolicy | ArbitratedPolicy:
    """Return a policy that is carried out in a way; parameters as in ``ArbitratedPolicy``."""
    if execution is Execution.RUN_TO_END:
        return greedy
    return ArbitratedPolicy(greedy, continuation_values, execution, interruption_margin)


@dataclass(frozen=True)
class ExploringPolicy:
    """A greedy policy that now and then runs anything that can start, and does not stop it."""

    greedy: GreedyPolicy
    share: float  # of decisions that explore
    arbitrated: ArbitratedPolicy | None = None  # how it is carried out; None: to the end

    def __call__(self, view: View, rng: np.random.Generator) -> Choice:
        """Return what to run next in each game."""
        best = (self.arbitrated or self.greedy)(view, rng)
        free = UniformPolicy(self.greedy.columns)(view, rng)
        explore = rng.random(len(best.column)) < self.share
        return Choice(np.where(explore, free.column, best.column), best.unknown)

    def stops(self, view: View, column: Ints, rng: np.random.Generator) -> Flags:
        """Tell where what runs is stopped."""
        if self.arbitrated is None:
            return self.greedy.stops(view, column, rng)
        stop = self.arbitrated.stops(view, column, rng)
        return stop & (rng.random(len(column)) >= self.share)
