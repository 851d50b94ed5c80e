"""
Taxi: fetch a passenger from one of four landmarks and deliver to another.

T. G. Dietterich (2000), "Hierarchical Reinforcement Learning with the MAXQ Value Function
Decomposition", section 2, figure 1. The 5 x 5 grid has the states, actions, walls and transitions
of Gymnasium's Taxi; the rewards are those of Subramanian, Isbell and Thomaz (2011), section 3.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import re

from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    DomainError,
    Feature,
    Outcome,
    Parameter,
    StateError,
    Transitions,
)
from humanopts_env.domains.capabilities import TeachingDefaults
from humanopts_env.domains.search_space import plain_cell_name, SearchSpace, space_by_features
from humanopts_env.domains.shared_tables import SharedTables
from humanopts_env.domains.taxi_board import draw_board, GLYPH_STYLES
from humanopts_env.domains.taxi_tables import (
    ABOARD,
    ACTIONS,
    feature_table,
    landmark_cells,
    LANDMARKS,
    state_parts,
    taxi_features,
    transition_table,
    walls_east,
)
import numpy as np
from numpy.typing import NDArray

SMALLEST, LARGEST = 4, 1000  # rows and columns
# What the participants of Subramanian, Isbell and Thomaz (2011) were asked to teach (section 7).
DEMO_OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')
STATE_TEXT = re.compile(
    r'taxi (\d{1,3}),(\d{1,3}) passenger (R|G|Y|B|aboard) destination (R|G|Y|B)'
)


@dataclass(frozen=True, slots=True)
class TaxiState:
    """Where the taxi, its passenger and the destination are."""

    row: int  # 0 = north edge
    col: int  # 0 = west edge
    passenger: int  # 0..3: waits at LANDMARKS[passenger]; ABOARD
    destination: int  # index into LANDMARKS


class Taxi(SharedTables[TaxiState]):
    """
    Taxi on a grid of any size, an ``EnumerableDomain``.

    The landmarks are R and G in the north-west and north-east corners, Y in the south-west corner
    and B one column west of the south-east corner. Walls stand on the east side of three columns:
    of column 2C//5 - 1 in the first 2R//5 rows, and of columns C//5 - 1 and 3C//5 - 1 in the last
    2R//5 rows (R rows, C columns; a column -1 has no wall). With 5 x 5 this is Dietterich's grid.

    States are numbered ((row * C + col) * 5 + passenger) * 4 + destination.
    """

    def __init__(self, rows: int = 5, cols: int = 5) -> None:
        """
        Make a taxi grid.

        :raises DomainError: rows or cols is not a whole number from 4 to 1000.
        """
        for name, value in (('rows', rows), ('cols', cols)):
            whole = isinstance(value, int) and not isinstance(value, bool)
            if not whole or not SMALLEST <= value <= LARGEST:
                raise DomainError(
                    f'{name} is {value!r}, and must be a whole number from {SMALLEST} to {LARGEST}'
                )
        self.rows, self.cols = rows, cols
        self.name = 'taxi'
        self.parameters: Mapping[str, Parameter] = {'rows': rows, 'cols': cols}
        self.features: Sequence[Feature] = taxi_features(rows, cols)
        self.actions: Sequence[Action] = ACTIONS
        self.gamma = 0.99
        self.max_steps = 20 * (rows + cols)  # 200 on the 5 x 5 grid
        self.glyph_styles: Mapping[str, str] = GLYPH_STYLES
        self.teaching = TeachingDefaults(DEMO_OPTIONS)

    @property
    def n_states(self) -> int:
        """Number of states, reachable or not."""
        return self.rows * self.cols * 20

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """
        Take one primitive action; there is no chance in it.

        :raises DomainError: the action is not in the domain, or the passenger was delivered.
        """
        if not 0 <= action < len(ACTIONS):
            raise DomainError(f'taxi has no action {action}; it has 0 to {len(ACTIONS) - 1}')
        if self.is_over(state):
            raise DomainError('the passenger was delivered, so no step can be taken')
        table, at = self.transitions(), (self.index(state), action, 0)
        successor = self.state_at(int(table.successor[at]))
        return Outcome(successor, float(table.reward[at]), bool(table.terminated[at]))

    def is_over(self, state: TaxiState) -> bool:
        """Tell whether the passenger is at the destination."""
        return state.passenger == state.destination

    def can_follow(self, state: TaxiState, action: int, successor: TaxiState) -> bool:
        """Tell whether ``step`` can lead from ``state`` by ``action`` to ``successor``."""
        if self.is_over(state) or not 0 <= action < len(ACTIONS):
            return False
        found = self.transitions().successor[self.index(state), action, 0]
        return int(found) == self.index(successor)

    def encode(self, state: TaxiState) -> str:
        """Return the state as one line, such as ``taxi 2,3 passenger R destination B``."""
        passenger = 'aboard' if state.passenger == ABOARD else LANDMARKS[state.passenger]
        destination = LANDMARKS[state.destination]
        return f'taxi {state.row},{state.col} passenger {passenger} destination {destination}'

    def decode(self, text: str) -> TaxiState:
        """
        Return the state that ``encode`` wrote.

        :raises StateError: ``text`` is not a state of this domain.
        """
        match = STATE_TEXT.fullmatch(text)
        if match is None:
            raise StateError(
                f'{text!r} is not a taxi state; one reads "taxi 2,3 passenger R destination B", '
                'or "passenger aboard"'
            )
        row, col, passenger, destination = match.groups()
        place = (*LANDMARKS, 'aboard').index(passenger)
        state = TaxiState(int(row), int(col), place, LANDMARKS.index(destination))
        self.index(state)
        if self.encode(state) != text:
            raise StateError(f'{text!r} is not written as {self.encode(state)!r}')
        return state

    def sample_states(self, rng: np.random.Generator, count: int) -> list[TaxiState]:
        """Draw states uniformly from those that an episode can pass through, never over."""
        open_states = np.flatnonzero(~self.over())
        return [self.state_at(int(index)) for index in rng.choice(open_states, count)]

    def render(self, state: TaxiState, shown: Collection[str] | None = None) -> str:
        """
        Draw the state as text lines.

        :param shown: names of the features that may be revealed; None: all.
        """
        values = zip(self.features, self.feature_values(state).tolist())
        visible = [(f, value) for f, value in values if shown is None or f.name in shown]
        places = landmark_cells(self.rows, self.cols)
        return draw_board(walls_east(self.rows, self.cols), places, visible)

    def index(self, state: TaxiState) -> int:
        """
        Return the state's index, 0..n_states-1.

        :raises StateError: it is not a state of this grid.
        """
        on_grid = 0 <= state.row < self.rows and 0 <= state.col < self.cols
        if not (on_grid and 0 <= state.passenger <= ABOARD and 0 <= state.destination < 4):
            raise StateError(f'{state} is not on a grid of {self.rows} x {self.cols} cells')
        cell = state.row * self.cols + state.col
        return (cell * 5 + state.passenger) * 4 + state.destination

    def state_at(self, index: int) -> TaxiState:
        """
        Return the state of an index.

        :raises StateError: there is no such state.
        """
        if not 0 <= index < self.n_states:
            raise StateError(f'taxi has no state {index}; it has 0 to {self.n_states - 1}')
        cell, rest = divmod(index, 20)
        return TaxiState(*divmod(cell, self.cols), *divmod(rest, 4))

    def board_slices(self) -> list[BoardSlice]:
        """Return the layouts with the passenger waiting at R and aboard, both bound for B."""
        cells = np.arange(self.rows * self.cols, dtype=np.int32).reshape(self.rows, self.cols)
        destination = LANDMARKS.index('B')
        return [
            BoardSlice(
                f'passenger {where}, destination B', cells * 20 + passenger * 4 + destination
            )
            for where, passenger in (('waiting at R', 0), ('aboard', ABOARD))
        ]

    def search_space(self) -> SearchSpace:
        """Return the search space whose cells are the taxi's; pickups and dropoffs are events."""
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

    def _build_over(self) -> NDArray[np.bool_]:
        _, passenger, destination = state_parts(self.rows, self.cols)
        over: NDArray[np.bool_] = passenger == destination
        return over

    def _build_start_states(self) -> NDArray[np.int32]:
        _, passenger, _ = state_parts(self.rows, self.cols)
        return np.flatnonzero(~self.over() & (passenger != ABOARD)).astype(np.int32)

    def _build_transitions(self) -> Transitions:
        return transition_table(self.rows, self.cols)

    def _build_feature_table(self) -> NDArray[np.int32]:
        return feature_table(self.rows, self.cols)
