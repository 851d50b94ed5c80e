"""``humanopts bench``: bad input, what it writes, and the graph on real processes."""

import json
from pathlib import Path
import signal
from typing import Any

from graph_support.command import Command
from humanopts_teach.cli import main
import psutil
import pytest

from benchmarks import graph, planning
from benchmarks.command import SECTIONS
from benchmarks.processes import own_domain
from benchmarks.recording import CALLBACK, Load, QUICK, read, READERS, RECORDER


def run(*arguments: Any) -> int:
    """Run bench in this process and return its exit status."""
    return main(['bench', *map(str, arguments)])


def test_help_names_every_option_and_section(capsys: pytest.CaptureFixture[str]) -> None:
    assert run('--help') == 0
    shown = ' '.join(capsys.readouterr().out.split())
    words = (
        '--json',
        '--figure',
        '--only',
        '--quick',
        '--largest',
        'yardstick',
        'processor',
        'interval',
    )
    assert [word for word in (*words, *SECTIONS) if word not in shown] == []


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (('extra',), 'extra'),
        (
            ('--only', 'weather'),
            "'weather' is none of planning, learning, games, graph",
        ),
        (('--only', 'games,'), "'' is none of"),
        (('--only', 'planning', '--json', 'nowhere/b.json'), 'nowhere/b.json: No such file'),
        (('--only', 'planning', '--json', '.'), 'cannot write .: Is a directory'),
        (('--only', 'planning', '--figure', 'b.jpeg'), '.svg or .png'),
        (('--only', 'games', '--figure', 'b.svg'), '--figure draws planning'),
        (('--only', 'games', '--largest', '300'), '--largest is a size of planning'),
        (('--only', 'planning', '--quick', '--largest', '300'), 'exclude each other'),
        (('--only', 'planning', '--largest', '100'), "'--largest'"),
        (('--only', 'planning', '--largest', '1001'), "'--largest'"),
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
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith('humanopts')
    assert err.count('\n') == 1
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_a_grid_that_does_not_fit_into_memory_is_refused_before_anything_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, 'BYTES_A_STATE', 10**9)
    assert run('--only', 'planning', '--largest', '300') == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.count('\n') == 1
    needed = 20 * 300 * 300 + planning.PROCESS_BYTES / 1e9
    assert f'--largest 300 needs about {needed:.1f} GB of memory, and ' in err
    assert err.endswith(' GB are free\n')


def test_chosen_sections_are_measured_shown_and_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    results, figure = tmp_path / 'bench.json', tmp_path / 'bench.svg'
    only = ('--quick', '--only', 'games,planning')
    assert run(*only, '--json', results, '--figure', figure) == 0
    out, err = capsys.readouterr()
    data = json.loads(results.read_text('utf-8'))
    assert list(data) == ['format', 'version', 'quick', 'machine', 'planning', 'games']
    for row in (*data['planning'], *data['games']):
        assert row['ratio'] == row['seconds'] / row['yardstick_seconds']
    errors = {row['solver']: row['error'] for row in data['planning'] if 'error' in row}
    (sweep,) = {row['solver'] for row in data['planning']} - set(errors)  # it has no plan
    assert sweep.startswith("quantecon's sweep")
    assert max(errors.values()) < 1e-6
    assert out.index('Planning on Taxi') < out.index('Game steps')
    assert 'Pac-Man: rules and every feature' in out
    assert figure.read_text('utf-8').count('options by composition') >= 2
    assert 'planning: done' in err
    assert str(results) in err


def measured(section: str, folder: Path, domain_id: int) -> tuple[list[dict[str, Any]], str]:
    """Measure a section on processes of its own; return its rows, and what is shown."""
    results = folder / 'bench.json'
    asked = ['bench', '--quick', '--only', section, '--json', results]
    command = Command(asked, folder, domain_id)
    try:
        assert command.ended(110) == 0, command.errors
        assert command.running() == {}
    finally:
        command.close()
    return json.loads(results.read_text('utf-8'))[section], command.output


@pytest.mark.slow
def test_graph_is_measured_on_processes_of_its_own(tmp_path: Path, domain_id: int) -> None:
    rows, _ = measured('graph', tmp_path, domain_id)
    assert all(row['ratio'] == row['seconds'] / row['yardstick_seconds'] for row in rows)
    rounds, steps, calls = graph.QUICK
    samples = {row['what']: (row['samples'], row['yardstick_samples']) for row in rows}
    steps, calls = rounds * steps, rounds * calls
    assert samples['a command, to the next state'] == (steps, steps)
    assert samples['run_option, 1 step'] == samples['run_option, 8 steps'] == (calls, calls)
    assert samples['execute_option, goal to result, 8 steps: a step'] == (calls, steps)


@pytest.mark.slow
def test_recorder_loses_nothing_of_any_load(tmp_path: Path, domain_id: int) -> None:
    rows, shown = measured('recording', tmp_path, domain_id)
    (loads,) = QUICK
    expected = [(load.name, name) for load in loads for name in READERS]
    assert [(row['load'], row['what']) for row in rows] == expected
    for row in rows:
        assert (row['taken'], row['lost']) == (row['sent'], 0)
        assert row['throughput'] == pytest.approx(row['yardstick_seconds'] / row['seconds'])
        assert row['memory'] > 10**7
    assert shown.count(RECORDER) == len(loads)


@pytest.mark.slow
def test_a_reader_that_is_too_slow_gets_fewer_messages_and_loses_none(tmp_path: Path) -> None:
    with own_domain():
        found = read(Load(60_000, 0, 1, longest=1.0), CALLBACK, tmp_path, lambda share: None)
    assert 0 < found.sent < 60_000
    assert (found.taken, found.lost) == (found.sent, 0)


@pytest.mark.slow
def test_a_reader_that_stops_ends_its_turn_in_bounded_time(tmp_path: Path) -> None:
    def stop_reader(share: float) -> None:
        for child in psutil.Process().children(recursive=True):
            if 'bench_reader' in ' '.join(child.cmdline()):
                child.send_signal(signal.SIGSTOP)

    with own_domain():
        found = read(Load(20_000, 0, 1, longest=1.0), CALLBACK, tmp_path, stop_reader)
    assert found.taken == 0
    assert found.lost == found.sent > 0


@pytest.mark.slow
def test_interrupted_measurement_leaves_no_process(tmp_path: Path, domain_id: int) -> None:
    command = Command(['bench', '--only', 'graph'], tmp_path, domain_id)
    try:
        command.until(lambda: 'steps, services and actions' in command.errors, 'the first round')
        assert len(command.running()) == 4  # three nodes, and the server that forked them
        command.send(signal.SIGINT)
        assert command.ended(30) == 130
        assert command.running() == {}
    finally:
        command.close()
