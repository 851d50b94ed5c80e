"""What a person sees of a Gymnasium environment: features, keys and drawings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import re
import string
from typing import Any

from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from humanopts_env.domains import taxi_board, taxi_tables
from humanopts_env.domains.base import Action, BoardSlice, DomainError, Feature, FeatureKind
import numpy as np
from numpy.typing import NDArray

AGENT, FLOOR, START, GOAL, NEVER = '☻', '·', 'S', 'G', '▒'
GRID_STYLES = {
    AGENT: 'bold bright_yellow',
    FLOOR: 'dim',
    NEVER: 'grey50',
    START: 'green',
    GOAL: 'bold bright_cyan',
    'H': 'bold red',
    'F': 'dim',
}
TILES = {
    AGENT: 'agent',
    START: 'start',
    'F': 'ice',
    'H': 'hole',
    FLOOR: 'floor',
    NEVER: 'never entered',
    GOAL: 'goal',
}
HIGHLIGHT = re.compile(r'(?:\x1b\[[\d;]*m)*\x1b\[(?:\d+;)*4\d(?:;\d+)*m([^\x1b]*)\x1b\[0?m')
ESCAPE = re.compile(r'\x1b\[[\d;]*m')
KEYS = string.digits + string.ascii_lowercase + string.ascii_uppercase
WAYS = {
    'left': Action('left', 'left', 'move left'),
    'down': Action('down', 'down', 'move down'),
    'right': Action('right', 'right', 'move right'),
    'up': Action('up', 'up', 'move up'),
}
IN_TAXI = 'in the taxi'
PASSENGER = (*taxi_tables.LANDMARKS, IN_TAXI)


@dataclass(frozen=True)
class View:
    """How one environment is shown."""

    features: tuple[Feature, ...]
    values: Sequence[tuple[int, ...]]  # of the features, by state; no two alike
    actions: tuple[Action, ...]
    draw: Callable[[int, Mapping[str, str]], str]  # state, what may be seen: feature -> value
    slices: list[BoardSlice] = field(default_factory=list)
    glyph_styles: Mapping[str, str] = field(default_factory=dict)


def view_of(env: Any, name: str, table: Sequence[Any], starts: set[int], ends: set[int]) -> View:
    """
    Return the view of an environment: Taxi's, a grid's, or that of numbered states.

    :raises DomainError: it has more actions than there are keys.
    """
    count = len(table)
    actions = _actions(env, name, len(table[0]))
    if isinstance(env, TaxiEnv):
        return _taxi_view(env, actions)
    desc = getattr(env, 'desc', None)
    shape: tuple[int, ...] = getattr(desc, 'shape', getattr(env, 'shape', ()))
    if len(shape) == 2 and np.prod(shape) == count:
        tiles = _tiles(table, starts, ends) if desc is None else np.array(desc).astype(str).ravel()
        return _grid_view(actions, (int(shape[0]), int(shape[1])), tiles.tolist())
    state = Feature('state', 'which state it is', FeatureKind.NOMINAL, _numbers(count))
    return View((state,), [(number,) for number in range(count)], actions, _drawing(env))


def _actions(env: Any, name: str, count: int) -> tuple[Action, ...]:
    if isinstance(env, TaxiEnv):
        return taxi_tables.ACTIONS
    if isinstance(env, FrozenLakeEnv):
        return tuple(WAYS[way] for way in ('left', 'down', 'right', 'up'))
    if isinstance(env, CliffWalkingEnv):
        return tuple(WAYS[way] for way in ('up', 'right', 'down', 'left'))
    if count > len(KEYS):
        raise DomainError(f'{name} has {count} actions, and there are keys for {len(KEYS)}')
    return tuple(Action(f'action_{n}', KEYS[n], f'action {n}') for n in range(count))


# Grids.


def _grid_view(actions: tuple[Action, ...], shape: tuple[int, int], tiles: list[str]) -> View:
    rows, cols = shape
    present = (f'{tile} {what}' for tile, what in TILES.items() if tile == AGENT or tile in tiles)
    legend = '   '.join(present)

    def draw(state: int, seen: Mapping[str, str]) -> str:
        at = state if len(seen) == 2 else -1  # drawn only where row and column may be seen
        cells = [(AGENT if cell == at else ' ') + tile for cell, tile in enumerate(tiles)]
        lines = [''.join(cells[row * cols : (row + 1) * cols]) for row in range(rows)]
        return '\n'.join([*lines, legend, *([] if len(seen) == 2 else [_words(seen)])])

    features = (
        Feature('row', 'which row the agent is in', FeatureKind.ORDINAL, _numbers(rows)),
        Feature('col', 'which column the agent is in', FeatureKind.ORDINAL, _numbers(cols)),
    )
    values = [divmod(state, cols) for state in range(rows * cols)]
    cells = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    return View(features, values, actions, draw, [BoardSlice('board', cells)], GRID_STYLES)


def _tiles(table: Sequence[Any], starts: set[int], ends: set[int]) -> NDArray[np.str_]:
    """Return a character for each state: a start, an end, one that is entered, or never."""
    entered = {to for row in table for entries in row for share, to, _, _ in entries if share > 0}
    return np.array(
        [
            START if s in starts else GOAL if s in ends else FLOOR if s in entered else NEVER
            for s in range(len(table))
        ]
    )


# Taxi.


def _taxi_view(env: Any, actions: tuple[Action, ...]) -> View:
    features = (
        Feature('taxi_row', 'which row the taxi is in', FeatureKind.ORDINAL, _numbers(5)),
        Feature('taxi_col', 'which column the taxi is in', FeatureKind.ORDINAL, _numbers(5)),
        Feature('passenger', 'where the passenger is', FeatureKind.NOMINAL, PASSENGER),
        Feature(
            'destination', 'where the destination is', FeatureKind.NOMINAL, taxi_tables.LANDMARKS
        ),
    )
    values = [tuple(map(int, env.decode(state))) for state in range(500)]
    states = np.arange(500, dtype=np.int32).reshape(5, 5, 5, 4)
    slices = [
        BoardSlice(f'passenger {PASSENGER[place]}, destination B', states[:, :, place, 3])
        for place in (0, taxi_tables.ABOARD)
    ]
    return View(features, values, actions, _draw_taxi, slices, taxi_board.GLYPH_STYLES)


def _draw_taxi(state: int, seen: Mapping[str, str]) -> str:
    """Draw the board of our own Taxi, which is the same grid, with what may be seen."""
    known = {feature.name: feature for feature in taxi_tables.taxi_features(5, 5)}
    cells = taxi_tables.landmark_cells(5, 5)
    shown = {name: int(seen[name]) for name in ('taxi_row', 'taxi_col') if name in seen}
    if 'passenger' in seen:
        shown['passenger_in_taxi'] = int(seen['passenger'] == IN_TAXI)
    for thing in ('passenger', 'destination'):
        if seen.get(thing) in cells:
            shown[f'{thing}_row'], shown[f'{thing}_col'] = cells[seen[thing]]
    values = [(known[name], value) for name, value in shown.items()]
    return taxi_board.draw_board(taxi_tables.walls_east(5, 5), cells, values)


# Numbered states.


def _drawing(env: Any) -> Callable[[int, Mapping[str, str]], str]:
    """Return what draws by the environment's own text, where it has one, and in words."""
    drawn = 'ansi' in env.metadata.get('render_modes', ()) and hasattr(env, 's')

    def draw(state: int, seen: Mapping[str, str]) -> str:
        if not drawn or not seen:
            return _words(seen)
        env.s, env.render_mode, env.lastaction = state, 'ansi', None
        text = HIGHLIGHT.sub(lambda match: '█' * len(match[1]), env.render())
        return ESCAPE.sub('', text).rstrip() + '\n' + _words(seen)

    return draw


def _words(seen: Mapping[str, str]) -> str:
    return '   '.join(f'{name.replace("_", " ")}: {value}' for name, value in seen.items())


def _numbers(count: int) -> tuple[str, ...]:
    return tuple(map(str, range(count)))
