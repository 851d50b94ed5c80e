"""One state of Pac-Man and its notation as one line of text."""

from dataclasses import dataclass
import re

from humanopts_env.domains.base import StateError
from humanopts_env.domains.pacman.maze import Maze
from humanopts_env.domains.pacman.paths import MOVES, STAY

SCARED_STEPS = 40
FRUIT_STEPS = 60
EATEN = ('food', 'power pill', 'fruit', 'ghost')  # bits of ``PacManState.ate``
HEADINGS = (*MOVES, 'none')
NO_CELL = -1
MAX_SCORE = 10**9  # in a decoded state
_GHOST = re.compile(rf'ghost (\d+),(\d+) heading ({"|".join(HEADINGS)}) scared (\d+)')
_STATE = re.compile(
    r'pacman (\d+),(\d+)((?: ghost \S+ heading \S+ scared \d+)*) food ([0-9a-f]+) '
    r'pills ([01]+|none) fruit (none|\d+,\d+ for \d+) lives (\d+) score (\d+) '
    r'ate (nothing|[a-z+-]+)',
    re.ASCII,
)


@dataclass(frozen=True, slots=True)
class Ghost:
    """One ghost."""

    cell: int
    heading: int = STAY  # its last move; STAY: none, so that it may move in any direction
    scared: int = 0  # remaining steps in which Pac-Man can eat it


@dataclass(frozen=True, slots=True)
class PacManState:
    """The complete state of a game; cells, food and pills are numbered as in the maze."""

    pacman: int  # cell
    ghosts: tuple[Ghost, ...]
    food: int  # bit k: food k is left
    pills: int  # bit k: pill k is left
    fruit: int  # remaining steps of the fruit; 0 if none
    fruit_at: int  # cell of the fruit; NO_CELL: none
    lives: int
    score: int
    ate: int  # bit k: the last step ate EATEN[k]


def encode(maze: Maze, state: PacManState) -> str:
    """Return the state as one line; food is a hexadecimal mask, pills are digits, last first."""
    ghosts = ''.join(
        f' ghost {_place(maze, ghost.cell)} heading {HEADINGS[ghost.heading]} '
        f'scared {ghost.scared}'
        for ghost in state.ghosts
    )
    pills = f'{state.pills:0{len(maze.pills)}b}' if maze.pills else 'none'
    fruit = f'{_place(maze, state.fruit_at)} for {state.fruit}' if state.fruit else 'none'
    ate = '+'.join(name.replace(' ', '-') for name in eaten_names(state.ate)) or 'nothing'
    return (
        f'pacman {_place(maze, state.pacman)}{ghosts} '
        f'food {state.food:0{_digits(maze)}x} pills {pills} '
        f'fruit {fruit} lives {state.lives} score {state.score} ate {ate}'
    )


def decode(maze: Maze, lives: int, text: str) -> PacManState:
    """
    Return the state from the text of ``encode``.

    :param lives: maximum number of lives.
    :raises StateError: the notation is wrong, or the text is not a state of this maze.
    """
    match = _STATE.fullmatch(text)
    if match is None or len(text) > 2000:
        raise StateError(
            f'{text[:200]!r} is not a Pac-Man state; write one like "pacman 8,8 ghost 4,8 heading '
            'none scared 0 ... food 3f pills 11 fruit none lives 3 score 0 ate nothing"'
        )
    row, col, ghosts, food, pills, fruit, life, score, ate = match.groups()
    place, _, steps = ('', '', '0') if fruit == 'none' else fruit.partition(' for ')
    state = PacManState(
        pacman=_cell(maze, row, col),
        ghosts=tuple(
            Ghost(_cell(maze, r, c), HEADINGS.index(heading), int(scared))
            for r, c, heading, scared in _GHOST.findall(ghosts)
        ),
        food=int(food, 16),
        pills=0 if pills == 'none' else int(pills, 2),
        fruit=int(steps),
        fruit_at=_cell(maze, *place.split(',')) if place else NO_CELL,
        lives=int(life),
        score=int(score),
        ate=sum(1 << k for k, e in enumerate(EATEN) if e.replace(' ', '-') in ate.split('+')),
    )
    _check(maze, lives, state)
    if encode(maze, state) != text:
        raise StateError(f'{text!r} is not written as {encode(maze, state)!r}')
    return state


def eaten_names(ate: int) -> list[str]:
    """Return the names in a mask of ``PacManState.ate``."""
    return [name for bit, name in enumerate(EATEN) if ate >> bit & 1]


def _check(maze: Maze, lives: int, state: PacManState) -> None:
    """Check that a game in this maze can have the state."""
    if len(state.ghosts) != len(maze.homes):
        raise StateError(f'{len(state.ghosts)} ghosts, and the maze has {len(maze.homes)}')
    if any(ghost.scared > SCARED_STEPS for ghost in state.ghosts):
        raise StateError(f'a ghost is scared for more than {SCARED_STEPS} steps')
    if state.food >> len(maze.food) or state.pills >> len(maze.pills):
        raise StateError(
            f'more than the {len(maze.food)} food and {len(maze.pills)} pills of the maze'
        )
    for items, mask, name in (
        (maze.food, state.food, 'food'),
        (maze.pills, state.pills, 'a pill'),
    ):
        if any(mask >> k & 1 and cell == state.pacman for k, cell in enumerate(items)):
            raise StateError(f'Pac-Man is where {name} is, and would have eaten it')
    limits = (('fruit', state.fruit, FRUIT_STEPS), ('lives', state.lives, lives))
    for name, value, most in (*limits, ('score', state.score, MAX_SCORE)):
        if value > most:
            raise StateError(f'{name} is {value}, but may be at most {most}')


def _cell(maze: Maze, row: str, col: str) -> int:
    # Rows and columns have fewer digits, and int() refuses very long numbers.
    place = (int(row[:4]), int(col[:4]))
    if place not in maze.cells:
        raise StateError(f'{row[:9]},{col[:9]} is not an open cell of the maze')
    return maze.cells.index(place)


def _place(maze: Maze, cell: int) -> str:
    row, col = maze.cells[cell]
    return f'{row},{col}'


def _digits(maze: Maze) -> int:
    return -(-len(maze.food) // 4)
