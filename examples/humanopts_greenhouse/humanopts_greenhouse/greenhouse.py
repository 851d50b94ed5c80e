"""
Greenhouse: carry water from the tap until no bed is dry.

Tomatoes, beans and basil grow in three corners of a square house, and the tap is in the fourth.
One can of water is enough for one bed; it can only be poured at a dry bed.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
import itertools

from humanopts_env.board import Board, Mark, PERSON
from humanopts_env.colours import BLUE, GREEN, ORANGE, RED
from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    check_whole,
    Feature,
    shown_values,
)
from humanopts_env.domains.capabilities import (
    Baselines,
    in_words,
    move_effect,
    StepEffect,
)
from humanopts_env.domains.search_space import SearchSpace, space_by_features
from humanopts_env.domains.table_domain import TableDomain
import numpy as np

SMALLEST, LARGEST = 3, 9  # cells along a side
ACTIONS = (
    Action('north', 'up', 'walk one cell north'),
    Action('south', 'down', 'walk one cell south'),
    Action('west', 'left', 'walk one cell west'),
    Action('east', 'right', 'walk one cell east'),
    Action('fill', 'f', 'fill the can at the tap'),
    Action('pour', 'p', 'water the dry bed here'),
)
STEPS = {0: (-1, 0), 1: (1, 0), 2: (0, -1), 3: (0, 1)}  # rows and columns by action
FILL, POUR = 4, 5
BEDS = ('tomatoes', 'beans', 'basil')
NO_TAP = StepEffect('no tap here', changed=False)
NO_DRY_BED = StepEffect('no dry bed here', changed=False)
BED_MARKS = {  # kind, name and colour, by the text of the feature; None: not shown
    'yes': ('*', 'dry', RED),
    'no': ('♣', 'watered', GREEN),
    None: ('?', 'dry or watered', ''),
}
Cell = tuple[int, int]  # row, 0 = north; column, 0 = west


@dataclass(frozen=True, slots=True)
class GreenhouseState:
    """The position of the gardener, and the water in the can and the beds."""

    row: int
    col: int
    full: bool  # whether the can is full
    dry: tuple[bool, bool, bool]  # whether each of BEDS is dry


class Greenhouse(TableDomain[GreenhouseState]):
    """
    A square house of ``size`` x ``size`` cells.

    Every step costs 1, and watering a dry bed earns 10. The task starts with an empty can, three
    dry beds and the gardener anywhere; it is over when no bed is dry.
    """

    def __init__(self, size: int = 4) -> None:
        """
        Create a greenhouse.

        :raises DomainError: size is not a whole number from 3 to 9.
        """
        check_whole('size', size, SMALLEST, LARGEST)
        self.size = size
        self.name = 'greenhouse'
        self.parameters = {'size': size}
        self.features = _features(size)
        self.actions = ACTIONS
        self.gamma = 0.95
        self.max_steps = 200
        last = size - 1
        self.tap: Cell = (last, 0)
        self.beds: dict[Cell, int] = {(0, 0): 0, (0, last): 1, (last, last): 2}  # index into BEDS
        places, yes_no = range(size), (False, True)
        super().__init__(
            [
                GreenhouseState(row, col, full, dry)
                for row, col, full in itertools.product(places, places, yes_no)
                for dry in itertools.product(yes_no, yes_no, yes_no)
            ]
        )

    def outcomes(
        self, state: GreenhouseState, action: int
    ) -> Sequence[tuple[float, GreenhouseState, float]]:
        """Return the only outcome: the successor and its reward."""
        after = self._after(state, action)
        return [(1.0, after, 9.0 if sum(after.dry) < sum(state.dry) else -1.0)]

    def is_over(self, state: GreenhouseState) -> bool:
        """Return whether every bed has water."""
        return not any(state.dry)

    def can_begin(self, state: GreenhouseState) -> bool:
        """Return whether the can is empty and every bed is dry."""
        return all(state.dry) and not state.full

    def values_of(self, state: GreenhouseState) -> Sequence[int]:
        """Return row, column, whether the can is full, and whether each bed is dry."""
        return state.row, state.col, int(state.full), *map(int, state.dry)

    def encode(self, state: GreenhouseState) -> str:
        """Return the state as one line, such as ``cell 3,0 can full dry beans basil``."""
        dry = ' '.join(bed for bed, is_dry in zip(BEDS, state.dry) if is_dry)
        can = 'full' if state.full else 'empty'
        return f'cell {state.row},{state.col} can {can} dry {dry or "none"}'

    def board(self, state: GreenhouseState, shown: Collection[str] | None = None) -> Board:
        """
        Return the board of a state.

        :param shown: names of the features that may be revealed; None: all.
        """
        values = shown_values(self, state, shown)
        marks, drawn = [Mark(self.tap, 'T', 'tap', BLUE)], {f'{bed}_dry' for bed in BEDS}
        for cell, bed in self.beds.items():
            marks.append(Mark(cell, *BED_MARKS[values.get(f'{BEDS[bed]}_dry')]))
        if {'row', 'col'} <= values.keys():
            marks.insert(0, Mark((state.row, state.col), PERSON, 'gardener', ORANGE))
            drawn |= {'row', 'col'}
        notes = in_words(values, drawn)
        return Board(self.size, self.size, marks=tuple(marks), notes=notes)

    def step_effect(
        self, state: GreenhouseState, action: int, successor: GreenhouseState
    ) -> StepEffect:
        """Return the effect of a step."""
        if action in STEPS:
            moved = successor != state
            return move_effect(ACTIONS[action].name, ACTIONS[action].name if moved else '')
        if action == FILL:
            if state.full:
                return StepEffect('the can is full already', changed=False)
            return StepEffect('filled the can') if successor.full else NO_TAP
        if not state.full:
            return StepEffect('the can is empty', changed=False)
        watered = [bed for bed, was, dry in zip(BEDS, state.dry, successor.dry) if was > dry]
        return StepEffect(f'watered the {watered[0]}') if watered else NO_DRY_BED

    def board_slices(self) -> list[BoardSlice]:
        """Return the layouts with the can empty and full, and every bed dry."""
        shape = self.size, self.size, 2, 2 ** len(BEDS)
        states = np.arange(self.n_states, dtype=np.int32).reshape(shape)
        return [
            BoardSlice(f'can {text}, every bed dry', states[:, :, full, -1])
            for full, text in enumerate(('empty', 'full'))
        ]

    def search_space(self) -> SearchSpace:
        """Return the search space with the gardener's cells; changes of the can are events."""
        return space_by_features(
            self,
            cell=('row', 'col'),
            status='can_full',
            events={'yes': 'fill', 'no': 'pour'},
            situation=[feature.name for feature in self.features],
            own_goals=True,
        )

    def baselines(self) -> Baselines:
        """Return the baseline for plans: a hand-written rule."""
        from humanopts_greenhouse.reference import reference_options  # avoids a circular import

        options = reference_options(self).values()  # at most one of them can start
        optimal = np.any([option.optimal for option in options], axis=0)
        return Baselines(heuristic=lambda games: optimal[games.state].argmax(axis=1))

    def _after(self, state: GreenhouseState, action: int) -> GreenhouseState:
        cell = state.row, state.col
        if action == FILL:
            return replace(state, full=True) if cell == self.tap else state
        if action == POUR:
            here = self.beds.get(cell)
            if not state.full or here is None or not state.dry[here]:
                return state
            dry = tuple(is_dry and bed != here for bed, is_dry in enumerate(state.dry))
            return GreenhouseState(*cell, False, (dry[0], dry[1], dry[2]))
        row, col = (place + step for place, step in zip(cell, STEPS[action]))
        inside = 0 <= row < self.size and 0 <= col < self.size
        return replace(state, row=row, col=col) if inside else state


def _features(size: int) -> tuple[Feature, ...]:
    answers = ('no', 'yes')
    return (
        *Feature.place('', 'the gardener', size, size),
        Feature.nominal('can_full', 'whether the can is full', answers),
        *[Feature.nominal(f'{bed}_dry', f'whether the {bed} are dry', answers) for bed in BEDS],
    )
