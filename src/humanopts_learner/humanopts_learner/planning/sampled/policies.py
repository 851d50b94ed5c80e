"""Policies over the options of an action set, for many games at once."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_learner.planning.interruption import arbitrate, interruptions, OptionValues
from humanopts_learner.planning.request import Execution, MODULAR
from humanopts_learner.planning.sampled.action_set import ActionSet, Observation
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Choice:
    """The next options in N games."""

    option: Ints  # (N,) indices
    unknown: Flags  # (N,) whether options can start, but none was sampled enough


class Policy(Protocol):
    """Chooses the options to run."""

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        ...

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return (N,): whether the running option is stopped; called only after its first step."""
        ...


@dataclass(frozen=True)
class UniformPolicy:
    """Any option that can start, all with the same probability; each runs to its end."""

    actions: ActionSet

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        can = seen.startable
        option = np.where(can, rng.random(can.shape), -1.0).argmax(axis=1)
        none = np.flatnonzero(~can.any(axis=1))
        if none.size:
            option[none] = self.actions.fallback(seen.rows[none])
        return Choice(option, np.zeros(len(option), dtype=np.bool_))

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return False for every game."""
        return np.zeros(len(option), dtype=np.bool_)


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
    execution: Execution = Execution.RUN_TO_END

    @cached_property
    def preference(self) -> NDArray[np.int64]:
        """(O,) number of states in which each option is the best."""
        values = self.values.option_values
        best = values[np.isfinite(values).any(axis=1)].argmax(axis=1)
        return np.bincount(best, minlength=self.actions.first_fallback)

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        return self.decide(seen)

    def decide(self, seen: Observation) -> Choice:
        """Return the next option in each game; of modules the one that acts for a step."""
        option_values, continuation_values = self._values(seen)
        choice = self._choose(seen, option_values)
        if self.execution not in MODULAR:
            return choice
        strongest = self.execution is Execution.MODULAR_STRONGEST
        competing = continuation_values if strongest else option_values
        known = np.isfinite(competing).any(axis=1)
        winner = arbitrate(self.execution, option_values, continuation_values, seen.wanted)
        return Choice(np.where(known, winner, choice.option), choice.unknown & ~known)

    def choose(self, seen: Observation) -> Choice:
        """Return the option of the greatest value in each game, whatever the execution."""
        return self._choose(seen, self._values(seen)[0])

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return (N,): whether the running option is stopped; modules run for one step."""
        if self.execution in MODULAR:
            return option >= 0
        if self.execution is Execution.RUN_TO_END or not (option >= 0).any():
            return np.zeros(len(option), dtype=np.bool_)
        stopped = interruptions(*self._values(seen), self.values.interruption_margin)
        running = (option >= 0) & (option < stopped.shape[1])
        found: Flags = running & stopped[np.arange(len(option)), np.where(running, option, 0)]
        return found

    def _choose(self, seen: Observation, values: Floats) -> Choice:
        """Return the best option by its values (N, O), among those that can start there."""
        can, known = seen.startable, np.isfinite(values).any(axis=1)
        option = np.where(
            known, values.argmax(axis=1), np.where(can, self.preference, -1).argmax(axis=1)
        )
        some = np.asarray(can.any(axis=1))
        none = np.flatnonzero(~some)
        if none.size:
            option[none] = self.actions.fallback(seen.rows[none])
        return Choice(option, some & ~known)

    def _values(self, seen: Observation) -> tuple[Floats, Floats]:
        """Return option and continuation values (N, O); -inf: not available, or not known."""
        can = seen.startable
        number, visited = self.values.find(seen.states)
        option_values = np.where(
            can & visited[:, None], self.values.option_values[number], -np.inf
        )
        going_on = np.where(visited[:, None], self.values.continuation_values[number], -np.inf)
        return option_values, np.where(can, option_values, going_on)


@dataclass(frozen=True)
class ExploringPolicy:
    """A greedy policy that sometimes runs a random option that can start, and does not stop it."""

    greedy: GreedyPolicy
    share: float  # of decisions that explore

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        best = self.greedy.decide(seen)
        free = UniformPolicy(self.greedy.actions)(seen, rng)
        explore = rng.random(len(best.option)) < self.share
        return Choice(np.where(explore, free.option, best.option), best.unknown)

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return (N,): whether the running option is stopped."""
        stop = self.greedy.stops(seen, option, rng)
        if self.greedy.execution is Execution.RUN_TO_END:
            return stop
        return stop & (rng.random(len(option)) >= self.share)
