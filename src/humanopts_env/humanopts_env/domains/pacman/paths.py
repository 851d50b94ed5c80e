"""
Moves and shortest paths of a maze, as arrays.

C cells; moves are numbered 0 north, 1 west, 2 east, 3 south, so that the opposite of m is 3 - m,
and a set of moves is a mask with bit m. STAY is a fifth move that stays in the cell; as a heading
it means that a ghost has no heading.
"""

from functools import lru_cache

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.pacman.maze import Maze
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

MOVES = ('north', 'west', 'east', 'south')
DELTAS = ((-1, 0), (0, -1), (0, 1), (1, 0))  # row, column
STAY = 4
Masks = NDArray[np.uint8]

# (16, 4): whether a mask contains each move; (16,): its first move, STAY if empty.
HAS_MOVE = read_only((np.arange(16)[:, None] >> np.arange(4) & 1).astype(np.bool_))
FIRST_MOVE = read_only(np.where(HAS_MOVE.any(axis=1), HAS_MOVE.argmax(axis=1), STAY))


class Paths:
    """
    Moves, distances and shortest paths of a maze, as shared and read-only arrays.

    :ivar longest: largest number of steps between two cells.
    :ivar far: largest number of the dtype of ``distance``, for cells without a path.
    """

    def __init__(self, maze: Maze) -> None:
        # (C, 5) the cell after a move; the same cell at a wall
        self.step = step = read_only(_steps(maze))
        passable = step[:, :STAY] != np.arange(len(step))[:, None]
        # (C, C) steps of a shortest path, below ``far - 1``
        self.distance = distance = read_only(_distances(step, passable))
        after = distance[step[:, :STAY]]  # (C, 4, C): distance to each cell after each move
        nearer = passable[:, :, None] & (after < distance[:, None, :])
        allowed = _allowed(passable)
        self.legal = read_only(_masks(passable))  # (C,) moves not blocked by a wall
        # (C, C) first moves of all shortest paths from one cell to another
        self.shortest = read_only(_masks(nearer))
        # (C, 5) moves of a ghost by its heading; it turns back only if it must
        self.allowed = read_only(_masks(allowed.swapaxes(1, 2)))
        # (C, 5, C) the allowed moves with the smallest and with the largest distance to a cell
        self.towards = read_only(_best(after, allowed, nearest=True))
        self.away = read_only(_best(after, allowed, nearest=False))
        self.longest = int(distance.max())
        self.far = int(np.iinfo(distance.dtype).max)


maze_paths = lru_cache(maxsize=16)(Paths)


def _steps(maze: Maze) -> Ints:
    number = {cell: index for index, cell in enumerate(maze.cells)}
    return np.array(
        [
            [*(number.get((row + down, col + east), here) for down, east in DELTAS), here]
            for here, (row, col) in enumerate(maze.cells)
        ],
        dtype=np.intp,
    )


def _distances(step: Ints, passable: Flags) -> NDArray[np.unsignedinteger]:
    """Return all distances, as bytes if the distances and two larger numbers fit."""
    count = len(step)
    here, move = np.nonzero(passable)
    # csgraph of SciPy 1.11 only accepts 32-bit indices
    edges = here.astype(np.int32), step[here, move].astype(np.int32)
    graph = coo_array((np.ones(len(here)), edges), shape=(count, count))
    exact = shortest_path(graph.tocsr(), unweighted=True)
    steps: NDArray[np.unsignedinteger] = exact.astype(
        np.uint8 if float(exact.max()) < 254 else np.uint16
    )
    return steps


def _allowed(passable: Flags) -> Flags:
    """Return (C, 5, 4): the moves of a ghost in each cell with each heading."""
    back = np.zeros((5, STAY), dtype=np.bool_)
    back[range(STAY), range(STAY - 1, -1, -1)] = True
    onward = passable[:, None, :] & ~back
    stuck = ~onward.any(axis=2, keepdims=True)
    return onward | (stuck & passable[:, None, :])


def _best(after: NDArray[np.unsignedinteger], allowed: Flags, *, nearest: bool) -> Masks:
    """Return (C, 5, C): the allowed moves after which the distance is least (or greatest)."""
    count = len(after)
    best = np.empty((count, 5, count), dtype=np.uint8)
    extreme, worst = (np.min, np.iinfo(after.dtype).max) if nearest else (np.max, 0)
    for heading in range(5):
        may = allowed[:, heading, :, None]
        value = np.where(may, after, worst)
        best[:, heading] = _masks((value == extreme(value, axis=1, keepdims=True)) & may)
    return best


def _masks(moves: Flags) -> Masks:
    """Return the masks of moves (C, 4, ...), without the second axis."""
    masks: Masks = np.einsum('cm...,m->c...', moves, 1 << np.arange(STAY)).astype(np.uint8)
    return masks
