"""Demonstrations from a person's own table: what is read, what is refused, and in which words."""

from pathlib import Path
from typing import Any

from humanopts_env import make_domain
from humanopts_learner import demonstrations_from_table, demonstrations_to_table, learn_option
from humanopts_learner.demonstrations import Demonstration, DemonstrationError, Kind
import pandas as pd
import pytest

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


def read(table: pd.DataFrame, **options: Any) -> list[Demonstration]:
    return demonstrations_from_table(table, ROOMS, 'go east', **options)


def test_rows_become_trajectories_and_not_here_answers() -> None:
    east, nowhere = read(TABLE, features=['row', 'col'], participant='me')
    assert (east.kind, nowhere.kind) == (Kind.TRAJECTORY, Kind.NOT_HERE)
    assert [text.split(' ')[-1] for text in east.states] == ['1,1', '1,2', '1,3']
    assert (east.actions, east.rewards) == (('right', 'right'), (0.0, 0.0))
    assert (east.participant, east.option_name, east.number) == ('me', 'go east', 1)
    assert (nowhere.number, nowhere.chosen_features) == (2, ('row', 'col'))


def test_the_same_table_in_any_order_gives_the_same_demonstrations() -> None:
    assert read(TABLE.iloc[[2, 0, 1, 3]]) == read(TABLE)
    assert len({demo.uuid for demo in read(TABLE)}) == 2


def test_rewards_are_those_of_the_rules_where_the_table_has_none() -> None:
    assert read(TABLE.drop(columns='reward')) == read(TABLE)


def test_a_csv_file_is_read_as_a_data_frame_is(tmp_path: Path) -> None:
    TABLE.to_csv(tmp_path / 'own.csv', index=False)
    assert demonstrations_from_table(tmp_path / 'own.csv', ROOMS, 'go east') == read(TABLE)


def test_a_table_of_demonstrations_reads_back_to_the_same_option(
    fetching: list[Demonstration],
) -> None:
    taxi = make_domain('taxi')
    table = demonstrations_to_table(fetching)
    back = demonstrations_from_table(table, taxi, features=fetching[0].chosen_features)
    assert [(d.states, d.actions, d.rewards) for d in back] == [
        (d.states, d.actions, d.rewards) for d in fetching
    ]
    ours, theirs = learn_option(back, taxi, 1), learn_option(fetching, taxi, 1)
    assert (ours.initiation, ours.termination) == (theirs.initiation, theirs.termination)


def changed(**cells: Any) -> pd.DataFrame:
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
        (changed(row=99), 'row has no value .99.'),
        (changed(col=[1, 4, 3, 8]), 'action right does not lead from state 0'),
        (changed(action=['jump', 'right', '', '']), 'no action .jump.'),
        (changed(reward='much'), 'could not convert'),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_words(table: pd.DataFrame, words: str) -> None:
    with pytest.raises(DemonstrationError, match=words):
        read(table)


def test_a_table_without_an_option_needs_its_name() -> None:
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
