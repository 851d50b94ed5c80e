"""What a board looks like, from the exact transitions alone: walls, and which action moves."""

from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import BoardSlice, EnumerableDomain, Transitions
import numpy as np
from numpy.typing import NDArray

SIDES = ((0, 1), (1, 0))  # (row, column) steps to the neighbours looked at: east, south


@dataclass(frozen=True)
class Board:
    """One slice of a domain's states with what stands between its cells."""

    title: str
    states: NDArray[np.int32]  # (rows, cols); -1: no state there
    walls: tuple[NDArray[np.bool_], NDArray[np.bool_]]  # between a cell and its east, south
    moves: dict[int, tuple[int, int]]  # action -> (rows, cols) by which it moves the agent


def read_board(domain: EnumerableDomain[Any], layout: BoardSlice) -> Board:
    """Return a slice with its walls and moves, as ``board_of`` finds them."""
    return board_of(domain.transitions(), layout)


def board_of(table: Transitions, layout: BoardSlice) -> Board:
    """
    Return states of some transitions with their walls and moves.

    Between two neighbouring states there is a wall where no action leads from one to the other. An
    action moves by what it moves in most of the cells that it leaves for another cell.
    """
    states = layout.states
    position = np.full((len(table.successor), 2), -1)
    position[states[states >= 0]] = np.argwhere(states >= 0)
    here = np.where(states >= 0, states, 0)
    possible = (table.probability[here] > 0) & (states >= 0)[:, :, None, None]
    arrives = np.where(possible, table.successor[here], -1)  # (rows, cols, A, B)
    walls = tuple(_walls(states, arrives, step) for step in SIDES)
    return Board(layout.title, states, (walls[0], walls[1]), _moves(states, arrives, position))


def _walls(
    states: NDArray[np.int32], arrives: NDArray[np.int32], step: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return (rows, cols): a wall or an edge is on the east (0, 1) or south (1, 0) side."""
    rows, cols = states.shape
    first, second = (
        (slice(0, rows - step[0]), slice(0, cols - step[1])),
        np.s_[step[0] :, step[1] :],
    )
    a, b = states[first], states[second]
    leads = (arrives[first] == b[:, :, None, None]).any(axis=(2, 3))
    leads |= (arrives[second] == a[:, :, None, None]).any(axis=(2, 3))
    walls = states >= 0
    walls[first] = (a >= 0) != (b >= 0)
    walls[first] |= (a >= 0) & (b >= 0) & ~leads
    return walls


def _moves(
    states: NDArray[np.int32], arrives: NDArray[np.int32], position: NDArray[np.int64]
) -> dict[int, tuple[int, int]]:
    moves = {}
    rows, cols = np.nonzero(states >= 0)
    for action in range(arrives.shape[2]):
        reached = arrives[rows, cols, action, 0]
        inside = (reached >= 0) & (position[reached, 0] >= 0) & (reached != states[rows, cols])
        steps = position[reached[inside]] - np.stack([rows, cols], axis=1)[inside]
        if len(steps):
            kinds, counts = np.unique(steps, axis=0, return_counts=True)
            row, col = kinds[counts.argmax()]
            moves[action] = (int(row), int(col))
    return moves
