"""
Mazes as text, in the notation of the Berkeley Pac-Man projects.

``%`` is a wall, ``.`` food, ``o`` a capsule (power pill), ``P`` Pac-Man and ``G`` a ghost; ghosts
may also be numbered ``1`` to ``4``. A space is open floor. Spaces around lines and empty lines
around the text are ignored.
"""

from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

from humanopts_env.domains.base import DomainError
from humanopts_ros.limits import shown
from humanopts_ros.text_files import FileError, read_text

WALL, FOOD, PILL, PACMAN, GHOST, BLANK = '%.oPG '
NUMBERED = '1234'  # ghosts, in this order; G counts as 1
MAX_SIDE, MAX_CELLS, MAX_GHOSTS = 66, 1500, 4
Cell = tuple[int, int]  # row, 0 = north; column, 0 = west; both inside the border


class MazeError(DomainError):
    """A text is not a maze; the message gives the reason and location."""


@dataclass(frozen=True, slots=True)
class Maze:
    """
    A maze that can be played.

    Cells are the floor reachable by Pac-Man, row by row; positions are indices into ``cells``.
    Unreachable floor is not a cell.
    """

    text: str  # lines of equal length, stripped; the only field used for equality
    rows: int = field(compare=False)  # inside the border
    cols: int = field(compare=False)
    cells: tuple[Cell, ...] = field(compare=False)
    start: int = field(compare=False)  # Pac-Man's cell
    homes: tuple[int, ...] = field(compare=False)  # cells of the ghosts
    food: tuple[int, ...] = field(compare=False)
    pills: tuple[int, ...] = field(compare=False)
    from_middle: tuple[int, ...] = field(compare=False)  # indices of food, nearest first


def maze_names() -> list[str]:
    """Return the names of the mazes in this package."""
    folder = files('humanopts_env') / 'mazes'
    return sorted(file.name.removesuffix('.lay') for file in folder.iterdir())


def load_maze(source: str) -> Maze:
    """
    Return a maze.

    :param source: name of a maze in this package, path of a file, or the text itself.
    :raises MazeError: the maze is unknown, or its text is not a maze.
    """
    if '\n' in source or source.startswith(WALL):
        return parse_maze(source)
    if source in maze_names():
        return parse_maze((files('humanopts_env') / 'mazes' / f'{source}.lay').read_text('utf-8'))
    try:
        text = read_text(Path(source).expanduser())
    except (FileError, RuntimeError) as error:  # RuntimeError: ~ cannot be expanded
        raise MazeError(
            f'no maze {shown(source)!r}: it is not one of {", ".join(maze_names())}, '
            f'and cannot be used as a file ({error})'
        ) from error
    try:
        return parse_maze(text)
    except MazeError as error:
        raise MazeError(f'{source}: {error}') from error


def parse_maze(text: str) -> Maze:
    """
    Read a maze from its text.

    :raises MazeError: the maze is too large, or has unequal lines, an unknown character, an open
        border, not exactly one Pac-Man, no food, too many ghosts, or food, a pill or a ghost that
        Pac-Man cannot reach.
    """
    lines = [line.strip() for line in text.strip().splitlines()]
    _check_shape(lines)
    found = {
        (row - 1, col - 1): character
        for row, line in enumerate(lines)
        for col, character in enumerate(line)
        if character != WALL
    }
    pacmen = [cell for cell, character in found.items() if character == PACMAN]
    if len(pacmen) != 1:
        raise MazeError(f'the maze has {len(pacmen) or "no"} Pac-Man (P), but must have one')
    reached = _flood(set(found), pacmen[0])
    _check_contents(found, reached)
    cells = tuple(sorted(reached))
    number = {cell: index for index, cell in enumerate(cells)}
    rows, cols = len(lines) - 2, len(lines[0]) - 2

    def all_of(characters: str) -> tuple[int, ...]:
        return tuple(number[cell] for cell in cells if found[cell] in characters)

    food = all_of(FOOD)

    def from_middle(index: int) -> int:
        row, col = cells[food[index]]
        return (2 * row - rows + 1) ** 2 + (2 * col - cols + 1) ** 2

    ghosts = sorted(
        all_of(GHOST + NUMBERED), key=lambda home: found[cells[home]].replace('G', '1')
    )
    return Maze(
        text='\n'.join(lines),
        rows=rows,
        cols=cols,
        cells=cells,
        start=number[pacmen[0]],
        homes=tuple(ghosts),
        food=food,
        pills=all_of(PILL),
        from_middle=tuple(sorted(range(len(food)), key=from_middle)),
    )


def _check_shape(lines: list[str]) -> None:
    """Check that the text is a rectangle of known characters enclosed by walls."""
    if not lines:
        raise MazeError('the maze is empty')
    known = {WALL, FOOD, PILL, PACMAN, GHOST, BLANK, *NUMBERED}
    for row, line in enumerate(lines, start=1):
        for col, character in enumerate(line, start=1):
            if character not in known:
                raise MazeError(
                    f'line {row}, column {col} of the maze is {character!r}; a maze is made of '
                    '% (wall), . (food), o (pill), P, G or 1 to 4 (ghosts), and spaces'
                )
        if len(line) != len(lines[0]):
            raise MazeError(
                f'line {row} of the maze has {len(line)} characters, but line 1 has '
                f'{len(lines[0])}: all must be of one length'
            )
    if max(len(lines), len(lines[0])) > MAX_SIDE:
        raise MazeError(
            f'the maze has {len(lines)} x {len(lines[0])} characters, but may have at most '
            f'{MAX_SIDE} x {MAX_SIDE}'
        )
    for row, line in enumerate(lines, start=1):
        edge = line if row in (1, len(lines)) else line[0] + line[-1]
        if set(edge) != {WALL}:
            raise MazeError(f'the border is open in line {row}: it must be % all around')


def _check_contents(found: dict[Cell, str], reached: set[Cell]) -> None:
    """Check that the maze can be cleared, and that Pac-Man can reach everything in it."""
    for characters, thing in (
        (FOOD, 'food'),
        (PILL, 'a power pill'),
        (GHOST + NUMBERED, 'a ghost'),
    ):
        for (row, col), character in found.items():
            if character in characters and (row, col) not in reached:
                raise MazeError(
                    f'{thing} in line {row + 2}, column {col + 2} cannot be reached by Pac-Man'
                )
    if FOOD not in found.values():
        raise MazeError('the maze has no food (.), so there is nothing to clear')
    ghosts = sum(character in GHOST + NUMBERED for character in found.values())
    if ghosts > MAX_GHOSTS:
        raise MazeError(f'the maze has {ghosts} ghosts, but may have at most {MAX_GHOSTS}')
    if len(reached) > MAX_CELLS:
        raise MazeError(
            f'the maze has {len(reached)} open cells, but may have at most {MAX_CELLS}'
        )


def _flood(open_cells: set[Cell], start: Cell) -> set[Cell]:
    """Return all open cells reachable from a cell."""
    reached, waiting = {start}, [start]
    while waiting:
        row, col = waiting.pop()
        around = {(row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)}
        fresh = (around & open_cells) - reached
        reached |= fresh
        waiting += fresh
    return reached
