"""``humanopts bench``: bad input, what it shows and writes, and the graph on real processes."""

import json
import os
from pathlib import Path
import signal
import socket
from typing import Any

from graph_support.command import Command
from humanopts_teach.cli import main
import pytest

from benchmarks import command as bench
from benchmarks.processes import DOMAIN_IDS, own_place


def run(*arguments: Any) -> int:
    """Run bench in this process and return its exit status."""
    return main(['bench', *map(str, arguments)])


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (('extra',), 'extra'),
        (
            ('--only', 'weather'),
            "'weather' is not one of 'planning', 'learning', 'games', 'screens', 'graph'",
        ),
        (('--only', 'games', '--json', 'nowhere/b.json'), 'nowhere/b.json: No such file'),
        (('--only', 'games', '--json', '.'), 'cannot write .: Is a directory'),
        (('--only', 'planning', '--largest', '1001'), "'--largest'"),
        (('--only', 'planning', '--largest', '300'), '300 needs about 1800000001.1 GB'),
    ],
    ids=lambda value: value if isinstance(value, str) else ' '.join(value),
)
def test_bad_input_is_refused_in_one_line_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, 'STATE_BYTES', 10**12)
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.count('\n') == 1
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_chosen_sections_are_measured_shown_and_written(tmp_path: Path, domain_id: int) -> None:
    results = tmp_path / 'bench.json'
    asked = ['bench', '--only', 'planning', '--largest', '10', '--json', results]
    command = Command(asked, tmp_path, domain_id)
    assert command.ended(110) == 0, command.errors
    assert "benchmark 'planning on Taxi 10 x 10'" in command.output
    found = {
        (each['group'], each['name']): each['extra_info']
        for each in json.loads(results.read_text('utf-8'))['benchmarks']
    }
    # on the way from a corner, an option needs a sweep, and primitive actions one for each step
    options, primitive = (
        found['planning on Taxi 10 x 10', name]['sweeps']
        for name in ('options by composition', 'primitive value iteration')
    )
    assert options < primitive
    assert ('10 sweeps of Taxi 5 x 5', 'a copy of as many bytes') in found


@pytest.mark.slow
@pytest.mark.parametrize('section', ['learning', 'games', 'screens', 'graph', 'recording'])
def test_every_section_works_and_leaves_no_process(
    tmp_path: Path, domain_id: int, section: str
) -> None:
    command = Command(['bench', '--quick', '--only', section], tmp_path, domain_id)
    try:
        assert command.ended(110) == 0, command.output
        command.gone(2.0)
    finally:
        command.close()


@pytest.mark.slow
def test_interrupted_measurement_leaves_no_process(tmp_path: Path, domain_id: int) -> None:
    command = Command(['bench', '--only', 'graph'], tmp_path, domain_id)
    try:
        command.until(lambda: len(command.running()) >= 4, 'the nodes')
        command.send(signal.SIGINT)
        assert command.ended(30) == 130
        command.gone(2.0)
    finally:
        command.close()


def test_domain_in_use_is_left_alone() -> None:
    with own_place():
        first = int(os.environ['ROS_DOMAIN_ID'])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(('', 7400 + 250 * first + 10))
        with own_place():
            assert int(os.environ['ROS_DOMAIN_ID']) in {*DOMAIN_IDS} - {first}
