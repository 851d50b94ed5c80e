"""The hallway options by what the paper says of them, and by solutions found in another way."""

from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.rooms import Rooms, RoomsState
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_env.domains.tabular import best_ways
import numpy as np
from numpy.typing import NDArray
import pytest

ROOMS = Rooms()
OPTIONS = reference_options(ROOMS)
VALUES = [
    [f.values[v] for f, v in zip(ROOMS.features, row)] for row in ROOMS.feature_table().tolist()
]
NORTH = 'north-west room to north doorway'


def at(row: int, col: int) -> int:
    """Return the index of a cell."""
    return ROOMS.index(RoomsState(row, col))


def test_every_room_has_two() -> None:
    """One for each of its doorways."""
    assert list(OPTIONS) == [
        'north-west room to north doorway',
        'north-west room to west doorway',
        'north-east room to north doorway',
        'north-east room to east doorway',
        'south-west room to west doorway',
        'south-west room to south doorway',
        'south-east room to east doorway',
        'south-east room to south doorway',
    ]


def test_it_starts_in_the_room_and_its_other_doorway_and_ends_outside_the_room() -> None:
    """25 cells and one; beta is 1 in the other doorway too, looked at after the first step."""
    option = OPTIONS[NORTH]
    room = ROOMS.feature_table()[:, 2] == 0
    others = np.flatnonzero(option.initiation & ~room)
    assert (option.initiation & room).sum() == 25
    assert others.tolist() == [at(5, 1)]
    assert (option.termination == ~room).all()


@pytest.mark.parametrize('goal', ['G1', 'G2'])
def test_no_option_starts_or_goes_on_at_the_goal(goal: str) -> None:
    """The task is over there."""
    domain = Rooms(goal)
    for option in reference_options(domain).values():
        assert not (option.initiation & domain.over()).any()
        assert (option.termination | ~domain.over()).all()
        assert not option.optimal[~option.initiation].any()
        assert option.optimal[option.initiation].any(axis=1).all()
        assert (option.distance[option.initiation] > 0).all()
        assert (option.distance[~option.initiation] == -1).all()


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


@pytest.mark.parametrize('option', OPTIONS.values(), ids=OPTIONS)
def test_no_other_policy_reaches_the_doorway_sooner(option: TabularReferenceOption) -> None:
    """
    Changing the action of any one state lowers the value there (policy improvement).

    The other doorway is worth 0 to those who walk into it, because the option ends there.
    """
    room, _, doorway = option.name.removesuffix(' doorway').partition(' room to ')
    values = [dict(zip(('room', 'doorway'), row[2:])) for row in VALUES]
    target = np.array([value['doorway'] == doorway for value in values])
    inside = np.array([value['room'] == room for value in values])
    starts = inside | option.initiation
    action = option.optimal.argmax(axis=1)
    value = reach_value(inside, action, target)
    table = ROOMS.transitions()
    ahead = 0.9 * (table.probability * value[table.successor]).sum(axis=2)
    best = ahead.max(axis=1)
    assert value[inside] == pytest.approx(best[inside], abs=1e-12)
    worse = ahead < best[:, None] - 1e-9
    assert (worse[starts] == ~option.optimal[starts]).all()


def reach_value(
    inside: NDArray[np.bool_], action: NDArray[np.intp], target: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Solve the dense equations of one policy: expected 0.9**k at the target."""
    table, n = ROOMS.transitions(), ROOMS.n_states
    step = np.zeros((n, n))
    for state in np.flatnonzero(inside):
        np.add.at(
            step[state],
            table.successor[state, action[state]],
            table.probability[state, action[state]],
        )
    value: NDArray[np.float64] = np.linalg.solve(np.eye(n) - 0.9 * step, target.astype(np.float64))
    return value


def test_the_policies_do_not_depend_on_the_goal() -> None:
    """Only where they can start does."""
    for name, option in reference_options(Rooms('G2')).items():
        both = option.initiation & OPTIONS[name].initiation
        assert (option.optimal[both] == OPTIONS[name].optimal[both]).all()


def test_a_way_that_slips_is_worth_the_share_that_arrives() -> None:
    """One cell before the doorway, with nothing else allowed: 0.9 * 2/3 at once, or slips."""
    target = np.arange(104) == at(2, 5)
    allowed = np.arange(104) == at(2, 4)
    table = ROOMS.transitions()
    value, optimal = best_ways(table, target[table.successor], allowed, 0.9)
    assert value[at(2, 4)] == pytest.approx(0.9 * 2 / 3)
    assert optimal[at(2, 4)].tolist() == [False, False, False, True]
