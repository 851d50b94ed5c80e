"""Taxi's reference options by distances and actions known by hand."""

from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
import numpy as np
import pytest

DOMAIN = Taxi()
OPTIONS = reference_options(DOMAIN)
PICKUP = 'go to passenger and pickup'
DROPOFF = 'go to destination and dropoff'
PASSENGER = 'go to passenger'
DESTINATION = 'go to destination'
EITHER = 'pickup/dropoff'
AWAY = 'move away from obstacles'


def test_they_are_the_buttons_of_table_1() -> None:
    """In the paper's order."""
    assert list(OPTIONS) == [PICKUP, DROPOFF, PASSENGER, DESTINATION, EITHER, AWAY]


def test_only_those_that_are_asked_for_are_made() -> None:
    few = reference_options(DOMAIN, (DROPOFF, PICKUP))
    assert list(few) == [PICKUP, DROPOFF]
    assert all(np.array_equal(few[name].distance, OPTIONS[name].distance) for name in few)


@pytest.mark.parametrize(
    ('name', 'state', 'distance', 'actions'),
    [
        (PICKUP, 'taxi 0,0 passenger R destination B', 1, ['pickup']),
        (PICKUP, 'taxi 1,0 passenger R destination B', 2, ['north']),
        (PICKUP, 'taxi 0,2 passenger R destination B', 7, ['south']),  # round the wall
        (PICKUP, 'taxi 2,2 passenger R destination B', 5, ['west']),
        (PICKUP, 'taxi 1,1 passenger R destination B', 3, ['north', 'west']),
        (DROPOFF, 'taxi 4,3 passenger aboard destination B', 1, ['dropoff']),
        (DROPOFF, 'taxi 0,0 passenger aboard destination G', 9, ['south', 'east']),
        (DROPOFF, 'taxi 0,0 passenger aboard destination Y', 5, ['south']),  # not out at R
        (PASSENGER, 'taxi 1,0 passenger R destination B', 1, ['north']),
        (DESTINATION, 'taxi 3,3 passenger R destination B', 1, ['south']),
        (DESTINATION, 'taxi 3,3 passenger aboard destination B', 1, ['south']),
        (EITHER, 'taxi 0,0 passenger R destination B', 1, ['pickup']),
        (EITHER, 'taxi 4,3 passenger aboard destination B', 1, ['dropoff']),
        (AWAY, 'taxi 0,0 passenger R destination B', 3, ['south', 'east']),
        (AWAY, 'taxi 2,0 passenger aboard destination B', 1, ['east']),
        (AWAY, 'taxi 0,3 passenger aboard destination B', 1, ['south']),
    ],
)
def test_distance_and_optimal_actions(
    name: str, state: str, distance: int, actions: list[str]
) -> None:
    """Counted on the board, the last action included."""
    option, start = OPTIONS[name], DOMAIN.decode(state)
    assert option.can_start(start)
    assert not option.ends(start)
    assert option.distance[DOMAIN.index(start)] == distance
    found = [DOMAIN.actions[action].name for action in option.optimal_actions(start)]
    assert found == actions


@pytest.mark.parametrize(
    ('name', 'state'),
    [
        (PICKUP, 'taxi 0,0 passenger aboard destination B'),
        (DROPOFF, 'taxi 4,3 passenger R destination B'),
        (DROPOFF, 'taxi 4,3 passenger B destination B'),
        (PASSENGER, 'taxi 0,0 passenger R destination B'),
        (PASSENGER, 'taxi 3,3 passenger aboard destination B'),
        (DESTINATION, 'taxi 4,3 passenger R destination B'),
        (EITHER, 'taxi 4,3 passenger R destination B'),
        (EITHER, 'taxi 0,0 passenger aboard destination B'),
        (AWAY, 'taxi 2,2 passenger R destination B'),
    ],
)
def test_an_option_has_ended_where_it_cannot_start(name: str, state: str) -> None:
    """No action is asked of it there."""
    option, end = OPTIONS[name], DOMAIN.decode(state)
    assert option.ends(end)
    assert not option.can_start(end)
    assert option.optimal_actions(end) == ()
    assert option.distance[DOMAIN.index(end)] == -1


@pytest.mark.parametrize(
    ('name', 'count'),
    [
        (PICKUP, 300),
        (DROPOFF, 100),
        (PASSENGER, 288),
        (DESTINATION, 384),
        (EITHER, 16),
        (AWAY, 336),
    ],
)
def test_sizes_of_initiation_sets(name: str, count: int) -> None:
    """Of 25 cells, 4 passengers or aboard, 4 destinations; 4 of the cells are open all round."""
    option = OPTIONS[name]
    assert option.initiation.sum() == count
    assert (option.distance[option.initiation] > 0).all()
    assert option.optimal[option.initiation].any(axis=1).all()
    assert not option.optimal[~option.initiation].any()


def test_states_after_the_end_are_judged_only_where_the_option_can_lead_there() -> None:
    """The 400 open states, and the four deliveries."""
    judged = {name: int(option.judged.sum()) for name, option in OPTIONS.items()}
    assert judged == {
        PICKUP: 400,
        DROPOFF: 404,
        PASSENGER: 400,
        DESTINATION: 400,
        EITHER: 404,
        AWAY: 400,
    }


@pytest.mark.parametrize('option', OPTIONS.values(), ids=OPTIONS)
def test_optimal_actions_end_the_option_in_as_many_steps_as_its_distance(
    option: TabularReferenceOption,
) -> None:
    """RecordedEpisodes in the domain's own rules, from every state of the initiation set."""
    for index in np.flatnonzero(option.initiation):
        state, steps = DOMAIN.state_at(int(index)), 0
        while not option.ends(state):
            action = option.optimal_actions(state)[-1]
            state = DOMAIN.step(state, action, generator(0, 'test')).state
            steps += 1
        assert steps == option.distance[index]
