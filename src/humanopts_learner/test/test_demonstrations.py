"""Demonstrations, also from a table: what the game could not have shown is refused in words."""

from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
from typing import Any
import uuid

from humanopts_env import make_domain
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_learner import demonstrations_from_table, demonstrations_to_table, learn_option
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    each_once,
    group_by_option,
    Kind,
    make_demonstration,
)
from humanopts_learner.spreadsheet import csv_of
import numpy as np
import pandas as pd
import pytest

TAXI = Taxi()
START = TaxiState(row=0, col=2, passenger=0, destination=3)
ABOARD = TaxiState(row=2, col=2, passenger=4, destination=3)


@pytest.fixture
def demo(person: Callable[..., Any]) -> Demonstration:
    """Return one good demonstration, from START."""
    shown: Demonstration = person().show(START)
    return shown


@pytest.fixture
def not_here(person: Callable[..., Any]) -> Demonstration:
    """Return one good "not here" answer."""
    shown: Demonstration = person().show(ABOARD)
    return shown


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'uuid': 'first'}, 'not a UUID'),
        ({'domain': 'rooms'}, 'of domain rooms'),
        ({'domain_parameters': '{"rows": 8, "cols": 5}'}, 'and the game is taxi'),
        ({'domain_parameters': '{'}, 'not JSON'),
        ({'option_name': ' '}, 'no option'),
        ({'chosen_features': ()}, 'no feature'),
        ({'chosen_features': ('ghost_row',)}, 'ghost_row'),
        ({'feature_names': ('ghost_row',)}, 'not those of taxi'),
        ({'actions': (), 'rewards': ()}, 'no steps'),
        ({'kind': Kind.NOT_HERE}, 'one state and no steps'),
        ({'rewards': (1.0,)}, 'rewards'),
        ({'seconds': float('inf')}, 'not finite'),
        ({'features': ()}, 'rows of features'),
        ({'features': ((0,),) * 6}, 'features'),
    ],
)
def test_a_wrong_field_is_refused(
    demo: Demonstration, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(DemonstrationError, match=message):
        check_demonstration(replace(demo, **change), TAXI)


def changed(values: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
    """Return the tuple with one element replaced."""
    return (*values[:place], value, *values[place + 1 :])


@pytest.mark.parametrize(
    ('field', 'place', 'value', 'message'),
    [
        ('rewards', 1, float('nan'), 'not finite'),
        ('actions', 0, 'jump', 'jump'),
        ('actions', 0, 'pickup', 'pickup does not lead from state 0'),
        ('states', 1, 'taxi 9,9 passenger R destination B', '9'),
        ('states', 1, 'nowhere', 'nowhere'),
        ('features', 1, (0,) * 10, 'features of state 1'),
        ('features', 1, (2**40,) * 10, 'taxi_row of taxi cannot be'),
        ('states', 1, 'taxi 3,3 passenger B destination R', 'features of state 1'),
        ('features', 1, (0, 1), 'not 10 wide'),
    ],
)
def test_a_wrong_step_is_refused(
    demo: Demonstration, field: str, place: int, value: Any, message: str
) -> None:
    values = changed(getattr(demo, field), place, value)
    with pytest.raises(DemonstrationError, match=message):
        check_demonstration(replace(demo, **{field: values}), TAXI)


def test_nothing_follows_the_end_of_the_task(person: Callable[..., Any]) -> None:
    demo = person('go to destination and dropoff').show(ABOARD)
    assert demo.terminated
    longer = replace(
        demo,
        states=(*demo.states, demo.states[-1]),
        features=(*demo.features, demo.features[-1]),
        actions=(*demo.actions, 'north'),
        rewards=(*demo.rewards, -1.0),
    )
    with pytest.raises(DemonstrationError, match='after the task was over'):
        check_demonstration(longer, TAXI)


def test_what_the_game_can_show_is_accepted_and_comes_back_from_its_line(
    demo: Demonstration, not_here: Demonstration
) -> None:
    assert (demo.kind, not_here.kind) == (Kind.TRAJECTORY, Kind.NOT_HERE)
    for one in (demo, not_here, replace(demo, withdrawn=True)):
        check_demonstration(one, TAXI)
        assert '\n' not in one.to_json()
        assert ('withdrawn' in one.to_json()) == one.withdrawn
        assert Demonstration.from_json(one.to_json()) == one


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'kind': 'dream'}, 'dream'),
        ({'number': 'many'}, 'number: .*many'),
        ({'number': float('inf')}, 'number: it should be a valid integer, not Infinity'),
        ({'rewards': None}, 'rewards'),
        ({'features': 3}, 'features'),
    ],
)
def test_a_field_of_the_wrong_form_is_refused(
    demo: Demonstration, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(DemonstrationError, match=message):
        Demonstration.from_fields({**json.loads(demo.to_json()), **change})
    for text in ('', '3', 'null', '{}'):
        with pytest.raises(DemonstrationError, match='not a demonstration'):
            Demonstration.from_json(text)


def test_return_is_the_undiscounted_sum(demo: Demonstration) -> None:
    assert demo.total_reward == -(len(demo.actions) - 1)  # 0 for the pickup
    assert demo.feature_rows.shape == (len(demo.actions) + 1, len(TAXI.features))
    assert demo.feature_rows.dtype == np.float64


@pytest.mark.parametrize('order', [(0, 1, 2, 3), (1, 0, 3, 2), (3, 1, 2, 0), (0, 2, 0, 1, 3, 0)])
def test_groups_keep_people_apart_count_repeats_once_and_leave_out_what_was_withdrawn(
    demo: Demonstration, order: tuple[int, ...]
) -> None:
    other = replace(demo, uuid=str(uuid.uuid4()), number=2)
    bob = replace(demo, participant='bob', uuid=str(uuid.UUID(int=3)))
    said = (demo, replace(demo, withdrawn=True), other, bob)
    sent = [said[n] for n in order]
    assert group_by_option(sent) == {
        (demo.participant, demo.option_name): [other],
        ('bob', demo.option_name): [bob],
    }
    known = {d.uuid: d.withdrawn for d in each_once(sent)}
    assert known == {demo.uuid: True, other.uuid: False, bob.uuid: False}
    later = replace(demo, uuid=str(uuid.UUID(int=2)), number=2)
    assert group_by_option([later, demo])[demo.participant, demo.option_name] == [demo, later]


ROOMS = make_domain('rooms')
TABLE = pd.DataFrame(
    [
        ('a', 0, 1, 1, 'right', 0.0),
        ('a', 1, 1, 2, 'right', 0.0),
        ('a', 2, 1, 3, '', None),
        ('b', 0, 1, 8, '', None),
    ],
    columns=['demonstration', 'step', 'row', 'col', 'action', 'reward'],
)


def read(table: pd.DataFrame | Path, **options: Any) -> list[Demonstration]:
    return demonstrations_from_table(table, ROOMS, 'go east', **options)


def test_rows_become_trajectories_and_not_here_answers() -> None:
    east, nowhere = read(TABLE, features=['row', 'col'], participant='me')
    assert (east.kind, nowhere.kind) == (Kind.TRAJECTORY, Kind.NOT_HERE)
    assert [text.split(' ')[-1] for text in east.states] == ['1,1', '1,2', '1,3']
    assert (east.actions, east.rewards) == (('right', 'right'), (0.0, 0.0))
    assert (east.participant, east.option_name, east.number) == ('me', 'go east', 1)
    assert (nowhere.number, nowhere.chosen_features) == (2, ('row', 'col'))


def test_a_table_means_the_same_in_any_order_from_a_file_and_by_the_rewards_of_the_rules(
    tmp_path: Path,
) -> None:
    found = read(TABLE)
    assert len({demo.uuid for demo in found}) == 2
    TABLE.to_csv(path := tmp_path / 'own.csv', index=False)
    for same in (TABLE.iloc[[2, 0, 1, 3]], TABLE.drop(columns='reward'), path):
        assert read(same) == found


def test_text_that_was_kept_from_being_run_is_read_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / 'own.csv'
    path.write_text(csv_of(TABLE.assign(option='=go', participant='+1')), 'utf-8-sig')
    for table in (path, pd.read_csv(path)):
        found = demonstrations_from_table(table, ROOMS)
        assert {(each.option_name, each.participant) for each in found} == {('=go', '+1')}


def test_a_table_of_demonstrations_reads_back_to_the_same_option(
    fetching: list[Demonstration],
) -> None:
    taxi = make_domain('taxi')
    run = replace(fetching[0], kind=Kind.JUDGED, uuid=str(uuid.uuid4()), option_version='v')
    table = demonstrations_to_table([*fetching, run])
    back = demonstrations_from_table(table, taxi, features=fetching[0].chosen_features)
    assert [(d.states, d.actions, d.rewards) for d in back] == [
        (d.states, d.actions, d.rewards) for d in fetching
    ]
    ours, theirs = learn_option(back, taxi, 1), learn_option(fetching, taxi, 1)
    assert (ours.initiation, ours.termination) == (theirs.initiation, theirs.termination)


def table_with(**cells: Any) -> pd.DataFrame:
    return TABLE.astype(object).assign(**cells)


@pytest.mark.parametrize(
    ('table', 'words'),
    [
        (TABLE[:0], 'no rows'),
        (TABLE.drop(columns=['step', 'action']), 'no column step, action'),
        (TABLE.drop(columns=['row', 'col']), 'no column state, and no feature of rooms'),
        (TABLE.drop(columns='col'), r'demonstration a of .*: \d+ states have row 1, not one'),
        (TABLE[1:], 'steps are not 0 to 1'),
        (TABLE[:2], 'every row but the last names an action'),
        (table_with(row=99), 'row 0, column row: unknown value .99.'),
        (
            table_with(action=['jump', 'right', '', '']),
            'row 0, column action: unknown action .jump.',
        ),
        (table_with(reward='much'), 'row 0, column reward: .*valid number.*much'),
        (table_with(step=['0', 'one', 2, 0]), 'row 1, column step: .*valid number.*one'),
        (table_with(can_start_at_end=2.0), 'row 0, column can_start_at_end: .*boolean.*2'),
        (table_with(can_start_at_end=[1, 0, 0, 0]), 'row 0, column can_start_at_end: it counts'),
        (table_with(participant=[None, 'a', 'a', 'a']), 'row 0, column participant: it is empty'),
        (table_with(**{'Can start at end': 1}), 'call it can_start_at_end'),
        (pd.concat([TABLE, TABLE.step], axis=1), 'two columns step'),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_words(table: pd.DataFrame, words: str) -> None:
    with pytest.raises(DemonstrationError, match=words):
        read(table)


FLAGS: dict[str, tuple[list[Any], Any, bool]] = {
    'float with gaps': ([np.nan, np.nan, 1.0, np.nan], 'float64', True),
    'float zero': ([np.nan, np.nan, 0.0, np.nan], 'float64', False),
    'mixed': ([None, 'no', 'TRUE', 0], object, True),
    'numpy values': ([np.int8(0), np.bool_(False), np.bool_(True), np.float32(0)], object, True),
    'spaces': (['', ' No', ' yes ', 'FALSE'], object, True),
    'nullable flag': ([None, False, True, None], 'boolean', True),
    'text': (['', '', '1.0', ''], 'string', True),
    'missing': ([np.nan] * 4, object, False),
}


@pytest.mark.parametrize(('cells', 'dtype', 'again'), FLAGS.values(), ids=FLAGS)
def test_a_cell_means_what_it_says_whatever_its_type_and_way(
    cells: list[Any], dtype: Any, again: bool, tmp_path: Path
) -> None:
    table = TABLE.assign(can_start_at_end=pd.Series(cells, dtype=dtype))
    floats = table.astype({'step': float, 'row': float, 'col': float})
    floats.to_csv(path := tmp_path / 'own.csv', index=False, na_rep='NaN')
    expected = read(table)
    assert [demo.can_start_at_end for demo in expected] == [again, False]
    ways = (floats, floats.convert_dtypes(), path, pd.read_csv(path), pd.read_csv(path, dtype=str))
    for way in ways:
        assert read(way) == expected


def test_an_error_in_a_file_names_the_row_that_a_spreadsheet_shows(tmp_path: Path) -> None:
    path = tmp_path / 'own.csv'
    path.write_text('demonstration,step,row,col,action\n\n1,0,1,1,right\n1,1,1,x,\n')
    with pytest.raises(DemonstrationError, match=r'row 4, column col: unknown value .x.'):
        read(path)


def test_what_lacks_a_state_a_name_or_rows_is_refused(tmp_path: Path) -> None:
    (path := tmp_path / 'empty.csv').touch()
    with pytest.raises(DemonstrationError, match='is not a table'):
        read(path)
    with pytest.raises(DemonstrationError, match='at least one state'):
        make_demonstration(ROOMS, 'leave', [], [])
    with pytest.raises(DemonstrationError, match='no column option: give option_name'):
        demonstrations_from_table(TABLE, ROOMS)


def test_states_of_a_domain_that_cannot_list_them_are_given_in_its_notation(
    plain_taxi: Any, fetching: list[Demonstration]
) -> None:
    table = demonstrations_to_table(fetching[:2])
    assert len(demonstrations_from_table(table, plain_taxi)) == 2
    with pytest.raises(DemonstrationError, match='cannot all be listed: give rewards'):
        demonstrations_from_table(table.drop(columns='reward'), plain_taxi)
    by_feature = table.drop(columns='state').assign(taxi_row=0)
    with pytest.raises(DemonstrationError, match='no column state, and the states of taxi'):
        demonstrations_from_table(by_feature, plain_taxi)
