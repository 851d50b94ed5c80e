"""Taxi: rules, features, notation, drawing and reference options, by hand."""

from typing import Any

from humanopts_env.domains.base import DomainError, StateError
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.tabular import reachable
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
import numpy as np
import pytest

RNG = generator(0, 'test')


def features_of(text: str, domain: Taxi | None = None) -> dict[str, str]:
    """Return how each feature of a state reads to a person."""
    domain = domain or Taxi()
    values = domain.feature_values(domain.decode(text))
    return {f.name: f.text(value) for f, value in zip(domain.features, values)}


def after(text: str, *actions: str) -> tuple[str, list[float]]:
    """Return the state after some actions, and their rewards."""
    domain = Taxi()
    state, rewards = domain.decode(text), []
    for name in actions:
        index = [action.name for action in domain.actions].index(name)
        outcome = domain.step(state, index, RNG)
        state = outcome.state
        rewards.append(outcome.reward)
    return domain.encode(state), rewards


def test_a_state_has_the_number_of_dietterichs_encoding() -> None:
    """((row * 5 + column) * 5 + passenger) * 4 + destination."""
    assert Taxi().index(TaxiState(3, 1, 2, 0)) == 328
    assert Taxi().state_at(328) == TaxiState(3, 1, 2, 0)


def test_there_are_500_states_300_starts_and_404_reachable() -> None:
    """Delivered states are reached at the four landmarks only."""
    domain = Taxi()
    assert domain.n_states == 500
    assert len(domain.start_states()) == 300
    visited = reachable(domain)
    assert visited.sum() == 404
    assert (visited & domain.over()).sum() == 4


def test_a_delivery_costs_one_for_each_move_nothing_for_the_pickup_and_earns_one() -> None:
    """From R to G over the gap below the wall."""
    moves = ('south', 'south', 'east', 'east', 'north', 'north', 'east', 'east')
    state, rewards = after('taxi 0,0 passenger R destination G', 'pickup', *moves, 'dropoff')
    assert state == 'taxi 0,4 passenger G destination G'
    assert rewards == [0, *[-1] * 8, 1]


@pytest.mark.parametrize(
    ('before', 'action', 'end'),
    [
        ('taxi 0,1 passenger R destination B', 'east', None),
        ('taxi 2,1 passenger R destination B', 'east', 'taxi 2,2 passenger R destination B'),
        ('taxi 4,0 passenger R destination B', 'east', None),
        ('taxi 4,3 passenger R destination B', 'west', None),
        ('taxi 0,0 passenger R destination B', 'north', None),
        ('taxi 1,1 passenger R destination B', 'pickup', None),
        ('taxi 1,1 passenger aboard destination B', 'pickup', None),
        ('taxi 0,0 passenger R destination B', 'dropoff', None),
        ('taxi 1,1 passenger aboard destination B', 'dropoff', None),
        (
            'taxi 0,0 passenger aboard destination B',
            'dropoff',
            'taxi 0,0 passenger R destination B',
        ),
    ],
)
def test_walls_and_illegal_actions_leave_the_taxi_where_it_is(
    before: str, action: str, end: str | None
) -> None:
    """Everything but a legal pickup and the delivery costs one."""
    assert after(before, action) == (end or before, [-1])


def test_features_of_a_waiting_passenger() -> None:
    """The taxi in the north-west corner, where the passenger waits."""
    assert features_of('taxi 0,0 passenger R destination B') == {
        'taxi_row': '0',
        'taxi_col': '0',
        'passenger_row': '0',
        'passenger_col': '0',
        'destination_row': '4',
        'destination_col': '3',
        'passenger_in_taxi': 'no',
        'taxi_at_passenger': 'yes',
        'taxi_at_destination': 'no',
        'blocked_moves': 'north, west',
    }


@pytest.mark.parametrize(
    'text',
    [
        'taxi 5,0 passenger R destination B',
        'taxi 02,3 passenger R destination B',
        'taxi ٢,3 passenger R destination B',
        f'taxi {"9" * 5000},3 passenger R destination B',
        'taxi 2,3 passenger r destination B',
        'taxi 2,3 passenger R destination aboard',
    ],
)
def test_text_in_another_notation_is_refused(text: str) -> None:
    with pytest.raises(StateError):
        Taxi().decode(text)


@pytest.mark.parametrize('bad', [3, 0, -5, 1001, 5.0, '5', True, None])
def test_a_size_that_is_no_grid_is_refused(bad: Any) -> None:
    with pytest.raises(DomainError, match='rows'):
        Taxi(rows=bad)
    with pytest.raises(DomainError, match='cols'):
        Taxi(cols=bad)


class OneByOne:
    """A reference option that judges one state at a time."""

    def __init__(self, option: TabularReferenceOption) -> None:
        self.can_start, self.ends = option.can_start, option.ends
        self.optimal_actions = option.optimal_actions


@pytest.mark.parametrize(('rows', 'cols'), [(4, 4), (4, 9), (9, 4), (10, 10), (23, 17)])
def test_every_open_state_of_any_grid_is_reachable(rows: int, cols: int) -> None:
    """No wall shuts anything off: all cells, passengers and destinations."""
    domain = Taxi(rows, cols)
    visited = reachable(domain)
    assert visited[~domain.over()].all()
    assert (visited & domain.over()).sum() == 4


DOMAIN = Taxi()
OPTIONS = reference_options(DOMAIN)
PICKUP = 'go to passenger and pickup'
DROPOFF = 'go to destination and dropoff'
PASSENGER = 'go to passenger'
DESTINATION = 'go to destination'
EITHER = 'pickup/dropoff'
AWAY = 'move away from obstacles'


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
    option, end = OPTIONS[name], DOMAIN.decode(state)
    assert option.ends(end)
    assert not option.can_start(end)
    assert option.optimal_actions(end) == ()
    assert option.distance[DOMAIN.index(end)] == -1


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
        assert option.reached(state)


def test_a_passenger_at_the_wrong_place_is_an_end_that_is_not_meant() -> None:
    wrong = DOMAIN.decode('taxi 0,0 passenger R destination B')
    assert OPTIONS[DROPOFF].ends(wrong)
    assert not OPTIONS[DROPOFF].reached(wrong)
