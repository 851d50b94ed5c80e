"""
Random mazes for tests of transfer; nothing was tuned on them.

Junctions lie on every second row and column of the left half. A random depth-first spanning tree
joins them; then every dead end is opened, and the left half is mirrored to the right. Two or more
rows cross the middle column, so that there are loops. All open cells are connected, and each has
at least two open neighbours.
"""

from humanopts_env.domains.pacman.maze import (
    Cell,
    FOOD,
    GHOST,
    Maze,
    PACMAN,
    parse_maze,
    PILL,
    WALL,
)
import numpy as np

ROWS, JUNCTIONS = (7, 9, 11), (4, 5, 6)  # without the border; junctions per row of the left half
CROSSINGS = 2  # minimum number of rows that cross the middle
_AROUND = ((-2, 0), (0, -2), (0, 2), (2, 0))


def random_maze(rng: np.random.Generator) -> Maze:
    """Draw a maze with two ghosts, two power pills, and food everywhere else."""
    rows, junctions = int(rng.choice(ROWS)), int(rng.choice(JUNCTIONS))
    middle = 2 * junctions - 1
    left = _tree(rows, middle, rng)
    _open_dead_ends(left, rows, middle, rng)
    levels = range(0, rows, 2)
    count = int(rng.integers(CROSSINGS, len(levels), endpoint=True))
    crossed = sorted(int(row) for row in rng.permutation(levels)[:count])
    cols = 2 * middle + 1
    found = {cell: FOOD for row, col in left for cell in ((row, col), (row, cols - 1 - col))}
    found |= {(row, middle): FOOD for row in crossed}
    home = min(levels, key=lambda row: abs(row - rows // 2))
    corner = int(rng.choice([row for row in levels if row != home]))
    for col in (0, cols - 1):
        found[corner, col] = PILL
    for col in (middle - 1, middle + 1):
        found[home, col] = GHOST
    found[crossed[-1] if crossed[-1] != home else crossed[0], middle] = PACMAN
    text = '\n'.join(
        ''.join(found.get((row, col), WALL) for col in range(-1, cols + 1))
        for row in range(-1, rows + 1)
    )
    return parse_maze(text)


def _tree(rows: int, cols: int, rng: np.random.Generator) -> set[Cell]:
    """Return the open cells of a spanning tree of the junctions."""
    cells, path = {(0, 0)}, [(0, 0)]
    while path:
        row, col = path[-1]
        fresh = [cell for cell in _near(path[-1], rows, cols) if cell not in cells]
        if not fresh:
            path.pop()
            continue
        onward = fresh[int(rng.integers(len(fresh)))]
        cells |= {onward, ((row + onward[0]) // 2, (col + onward[1]) // 2)}
        path.append(onward)
    return cells


def _open_dead_ends(cells: set[Cell], rows: int, cols: int, rng: np.random.Generator) -> None:
    """Open one more wall at each junction with a single exit."""
    for row in range(0, rows, 2):
        for col in range(0, cols, 2):
            ways = [((row + r) // 2, (col + c) // 2) for r, c in _near((row, col), rows, cols)]
            closed = [cell for cell in ways if cell not in cells]
            if len(ways) - len(closed) == 1:
                cells.add(closed[int(rng.integers(len(closed)))])


def _near(cell: Cell, rows: int, cols: int) -> list[Cell]:
    """Return the neighbouring junctions."""
    around = [(cell[0] + down, cell[1] + east) for down, east in _AROUND]
    return [(row, col) for row, col in around if 0 <= row < rows and 0 <= col < cols]
