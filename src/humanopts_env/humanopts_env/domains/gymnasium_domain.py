"""
Gymnasium environments with a transition table as domains: ``gymnasium:ENV_ID``.

Everything is read from the environment's table ``P`` (P[state][action] lists probability,
successor, reward and whether the task is over), as in Taxi, FrozenLake and CliffWalking.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
import importlib
import string
import sys
import sysconfig
from typing import Any, ClassVar
import warnings

import gymnasium
from gymnasium.envs.registration import load_env_creator
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from humanopts_env.arrays import Rows
from humanopts_env.board import Board, DOT, HATCHED_BOX, Mark, PERSON, plain_picture
from humanopts_env.colours import GREEN, GREY, ORANGE, RED, TEAL
from humanopts_env.domains import taxi
from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    DomainError,
    Feature,
    shown_values,
)
from humanopts_env.domains.capabilities import in_words, move_effect, plain_effect, StepEffect
from humanopts_env.domains.names import GYMNASIUM, package_of
from humanopts_env.domains.parameters import check_parameters
from humanopts_env.domains.table_domain import TableDomain
import numpy as np
from numpy.typing import NDArray

START, GOAL, FLOOR, NEVER = 'S', 'G', DOT, HATCHED_BOX
TILES = {  # name and colour of each cell type; floor is empty
    START: ('start', GREEN),
    'F': ('ice', GREY),
    'H': ('hole', RED),
    NEVER: ('never entered', GREY),
    GOAL: ('goal', TEAL),
}
KEYS = string.digits + string.ascii_lowercase + string.ascii_uppercase
WAYS = {
    'left': Action('left', 'left', 'move left'),
    'down': Action('down', 'down', 'move down'),
    'right': Action('right', 'right', 'move right'),
    'up': Action('up', 'up', 'move up'),
}
DIRECTIONS = {(0, -1): 'left', (1, 0): 'down', (0, 1): 'right', (-1, 0): 'up'}
ENTERED = {'H': 'fell into a hole', GOAL: 'reached the goal'}
TAXI = taxi.Taxi()  # with the same grid and state indices


@dataclass(frozen=True)
class View:
    """The presentation of one environment."""

    features: Sequence[Feature]
    values: Sequence[Sequence[float]] | Rows  # feature values by state; all distinct
    actions: tuple[Action, ...]
    board: Callable[[int, Mapping[str, str]], Board]  # state, texts of the features to show
    slices: list[BoardSlice] = field(default_factory=list)
    effect: Callable[[int, int, int], StepEffect] | None = None  # state, action, successor
    text: Callable[[int], str] | None = None  # text of a state; None: of its features


def view_of(env: Any, name: str, table: Sequence[Any], starts: set[int], ends: set[int]) -> View:
    """
    Return the view of an environment: that of Taxi, of a grid, or of numbered states.

    :raises DomainError: there are more actions than keys.
    """
    count = len(table)
    actions = _actions(env, name, len(table[0]))
    if isinstance(env, TaxiEnv):
        return View(
            TAXI.features,
            TAXI.feature_table(),
            actions,
            lambda state, seen: TAXI.board(TAXI.state_at(state), seen),
            TAXI.board_slices(),
            lambda at, action, to: TAXI.step_effect(TAXI.state_at(at), action, TAXI.state_at(to)),
            lambda state: TAXI.encode(TAXI.state_at(state)),
        )
    desc = getattr(env, 'desc', None)
    shape: tuple[int, ...] = getattr(desc, 'shape', getattr(env, 'shape', ()))
    if len(shape) == 2 and np.prod(shape) == count:
        tiles = _tiles(table, starts, ends) if desc is None else np.array(desc).astype(str).ravel()
        return _grid_view(actions, (int(shape[0]), int(shape[1])), tiles.tolist())
    state = Feature.nominal('state', 'which state it is', map(str, range(count)))
    return View((state,), [(number,) for number in range(count)], actions, _picture(env))


def _actions(env: Any, name: str, count: int) -> tuple[Action, ...]:
    if isinstance(env, TaxiEnv):
        return taxi.ACTIONS
    if isinstance(env, FrozenLakeEnv):
        return tuple(WAYS[way] for way in ('left', 'down', 'right', 'up'))
    if isinstance(env, CliffWalkingEnv):
        return tuple(WAYS[way] for way in ('up', 'right', 'down', 'left'))
    if count > len(KEYS):
        raise DomainError(f'{name} has {count} actions, and there are keys for {len(KEYS)}')
    return tuple(Action(f'action_{n}', KEYS[n], f'action {n}') for n in range(count))


# Grids.


def _grid_view(actions: tuple[Action, ...], shape: tuple[int, int], tiles: list[str]) -> View:
    """Return the view of a grid; cells that are never entered form a cliff."""
    rows, cols = shape
    ways = {name: step for step, name in DIRECTIONS.items()}
    fixed = [
        Mark(divmod(cell, cols), tile, *TILES.get(tile, (tile, '')))
        for cell, tile in enumerate(tiles)
        if tile != FLOOR
    ]

    def board(state: int, seen: Mapping[str, str]) -> Board:
        if len(seen) < 2:
            return Board(rows, cols, marks=tuple(fixed), notes=in_words(seen))
        agent = Mark(divmod(state, cols), PERSON, 'agent', ORANGE)
        return Board(rows, cols, marks=(agent, *fixed))

    def effect(state: int, action: int, successor: int) -> StepEffect:
        (row, col), (to_row, to_col) = divmod(state, cols), divmod(successor, cols)
        went, asked = DIRECTIONS.get((to_row - row, to_col - col), ''), actions[action].name
        if not went and tiles[successor] == START and NEVER in tiles:
            if state == successor:
                return StepEffect('wall or cliff: still at the start', changed=False)
            return StepEffect('fell off the cliff: back at the start')
        down, right = ways.get(asked, (0, 0))
        free = asked in ways and 0 <= row + down < rows and 0 <= col + right < cols
        moved = move_effect(asked if asked in ways else went, went, free=free)
        entered = ENTERED.get(tiles[successor], '') if moved.changed else ''
        return replace(moved, text=f'{moved.text} and {entered}') if entered else moved

    features = Feature.place('', 'the agent', rows, cols)
    values = [divmod(state, cols) for state in range(rows * cols)]
    layout = BoardSlice('board', np.arange(rows * cols, dtype=np.int32).reshape(rows, cols))
    return View(features, values, actions, board, [layout], effect)


def _tiles(table: Sequence[Any], starts: set[int], ends: set[int]) -> NDArray[np.str_]:
    """Return the type of each state as a character: start, end, entered or never entered."""
    entered = {to for row in table for entries in row for share, to, _, _ in entries if share > 0}
    return np.array(
        [
            START if s in starts else GOAL if s in ends else FLOOR if s in entered else NEVER
            for s in range(len(table))
        ]
    )


# Numbered states.


def _picture(env: Any) -> Callable[[int, Mapping[str, str]], Board]:
    """Return a function that shows the state and the environment's text rendering, if any."""
    drawn = 'ansi' in env.metadata.get('render_modes', ()) and hasattr(env, 's')

    def board(state: int, seen: Mapping[str, str]) -> Board:
        if not drawn or not seen:
            return Board(notes=in_words(seen))
        env.s, env.render_mode, env.lastaction = state, 'ansi', None
        return Board(picture=plain_picture(env.render()), notes=in_words(seen))

    return board


GAMMA = 0.99  # not defined by Gymnasium
MAX_STEPS = 1000  # if the environment has no limit
ROUNDING = 1e-6  # tolerance for the sum of an action's probabilities
Entry = tuple[float, int, float, bool]  # probability, successor, reward, over
Table = list[list[list[Entry]]]  # by state, then action


class NoTableError(DomainError):
    """The environment has no table of its transitions."""


class GymnasiumDomain(TableDomain[int]):
    """
    The domain of one environment; ``gymnasium_domain`` creates a class for each id.

    States are the observations 0..S-1. The parameters are the environment's keyword arguments.
    """

    env_id: ClassVar[str] = ''

    def __init__(self, **arguments: Any) -> None:
        """
        Create the environment and read its table.

        :param arguments: arguments of the environment, such as ``is_slippery``; JSON values only.
        :raises DomainError: the environment is unknown, refuses the arguments, or has no complete
            table of its rules.
        """
        self.name = GYMNASIUM + self.env_id
        made = make_env(self.name, self.env_id, arguments)
        env = made.unwrapped
        self._table = _read_table(self.name, env)
        again = make_env(self.name, self.env_id, arguments)
        if _read_table(self.name, again.unwrapped) != self._table:
            raise DomainError(
                f'{self.name} becomes a different game each time it is made with these '
                'arguments, so a recording could not say which was played'
            )
        super().__init__(range(len(self._table)))
        self._starts = _start_shares(self.name, env, len(self._table))
        self._ends = _end_states(self.name, self._table, set(self._starts))
        self.parameters = arguments
        self.gamma = GAMMA
        self.max_steps = made.spec.max_episode_steps or MAX_STEPS
        self._view = view_of(env, self.name, self._table, set(self._starts), self._ends)
        self.features, self.actions = self._view.features, self._view.actions

    def outcomes(self, state: int, action: int) -> Sequence[tuple[float, int, float]]:
        """Return the table entries, the most probable first; among equals, the intended one."""
        entries = [(share, to, gain) for share, to, gain, _ in self._table[state][action]]
        if len(entries) == 3:  # slippery grids list the intended outcome between two slips
            entries = [entries[1], entries[0], entries[2]]
        return sorted(entries, key=lambda entry: -round(entry[0], 9))

    def is_over(self, state: int) -> bool:
        """Return whether the table ends the task in ``state``."""
        return state in self._ends

    def can_begin(self, state: int) -> bool:
        """Return whether an episode can begin in ``state``."""
        return state in self._starts

    def reset(self, rng: np.random.Generator) -> int:
        """Draw a start state with the environment's probabilities."""
        states, shares = list(self._starts), np.array(list(self._starts.values()))
        return int(rng.choice(states, p=shares / shares.sum()))

    def values_of(self, state: int) -> Sequence[float]:
        return tuple(self._view.values[state])

    def encode(self, state: int) -> str:
        """Return the state as one line, such as ``row 2, col 3``."""
        self.index(state)
        if self._view.text is not None:
            return self._view.text(state)
        return ', '.join(f'{name} {text}' for name, text in shown_values(self, state).items())

    def board(self, state: int, shown: Collection[str] | None = None) -> Board:
        self.index(state)
        return self._view.board(state, shown_values(self, state, shown))

    def step_effect(self, state: int, action: int, successor: int) -> StepEffect:
        if self._view.effect is None:
            return plain_effect(self, state, action, successor)
        return self._view.effect(state, action, successor)

    def board_slices(self) -> list[BoardSlice]:
        """Return the layout of the grid; empty if the states do not form a grid."""
        return self._view.slices


@cache
def gymnasium_domain(env_id: str) -> type[GymnasiumDomain]:
    """Return the domain of one environment id, such as ``FrozenLake-v1``."""
    return type('GymnasiumDomain', (GymnasiumDomain,), {'env_id': env_id})


def make_env(
    name: str, env_id: str, arguments: Mapping[str, Any], render_mode: str | None = None
) -> Any:
    """
    Create an environment.

    :param name: name of the domain, for errors.
    :raises DomainError: the environment is unknown, refuses the arguments, or raises an error.
    """
    if 'render_mode' in arguments:
        raise DomainError(
            f'the render mode of {name} is chosen automatically: leave render_mode out'
        )
    package = package_of(env_id)
    mode: dict[str, Any] = {} if render_mode is None else {'render_mode': render_mode}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # warnings about old versions
            if package:
                importlib.import_module(package)
            _check_arguments(name, env_id, arguments)
            return gymnasium.make(env_id, disable_env_checker=True, **mode, **arguments)
    except DomainError:
        raise
    except ModuleNotFoundError as error:
        missing = package or error.name
        raise DomainError(
            f'{name} needs the module {missing}; install its package: '
            f'{sys.executable} -m pip install {missing} (a file of your own, {missing}.py, goes '
            f'into {sysconfig.get_path("purelib")})'
        ) from error
    except gymnasium.error.UnregisteredEnv as error:
        hint = 'if another package registers it, name its module, as in gymnasium:MODULE:ENV_ID'
        raise DomainError(f'{name} cannot be made: {error} ({hint})') from error
    except Exception as error:  # any error of a third-party environment
        raise DomainError(f'{name} cannot be made: {type(error).__name__}: {error}') from error


def _check_arguments(name: str, env_id: str, arguments: Mapping[str, Any]) -> None:
    """
    Check arguments against the types of the constructor and of the registered arguments.

    :raises DomainError: an argument is unknown or has the wrong type.
    """
    try:
        spec = gymnasium.spec(env_id)
        entry = spec.entry_point
        constructor = load_env_creator(entry) if isinstance(entry, str) else entry
    except Exception:  # import error: creation will report it
        return
    common = {'max_episode_steps'}  # argument of gymnasium.make
    own = {key: value for key, value in arguments.items() if key not in common}
    if constructor is not None:
        check_parameters(name, constructor, own, spec.kwargs)
    check_parameters(name, gymnasium.make, {k: arguments[k] for k in common & arguments.keys()})


def _read_table(name: str, env: Any) -> Table:
    if not hasattr(env, 'P'):
        raise NoTableError(f'{name} has no table of transitions (P), unlike FrozenLake or Taxi')
    if getattr(env, 'fickle_passenger', False):
        raise DomainError(
            f'{name} with fickle_passenger changes the destination outside its table'
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
        raise DomainError(f'{where} has probabilities {shares}, but they must sum to 1')
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

    :raises DomainError: some transitions into a state end the task, and others do not.
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
            f'{name}: state {min(ended & entered)} ends the task when entered one way but not '
            'when entered another, so the state alone does not say whether the task is over'
        )
    anywhere = {to for row in table for entries in row for p, to, _, over in entries if over and p}
    return anywhere - entered
