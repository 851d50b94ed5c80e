"""The status of a recorder, what it keeps, and how a lesson reacts to recorders."""

import hashlib
from pathlib import Path
import platform
from typing import Any

from humanopts_ros.recording import Selection
from humanopts_teach.bags.provenance import attachments, lock_hash, software, UNKNOWN
from humanopts_teach.bags.sequence_numbers import LossCounter, MAX_STREAMS, Stamp
from humanopts_teach.command_line import LaunchOptions, size
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.session import check_folder, setup_from
from humanopts_teach.launching.processes import common_parameters, processes, Setup
from humanopts_teach.lesson.recorders import AGAIN, PATIENCE, Recorders, SILENT
from humanopts_teach.ros.recorder import Lag
import numpy as np
import pytest
import typer


@pytest.mark.parametrize(
    ('takings', 'longest', 'behind'),
    [
        ([(1000.0, 0.0)], 0.0, False),  # the first is not late
        ([(1.0, 0.1), (1.1, 0.3), (1.2, 0.0)], 0.3, False),
        ([(10.0, 0.02), (10.1, 0.6)], 0.6, True),
        ([(1.0, 0.0), (4.0, 0.01)], 3.0, True),  # it was stopped
    ],
)
def test_a_message_that_waits_too_long_puts_the_recorder_behind_for_a_second(
    takings: list[tuple[float, float]], longest: float, behind: bool
) -> None:
    lag, last = Lag(), takings[-1][0]
    for now, waited in takings:
        lag.add(now, waited)
    assert (lag.take_longest(), lag.take_longest()) == (longest, 0.0)
    assert [lag.behind(last + after) for after in (0, 0.95, 1.1)] == [behind, behind, False]


def test_streams_are_counted_separately_up_to_a_limit() -> None:
    losses = LossCounter()
    for number in range(MAX_STREAMS + 5):
        losses.add('/game_state', Stamp(f'/made_up#{number}', 2))
    losses.add('/game_state', Stamp('/made_up#0', 3))
    assert (losses.missing, len(list(losses))) == (MAX_STREAMS, MAX_STREAMS)


def test_the_software_is_named() -> None:
    facts = software()
    assert facts['python'] == platform.python_version()
    assert facts['numpy'] == np.__version__
    assert facts.keys() == {'humanopts_version', 'scikit-learn', 'numpy', 'python', 'lock_sha256'}


def test_the_lock_file_is_that_of_the_checkout(tmp_path: Path) -> None:
    inner = tmp_path / 'src' / 'humanopts_teach'
    inner.mkdir(parents=True)
    (inner / 'requirements.lock').write_text('another')
    assert lock_hash([inner, tmp_path]) == UNKNOWN
    (tmp_path / 'requirements.lock').write_text('numpy==2')
    assert lock_hash([inner, tmp_path]) == hashlib.sha256(b'numpy==2').hexdigest()


def test_attachments_are_the_json_files_of_folders_and_any_file_by_name(tmp_path: Path) -> None:
    (tmp_path / 'options' / 'p1').mkdir(parents=True)
    for name in ('p1/go.json', 'p1/go.json.damaged-1', 'demos.jsonl', 'go\udcff.json'):
        (tmp_path / 'options' / name).write_text('{}')
    (tmp_path / 'notes.txt').write_text('x')
    paths = [tmp_path / name for name in ('options', 'notes.txt', 'not there')]
    assert {name for name, _ in attachments(paths)} == {
        *('options/p1/go.json', 'options/go?.json', 'notes.txt')
    }


def test_a_folder_that_is_not_in_utf_8_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match='is not in UTF-8; choose another --out'):
        check_folder(Setup('taxi', tmp_path / 'b\udcff'))
    assert not any(tmp_path.iterdir())


def launch(evaluated: bool = False, recorded: bool = True, **options: Any) -> Setup:
    """Return the setup of a launch with these options."""
    launch_options = LaunchOptions(**options)
    return setup_from(
        'taxi', launch_options, directory=Path('x'), evaluated=evaluated, record=recorded
    )


def test_a_launch_passes_on_what_is_recorded_and_how() -> None:
    patterns = ['rosout', 'lesson/*']
    setup = launch(record_exclude=patterns, split_bytes=size('500M'), split_seconds=60.0)
    for spec in processes(setup):
        assert spec.parameters['record_exclude'] == patterns
        assert 'record_topics' not in spec.parameters
    assert common_parameters(setup) == {'expect_recorder': True, 'record_exclude': patterns}
    recorder = processes(setup)[0].parameters
    assert (recorder['max_bytes'], recorder['max_seconds']) == (500_000_000, 60.0)
    assert recorder['attach'] == [str(setup.directory / 'options')]


@pytest.mark.parametrize('text', ['0', '-1', '5 M', '5T', 'M', '1.5G', '5000000000G', '٣'])
def test_other_texts_than_a_size_are_refused(text: str) -> None:
    with pytest.raises(typer.BadParameter, match='is not a size such as 500M'):
        size(text)


def test_a_bag_that_could_not_be_evaluated_is_warned_of_or_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    launch(record_exclude=['demo*'])
    assert Selection(exclude=['demo*']).missing_for_evaluation in capsys.readouterr().err
    launch(record_exclude=['demo*'], recorded=False)
    assert capsys.readouterr().err == ''
    with pytest.raises(CommandError, match='domain_info will not be recorded'):
        launch(record_exclude=['domain_info'], evaluated=True)


STARTING: dict[str, Any] = {'complete': False, 'stopped': False, 'text': ''}
WORKS = STARTING | {'complete': True}
STOPPED = WORKS | {'stopped': True, 'text': 'recording stopped: no space'}


FAULT = 'recording stopped: no space. Everything taught so far is on disk'
Look = tuple[dict[str, Any], bool, str]  # new statuses, whether a recorder is there, the fault


@pytest.mark.parametrize(
    'looks',
    [
        pytest.param([({}, True, '')], id='no status yet'),
        pytest.param([({'a': WORKS}, True, ''), ({}, False, SILENT)], id='left'),
        pytest.param([({'a': WORKS}, True, ''), ({'a': STARTING}, True, '')], id='unmatched node'),
        pytest.param(
            [
                ({'a': WORKS}, True, ''),
                *[({}, True, '')] * (PATIENCE - 1),
                *(({}, True, SILENT), ({'a': WORKS}, True, '')),
            ],
            id='silent for a while',
        ),
        pytest.param(
            [
                *(({'a': STOPPED}, True, FAULT), ({}, False, FAULT), ({}, True, FAULT)),
                *(({'b': STARTING}, True, FAULT), ({'b': WORKS}, True, '')),
            ],
            id='stopped, and started again',
        ),
        pytest.param(
            [({'a': WORKS, 'b': STOPPED}, True, '')]
            + [({'b': STOPPED}, True, '')] * (PATIENCE - 1)
            + [({}, True, FAULT)],
            id='one of two works until it leaves',
        ),
        pytest.param(
            [
                ({'a': WORKS}, True, ''),
                ({'b': WORKS}, True, AGAIN),  # a was killed just now, and is still on the graph
                *[({}, True, '')] * 2,
                *(({'c': STARTING}, True, AGAIN), ({}, True, '')),
                ({'c': WORKS}, True, ''),
            ],
            id='another with every topic',
        ),
    ],
)
def test_a_lesson_goes_on_only_while_a_recorder_has_every_topic(looks: list[Look]) -> None:
    recorders = Recorders(expected=True)
    for number, (statuses, there, expected) in enumerate(looks):
        for name, words in statuses.items():
            recorders.update(name, **words)
        fault = recorders.check(there)
        assert (fault[: len(expected)], fault != '') == (expected, expected != ''), number


def test_a_lesson_that_expects_no_recorder_goes_on_without_one() -> None:
    recorders = Recorders(expected=False)
    recorders.update('a', **WORKS)
    assert (recorders.check(True), recorders.check(False)) == ('', '')
