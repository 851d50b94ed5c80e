"""
Rooms: walk through four rooms to a goal, with moves that may slip.

R. S. Sutton, D. Precup and S. Singh (1999), "Between MDPs and semi-MDPs: A framework for temporal
abstraction in reinforcement learning", section 3, figure 2.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from humanopts_env.board import BLOCK, Board, FLAG, Mark, PERSON
from humanopts_env.colours import GREY, ORANGE, TEAL
from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    check_choice,
    Feature,
    shown_values,
    subset_names,
)
from humanopts_env.domains.capabilities import in_words, move_effect, StepEffect
from humanopts_env.domains.table_domain import TableDomain
import numpy as np

# Interior of the gridworld in figure 2 of the paper, row 0 in the north. a b c d: cells of the
# four rooms; N W E S: doorways; #: walls. Outer walls surround it.
LAYOUT = (
    'aaaaa#bbbbb',
    'aaaaa#bbbbb',
    'aaaaaNbbbbb',
    'aaaaa#bbbbb',
    'aaaaa#bbbbb',
    '#W####bbbbb',
    'ccccc###E##',
    'ccccc#ddddd',
    'ccccc#ddddd',
    'cccccSddddd',
    'ccccc#ddddd',
)
ROOMS = {'a': 'north-west', 'b': 'north-east', 'c': 'south-west', 'd': 'south-east'}
DOORWAYS = {'N': 'north', 'W': 'west', 'E': 'east', 'S': 'south'}
GOALS = {'G1': (6, 8), 'G2': (8, 8)}  # the east doorway; a cell of the south-east room
EXPLANATION = (
    ('', 'Walk to the goal. One step in three goes a different way than you want.'),
    (PERSON, 'you'),
    (FLAG, 'the goal'),
    (BLOCK, 'walls'),
)
Place = tuple[int, int]  # row, 0 = north; column, 0 = west


ACTIONS = (
    Action('up', 'up', 'walk one cell north'),
    Action('down', 'down', 'walk one cell south'),
    Action('left', 'left', 'walk one cell west'),
    Action('right', 'right', 'walk one cell east'),
)
STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # rows, columns of each action
INTENDED = 2 / 3  # probability of the intended direction; the other three share the rest
# The 104 cells of the agent, and the walls, by row and column.
PLACES = [(r, c) for r, line in enumerate(LAYOUT) for c, sign in enumerate(line) if sign != '#']
WALLS = tuple(
    (r, c) for r, line in enumerate(LAYOUT) for c, sign in enumerate(line) if sign == '#'
)
OPEN = frozenset(PLACES)
NOWHERE = ('none', *DOORWAYS.values())
ROOM_VALUES = (*ROOMS.values(), 'doorway')


@dataclass(frozen=True, slots=True)
class RoomsState:
    """The agent's position."""

    row: int  # 0 = north edge
    col: int  # 0 = west edge


class Rooms(TableDomain[RoomsState]):
    """
    The four-room gridworld: 104 cells, four doorways ("hallways" in the paper).

    A move goes in the intended direction with probability 2/3 and in each other direction with
    1/9; moves into walls have no effect. Entering the goal has reward 1 and ends the task; all
    other rewards are 0. Episodes start in any other cell.
    """

    def __init__(self, goal: str = 'G1') -> None:
        """
        Create the rooms.

        :param goal: G1, the east doorway, or G2, a cell of the south-east room, as in the paper.
        :raises DomainError: the goal is unknown.
        """
        check_choice('goal', goal, GOALS)
        super().__init__([RoomsState(*place) for place in PLACES])
        self.goal = RoomsState(*GOALS[goal])
        self.name = 'rooms'
        self.parameters = {'goal': goal}
        self.features = _features()
        self.actions = ACTIONS
        self.gamma = 0.9
        self.max_steps = 1000
        self.explanation = EXPLANATION

    def outcomes(
        self, state: RoomsState, action: int
    ) -> Sequence[tuple[float, RoomsState, float]]:
        """Return the four outcomes: the intended one, then the others in action order."""
        slips = [other for other in range(4) if other != action]
        shares = (INTENDED, *[(1 - INTENDED) / 3] * 3)
        arrivals = [RoomsState(*neighbour((state.row, state.col), a)) for a in (action, *slips)]
        return [(p, to, float(to == self.goal)) for p, to in zip(shares, arrivals)]

    def is_over(self, state: RoomsState) -> bool:
        """Return whether the agent is at the goal."""
        return state == self.goal

    def can_begin(self, state: RoomsState) -> bool:
        """Return whether the agent is not at the goal."""
        return state != self.goal

    def values_of(self, state: RoomsState) -> Sequence[int]:
        """Return row, column, room, doorway and blocked moves."""
        place = state.row, state.col
        sign = LAYOUT[state.row][state.col]
        room = ROOM_VALUES.index(ROOMS.get(sign, 'doorway'))
        doorway = NOWHERE.index(DOORWAYS.get(sign, 'none'))
        blocked = sum(1 << action for action in range(4) if neighbour(place, action) == place)
        return state.row, state.col, room, doorway, blocked

    def encode(self, state: RoomsState) -> str:
        """Return the state as one line, such as ``cell 2,5``."""
        return f'cell {state.row},{state.col}'

    def board(self, state: RoomsState, shown: Collection[str] | None = None) -> Board:
        values = shown_values(self, state, shown)
        marks = [Mark((self.goal.row, self.goal.col), FLAG, 'goal', TEAL)]
        if seen := {'row', 'col'} <= values.keys():
            marks.insert(0, Mark((state.row, state.col), PERSON, 'agent', ORANGE))
        notes = () if seen else in_words(values)  # the cell determines the other features
        return Board(len(LAYOUT), len(LAYOUT[0]), WALLS, (), tuple(marks), notes, GREY)

    def step_effect(self, state: RoomsState, action: int, successor: RoomsState) -> StepEffect:
        """Return the effect of a step, which may have slipped."""
        place, after = (state.row, state.col), (successor.row, successor.col)
        step = after[0] - place[0], after[1] - place[1]
        went = ACTIONS[STEPS.index(step)].name if step in STEPS else ''
        effect = move_effect(ACTIONS[action].name, went, free=neighbour(place, action) != place)
        if self.is_over(successor):
            effect = replace(effect, text=f'{effect.text} and reached the goal')
        return effect

    def board_slices(self) -> list[BoardSlice]:
        """Return the only layout."""
        cells = np.full((len(LAYOUT), len(LAYOUT[0])), -1, dtype=np.int32)
        for index, place in enumerate(PLACES):
            cells[place] = index
        return [BoardSlice(f'goal {self.parameters["goal"]}', cells)]


def neighbour(place: Place, action: int) -> Place:
    """Return the target cell of an intended move: a neighbour of ``place``, or ``place``."""
    to = place[0] + STEPS[action][0], place[1] + STEPS[action][1]
    return to if to in OPEN else place


def _features() -> tuple[Feature, ...]:
    blocked = subset_names([action.name for action in ACTIONS])
    return (
        *Feature.place('', 'the agent', len(LAYOUT), len(LAYOUT[0])),
        Feature.nominal('room', 'which room the agent is in', ROOM_VALUES),
        Feature.nominal('doorway', 'which doorway the agent is in', NOWHERE),
        Feature.nominal('blocked_moves', 'which moves a wall blocks', blocked),
    )
