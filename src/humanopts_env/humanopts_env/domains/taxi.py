"""
Taxi: fetch a passenger from one of four landmarks and deliver the passenger to another.

T. G. Dietterich (2000), "Hierarchical Reinforcement Learning with the MAXQ Value Function
Decomposition", section 2, figure 1. The 5 x 5 grid has the states, actions, walls and transitions
of Gymnasium's Taxi; the rewards are those of Subramanian, Isbell and Thomaz (2011), section 3.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import re

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.board import Board, BOX, FLAG, HATCHED_BOX, Mark, OPEN_BOX, PERSON, Wall
from humanopts_env.colours import BLUE, GREEN, MAGENTA, ORANGE, RED, TEAL
from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    check_whole,
    Feature,
    Parameter,
    shown_values,
    StateError,
    subset_names,
    Transitions,
)
from humanopts_env.domains.capabilities import in_words, move_effect, StepEffect, TeachingDefaults
from humanopts_env.domains.search_space import plain_cell_name, SearchSpace, space_by_features
from humanopts_env.domains.table_domain import built_once, SharedTables
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
DIRECTIONS = {(1, 0): 'south', (-1, 0): 'north', (0, 1): 'east', (0, -1): 'west'}
Cell = tuple[int, int]  # row, 0 = north edge; column, 0 = west edge
Column = NDArray[np.int32]


def landmark_cells(rows: int, cols: int) -> dict[str, Cell]:
    """Return the cell of each landmark."""
    corners = ((0, 0), (0, cols - 1), (rows - 1, 0), (rows - 1, cols - 2))
    return dict(zip(LANDMARKS, corners))


def walls_east(rows: int, cols: int) -> Flags:
    """Return (rows, cols): whether a wall or the edge is on the east side of each cell."""
    walls = np.zeros((rows, cols), dtype=np.bool_)
    height = 2 * rows // 5
    walls[:height, 2 * cols // 5 - 1] = True
    for col in (cols // 5 - 1, 3 * cols // 5 - 1):
        walls[rows - height :, col] = True  # column -1 (no wall) is the east edge
    walls[:, -1] = True
    return read_only(walls)


def blocked_moves(rows: int, cols: int) -> Flags:
    """Return (rows * cols, 4): whether each move is blocked in each cell, in action order."""
    row = np.indices((rows, cols))[0]
    east = walls_east(rows, cols)
    west = np.roll(east, 1, axis=1)  # a cell's west is its neighbour's east; the edges wrap
    return np.stack((row == rows - 1, row == 0, east, west), axis=2).reshape(-1, 4)


def taxi_features(rows: int, cols: int) -> tuple[Feature, ...]:
    """Return the ten features; value 0 is the north row, the west column, no or none."""
    blocked = subset_names([action.name for action in ACTIONS[:4]])
    yes_no = ('no', 'yes')
    return (
        *Feature.place('taxi', 'the taxi', rows, cols),
        *Feature.place('passenger', 'the passenger', rows, cols),
        *Feature.place('destination', 'the destination', rows, cols),
        Feature.nominal('passenger_in_taxi', 'whether the passenger is in the taxi', yes_no),
        Feature.nominal('taxi_at_passenger', 'whether the taxi is where the passenger is', yes_no),
        Feature.nominal('taxi_at_destination', 'whether the taxi is at the destination', yes_no),
        Feature.nominal('blocked_moves', 'which moves a wall or the edge blocks', blocked),
    )


EMPTY_TAXI, FULL_TAXI, SOME_TAXI = OPEN_BOX, BOX, HATCHED_BOX
TAXIS = {  # by the text of passenger_in_taxi
    'no': (EMPTY_TAXI, 'taxi, empty', ORANGE),
    'yes': (FULL_TAXI, 'taxi, passenger aboard', GREEN),
    None: (SOME_TAXI, 'taxi', ORANGE),
}
EXPLANATION = (
    ('', 'Fetch the passenger and drive to the destination. Each step costs 1; delivery earns 1.'),
    (f'{EMPTY_TAXI} {FULL_TAXI}', 'the taxi: empty, and with the passenger'),
    (SOME_TAXI, 'the taxi, when it is not shown whether it is empty'),
    (PERSON, 'the waiting passenger'),
    (FLAG, 'the destination'),
    ('R G Y B', 'landmarks: the passenger waits and gets off only there'),
    ('┃ ━', 'walls'),
)
LANDMARK_COLOURS = dict(zip(LANDMARKS, (RED, GREEN, ORANGE, BLUE)))
NEEDS = {  # marks that must be on the board to show a feature, except rows and columns
    'passenger_in_taxi': {'taxi'},
    'taxi_at_passenger': {'taxi', 'passenger'},
    'taxi_at_destination': {'taxi', 'destination'},
    'blocked_moves': {'taxi'},
}


MIN_SIDE, MAX_SIDE = 4, 1000  # rows and columns
# Options taught by the participants of Subramanian, Isbell and Thomaz (2011), section 7.
DEMO_OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')
STATE_TEXT = re.compile(
    r'taxi (\d{1,3}),(\d{1,3}) passenger (R|G|Y|B|aboard) destination (R|G|Y|B)'
)


@dataclass(frozen=True, slots=True)
class TaxiState:
    """Positions of the taxi, its passenger and the destination."""

    row: int  # 0 = north edge
    col: int  # 0 = west edge
    passenger: int  # 0..3: waits at LANDMARKS[passenger]; ABOARD
    destination: int  # index into LANDMARKS


class Taxi(SharedTables[TaxiState]):
    """
    Taxi on a grid of any size, an ``EnumerableDomain``.

    The landmarks are R and G in the north-west and north-east corners, Y in the south-west corner
    and B one column west of the south-east corner. Three columns have walls on their east side:
    column 2C//5 - 1 in the first 2R//5 rows, and columns C//5 - 1 and 3C//5 - 1 in the last
    2R//5 rows (R rows, C columns; a column -1 has no wall). With 5 x 5 this is Dietterich's grid.

    States are numbered ((row * C + col) * 5 + passenger) * 4 + destination.
    """

    def __init__(self, rows: int = 5, cols: int = 5) -> None:
        """
        Create a taxi grid.

        :raises DomainError: rows or cols is not a whole number from 4 to 1000.
        """
        check_whole('rows', rows, MIN_SIDE, MAX_SIDE)
        check_whole('cols', cols, MIN_SIDE, MAX_SIDE)
        self.rows, self.cols = rows, cols
        self.name = 'taxi'
        self.parameters: Mapping[str, Parameter] = {'rows': rows, 'cols': cols}
        self.features: Sequence[Feature] = taxi_features(rows, cols)
        self.actions: Sequence[Action] = ACTIONS
        self.gamma = 0.99
        self.max_steps = 20 * (rows + cols)  # 200 on the 5 x 5 grid
        self.explanation = EXPLANATION
        self.teaching = TeachingDefaults(DEMO_OPTIONS)

    @property
    def n_states(self) -> int:
        return self.rows * self.cols * 20

    def is_over(self, state: TaxiState) -> bool:
        return state.passenger == state.destination

    def encode(self, state: TaxiState) -> str:
        """Return the state as one line, such as ``taxi 2,3 passenger R destination B``."""
        passenger = 'aboard' if state.passenger == ABOARD else LANDMARKS[state.passenger]
        destination = LANDMARKS[state.destination]
        return f'taxi {state.row},{state.col} passenger {passenger} destination {destination}'

    def decode(self, text: str) -> TaxiState:
        match = STATE_TEXT.fullmatch(text)
        if match is None:
            raise StateError(
                f'{text!r} is not a taxi state; write one like "taxi 2,3 passenger R destination '
                'B", or "passenger aboard"'
            )
        row, col, passenger, destination = match.groups()
        place = (*LANDMARKS, 'aboard').index(passenger)
        state = TaxiState(int(row), int(col), place, LANDMARKS.index(destination))
        self.index(state)
        if self.encode(state) != text:
            raise StateError(f'{text!r} is not written as {self.encode(state)!r}')
        return state

    def board(self, state: TaxiState, shown: Collection[str] | None = None) -> Board:
        values = shown_values(self, state, shown)
        cells = {
            thing: (int(values[f'{thing}_row']), int(values[f'{thing}_col']))
            for thing in ('taxi', 'passenger', 'destination')
            if {f'{thing}_row', f'{thing}_col'} <= values.keys()
        }
        seen = {f'{thing}_{part}' for thing in cells for part in ('row', 'col')}
        seen |= {name for name, things in NEEDS.items() if things <= cells.keys()}
        taxi = TAXIS[values.get('passenger_in_taxi')]
        if taxi[0] == FULL_TAXI and 'taxi' in cells:
            cells.pop('passenger', None)  # drawn with the taxi
        looks = {
            'taxi': taxi,
            'passenger': (PERSON, 'passenger', MAGENTA),
            'destination': (FLAG, 'destination', TEAL),
        }
        marks = [Mark(cell, *looks[thing]) for thing, cell in cells.items()]
        marks += [
            Mark(cell, letter, 'landmarks', LANDMARK_COLOURS[letter])
            for letter, cell in landmark_cells(self.rows, self.cols).items()
            if list(cells.values()).count(cell) < 3  # a cell shows three marks
        ]
        notes = in_words(values, seen)
        return Board(self.rows, self.cols, (), self._walls, tuple(marks), notes)

    @cached_property
    def _walls(self) -> tuple[Wall, ...]:
        """The walls between cells, one per side of a cell."""
        east = walls_east(self.rows, self.cols)[:, :-1]
        return tuple((row, col + 1, row + 1, col + 1) for row, col in np.argwhere(east).tolist())

    def index(self, state: TaxiState) -> int:
        on_grid = 0 <= state.row < self.rows and 0 <= state.col < self.cols
        if not (on_grid and 0 <= state.passenger <= ABOARD and 0 <= state.destination < 4):
            raise StateError(f'{state} is not on a grid of {self.rows} x {self.cols} cells')
        cell = state.row * self.cols + state.col
        return (cell * 5 + state.passenger) * 4 + state.destination

    def state_at(self, index: int) -> TaxiState:
        if not 0 <= index < self.n_states:
            raise StateError(f'taxi has no state {index}; it has 0 to {self.n_states - 1}')
        cell, rest = divmod(index, 20)
        return TaxiState(*divmod(cell, self.cols), *divmod(rest, 4))

    def step_effect(self, state: TaxiState, action: int, successor: TaxiState) -> StepEffect:
        if action == PICKUP:
            if state.passenger == ABOARD:
                return StepEffect('the passenger is aboard already', changed=False)
            if successor.passenger != ABOARD:
                return StepEffect('no passenger here', changed=False)
            return StepEffect('picked the passenger up')
        if action == DROPOFF:
            if state.passenger != ABOARD:
                return StepEffect('no passenger aboard', changed=False)
            if successor.passenger == ABOARD:
                where = f'{", ".join(LANDMARKS[:-1])} and {LANDMARKS[-1]}'
                return StepEffect(f'passengers get out only at {where}', changed=False)
            if successor.passenger == successor.destination:
                return StepEffect('delivered the passenger')
            return StepEffect(f'let the passenger out at {LANDMARKS[successor.passenger]}')
        went = DIRECTIONS.get((successor.row - state.row, successor.col - state.col), '')
        return move_effect(ACTIONS[action].name, went)

    def board_slices(self) -> list[BoardSlice]:
        """Return the layouts with the passenger at R and aboard, with destination B."""
        cells = np.arange(self.rows * self.cols, dtype=np.int32).reshape(self.rows, self.cols)
        destination = LANDMARKS.index('B')
        return [
            BoardSlice(
                f'passenger {where}, destination B', cells * 20 + passenger * 4 + destination
            )
            for where, passenger in (('waiting at R', 0), ('aboard', ABOARD))
        ]

    def search_space(self) -> SearchSpace:
        """Return the search space with the taxi's cells; pickups and dropoffs are events."""
        landmarks = {c: name for name, c in landmark_cells(self.rows, self.cols).items()}

        def name(values: tuple[int, ...]) -> str:
            return landmarks.get((values[0], values[1])) or plain_cell_name(values)

        taxi, passenger = ('taxi_row', 'taxi_col'), ('passenger_row', 'passenger_col')
        return space_by_features(
            self,
            cell=taxi,
            status='passenger_in_taxi',
            events={'yes': 'pickup', 'no': 'dropoff'},
            situation=(*taxi, *passenger, 'passenger_in_taxi'),
            own_goals=True,
            cell_name=name,
        )

    @built_once
    def over(self) -> Flags:
        _, passenger, destination = self._parts()
        over: Flags = passenger == destination
        return read_only(over)

    @cached_property
    def _open(self) -> Ints:
        return np.flatnonzero(~self.over())

    @built_once
    def start_states(self) -> NDArray[np.int32]:
        _, passenger, _ = self._parts()
        return read_only(np.flatnonzero(~self.over() & (passenger != ABOARD)).astype(np.int32))

    @built_once
    def transitions(self) -> Transitions:
        """
        Return the exact transitions, B = 1.

        Rewards: 0 for a legal pickup, +1 for a dropoff at the destination, -1 otherwise. A dropoff
        at another landmark leaves the passenger there; in any other cell it has no effect.
        """
        cell, passenger, destination = self._parts()
        index = np.arange(self.n_states, dtype=np.int32)
        successor = np.repeat(index[:, None], len(ACTIONS), axis=1)
        moves = np.array([self.cols, -self.cols, 1, -1], dtype=np.int32) * 20
        successor[:, :4] += np.where(blocked_moves(self.rows, self.cols), 0, moves)[cell]

        picked = (passenger != ABOARD) & (cell == self._passenger_cells())
        successor[:, PICKUP] += np.where(picked, 4 * (ABOARD - passenger), 0)

        place = np.full(self.rows * self.cols, -1, dtype=np.int32)  # landmark of each cell
        place[self._landmarks] = range(4)
        here = place[cell]
        dropped = (passenger == ABOARD) & (here >= 0)
        successor[:, DROPOFF] += np.where(dropped, 4 * (here - ABOARD), 0)

        terminated = np.zeros(successor.shape, dtype=np.bool_)
        terminated[:, DROPOFF] = dropped & (here == destination)
        reward = np.where(terminated, 1.0, -1.0)
        reward[picked, PICKUP] = 0.0
        return Transitions(
            successor=read_only(successor[:, :, None]),
            probability=np.broadcast_to(1.0, (*successor.shape, 1)),
            reward=read_only(reward[:, :, None]),
            terminated=read_only(terminated[:, :, None]),
        )

    @built_once
    def feature_table(self) -> Rows:
        cell, passenger, destination = self._parts()
        waiting_at, target = self._passenger_cells(), self._landmarks[destination]
        # bit 0 south, 1 north, 2 east, 3 west
        mask = blocked_moves(self.rows, self.cols) @ (1 << np.arange(4))
        table = np.empty((len(cell), 10))
        for column, place in ((0, cell), (2, waiting_at), (4, target)):
            table[:, column], table[:, column + 1] = divmod(place, self.cols)
        table[:, 6] = passenger == ABOARD
        table[:, 7] = cell == waiting_at
        table[:, 8] = cell == target
        table[:, 9] = mask[cell]
        return read_only(table)

    def _parts(self) -> tuple[Column, Column, Column]:
        """Return (S,) each: the taxi's cell (row * cols + col), passenger and destination."""
        index = np.arange(self.n_states, dtype=np.int32)
        return index // 20, index // 4 % 5, index % 4

    @property
    def _landmarks(self) -> Column:
        """(4,): the cell of each landmark, row * cols + col."""
        cells = landmark_cells(self.rows, self.cols).values()
        return np.array([row * self.cols + col for row, col in cells], dtype=np.int32)

    def _passenger_cells(self) -> Column:
        """Return (S,): the passenger's cell, row * cols + col; the taxi's when aboard."""
        cell, passenger, _ = self._parts()
        waiting_at = self._landmarks[passenger % 4]
        return np.where(passenger == ABOARD, cell, waiting_at).astype(np.int32)
