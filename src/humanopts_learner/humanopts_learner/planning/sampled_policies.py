"""Policies over the options of an action set, for many games at once."""

from dataclasses import dataclass
from functools import cached_property

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_learner.execution import Choice
from humanopts_learner.planning.action_set import ActionSet, CodeTable, Observation
from humanopts_learner.planning.interruption import arbitrate, interruptions, OptionValues
from humanopts_learner.planning.request import Arbitration, MODULAR
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class UniformPolicy:
    """Any option that can start, all with the same probability; each runs to its end."""

    rng: np.random.Generator

    def choose(self, seen: Observation, games: Ints) -> Choice:
        return Choice(drawn(seen, self.rng.random(seen.startable.shape)))

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        return None


def drawn(seen: Observation, draws: Floats) -> Ints:
    """Return the option of the greatest draw (N, O) in each game, (N,)."""
    option: Ints = np.where(seen.startable, draws, -1.0).argmax(axis=1)
    np.copyto(option, seen.fallback, where=seen.fallback >= 0)
    return option


@dataclass(frozen=True)
class GreedyPolicy:
    """
    The option of the greatest value among those that can start and were sampled enough.

    Where none of those that can start was, it is the option that is the best in most states.

    :ivar values: of the abstract states visited; continuation values where the option cannot
        start. Where it can, going on is worth as much as choosing it.
    :ivar execution: of the policy; nothing is drawn in any.
    """

    actions: ActionSet
    values: OptionValues
    execution: Arbitration = Arbitration.RUN_TO_END

    @cached_property
    def preference(self) -> NDArray[np.int64]:
        """(O,) number of states in which each option is the best."""
        values = self.values.option_values
        best = values[np.isfinite(values).any(axis=1)].argmax(axis=1)
        return np.bincount(best, minlength=self.actions.first_fallback)

    def choose(self, seen: Observation, games: Ints) -> Choice:
        """Return the next option in each game; of modules the one that acts for a step."""
        row = self._row(seen)
        option_values = self._option_values(seen, row)
        choice = self._best(seen, option_values)
        if self.execution not in MODULAR:
            return choice
        going_on = self._table[2].take(row, axis=0)
        continuation_values = np.where(seen.startable, option_values, going_on)
        strongest = self.execution is Arbitration.MODULAR_STRONGEST
        competing = continuation_values if strongest else option_values
        known = np.isfinite(competing).any(axis=1)
        winner = arbitrate(self.execution, option_values, continuation_values, seen.wanted)
        unknown: Flags = np.logical_and(choice.unknown, ~known)
        return Choice(np.where(known, winner, choice.option), unknown)

    def best(self, seen: Observation) -> Ints:
        """Return (N,): the option of the greatest value, whatever the execution."""
        return self._best(seen, self._option_values(seen, self._row(seen))).option

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        """Return (N,): whether each game's option is stopped; modules run for one step."""
        if self.execution is Arbitration.RUN_TO_END:
            return None
        stopped = np.full(len(option), self.execution in MODULAR)
        if self.execution in MODULAR:
            return stopped
        running = np.flatnonzero((option >= 0) & (option < self.actions.first_fallback))
        seen = seen.take(running)
        row = self._row(seen)
        best, its = self._option_values(seen, row), option[running]
        at = np.arange(len(running)), its
        worth = np.where(seen.startable[at], best[at], self._table[2][row, its])
        margin = self.values.interruption_margin
        stopped[running] = interruptions(best, worth[:, None], margin)[:, 0]
        return stopped

    def _best(self, seen: Observation, values: Floats) -> Choice:
        """Return the best option by its values (N, O), among those that can start there."""
        option = values.argmax(axis=1)
        unknown = np.zeros(len(option), dtype=np.bool_)
        greatest = values.ravel().take(option + np.arange(0, values.size, values.shape[1]))
        others = np.flatnonzero(greatest == -np.inf)
        if others.size:
            can = seen.startable.take(others, axis=0)
            option[others] = np.where(can, self.preference, -1).argmax(axis=1)
            fallback = seen.fallback.take(others)
            unknown[others] = fallback < 0
            option[others] = np.where(fallback < 0, option[others], fallback)
        return Choice(option, unknown)

    @cached_property
    def _table(self) -> tuple[CodeTable, Floats, Floats]:
        """States (K,), option values and continuation values (K + 1, O); the last: unknown."""
        values, nothing = self.values, np.full((1, self.values.option_values.shape[1]), -np.inf)
        return (
            CodeTable(values.states),
            np.concatenate([values.option_values, nothing]),
            np.concatenate([values.continuation_values, nothing]),
        )

    def _row(self, seen: Observation) -> Ints:
        """Return (N,): the row of each game's state in the table."""
        return self._table[0].find(seen.states)

    def _option_values(self, seen: Observation, row: Ints) -> Floats:
        """Return option values (N, O); -inf: the option cannot start, or is not known."""
        values = self._table[1].take(row, axis=0)
        np.copyto(values, -np.inf, where=~seen.startable)
        return values


@dataclass(frozen=True)
class ExploringPolicy:
    """A greedy policy that sometimes runs a random option that can start, and does not stop it."""

    greedy: GreedyPolicy
    share: float  # of decisions that explore
    rng: np.random.Generator

    def choose(self, seen: Observation, games: Ints) -> Choice:
        best = self.greedy.choose(seen, games)
        draws = self.rng.random(seen.startable.shape)
        explore = np.flatnonzero(self.rng.random(len(best.option)) < self.share)
        best.option[explore] = drawn(seen.take(explore), draws.take(explore, axis=0))
        return best

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        stopped = self.greedy.stops(seen, option)
        if stopped is None:
            return None
        return stopped & (self.rng.random(len(option)) >= self.share)
