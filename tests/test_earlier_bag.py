"""A bag of an earlier version (0.1.0) still says what that version said of it."""

from collections.abc import Sequence
import csv
import hashlib
import json
from pathlib import Path
from typing import Any

from humanopts_teach.cli import main
import pytest

EARLIER = Path(__file__).parent / 'data' / 'earlier'
BAG = EARLIER / 'bag'  # a short lesson on Taxi, two plans and two episodes
# What version 0.1.0 said, with the intervals, limits and methods of now, without paths and the
# seconds that planning took.
EXPECTED = json.loads((EARLIER / 'expected.json').read_text('utf-8'))


def said(capsys: pytest.CaptureFixture[str], arguments: Sequence[str]) -> Any:
    """Return what a command on the bag prints as JSON, without its path."""
    assert main(['bag', *arguments, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    found.pop('path', None)
    return found


@pytest.mark.parametrize('command', ['info', 'check'])  # eval is in test_cli.py, beside another
def test_commands_say_of_an_earlier_bag_what_they_said_then(
    capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert said(capsys, [command, str(BAG)]) == EXPECTED[command]


def test_the_tables_of_an_earlier_bag_are_equal_in_every_byte(tmp_path: Path) -> None:
    """All but the columns ``method`` and ``machine_steps``, which there were not."""
    assert main(['bag', 'export', str(BAG), '--to', 'csv', '--out', str(tmp_path)]) == 0
    with (tmp_path / 'demonstrations.csv').open(newline='', encoding='utf-8') as file:
        head, *rows = csv.reader(file)
    for name, usual in (('method', 'trees'), ('machine_steps', '0')):
        at = head.index(name)
        assert {row.pop(at) for row in rows} == {usual}
        del head[at]
    with (tmp_path / 'demonstrations.csv').open('w', newline='', encoding='utf-8') as file:
        csv.writer(file).writerows((head, *rows))
    hashes = {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in tmp_path.iterdir()
    }
    assert hashes == EXPECTED['csv_sha256']
