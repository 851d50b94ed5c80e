"""
Gymnasium environments with a table as domains: ``gymnasium:ENV_ID``.

Everything comes from the environment's table ``P`` (P[state][action] lists probability, successor,
reward and whether the task is over there), as Taxi, FrozenLake and CliffWalking have it.
"""

from collections.abc import Collection, Sequence
from functools import cache
import json
from typing import Any, ClassVar
import warnings

import gymnasium
from humanopts_env.domains.base import BoardSlice, DomainError, StateError
from humanopts_env.domains.gymnasium_views import view_of
from humanopts_env.domains.table_domain import TableDomain
import numpy as np

PREFIX = 'gymnasium:'
GAMMA = 0.99  # Gymnasium has none
MAX_STEPS = 1000  # where the environment has no limit of its own
ROUNDING = 1e-6  # how far the probabilities of one action may be from 1 in sum
Entry = tuple[float, int, float, bool]  # probability, successor, reward, over
Table = list[list[list[Entry]]]  # by state, then action


class GymnasiumDomain(TableDomain[int]):
    """
    One environment; ``gymnasium_domain`` makes the class of each id.

    States are the observations 0..S-1. The parameters are the environment's own keyword arguments.
    """

    env_id: ClassVar[str] = ''

    def __init__(self, **arguments: Any) -> None:
        """
        Make the environment and read its table.

        :param arguments: of the environment, such as ``is_slippery``; JSON values only.
        :raises DomainError: there is no such environment, it refuses the arguments, or it has no
            table that says all of its rules.
        """
        self.name = PREFIX + self.env_id
        made, again = (_make(self.name, self.env_id, arguments) for _ in range(2))
        env = made.unwrapped
        self._table = _read_table(self.name, env)
        if _read_table(self.name, again.unwrapped) != self._table:
            raise DomainError(
                f'{self.name} is another game each time that it is made with these arguments, '
                'so a recording could not say which was played'
            )
        super().__init__(range(len(self._table)))
        self._starts = _start_shares(self.name, env, len(self._table))
        self._ends = _end_states(self.name, self._table, set(self._starts))
        self.parameters = arguments
        self.gamma = GAMMA
        self.max_steps = made.spec.max_episode_steps or MAX_STEPS
        self._view = view_of(env, self.name, self._table, set(self._starts), self._ends)
        self.features, self.actions = self._view.features, self._view.actions
        self.glyph_styles = self._view.glyph_styles

    def outcomes(self, state: int, action: int) -> Sequence[tuple[float, int, float]]:
        """Return the entries of the table, first the likeliest, of equals what is intended."""
        entries = [(share, to, gain) for share, to, gain, _ in self._table[state][action]]
        if len(entries) == 3:  # slippery grids have what is intended between two slips
            entries = [entries[1], entries[0], entries[2]]
        return sorted(entries, key=lambda entry: -round(entry[0], 9))

    def is_over(self, state: int) -> bool:
        """Tell whether the table ends the task in ``state``."""
        return state in self._ends

    def can_begin(self, state: int) -> bool:
        """Tell whether an episode can begin in ``state``."""
        return state in self._starts

    def reset(self, rng: np.random.Generator) -> int:
        """Draw a start state as the environment does."""
        states, shares = list(self._starts), np.array(list(self._starts.values()))
        return int(rng.choice(states, p=shares / shares.sum()))

    def values_of(self, state: int) -> Sequence[int]:
        """Return the value of every feature."""
        return self._view.values[state]

    def encode(self, state: int) -> str:
        """Return the state as one line, such as ``row 2, col 3``."""
        self.index(state)
        return ', '.join(f'{name} {text}' for name, text in self.shown_values(state, None).items())

    def render(self, state: int, shown: Collection[str] | None = None) -> str:
        """
        Draw the state as text lines.

        :param shown: names of the features that may be revealed; None: all.
        """
        if not 0 <= state < self.n_states:
            raise StateError(f'{state} is not a state of {self.name}')
        return self._view.draw(state, self.shown_values(state, shown))

    def board_slices(self) -> list[BoardSlice]:
        """Return the layout of a grid; none where there is no known grid."""
        return self._view.slices


@cache
def gymnasium_domain(env_id: str) -> type[GymnasiumDomain]:
    """Return the domain of one environment id, such as ``FrozenLake-v1``."""
    return type('GymnasiumDomain', (GymnasiumDomain,), {'env_id': env_id})


def _make(name: str, env_id: str, arguments: dict[str, Any]) -> Any:
    if 'render_mode' in arguments:
        raise DomainError(f'{name} is drawn as text: leave render_mode out')
    try:
        json.dumps(arguments)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of old versions: errors say what to do
            env = gymnasium.make(env_id, disable_env_checker=True, **arguments)
    except Exception as error:  # whatever a foreign environment raises
        raise DomainError(f'{name} cannot be made: {type(error).__name__}: {error}') from error
    if getattr(env.unwrapped, 'fickle_passenger', False):
        raise DomainError(
            f'{name} with fickle_passenger changes the destination outside its table'
        )
    return env


def _read_table(name: str, env: Any) -> Table:
    if not hasattr(env, 'P'):
        raise DomainError(
            f'{name} has no table of transitions (P), as FrozenLake or Taxi have; only '
            'environments with one can be domains'
        )
    for space in (env.observation_space, env.action_space):
        if not isinstance(space, gymnasium.spaces.Discrete) or space.start != 0:
            raise DomainError(f'{name} has the space {space}, and its table needs Discrete(n)')
    states, actions = int(env.observation_space.n), int(env.action_space.n)
    try:
        table = [
            [
                [(float(p), int(to), float(gain), bool(over)) for p, to, gain, over in env.P[s][a]]
                for a in range(actions)
            ]
            for s in range(states)
        ]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DomainError(f'{name} has a table that cannot be read: {error!r}') from error
    for state, row in enumerate(table):
        for action, entries in enumerate(row):
            _check_entries(f'{name}: P[{state}][{action}]', entries, states)
    return table


def _check_entries(where: str, entries: list[Entry], states: int) -> None:
    shares = [share for share, _, _, _ in entries]
    if not abs(sum(shares) - 1) <= ROUNDING or min(shares) < 0:
        raise DomainError(f'{where} has probabilities {shares}, and they must sum to 1')
    for _, to, gain, _ in entries:
        if not 0 <= to < states or not np.isfinite(gain):
            raise DomainError(f'{where} leads to state {to} of {states} with reward {gain}')


def _start_shares(name: str, env: Any, states: int) -> dict[int, float]:
    """Return the probability of each start state."""
    if hasattr(env, 'initial_state_distrib'):
        shares = np.asarray(env.initial_state_distrib, dtype=np.float64)
        found = {int(state): float(shares[state]) for state in np.flatnonzero(shares)}
    else:
        drawn = [int(env.reset(seed=seed)[0]) for seed in range(1000)]
        found = {state: drawn.count(state) / 1000 for state in sorted(set(drawn))}
    if not found or not set(found) <= set(range(states)):
        raise DomainError(f'{name} begins in no state of its table')
    return found


def _end_states(name: str, table: Table, starts: set[int]) -> set[int]:
    """
    Return the states in which the task is over.

    :raises DomainError: an episode can end in a state, and also go on from it.
    """
    entered, ended, waiting = set(starts), set(), list(starts)
    while waiting:
        for entries in table[waiting.pop()]:
            for share, to, _, over in entries:
                if over and share > 0:
                    ended.add(to)
                elif share > 0 and to not in entered:
                    entered.add(to)
                    waiting.append(to)
    if ended & entered:
        raise DomainError(
            f'{name}: state {min(ended & entered)} ends the task on one way into it and not on '
            'another, so the state alone does not say whether the task is over'
        )
    anywhere = {to for row in table for entries in row for p, to, _, over in entries if over and p}
    return anywhere - entered
