"""A whole study, from its plan to its tables: simulated participants, and keys in a terminal."""

import csv
import json
from pathlib import Path
import re
import signal
import sys
import time
from typing import Any

from graph_support.command import Command
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
from humanopts_teach.evaluation.table1 import STUDY_EVENT
import pexpect
import pytest
from teach_support.page_client import PageClient

pytestmark = [pytest.mark.whole, pytest.mark.timeout(300)]  # on a busy machine
READING = 1.0  # s, more than the minimum display time of a page
EXAMPLE = Path(__file__).parents[1] / 'examples' / 'study' / 'plan.yaml'


def rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding='utf-8', newline='') as file:
        return list(csv.DictReader(file))


def events(bag: Path) -> list[dict[str, Any]]:
    """Return the events of a study in a bag."""
    return list(open_bag(bag).converted(STUDY_EVENT, lambda m: json.loads(m.event)))


def write_plan(folder: Path, *names: str, **given: Any) -> Path:
    """Write a plan of conditions with these names and some settings, and its consent."""
    every = {'domain': 'taxi', 'buttons': 1, 'learn': 'goal', **given}
    conditions = [{'name': name} for name in names]
    plan = {
        'study': 'small',
        'reading': 0,
        'consent': 'consent.md',
        'all': every,
        'conditions': conditions,
    }
    (folder / 'consent.md').write_text('# Taking part\n')
    (folder / 'plan.yaml').write_text(json.dumps(plan))
    return folder / 'plan.yaml'


@pytest.mark.parametrize('example', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_simulated_participant_goes_from_a_plan_to_tables_and_table_1(
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    example: bool,
) -> None:
    plan = EXAMPLE if example else write_plan(tmp_path, 'only', buttons=3, questions='nasa-tlx')
    names = ['trees', 'goal'] if example else ['only']
    study = tmp_path / 'study'
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    assert main(['study', str(plan), '--simulate', '1', '--study', str(study)]) == 0
    assert 'go to passenger and pickup     1 of 1' in capsys.readouterr().out
    taught = rows(study / 'tables' / 'options.csv')
    assert [row['condition'] for row in taught] == [name for name in names for _ in range(2)]
    assert {row['learned'] for row in taught} == {'yes'}
    for row in rows(study / 'tables' / 'conditions.csv'):  # from the files of the lessons
        own = [int(o['demonstrations']) for o in taught if o['condition'] == row['condition']]
        assert (row['reached'], int(row['demonstrations'])) == ('yes', sum(own))
    assert len(rows(study / 'tables' / 'answers.csv')) == 6 * len(names)
    kept = [
        json.loads(line) for line in (study / '000-simulated-1.jsonl').read_text().splitlines()
    ]
    in_bags = [
        event
        for name in names
        for event in events(*(study / 'simulated-1' / name / 'bags').iterdir())
    ]
    assert in_bags == kept[1:-1]  # all but that it began and ended


def test_a_participant_takes_part_by_keys_and_is_then_refused(
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    write_plan(tmp_path, 'only')
    words = ['study', 'plan.yaml', '--participant', 'anna']
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    program = ['-m', 'humanopts_teach', *words]
    with pexpect.spawn(sys.executable, program, dimensions=(24, 80), timeout=60) as person:
        for sees, key in (('Taking part', 'n'), ('Nothing was saved', '\r')):
            person.expect(sees)
            time.sleep(READING)
            person.send(key)
        person.expect(pexpect.EOF)
    assert person.exitstatus == 0
    folder = tmp_path / 'runs' / 'small'
    assert sorted(path.name for path in folder.rglob('*')) == ['.lock', 'log.jsonl']
    with pexpect.spawn(sys.executable, program, dimensions=(24, 80), timeout=60) as person:
        for sees, key in (
            ('Taking part', 'y'),
            ('no more', 'fetch\r'),
            ('Finish teaching', '5'),
        ):
            person.expect(sees)
            time.sleep(READING)
            person.send(key)
        person.expect('You have finished the study')
        person.expect(pexpect.EOF)
    assert person.exitstatus == 0
    with pexpect.spawn(sys.executable, program, timeout=60) as again:
        again.expect_exact("'anna' has already ended this study")
        again.expect(pexpect.EOF)
    assert again.exitstatus == 2
    (record,) = folder.glob('000-anna.jsonl')
    noted = [json.loads(line) for line in record.read_text().splitlines()]
    assert [event['text'] for event in noted if event['event'] == 'button'] == ['fetch']
    (bag,) = (folder / 'anna' / 'only' / 'bags').iterdir()
    assert [event['text'] for event in events(bag) if event['event'] == 'button'] == ['fetch']


def test_a_page_leads_through_all_conditions_whatever_else_is_in_the_record(
    tmp_path: Path, domain_id: int
) -> None:
    plan = write_plan(tmp_path, 'a', 'b')
    study = tmp_path / 'study'
    study.mkdir()
    who = {'participant': 'anna', 'number': 0, 'place': 0, 'simulated': False, 'study': 'small'}
    began = {'event': 'began', 'time': 1.0, 'order': ['a', 'b'], **who}
    spoilt = {'event': 'part ended', 'time': 2.0, 'condition': '', 'kind': 'consent'}
    for name in ('000-anna.jsonl', '000-anna-DESKTOP.jsonl'):
        (study / name).write_text(f'{json.dumps(began)}\n{json.dumps(spoilt)}\n')
    arguments = ['study', plan, '--browser', '--port', 0, '--study', study]
    command = Command(arguments, tmp_path, domain_id)
    try:
        command.until(lambda: 'Open ' in command.output, 'the address')
        found = re.search(r'Open (\S+)(/\S+) in a browser', command.output)
        assert found is not None
        with PageClient(found.group(1), f'{found.group(2)}/anna') as page:
            page.until('panel', '<h1>Taking part</h1>')
            time.sleep(READING)
            page.press('y')
            page.until('panel', 'Which button')
            page.press(*'fetch', 'enter')
            for condition in ('a', 'b'):
                page.until('panel', 'Finish teaching')
                command.until((study / 'anna' / condition).exists, condition)
                page.press('5')
                page.until('panel', 'prepared' if condition == 'a' else 'You have finished')
        command.send(signal.SIGINT)
        assert command.ended(60.0) == 0, command.errors
        assert f'line 2 of {study / "000-anna.jsonl"} is left out' in command.errors
        assert f'{study / "000-anna-DESKTOP.jsonl"} is left out' in command.errors
    finally:
        command.close()
    noted = [json.loads(line) for line in (study / '000-anna.jsonl').read_text().splitlines()]
    ended = [event['part'] for event in noted[2:] if event['event'] == 'part ended']
    assert ended == ['consent', 'a/buttons', 'a/teach', 'b/teach']
    assert noted[-1]['event'] == 'ended'


@pytest.mark.parametrize(
    ('words', 'why'),
    [
        pytest.param(['none.yaml'], 'cannot read', id='no plan'),
        pytest.param([EXAMPLE], 'needs a terminal', id='no terminal'),
        pytest.param(['status', EXAMPLE, 'more'], 'unexpected extra argument', id='too much'),
    ],
)
def test_what_cannot_be_done_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[Any],
    why: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['study', *map(str, words)]) == 2
    said = capsys.readouterr().err
    assert why in said
    assert said.count('\n') == 1
