"""A whole study, from its plan to its tables: simulated participants, and keys in a terminal."""

import csv
import json
import os
from pathlib import Path
import re
import signal
import sys
from typing import Any

from graph_support.command import Command
from graph_support.live import free_domain_id
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.table1 import STUDY_EVENT
import pexpect
import pytest
from teach_support.page_client import PageClient

EXAMPLE = Path(__file__).parents[1] / 'examples' / 'study' / 'plan.yaml'
PLAN = """
study: small
consent: consent.md
all: {domain: taxi, buttons: 1, learn: goal}
conditions: [{name: only}]
"""


def rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding='utf-8', newline='') as file:
        return list(csv.DictReader(file))


def events(bag: Path) -> list[dict[str, Any]]:
    """Return the events of a study in a bag."""
    return list(open_bag(bag).converted(STUDY_EVENT, lambda m: json.loads(m.event)))


def test_the_example_goes_from_its_plan_to_tables_and_table_1(tmp_path: Path) -> None:
    study = tmp_path / 'study'
    with free_domain_id() as number:
        command = Command(['study', EXAMPLE, '--simulate', 1, '--study', study], tmp_path, number)
        try:
            assert command.ended(180.0) == 0, command.errors
        finally:
            command.close()
    assert 'go to passenger and pickup     1 of 1' in command.output
    taught = rows(study / 'tables' / 'options.csv')
    assert [row['condition'] for row in taught] == ['trees', 'trees', 'goal', 'goal']
    assert {row['criteria_met'] for row in taught} == {'True'}
    assert len(rows(study / 'tables' / 'answers.csv')) == 2 * 6
    kept = [
        json.loads(line) for line in (study / '000-simulated-1.jsonl').read_text().splitlines()
    ]
    in_bags = [
        event
        for name in ('trees', 'goal')
        for event in events(*(study / 'simulated-1' / name / 'bags').iterdir())
    ]
    assert in_bags == kept[1:-1]  # all but that it began and ended


def test_a_participant_takes_part_by_keys_and_is_then_refused(tmp_path: Path) -> None:
    (tmp_path / 'plan.yaml').write_text(PLAN)
    (tmp_path / 'consent.md').write_text('# Taking part\n')
    with free_domain_id() as number:
        arguments = ['-m', 'humanopts_teach.cli', 'study', 'plan.yaml', '--participant', 'anna']
        place: dict[str, Any] = {'cwd': tmp_path, 'dimensions': (24, 80), 'timeout': 60}
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(number), 'TERM': 'xterm'}
        person = pexpect.spawn(sys.executable, arguments, env=environment, **place)
        try:
            for sees, key in (
                ('Taking part', 'y'),
                ('no more', 'fetch\r'),
                ('Finish teaching', '5'),
            ):
                person.expect(sees)
                person.send(key)
            person.expect('anna has finished')
            person.expect(pexpect.EOF)
            again = pexpect.spawn(sys.executable, arguments, env=environment, **place)
            again.expect("'anna' has ended this study already")
            again.expect(pexpect.EOF)
        finally:
            person.close(force=True)
    assert (person.exitstatus, again.wait()) == (0, 2)
    (record,) = (tmp_path / 'runs' / 'small').glob('000-anna.jsonl')
    noted = [json.loads(line) for line in record.read_text().splitlines()]
    assert [event['text'] for event in noted if event['event'] == 'button'] == ['fetch']
    (bag,) = (tmp_path / 'runs' / 'small' / 'anna' / 'only' / 'bags').iterdir()
    assert [event['text'] for event in events(bag) if event['event'] == 'button'] == ['fetch']


def test_several_take_part_at_once_in_browsers(tmp_path: Path) -> None:
    (tmp_path / 'plan.yaml').write_text(PLAN.replace('[{name: only}]', '[{name: a}, {name: b}]'))
    (tmp_path / 'consent.md').write_text('# Taking part\n')
    study = tmp_path / 'study'
    with free_domain_id() as number:
        arguments = ['study', tmp_path / 'plan.yaml', '--browser', '--port', 0, '--study', study]
        command = Command(arguments, tmp_path, number)
        try:
            command.until(lambda: 'Open ' in command.output, 'the address')
            found = re.search(r'Open (\S+)(/\S+) in a browser', command.output)
            assert found is not None
            anna, ben = (
                PageClient(found.group(1), f'{found.group(2)}/{code}') for code in ('anna', 'ben')
            )
            with anna, ben:
                for page in (anna, ben):
                    page.until('panel', '<h1>Taking part</h1>')
                ben.press('n')
                ben.until('panel', 'ben does not take part')
                anna.press('y')
                anna.until('panel', 'Which button')
                anna.press(*'fetch', 'enter')
                for condition in ('a', 'b'):
                    anna.until('panel', 'Finish teaching')
                    done = study / 'anna' / condition
                    command.until(done.exists, condition)
                    anna.press('5')
                    anna.until('panel', 'prepared' if condition == 'a' else 'anna has finished')
            command.send(signal.SIGINT)
            assert command.ended(60.0) == 0, command.errors
        finally:
            command.close()
    events = [json.loads(line) for line in (study / '000-anna.jsonl').read_text().splitlines()]
    ended = [event['part'] for event in events if event['event'] == 'part ended']
    assert ended == ['consent', 'a/buttons', 'a/teach', 'b/teach']
    assert events[-1]['event'] == 'ended'
    assert '"why": "not agreed"' in (study / '001-ben.jsonl').read_text()


@pytest.mark.parametrize(
    ('words', 'why'),
    [
        pytest.param(['none.yaml'], 'cannot read', id='no plan'),
        pytest.param([EXAMPLE], 'needs a terminal', id='no terminal'),
        pytest.param(['status', EXAMPLE, 'more'], 'unexpected extra argument', id='too much'),
    ],
)
def test_what_cannot_be_done_is_one_line(tmp_path: Path, words: list[Any], why: str) -> None:
    command = Command(['study', *words], tmp_path, 0)
    try:
        assert command.ended(30.0) == 2
    finally:
        command.close()
    assert why in command.errors
    assert command.errors.count('\n') == 1
