"""The maze as text, two characters to a cell, revealing only the features that may be shown."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

from humanopts_env.arrays import Flags
from humanopts_env.colours import BLUE, GREEN, MAGENTA, ORANGE, RED, TEAL
from humanopts_env.domains.base import Feature
from humanopts_env.domains.pacman.maze import Cell, Maze, WALL
from humanopts_env.domains.pacman.paths import DELTAS
from humanopts_env.domains.pacman.state import eaten_names, PacManState
import numpy as np

PACMAN, FOOD, PILL, FRUIT, LIFE, LOST = 'C', '·', '●', '♣', '♥', '♡'
GHOSTS, SCARED = 'ΩΨΦΔ', 'ωψφδ'
WALLS = '■╵╴╯╶╰─┴╷│╮┤╭├┬┼'  # by sides that continue: bits 0 north, 1 west, 2 east, 3 south
EXPLANATION = (
    ('', 'Eat all the food. A ghost that meets you takes a life.'),
    (PACMAN, 'Pac-Man, whom you drive'),
    (FOOD, 'food: 10 points'),
    (PILL, 'a power pill: 50 points; it scares the ghosts for a while'),
    (FRUIT, 'fruit, which is there for a short time: 100 points'),
    (' '.join(GHOSTS), 'ghosts'),
    (' '.join(SCARED), 'scared ghosts: 200 points each'),
    (f'{LIFE} {LOST}', 'lives that are left and lost'),
)
GLYPH_STYLES = {
    **dict.fromkeys(WALLS, BLUE),
    **{ghost: f'bold {colour}' for ghost, colour in zip(GHOSTS, (RED, MAGENTA, TEAL, GREEN))},
    **dict.fromkeys(SCARED, f'bold {BLUE}'),
    PACMAN: f'bold {ORANGE}',
    PILL: 'bold',
    FRUIT: f'bold {RED}',
    LIFE: f'bold {ORANGE}',
    LOST: 'dim',
}
Thing = tuple[str, str, Cell]  # glyph, name, cell; the first in a cell is in front


def draw_state(maze: Maze, state: PacManState, lives: int) -> str:
    """
    Draw everything.

    :param lives: of a new game.
    """
    things, legend = [(PACMAN, 'pac-man', maze.cells[state.pacman])], []
    for number, ghost in enumerate(state.ghosts):
        glyph, name = (SCARED if ghost.scared else GHOSTS)[number], f'ghost {number + 1}'
        things.append((glyph, name, maze.cells[ghost.cell]))
        fear = f' scared {_steps(ghost.scared)}' if ghost.scared else ''
        legend.append(f'{glyph} {name}{fear}')
    if state.fruit:
        things.append((FRUIT, 'fruit', maze.cells[state.fruit_at]))
        legend.append(f'{FRUIT} fruit {_steps(state.fruit)}')
    for glyph, name, cells, mask in (
        (FOOD, 'food', maze.food, state.food),
        (PILL, 'power pill', maze.pills, state.pills),
    ):
        things += [(glyph, name, maze.cells[c]) for k, c in enumerate(cells) if mask >> k & 1]
    score = [
        f'score {state.score}',
        f'lives {LIFE * state.lives}{LOST * (lives - state.lives)}',
        f'food left {state.food.bit_count()}',
        f'ate {" and ".join(eaten_names(state.ate)) or "nothing"}',
    ]
    return _join(_grid(maze, things), score, *_threes(legend), _hidden(things))


def draw_features(maze: Maze, shown: Sequence[tuple[Feature, int]]) -> str:
    """
    Draw the maze, a legend, and in words the features of ``shown`` that the drawing lacks.

    :param shown: features that may be revealed, with their values; nothing else is used.
    """
    values = {feature.name: value for feature, value in shown}
    things = []
    for prefix, glyph, name in _movable(maze, values):
        place = (values.get(f'{prefix}_row', maze.rows), values.get(f'{prefix}_col', maze.cols))
        if place[0] < maze.rows and place[1] < maze.cols:
            things.append((prefix, (glyph, name, place)))
    drawn = {prefix for prefix, _ in things}
    facts = [
        f'{feature.name.replace("_", " ")}: {feature.values[value]}'
        for feature, value in shown
        if not _expressed_by(feature.name) <= drawn
    ]
    legend = [f'{glyph} {name}' for _, (glyph, name, _) in things]
    placed = [thing for _, thing in things]
    return _join(_grid(maze, placed), *_threes(legend), *_threes(facts), _hidden(placed))


def _movable(maze: Maze, values: Mapping[str, int]) -> list[tuple[str, str, str]]:
    """Return prefix of feature names, glyph and name of each thing with a row and column."""
    ghosts = []
    for number in range(1, len(maze.homes) + 1):
        scared = values.get(f'ghost_{number}_scared')
        glyph = (SCARED if scared else GHOSTS)[number - 1]
        doubt = ', scared or not' if scared is None else ''
        ghosts.append((f'ghost_{number}', glyph, f'ghost {number}{doubt}'))
    items = [
        ('food', FOOD, 'nearest food'),
        ('pill', PILL, 'nearest power pill'),
        ('fruit', FRUIT, 'fruit'),
    ]
    return [('pacman', PACMAN, 'pac-man'), *ghosts, *items]


def _expressed_by(feature: str) -> set[str]:
    """Return the things that must be drawn for a feature to be read from the drawing."""
    if feature == 'legal_moves':
        return {'pacman'}
    prefix, _, part = feature.rpartition('_')
    if part in ('row', 'col'):
        return {prefix}
    if part in ('direction', 'distance') and prefix not in ('danger', 'prey'):
        return {'pacman', prefix}
    return {''}  # nothing in the drawing


def _grid(maze: Maze, things: Sequence[Thing]) -> list[str]:
    """Draw the walls, and in each cell the thing in front, with the one behind beside it."""
    inside: dict[Cell, str] = {}
    for glyph, _, cell in things:
        inside[cell] = inside.get(cell, '') + glyph
    rows = [list(row) for row in _empty(maze)]
    for (row, col), glyphs in inside.items():
        rows[row + 1][col + 1] = f'{glyphs:2.2}'
    return [''.join(row)[:-1] for row in rows]


@lru_cache(maxsize=16)
def _empty(maze: Maze) -> list[list[str]]:
    """
    Return the two characters of each cell of the empty maze, border included.

    A wall is a line to each wall beside it, unless all cells along that line are walls.
    """
    solid = np.array([list(line) for line in maze.text.split('\n')]) == WALL
    within, around = (np.pad(solid, 1, constant_values=outside) for outside in (False, True))

    def beside(walls: Flags, down: int, east: int) -> Flags:
        """Return the walls of the cells that lie so far from each cell."""
        return walls[1 + down :, 1 + east :][: len(solid), : solid.shape[1]]

    buried, lines = solid.copy(), np.zeros(solid.shape, dtype=np.intp)
    for bit, (down, east) in enumerate(DELTAS):
        along = [(s * east + n * down, s * down + n * east) for s in (-1, 1) for n in (0, 1)]
        hidden = np.logical_and.reduce([beside(around, *place) for place in along])
        lines |= (beside(within, down, east) & ~hidden) << bit
        buried &= hidden
    drawn = [f'{line}{WALLS[6] if mask & 4 else " "}' for mask, line in enumerate(WALLS)]
    shown = solid & ((lines > 0) | ~buried)
    return [
        [drawn[mask] if wall else '  ' for mask, wall in zip(*row)] for row in zip(lines, shown)
    ]


def _hidden(things: Sequence[Thing]) -> list[str]:
    """Return in words the things in a cell behind two others."""
    seen: dict[Cell, int] = {}
    hidden = []
    for _, name, cell in things:
        seen[cell] = seen.get(cell, 0) + 1
        if seen[cell] > 2:
            hidden.append(f'hidden: {name} in row {cell[0]}, column {cell[1]}')
    return hidden


def _threes(texts: list[str]) -> list[list[str]]:
    return [texts[at : at + 3] for at in range(0, len(texts), 3)]


def _steps(count: int) -> str:
    return f'{count} step' if count == 1 else f'{count} steps'


def _join(board: list[str], *rows: Sequence[str]) -> str:
    return '\n'.join([*board, *('   '.join(row) for row in rows if row)])
