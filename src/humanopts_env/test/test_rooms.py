"""Rooms and its hallway options, by what the paper and its figure say and by hand."""

from collections import Counter

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.rooms import Rooms, RoomsState
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_env.domains.tabular import best_paths, draw_outcomes, outcome_limits
from humanopts_env.seeding import generator
import numpy as np
import pytest

ROOMS = Rooms()
UP, DOWN, LEFT, RIGHT = range(4)


def count_of(feature: str) -> dict[str, int]:
    """Return how many states have each value of a feature."""
    column = [f.name for f in ROOMS.features].index(feature)
    values = ROOMS.features[column].values
    return dict(Counter(values[int(row[column])] for row in ROOMS.feature_table().tolist()))


def test_there_are_104_cells_in_four_rooms_and_four_doorways() -> None:
    """Rooms of 5 x 5, 6 x 5, 5 x 5 and 4 x 5 cells."""
    assert ROOMS.n_states == 104
    assert count_of('room') == {
        'north-west': 25,
        'north-east': 30,
        'south-west': 25,
        'south-east': 20,
        'doorway': 4,
    }
    assert count_of('doorway') == {'none': 100, 'north': 1, 'west': 1, 'east': 1, 'south': 1}


@pytest.mark.parametrize(
    ('start', 'action', 'arrivals'),
    [
        ((0, 0), UP, {(0, 0): 7 / 9, (1, 0): 1 / 9, (0, 1): 1 / 9}),
        ((1, 1), UP, {(0, 1): 6 / 9, (2, 1): 1 / 9, (1, 0): 1 / 9, (1, 2): 1 / 9}),
        ((2, 4), RIGHT, {(2, 5): 6 / 9, (2, 3): 1 / 9, (1, 4): 1 / 9, (3, 4): 1 / 9}),
        ((2, 5), UP, {(2, 5): 7 / 9, (2, 4): 1 / 9, (2, 6): 1 / 9}),
        ((0, 4), RIGHT, {(0, 4): 7 / 9, (1, 4): 1 / 9, (0, 3): 1 / 9}),
    ],
)
def test_moves_slip_as_the_paper_says(
    start: tuple[int, int], action: int, arrivals: dict[tuple[int, int], float]
) -> None:
    """2/3 as intended, 1/9 in each other direction; into a wall the agent stays."""
    table, here = ROOMS.transitions(), ROOMS.index(RoomsState(*start))
    found: dict[tuple[int, int], float] = {}
    for to, share in zip(table.successor[here, action], table.probability[here, action]):
        state = ROOMS.state_at(int(to))
        found[state.row, state.col] = found.get((state.row, state.col), 0.0) + share
    assert found == pytest.approx(arrivals)


@pytest.mark.parametrize(('goal', 'cell'), [('G1', (6, 8)), ('G2', (8, 8))])
def test_entering_the_goal_is_worth_one_and_ends_the_task(
    goal: str, cell: tuple[int, int]
) -> None:
    domain = Rooms(goal)
    table, end = domain.transitions(), domain.index(RoomsState(*cell))
    assert (table.reward == (table.successor == end)).all()
    assert np.flatnonzero(domain.over()).tolist() == [end]
    assert domain.start_states().tolist() == [i for i in range(104) if i != end]


def test_a_goal_that_there_is_not_is_refused() -> None:
    with pytest.raises(DomainError, match=r"'G3'.*G1 or G2"):
        Rooms('G3')


def test_outcomes_are_drawn_as_often_as_they_are_likely() -> None:
    """5,000 steps from one cell; a share of 2/3 has a standard error of 0.007."""
    rng = generator(0, 'test')
    drawn = Counter(ROOMS.step(RoomsState(1, 1), UP, rng).state for _ in range(5000))
    assert drawn[RoomsState(0, 1)] / 5000 == pytest.approx(2 / 3, abs=0.025)
    for slip in (RoomsState(2, 1), RoomsState(1, 0), RoomsState(1, 2)):
        assert drawn[slip] / 5000 == pytest.approx(1 / 9, abs=0.02)


def test_an_outcome_that_cannot_happen_is_never_drawn() -> None:
    """Whatever number is drawn, at the ends of the range too."""
    shares = np.array([[[0.0, 0.25, 0.0, 0.75, 0.0]]])
    table = type(ROOMS.transitions())(
        np.zeros(shape := shares.shape, np.int32), shares, np.zeros(shape), np.zeros(shape, bool)
    )
    numbers = np.array([0.0, 0.2499, 0.25, 0.9999999])
    zeros = np.zeros(4, dtype=np.intp)
    drawn = draw_outcomes(outcome_limits(table), zeros, zeros, numbers)
    assert drawn.tolist() == [1, 1, 3, 3]


OPTIONS = reference_options(ROOMS)
VALUES = [
    [f.text(v) for f, v in zip(ROOMS.features, row)] for row in ROOMS.feature_table().tolist()
]
NORTH = 'north-west room to north doorway'


def at(row: int, col: int) -> int:
    """Return the index of a cell."""
    return ROOMS.index(RoomsState(row, col))


def test_it_starts_in_the_room_and_its_other_doorway_and_ends_outside_the_room() -> None:
    """25 cells and one; beta is 1 in the other doorway too, looked at after the first step."""
    option = OPTIONS[NORTH]
    room = ROOMS.feature_table()[:, 2] == 0
    others = np.flatnonzero(option.initiation & ~room)
    assert (option.initiation & room).sum() == 25
    assert others.tolist() == [at(5, 1)]
    assert (option.termination == ~room).all()
    assert np.flatnonzero(option.goal).tolist() == [at(2, 5)]


@pytest.mark.parametrize(
    ('cell', 'distance', 'action'),
    [
        ((2, 4), 1, 'right'),
        ((0, 0), 7, 'right'),  # the middle row is where a slip costs least
        ((4, 1), 6, 'right'),  # away from the other doorway, not up beside it
        ((5, 1), 7, 'up'),
        ((0, 4), 3, 'down'),
    ],
)
def test_distances_and_actions(cell: tuple[int, int], distance: int, action: str) -> None:
    """Counted on the board."""
    option, state = OPTIONS[NORTH], RoomsState(*cell)
    assert option.distance[ROOMS.index(state)] == distance
    assert [ROOMS.actions[a].name for a in option.optimal_actions(state)] == [action]


def test_a_way_that_slips_is_worth_the_share_that_arrives() -> None:
    """One cell before the doorway, with nothing else allowed: 0.9 * 2/3 at once, or slips."""
    target = np.arange(104) == at(2, 5)
    allowed = np.arange(104) == at(2, 4)
    table = ROOMS.transitions()
    value, optimal = best_paths(table, target[table.successor], allowed, 0.9)
    assert value[at(2, 4)] == pytest.approx(0.9 * 2 / 3)
    assert optimal[at(2, 4)].tolist() == [False, False, False, True]
