"""The maze as a board: a complete state, or only the features that may be revealed."""

from collections.abc import Mapping

from humanopts_env.board import BALL, Board, DOT, Mark
from humanopts_env.colours import BLUE, GREEN, MAGENTA, ORANGE, RED, TEAL
from humanopts_env.domains.capabilities import in_words
from humanopts_env.domains.pacman.maze import Cell, Maze, WALL
from humanopts_env.domains.pacman.state import eaten_names, PacManState

PACMAN, FRUIT, LIFE, LOST = 'C', '♣', '♥', '♡'
GHOSTS, SCARED = 'ΩΨΦΔ', 'ωψφδ'
GHOST_COLOURS = (RED, MAGENTA, TEAL, GREEN)
EXPLANATION = (
    ('', 'Eat all the food. A ghost that touches you costs a life.'),
    (PACMAN, 'Pac-Man: you'),
    (DOT, 'food: 10 points'),
    (BALL, 'a power pill: 50 points; it scares the ghosts for a while'),
    (FRUIT, 'fruit, which appears for a short time: 100 points'),
    (' '.join(GHOSTS), 'ghosts'),
    (' '.join(SCARED), 'scared ghosts: 200 points each'),
    (f'{LIFE} {LOST}', 'lives left and lost'),
)


def board_of_state(maze: Maze, state: PacManState, lives: int) -> Board:
    """
    Return a board that shows everything.

    :param lives: number of lives of a new game.
    """
    marks = [Mark(maze.cells[state.pacman], PACMAN, 'pac-man', ORANGE)]
    for number, ghost in enumerate(state.ghosts):
        fear = f' scared {_steps(ghost.scared)}' if ghost.scared else ''
        marks.append(_ghost(number, maze.cells[ghost.cell], bool(ghost.scared), fear))
    if state.fruit:
        name = f'fruit {_steps(state.fruit)}'
        marks.append(Mark(maze.cells[state.fruit_at], FRUIT, name, RED))
    for kind, name, cells, there in (
        (DOT, 'food', maze.food, state.food),
        (BALL, 'power pill', maze.pills, state.pills),
    ):
        marks += [Mark(maze.cells[c], kind, name) for k, c in enumerate(cells) if there >> k & 1]
    score = (
        f'score {state.score}',
        f'lives {LIFE * state.lives}{LOST * (lives - state.lives)}',
        f'food left {state.food.bit_count()}',
        f'ate {" and ".join(eaten_names(state.ate)) or "nothing"}',
    )
    return _board(maze, marks, score)


def board_of_features(maze: Maze, values: Mapping[str, str]) -> Board:
    """
    Return a board that shows only some features.

    :param values: texts of the values of these features, by name.
    """
    looks = {'pacman': (PACMAN, 'pac-man', ORANGE)}
    looks |= {'food': (DOT, 'nearest food', ''), 'pill': (BALL, 'nearest power pill', '')}
    looks['fruit'] = (FRUIT, 'fruit', RED)
    cells: dict[str, Cell] = {}
    for thing in ('pacman', *(f'ghost_{n + 1}' for n in range(len(maze.homes))), *list(looks)[1:]):
        place = [values.get(f'{thing}_{part}', '') for part in ('row', 'col')]
        if all(part.isdecimal() for part in place):  # an absent object has no number
            cells[thing] = int(place[0]), int(place[1])
    marks = []
    for thing, cell in cells.items():
        if thing in looks:
            marks.append(Mark(cell, *looks[thing]))
            continue
        scared = values.get(f'{thing}_scared')
        doubt = ', scared or not' if scared is None else ''
        marks.append(_ghost(int(thing[-1]) - 1, cell, scared not in (None, 'no'), doubt))
    seen = {name for name in values if _needs(name) <= cells.keys()}
    return _board(maze, marks, in_words(values, seen))


def _needs(feature: str) -> set[str]:
    """Return the objects that must be on the board to show a feature."""
    if feature == 'legal_moves':
        return {'pacman'}
    thing, _, part = feature.rpartition('_')
    if part in ('row', 'col'):
        return {thing}
    if part in ('direction', 'distance') and thing not in ('danger', 'prey'):
        return {'pacman', thing}
    return {''}  # cannot be shown


def _ghost(number: int, cell: Cell, scared: bool, more: str) -> Mark:
    colour = BLUE if scared else GHOST_COLOURS[number]
    return Mark(cell, (SCARED if scared else GHOSTS)[number], f'ghost {number + 1}{more}', colour)


def _board(maze: Maze, marks: list[Mark], notes: tuple[str, ...]) -> Board:
    inside = [line[1:-1] for line in maze.text.split('\n')[1:-1]]
    blocks = tuple(
        (row, col) for row, line in enumerate(inside) for col, c in enumerate(line) if c == WALL
    )
    return Board(maze.rows, maze.cols, blocks, (), tuple(marks), notes, BLUE, dotted=False)


def _steps(count: int) -> str:
    return f'{count} step' if count == 1 else f'{count} steps'
