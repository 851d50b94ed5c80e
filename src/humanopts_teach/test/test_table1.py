"""``bag table1``: named options are counted as in Table 1 of the paper."""

import json
import os
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.msg import Demonstration, LessonState, StudyEvent
from humanopts_ros.limits import composed, one_line
from humanopts_ros.text_files import FileError
from humanopts_teach.cli import main
from humanopts_teach.evaluation.table1 import (
    count_named,
    MergeError,
    Named,
    read_merge,
    TABLE_1,
)
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest
from teach_support.bags import write_messages
import yaml

PICKUP = 'go to passenger and pickup'
MERGE = """
go to passenger and pickup: [fetch  HIM, get the guy]
wave: [say hello]
"""


def lesson(who: str, name: str = '') -> tuple[str, LessonState]:
    """Return the message of a lesson while a person names an option."""
    return '/lesson_state', LessonState(participant=who, option_name=name)


def shown(who: str, name: str, uuid: str, **fields: Any) -> tuple[str, Demonstration]:
    """Return a demonstration of one step."""
    fields = {'kind': 1, **fields}
    demo = Demonstration(participant=who, option_name=name, uuid=uuid, **fields)
    demo.states, demo.actions, demo.rewards = ['a', 'b'], ['east'], [0.0]
    return '/demonstrations', demo


@pytest.fixture
def bags(tmp_path: Path, taxi: Domain) -> list[str]:
    """Two bags of Taxi with four people, and one of Pac-Man."""
    first = [
        ('/domain_info', domain_to_info(taxi)),
        *(lesson('anna'), lesson('anna', PICKUP), lesson('ben'), lesson('ben', 'Fetch him')),
        *(shown('anna', PICKUP, 'u1'), shown('ben', 'Fetch him', 'u2', withdrawn=True)),
        shown('ben', 'Fetch him', 'u4', kind=3, option_version='v'),  # only judged
    ]
    second = [
        ('/domain_info', domain_to_info(taxi)),
        *(lesson('anna', 'get the guy'), lesson('cleo', 'say Hello'), lesson('dora')),
        shown('cleo', 'Wave', 'u3'),
    ]
    third = [
        ('/domain_info', domain_to_info(make_domain('pacman'))),
        lesson('ben', 'Avoid  ghost'),
    ]
    for name, entries in (('a', first), ('b', second), ('c', third)):
        write_messages(tmp_path / name, entries)
    return [str(tmp_path / name) for name in 'abc']


def event(seconds: float, what: str, **values: Any) -> tuple[str, StudyEvent]:
    """Return an event of a study."""
    where = {'event': what, 'time': seconds, 'part': 'a/buttons', 'condition': 'a'}
    return '/study_events', StudyEvent(participant='p1', event=json.dumps({**where, **values}))


def test_buttons_of_a_part_that_was_begun_again_in_the_next_bag_count_no_longer(
    tmp_path: Path, taxi: Domain, capsys: pytest.CaptureFixture[str]
) -> None:
    for n, name in enumerate(('fetch', 'wave')):
        began = event(10.0 * n, 'part began', kind='buttons')
        named = event(10.0 * n + 1, 'button', domain='taxi', rank=1, text=name)
        entries = [('/domain_info', domain_to_info(taxi)), began, named]
        write_messages(tmp_path / f'{n}', entries)
    assert main(['bag', 'table1', str(tmp_path / '1'), str(tmp_path / '0'), '--json']) == 0
    (table,) = json.loads(capsys.readouterr().out)
    assert [row['option'] for row in table['rows'] if row['people']] == ['wave']


def test_people_are_counted_once_beside_the_paper(
    bags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'merge.yaml').write_text(MERGE)
    merged = ['bag', 'table1', *bags, '--merge', str(tmp_path / 'merge.yaml')]
    assert main([*merged, '--json']) == 0
    taxi, pacman = json.loads(capsys.readouterr().out)
    assert (taxi['domain'], taxi['people']) == ('taxi', ['anna', 'ben', 'cleo', 'dora'])
    assert [row['option'] for row in taxi['rows']] == [*TABLE_1['taxi'], 'wave']
    assert [row['people'] for row in taxi['rows']] == [2, 0, 0, 0, 0, 0, 1]
    assert [row['taught'] for row in taxi['rows']] == [1, 0, 0, 0, 0, 0, 1]
    assert [row['paper'] for row in taxi['rows']] == [*TABLE_1['taxi'].values(), None]
    assert taxi['rows'][0]['wordings'] == [PICKUP, 'Fetch him', 'get the guy']
    assert {row['option']: row['people'] for row in pacman['rows']} == {
        **dict.fromkeys(TABLE_1['pacman'], 0),
        'avoid ghost': 1,
    }
    assert main(merged) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = [line for line in lines if line.startswith(PICKUP)]
    counted = f'{PICKUP} 2 of 4 50% 15% to 85% 60% 1 Fetch him, get the guy'
    assert ' '.join(line.split()) == counted
    assert [line[-15:] for line in lines if line.startswith('wave')] == ['say Hello, Wave']


def named_by(*names: tuple[str, str], domain: str = 'taxi') -> list[Named]:
    """Return the options that people named and taught in a domain."""
    return [Named(domain, who, name, True) for who, name in names]


@pytest.mark.parametrize(
    ('names', 'merge', 'people'),
    [
        (['Go  to Passenger', 'fetch', 'Fetch ', 'fetch'], '', {'go to passenger': 1, 'fetch': 3}),
        (['Go  to Passenger', 'fetch'], 'Go to PASSENGER: [fetch]', {'go to passenger': 2}),
        (
            ['weiter fa\u0308hren', 'Weiter f\xe4hren', 'WEITER FA\u0308HREN'],
            '',
            {'weiter f\xe4hren': 3},
        ),
    ],
)
def test_a_word_is_one_button_however_its_letters_were_typed(
    tmp_path: Path, names: list[str], merge: str, people: dict[str, int]
) -> None:
    """Without a merge file only case, spaces and the Unicode form are the same."""
    (tmp_path / 'merge').write_text(merge or '{}')
    named = named_by(*((str(number), composed(name)) for number, name in enumerate(names)))
    (table,) = count_named(named, read_merge(tmp_path / 'merge'))
    assert {row.option: row.people for row in table.rows if row.people} == people
    (unknown,) = count_named(named_by(('a', 'leave'), domain='rooms'), {})
    (row,) = unknown.rows
    assert (row.option, row.people, row.paper) == ('leave', 1, None)


_TEXT = st.text(max_size=12) | st.sampled_from(['fetch', 'No', '&a x', '*a', '<<', '!!int 1'])
_MERGE = st.dictionaries(_TEXT, st.lists(_TEXT | st.none() | st.booleans() | st.floats()) | _TEXT)


@pytest.mark.heavy
@given(
    st.dictionaries(_TEXT, st.lists(_TEXT, max_size=4)).map(yaml.safe_dump)
    | _MERGE.map(yaml.safe_dump)
    | _MERGE.map(lambda values: '\n'.join(f'{key}: {value}' for key, value in values.items()))
)
@settings(
    max_examples=int(os.environ.get('GENERATED', '60')),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_merge_file_is_read_or_refused_in_one_line_at_once(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'merge'
    path.write_text(text, encoding='utf-8', errors='surrogatepass')
    began, said = time.process_time(), ''
    try:
        read_merge(path)
    except (MergeError, FileError) as error:
        said = str(error)
    assert one_line(said) == said
    assert time.process_time() - began < 1


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        ('[a, b]', 'must map'),
        ('a: b', "'a' needs a list"),
        ('a: [no]', "a wording of 'a' is false, not text: put it in quotes"),
        ('"": [b]', "'' is not a name"),
        ('a: [b]\na: [c]', "the key 'a' occurs twice"),
        ('a: !!python/name:os.system []', 'remove tags'),
        ('a: [b]\nc: [B]', "'B' belongs to 'a' and to 'c'"),
        ('a: [', 'not YAML'),
    ],
)
def test_a_merge_file_that_says_nothing_clear_is_refused(
    text: str, why: str, bags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'merge').write_text(text)
    assert main(['bag', 'table1', *bags, '--merge', str(tmp_path / 'merge')]) == 2
    assert why in capsys.readouterr().err


def test_a_missing_merge_file_and_a_bag_of_no_domain_are_refused(
    bags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['bag', 'table1', *bags, '--merge', str(tmp_path / 'none')]) == 2
    assert 'cannot read' in capsys.readouterr().err
    write_messages(tmp_path / 'none', [lesson('anna', PICKUP)])
    assert main(['bag', 'table1', str(tmp_path / 'none')]) == 2
    assert 'games of 0 domains' in capsys.readouterr().err
