"""Taxi's grid, features and transitions as arrays; S = rows * cols * 20 states."""

from humanopts_env.domains.base import Action, Feature, FeatureKind, Transitions
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

LANDMARKS = ('R', 'G', 'Y', 'B')
ABOARD = 4  # the passenger's place when in the taxi; 0..3: waits at LANDMARKS[place]
ACTIONS = (
    Action('south', 'down', 'drive one cell south'),
    Action('north', 'up', 'drive one cell north'),
    Action('east', 'right', 'drive one cell east'),
    Action('west', 'left', 'drive one cell west'),
    Action('pickup', 'p', 'let the passenger in'),
    Action('dropoff', 'd', 'let the passenger out'),
)
PICKUP, DROPOFF = 4, 5
Cell = tuple[int, int]  # row, 0 = north edge; column, 0 = west edge
Column = NDArray[np.int32]


def landmark_cells(rows: int, cols: int) -> dict[str, Cell]:
    """Return the cell of each landmark."""
    corners = ((0, 0), (0, cols - 1), (rows - 1, 0), (rows - 1, cols - 2))
    return dict(zip(LANDMARKS, corners))


def walls_east(rows: int, cols: int) -> NDArray[np.bool_]:
    """Return (rows, cols): whether a wall or the edge is on the east side of each cell."""
    walls = np.zeros((rows, cols), dtype=np.bool_)
    height = 2 * rows // 5
    walls[:height, 2 * cols // 5 - 1] = True
    for col in (cols // 5 - 1, 3 * cols // 5 - 1):
        walls[rows - height :, col] = True  # column -1 (no wall) is the east edge
    walls[:, -1] = True
    return read_only(walls)


def blocked_moves(rows: int, cols: int) -> NDArray[np.bool_]:
    """Return (rows * cols, 4): whether each move is blocked in each cell, in action order."""
    row = np.indices((rows, cols))[0]
    east = walls_east(rows, cols)
    west = np.roll(east, 1, axis=1)  # a cell's west is its neighbour's east; the edges wrap
    return np.stack((row == rows - 1, row == 0, east, west), axis=2).reshape(-1, 4)


def state_parts(rows: int, cols: int) -> tuple[Column, Column, Column]:
    """Return (S,) each: the taxi's cell (row * cols + col), the passenger, the destination."""
    index = np.arange(rows * cols * 20, dtype=np.int32)
    return index // 20, index // 4 % 5, index % 4


def transition_table(rows: int, cols: int) -> Transitions:
    """
    Return the exact transitions, B = 1.

    Rewards: 0 for a legal pickup, +1 for a dropoff at the destination, -1 for all else. A dropoff
    at another landmark lets the passenger out there, and anywhere else does nothing.
    """
    cell, passenger, destination = state_parts(rows, cols)
    landmarks = _landmark_numbers(rows, cols)
    index = np.arange(rows * cols * 20, dtype=np.int32)
    successor = np.repeat(index[:, None], len(ACTIONS), axis=1)
    moves = np.array([cols, -cols, 1, -1], dtype=np.int32) * 20
    successor[:, :4] += np.where(blocked_moves(rows, cols), 0, moves)[cell]

    picked = (passenger != ABOARD) & (cell == _passenger_cells(rows, cols))
    successor[:, PICKUP] += np.where(picked, 4 * (ABOARD - passenger), 0)

    place = np.full(rows * cols, -1, dtype=np.int32)  # landmark of each cell
    place[landmarks] = range(4)
    here = place[cell]
    dropped = (passenger == ABOARD) & (here >= 0)
    successor[:, DROPOFF] += np.where(dropped, 4 * (here - ABOARD), 0)

    terminated = np.zeros(successor.shape, dtype=np.bool_)
    terminated[:, DROPOFF] = dropped & (here == destination)
    reward = np.where(terminated, 1.0, -1.0)
    reward[picked, PICKUP] = 0.0
    return Transitions(
        successor=read_only(successor[:, :, None]),
        probability=read_only(np.ones((*successor.shape, 1))),
        reward=read_only(reward[:, :, None]),
        terminated=read_only(terminated[:, :, None]),
    )


def feature_table(rows: int, cols: int) -> NDArray[np.int32]:
    """Return (S, 10): the values of ``taxi_features`` in every state."""
    cell, passenger, destination = state_parts(rows, cols)
    waiting_at = _passenger_cells(rows, cols)
    target = _landmark_numbers(rows, cols)[destination]
    mask = blocked_moves(rows, cols) @ (1 << np.arange(4))  # bit 0 south, 1 north, 2 east, 3 west
    table = np.empty((len(cell), 10), dtype=np.int32)
    for column, place in ((0, cell), (2, waiting_at), (4, target)):
        table[:, column], table[:, column + 1] = divmod(place, cols)
    table[:, 6] = passenger == ABOARD
    table[:, 7] = cell == waiting_at
    table[:, 8] = cell == target
    table[:, 9] = mask[cell]
    return read_only(table)


def taxi_features(rows: int, cols: int) -> tuple[Feature, ...]:
    """Return the ten features; their value 0 is the north row, the west column, no or none."""
    return (
        _line('taxi_row', 'which row the taxi is in', rows),
        _line('taxi_col', 'which column the taxi is in', cols),
        _line('passenger_row', 'which row the passenger is in', rows),
        _line('passenger_col', 'which column the passenger is in', cols),
        _line('destination_row', 'which row the destination is in', rows),
        _line('destination_col', 'which column the destination is in', cols),
        _yes_no('passenger_in_taxi', 'whether the passenger is in the taxi'),
        _yes_no('taxi_at_passenger', 'whether the taxi is where the passenger is'),
        _yes_no('taxi_at_destination', 'whether the taxi is at the destination'),
        Feature(
            'blocked_moves',
            'which moves a wall or the edge blocks',
            FeatureKind.NOMINAL,
            tuple(_mask_name(mask) for mask in range(16)),
        ),
    )


def _line(name: str, question: str, count: int) -> Feature:
    return Feature(name, question, FeatureKind.ORDINAL, tuple(map(str, range(count))))


def _yes_no(name: str, question: str) -> Feature:
    return Feature(name, question, FeatureKind.NOMINAL, ('no', 'yes'))


def _mask_name(mask: int) -> str:
    moves = [action.name for bit, action in enumerate(ACTIONS[:4]) if mask >> bit & 1]
    return ', '.join(moves) or 'none'


def _landmark_numbers(rows: int, cols: int) -> Column:
    """Return (4,): the cell of each landmark, row * cols + col."""
    cells = landmark_cells(rows, cols).values()
    return np.array([row * cols + col for row, col in cells], dtype=np.int32)


def _passenger_cells(rows: int, cols: int) -> Column:
    """Return (S,): the passenger's cell, row * cols + col; the taxi's when aboard."""
    cell, passenger, _ = state_parts(rows, cols)
    waiting_at = _landmark_numbers(rows, cols)[passenger % 4]
    return np.where(passenger == ABOARD, cell, waiting_at).astype(np.int32)
