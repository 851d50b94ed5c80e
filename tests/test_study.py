"""A whole study, from its plan to its tables: simulated participants, and keys in a terminal."""

import csv
import json
import os
from pathlib import Path
import sys
from typing import Any

from graph_support.command import Command
from graph_support.live import free_domain_id
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.table1 import STUDY_EVENT
import pexpect
import pytest

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
