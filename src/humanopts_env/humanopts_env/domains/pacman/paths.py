"""
Moves and shortest paths of a maze, as arrays.

C cells; moves are numbered 0 north, 1 west, 2 east, 3 south, so that the opposite of m is 3 - m,
and a set of moves is a mask with bit m. STAY is a fifth move that stays in the cell; as a heading
it means that a ghost has no heading.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

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

# (16, 4): whether a mask holds each move; (16,): its first move, STAY where it has none.
HAS_MOVE = read_only((np.arange(16)[:, None] >> np.arange(4) & 1).astype(np.bool_))
FIRST_MOVE = read_only(np.where(HAS_MOVE.any(axis=1), HAS_MOVE.argmax(axis=1), STAY))


@dataclass(frozen=True, eq=False)
class Paths:
    """Moves, distances and shortest paths of a maze, computed once."""

    step: NDArray[np.intp]  # (C, 5) the cell after a move; the same cell at a wall
    legal: Masks  # (C,) moves that no wall blocks
    distance: NDArray[np.unsignedinteger]  # (C, C) steps of a shortest path, below ``far - 1``
    shortest: Masks  # (C, C) first moves of all shortest paths from one cell to another
    allowed: Masks  # (C, 5) moves of a ghost by its heading; it turns back only where it must
    towards: Masks  # (C, 5, C) the allowed moves that lead nearest to a cell
    away: Masks  # (C, 5, C) the allowed moves that lead farthest from it

    @cached_property
    def longest(self) -> int:
        """Number of steps between the two cells that are farthest apart."""
        return int(self.distance.max())

    @cached_property
    def far(self) -> int:
        """The largest number of the type of ``distance``, which stands for no distance."""
        return int(np.iinfo(self.distance.dtype).max)


@lru_cache(maxsize=16)
def maze_paths(maze: Maze) -> Paths:
    """Compute the moves and all shortest paths of a maze; arrays are shared and read-only."""
    step = _steps(maze)
    passable = step[:, :STAY] != np.arange(len(step))[:, None]
    distance = _distances(step, passable)
    after = distance[step[:, :STAY]]  # (C, 4, C): distance to each cell after each move
    nearer = passable[:, :, None] & (after < distance[:, None, :])
    allowed = _allowed(passable)
    return Paths(
        step=read_only(step),
        legal=read_only(_masks(passable)),
        distance=read_only(distance),
        shortest=read_only(_masks(nearer)),
        allowed=read_only(_masks(allowed.swapaxes(1, 2))),
        towards=read_only(_best(after, allowed, nearest=True)),
        away=read_only(_best(after, allowed, nearest=False)),
    )


def _steps(maze: Maze) -> NDArray[np.intp]:
    number = {cell: index for index, cell in enumerate(maze.cells)}
    return np.array(
        [
            [*(number.get((row + down, col + east), here) for down, east in DELTAS), here]
            for here, (row, col) in enumerate(maze.cells)
        ],
        dtype=np.intp,
    )


def _distances(step: NDArray[np.intp], passable: NDArray[np.bool_]) -> NDArray[np.unsignedinteger]:
    """Return all distances, as bytes where these hold them and two numbers above."""
    count = len(step)
    here, move = np.nonzero(passable)
    graph = coo_array((np.ones(len(here)), (here, step[here, move])), shape=(count, count))
    exact = shortest_path(graph.tocsr(), unweighted=True)
    steps: NDArray[np.unsignedinteger] = exact.astype(
        np.uint8 if float(exact.max()) < 254 else np.uint16
    )
    return steps


def _allowed(passable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (C, 5, 4): the moves of a ghost in each cell with each heading."""
    back = np.zeros((5, STAY), dtype=np.bool_)
    back[range(STAY), range(STAY - 1, -1, -1)] = True
    onward = passable[:, None, :] & ~back
    stuck = ~onward.any(axis=2, keepdims=True)
    return onward | (stuck & passable[:, None, :])


def _best(
    after: NDArray[np.unsignedinteger], allowed: NDArray[np.bool_], *, nearest: bool
) -> Masks:
    """Return (C, 5, C): the allowed moves with the least (or the greatest) distance after."""
    count = len(after)
    best = np.empty((count, 5, count), dtype=np.uint8)
    far = np.iinfo(after.dtype).max
    for heading in range(5):
        may = allowed[:, heading, :, None]
        if nearest:
            value = np.where(may, after, far)
            chosen = value == value.min(axis=1, keepdims=True)
        else:
            value = np.where(may, after, 0)
            chosen = value == value.max(axis=1, keepdims=True)
        best[:, heading] = _masks(chosen & may)
    return best


def _masks(moves: NDArray[np.bool_]) -> Masks:
    """Return the masks of moves (C, 4, ...), without the second axis."""
    masks: Masks = np.einsum('cm...,m->c...', moves, 1 << np.arange(STAY)).astype(np.uint8)
    return masks
