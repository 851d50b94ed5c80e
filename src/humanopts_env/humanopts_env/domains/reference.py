"""
Reference options: options known exactly from the rules of a game.

They are the reference for accuracy and the policy of the simulated teacher. Learning never uses
them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.games import Games, TableGames
import numpy as np
from numpy.typing import NDArray


class ReferenceOption(Hashable, Protocol):
    """An option with exactly known initiation set, policy and termination condition."""

    @property
    def name(self) -> str:
        """The name shown to people, in lower case."""

    @property
    def features(self) -> tuple[str, ...]:
        """The relevant features, in the domain's order."""

    @property
    def definition(self) -> str:
        """The initiation set, policy and termination condition in words."""

    def can_start(self, state: Any) -> bool:
        """Return whether the state is in the initiation set."""

    def ends(self, state: Any) -> bool:
        """Return whether the termination condition holds; False if the task is over before."""

    def optimal_actions(self, state: Any) -> tuple[int, ...]:
        """
        Return every action on a shortest path to the end, the usual one first.

        Empty outside the initiation set.
        """


@runtime_checkable
class StartDependent(Protocol):
    """A ``ReferenceOption`` with an end that depends on the start of the run."""

    def begun(self, state: Any) -> ReferenceOption:
        """Return the option for a run that starts in a state."""


@runtime_checkable
class KnowsGoal(Protocol):
    """A ``ReferenceOption`` that can also end without reaching its goal."""

    def reached(self, state: Any) -> bool:
        """Return whether the option ends at its goal in a state."""


def reached(option: ReferenceOption, state: Any) -> bool:
    """Return whether a reference option ends at its goal in a state."""
    return option.reached(state) if isinstance(option, KnowsGoal) else option.ends(state)


@dataclass(frozen=True, slots=True)
class Judgement:
    """The values of a reference option in N states."""

    initiation: Flags  # (N,)
    termination: Flags  # (N,)
    optimal: Flags  # (N, A), False outside the initiation set


class JudgedOption(ABC):
    """A ``ReferenceOption`` that evaluates many states at once; one state is a batch of one."""

    @abstractmethod
    def judge_states(self, states: Sequence[Any]) -> Judgement:
        """Evaluate N states."""

    def judge_games(self, games: Any) -> Judgement:
        """Evaluate the states of N ``Games``."""
        return self.judge_states(games.states())

    def can_start(self, state: Any) -> bool:
        """Return whether the state is in the initiation set."""
        return bool(self.judge_states([state]).initiation[0])

    def ends(self, state: Any) -> bool:
        """Return whether the termination condition holds."""
        return bool(self.judge_states([state]).termination[0])

    def optimal_actions(self, state: Any) -> tuple[int, ...]:
        """Return every best action; empty outside the initiation set."""
        return tuple(np.flatnonzero(self.judge_states([state]).optimal[0]).tolist())


def judge_states(option: ReferenceOption, states: Sequence[Any], n_actions: int) -> Judgement:
    """Evaluate N states with a reference option: in one batch if possible, else one by one."""
    if isinstance(option, JudgedOption):
        return option.judge_states(states)
    optimal = np.zeros((len(states), n_actions), dtype=np.bool_)
    for row, state in zip(optimal, states):
        row[list(option.optimal_actions(state))] = True
    return Judgement(
        np.array([option.can_start(state) for state in states], dtype=np.bool_),
        np.array([option.ends(state) for state in states], dtype=np.bool_),
        optimal,
    )


def judge_games(option: ReferenceOption, games: Games) -> Judgement:
    """Evaluate the states of N games with a reference option."""
    if isinstance(option, JudgedOption):
        return option.judge_games(games)
    return judge_states(option, games.states(), len(games.domain.actions))


@dataclass(frozen=True, eq=False)
class TabularReferenceOption(JudgedOption):
    """A reference option of an enumerable domain, as arrays over its S states and A actions."""

    domain: EnumerableDomain
    name: str
    features: tuple[str, ...]
    initiation: Flags  # (S,)
    termination: Flags  # (S,)
    optimal: Flags  # (S, A), False outside the initiation set
    distance: NDArray[np.int32]  # (S,) steps to the end; -1 outside the initiation set
    judged: Flags  # (S,) reachable states, for evaluating learned I and beta
    definition: str = ''  # in words

    def judge_states(self, states: Sequence[Any]) -> Judgement:
        """Evaluate N states in one batch."""
        return self._at(np.array([self.domain.index(state) for state in states], dtype=np.intp))

    def judge_games(self, games: Games) -> Judgement:
        """Evaluate the states of N games."""
        if isinstance(games, TableGames):
            return self._at(games.state)
        return self.judge_states(games.states())

    @cached_property
    def goal(self) -> Flags:
        """(S,): the ends of shortest paths, without ends that are reached only by chance."""
        found = np.zeros(len(self.distance), dtype=np.bool_)
        found[self.domain.transitions().successor[:, :, 0][self.optimal]] = True
        return found & self.termination & (self.distance < 0)

    def reached(self, state: Any) -> bool:
        """Return whether a shortest path ends in a state."""
        return bool(self.goal[self.domain.index(state)])

    def _at(self, states: Ints) -> Judgement:
        return Judgement(self.initiation[states], self.termination[states], self.optimal[states])


@dataclass(frozen=True)
class Rule:
    """An option defined by functions of an environment and its newest observation."""

    name: str
    definition: str
    features: tuple[str, ...]  # relevant features, if the environment has them
    best: Callable[[Any, Any], Sequence[int]]  # actions, the usual one first; empty: cannot start
    done: Callable[[Any, Any], bool]  # whether the end is reached
