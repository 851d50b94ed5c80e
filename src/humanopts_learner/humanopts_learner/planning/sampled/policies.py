"""Policies over the options of an action set, for many games at once."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from humanopts_env.arrays import Flags, Ints
from humanopts_learner.planning.arbitration import greatest_mass, stops, strongest
from humanopts_learner.planning.request import Execution
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.sampled_models import StateIndex
from humanopts_learner.planning.sampled.state_abstraction import Observation
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


class RunningToEnd:
    """A policy that never stops a running option."""

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return False for every game."""
        return np.zeros(len(option), dtype=np.bool_)


@dataclass(frozen=True)
class UniformPolicy(RunningToEnd):
    """Any option that can start, all with the same probability."""

    actions: ActionSet

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        can = self.actions.startable(seen.rows)
        option = np.where(can, rng.random(can.shape), -1.0).argmax(axis=1)
        none = ~can.any(axis=1)
        option = np.where(none, self.actions.fallback(seen.rows), option)
        return Choice(option, np.zeros(len(option), dtype=np.bool_))


@dataclass(frozen=True)
class GreedyPolicy(RunningToEnd):
    """
    The option of the greatest value among those that can start and were sampled enough.

    Where none of those that can start was, it is the option that is the best in most states.
    """

    actions: ActionSet
    index: StateIndex
    values: NDArray[np.float64]  # (S, O), -inf where not available

    @cached_property
    def preference(self) -> NDArray[np.int64]:
        """(O,) number of states in which each option is the best."""
        known = np.isfinite(self.values).any(axis=1)
        best = self.values[known].argmax(axis=1)
        return np.bincount(best, minlength=self.actions.first_fallback)

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        return self.choose(seen)

    def choose(self, seen: Observation) -> Choice:
        """Return the next option in each game, without random draws."""
        return self.choose_among(seen, self.actions.startable(seen.rows))

    def choose_among(self, seen: Observation, can: Flags) -> Choice:
        """Return the next option in each game, among those that can start there (N, O)."""
        number, visited = self.index.find(seen.states)
        values = np.where(can & visited[:, None], self.values[number], -np.inf)
        known = np.isfinite(values).any(axis=1)
        option = np.where(
            known, values.argmax(axis=1), np.where(can, self.preference, -1).argmax(axis=1)
        )
        some = np.asarray(can.any(axis=1))
        option = np.where(some, option, self.actions.fallback(seen.rows))
        return Choice(option, some & ~known)


@dataclass(frozen=True)
class ArbitratedPolicy:
    """
    A greedy policy whose options are interrupted, or run as modules.

    :ivar continuation_values: (S, O) value of continuing each option where it cannot start; where
        it can start, the value of choosing it. -inf where not available.
    :ivar execution: not RUN_TO_END.
    :ivar interruption_margin: options are stopped only for a larger gain, reward units.
    """

    greedy: GreedyPolicy
    continuation_values: NDArray[np.float64]
    execution: Execution
    interruption_margin: float

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        choice = self.greedy.choose(seen)
        if self.execution is Execution.INTERRUPTED:
            return choice
        actions = self.greedy.actions
        values = self._values(seen, actions.startable(seen.rows))
        known = np.isfinite(values).any(axis=1)
        if self.execution is Execution.MODULAR_STRONGEST:
            winner = strongest(values)
        else:
            winner = greatest_mass(values, self._actions(seen), actions.n_actions)
        return Choice(np.where(known, winner, choice.option), choice.unknown & ~known)

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return (N,): whether the running option is stopped; modules run for one step."""
        if self.execution is not Execution.INTERRUPTED:
            return option >= 0
        if not (option >= 0).any():
            return np.zeros(len(option), dtype=np.bool_)
        can = self.greedy.actions.startable(seen.rows)
        values, choice = self._values(seen, can), self.greedy.choose_among(seen, can)
        option = np.where(option < values.shape[1], option, -1)
        modelled = choice.option < values.shape[1]
        best = values[np.arange(len(option)), np.where(modelled, choice.option, 0)]
        return stops(values, np.where(modelled, best, -np.inf), option, self.interruption_margin)

    def _values(self, seen: Observation, can: Flags) -> NDArray[np.float64]:
        """Return (N, O): the values that options compete with; -inf: unavailable or unknown."""
        number, visited = self.greedy.index.find(seen.states)
        found = np.where(can, self.greedy.values[number], -np.inf)
        if self.execution is not Execution.MODULAR_MASS:
            found = np.where(can, found, self.continuation_values[number])
        return np.where(visited[:, None], found, -np.inf)

    def _actions(self, seen: Observation) -> Ints:
        """Return (N, O): the primitive action of each option."""
        actions = self.greedy.actions
        each = [np.full(len(seen.states), o) for o in range(actions.first_fallback)]
        return np.stack([actions.actions(seen, option) for option in each], axis=1)


def as_executed(
    greedy: GreedyPolicy,
    continuation_values: NDArray[np.float64],
    execution: Execution,
    interruption_margin: float,
) -> GreedyPolicy | ArbitratedPolicy:
    """Return a policy with a way of execution; parameters as in ``ArbitratedPolicy``."""
    if execution is Execution.RUN_TO_END:
        return greedy
    return ArbitratedPolicy(greedy, continuation_values, execution, interruption_margin)


@dataclass(frozen=True)
class ExploringPolicy:
    """A greedy policy that sometimes runs a random option that can start, and does not stop it."""

    greedy: GreedyPolicy
    share: float  # of decisions that explore
    arbitrated: ArbitratedPolicy | None = None  # how it is executed; None: run to the end

    def __call__(self, seen: Observation, rng: np.random.Generator) -> Choice:
        """Return the next option in each game."""
        best = (self.arbitrated or self.greedy)(seen, rng)
        free = UniformPolicy(self.greedy.actions)(seen, rng)
        explore = rng.random(len(best.option)) < self.share
        return Choice(np.where(explore, free.option, best.option), best.unknown)

    def stops(self, seen: Observation, option: Ints, rng: np.random.Generator) -> Flags:
        """Return (N,): whether the running option is stopped."""
        if self.arbitrated is None:
            return self.greedy.stops(seen, option, rng)
        stop = self.arbitrated.stops(seen, option, rng)
        return stop & (rng.random(len(option)) >= self.share)
