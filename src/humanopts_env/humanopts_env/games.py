"""
N independent games of one domain, stepped in place.

There are three implementations: ``TableGames`` if all states can be listed, the domain's own
arrays if it has them (``HasGames``), and ``StateGames``, state by state, for any domain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable, Self

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.tabular import TabularSimulator
import numpy as np
from numpy.typing import NDArray

# Generators for the outcomes of steps: one for all games, or one for each of the N games. With its
# own generator, a game draws the same outcomes as ``Domain.step``, independently of other games.
Chance = np.random.Generator | Sequence[np.random.Generator]


@dataclass(frozen=True, slots=True)
class Steps:
    """The results of one step of N games."""

    reward: Floats  # (N,); 0 if the game was already over
    over: Flags  # (N,) whether the task is over now


class Games(Protocol):
    """N games of one domain; finished games do not change."""

    @property
    def domain(self) -> Domain:
        """The domain."""

    def __len__(self) -> int:
        """Return the number of games, N."""

    def features(self) -> Rows:
        """Return all features, (N, F)."""

    def over(self) -> Flags:
        """Return (N,): whether the task is over."""

    def step(self, actions: Ints, chance: Chance) -> Steps:
        """
        Take one step in every game that is not over.

        :param actions: (N,) indices of primitive actions.
        """

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        """Restart the games with indices (M,), like ``Domain.reset``."""

    def take(self, games: Ints) -> Self:
        """Return copies of the games with indices (M,), in any order, possibly repeated."""

    def states(self) -> list[Any]:
        """Return the state of each game."""

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        """Return the reported outcomes of the games other than the return, (N,) each, by name."""


@runtime_checkable
class HasGames(Protocol):
    """A domain with its own array implementation of many games."""

    def games(self, states: Sequence[Any]) -> Games:
        """Return games in given states."""


def games_at(domain: Domain, states: Sequence[Any]) -> Games:
    """Return games of a domain in given states, with the fastest implementation."""
    if isinstance(domain, HasGames):
        return domain.games(states)
    if is_enumerable(domain):
        return TableGames.at(domain, states)
    return StateGames(domain, list(states))


def new_games(domain: Domain, count: int, chance: np.random.Generator) -> Games:
    """Start N games in start states."""
    one = games_at(domain, [domain.reset(np.random.default_rng(0))])
    games = one.take(np.zeros(count, dtype=np.intp))
    games.reset(np.arange(count), chance)
    return games


def feature_rows(domain: Domain, states: Sequence[Any]) -> Rows:
    """Return the features of N states, (N, F)."""
    return games_at(domain, states).features()


def chance_of(chance: Chance, games: Ints) -> Chance:
    """Return the generators for the games with indices (M,)."""
    if isinstance(chance, np.random.Generator):
        return chance
    return [chance[game] for game in games.tolist()]


class TableGames:
    """Games of an enumerable domain; ``state`` (N,) has the index of each game's state."""

    def __init__(
        self, domain: EnumerableDomain, state: Ints, simulator: TabularSimulator | None = None
    ) -> None:
        """
        Create the games; ``state`` is modified in place.

        :param simulator: simulator of the domain; None: create one.
        """
        self.domain, self.state = domain, state
        self._simulator = simulator or TabularSimulator(domain.transitions(), domain.over())

    @classmethod
    def at(cls, domain: EnumerableDomain, states: Sequence[Any]) -> Self:
        """Return games in given states."""
        return cls(domain, np.array([domain.index(state) for state in states], dtype=np.intp))

    def __len__(self) -> int:
        return len(self.state)

    def features(self) -> Rows:
        return self.domain.feature_table().take(self.state, axis=0)

    def over(self) -> Flags:
        return self.domain.over().take(self.state)

    def step(self, actions: Ints, chance: Chance) -> Steps:
        drawn = None
        if self._simulator.deterministic:
            pass
        elif isinstance(chance, np.random.Generator):
            drawn = chance.random(len(self.state))
        else:
            drawn = np.array([rng.random() for rng in chance])
        there, reward, over = self._simulator.step(self.state, actions, drawn)
        before = self.over()
        if before.any():
            there, reward = np.where(before, self.state, there), np.where(before, 0.0, reward)
        self.state = there
        return Steps(reward, over | before)

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        self.state[games] = chance.choice(self.domain.start_states(), len(games))

    def take(self, games: Ints) -> Self:
        return type(self)(self.domain, self.state.take(games), self._simulator)

    def states(self) -> list[Any]:
        return [self.domain.state_at(index) for index in self.state.tolist()]

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        return {}


class StateGames:
    """Games of any domain, as a list of states, stepped one by one."""

    def __init__(self, domain: Domain, states: list[Any]) -> None:
        self.domain, self._states = domain, states

    def __len__(self) -> int:
        return len(self._states)

    def features(self) -> Rows:
        rows = [self.domain.feature_values(state) for state in self._states]
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(self.domain.features))

    def over(self) -> Flags:
        return np.array([self.domain.is_over(state) for state in self._states], dtype=np.bool_)

    def step(self, actions: Ints, chance: Chance) -> Steps:
        reward, over = np.zeros(len(self)), self.over()
        for game in np.flatnonzero(~over).tolist():
            rng = chance if isinstance(chance, np.random.Generator) else chance[game]
            outcome = self.domain.step(self._states[game], int(actions[game]), rng)
            self._states[game], reward[game] = outcome.state, outcome.reward
            over[game] = outcome.terminated
        return Steps(reward, over)

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        for game in games.tolist():
            self._states[game] = self.domain.reset(chance)

    def take(self, games: Ints) -> 'StateGames':
        return StateGames(self.domain, [self._states[game] for game in games.tolist()])

    def states(self) -> list[Any]:
        return list(self._states)

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        return {}
