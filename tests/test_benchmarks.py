"""Tables, figures and arithmetic of ``humanopts bench``, without the graph."""

import json
import os
from pathlib import Path
import platform
import socket
import time

from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_teach.launching.usage import look
import numpy as np
import pytest
from rich.console import Console

from benchmarks.figure import SUFFIXES, write_figure
from benchmarks.latencies import latencies, LENGTHS, SIDE, start_of
from benchmarks.machine import machine_facts
from benchmarks.measured import compare
from benchmarks.place import DOMAIN_IDS, own_domain
from benchmarks.readers import Load, READERS, RECORDER, Run
from benchmarks.recording import recording
from benchmarks.records import read_records, RecordWriter
from benchmarks.results import Planned, results_to_dict
from benchmarks.scaling import ScalingRow
from benchmarks.tables import duration, ratio, section_table
from benchmarks.taxi_case import TaxiCase

SOLVERS = ('options by composition', 'primitive value iteration')


def planned() -> list[Planned]:
    """Two solvers on two grids, with made up times."""
    rows = []
    for side in (5, 10):
        for factor, solver in enumerate(SOLVERS, start=1):
            parts = (0.0, 1e-3 * factor * side, 2e-3 * factor * side)
            row = ScalingRow(
                side, 20 * side * side, solver, 'nothing', 0.5, *parts, sum(parts), 7, 1e-9
            )
            rows.append(Planned(row, 6e-3 * side))
    return rows


@pytest.mark.parametrize('steps', LENGTHS)
def test_timed_runs_take_the_steps_that_they_are_said_to(steps: int) -> None:
    domain, option = Taxi(SIDE, SIDE), TaxiCase(SIDE).learned[0]
    state = domain.decode(start_of(option, steps))
    assert option.can_start(domain.feature_values(state)[None])[0]
    for step in range(1, steps + 1):
        action = option.greedy_action(domain.feature_values(state)[None])[0]
        state = domain.step(state, int(action), generator(0, 'no chance')).state
        ended = option.ends(domain.feature_values(state)[None])[0]
        assert ended == (step == steps)


def test_each_latency_stands_beside_its_own_bare_form() -> None:
    samples = {'step': [3.0, 3.0], 'bare step': [1.0], 'bare service': [2.0], 'bare action': [4.0]}
    for k in LENGTHS:
        samples |= {f'service {k}': [8.0 * k], f'action {k}': [16.0 * k]}
    rows = {row.what: row for row in latencies([samples, samples])}
    long = LENGTHS[-1]
    assert {what: row.ratio for what, row in rows.items()} == {
        'a command, to the next state': 3.0,
        'run_option, 1 step': 4.0,
        f'run_option, {long} steps': 4.0 * long,
        f'run_option, {long} steps: a step': 8.0,
        'execute_option, goal to result, 1 step': 4.0,
        f'execute_option, goal to result, {long} steps': 4.0 * long,
        f'execute_option, goal to result, {long} steps: a step': 16.0,
    }
    assert rows['a command, to the next state'].samples == 4


def run(taken: int, seconds: float, memory: int = 10**7) -> Run:
    """A turn with 100 messages, of which the last are lost."""
    lost = 100 - taken
    return Run(100, taken, lost, 20_000, seconds, 0.25, memory, memory // 10, 0.005)


def test_what_the_recorder_lost_and_cost_stands_beside_readers_that_write_nothing() -> None:
    runs = {name: [run(100, 1.0), run(100, 3.0)] for name in READERS}
    runs[RECORDER] = [run(98, 2.0), run(100, 6.0, memory=2 * 10**7)]
    rows = recording(Load(100, 0, 2), runs)
    assert {row.what: row.throughput for row in rows} == {
        name: 0.5 if name == RECORDER else 1.0 for name in READERS
    }
    (row,) = [row for row in rows if row.what == RECORDER]
    assert (row.sent, row.taken, row.lost, row.per_second) == (200, 198, 2, 25.0)
    assert (row.memory, row.grown, row.message_bytes) == (2 * 10**7, 2 * 10**6, 200.0)
    console = Console(width=200)
    with console.capture() as shown:
        console.print(section_table('recording', rows))
    (line,) = [line for line in shown.get().splitlines() if RECORDER in line]
    assert '  '.join(line.split()[-11:]) == '200  2  25  0.50  25%  20.0  MB  2.0  MB  5  ms'


def test_processor_time_and_memory_of_a_process_are_seen() -> None:
    before = look(os.getpid())
    while time.process_time() < before.cpu + 0.03:
        sum(range(1000))
    after = look(os.getpid())
    assert after.cpu > before.cpu
    assert after.time > before.time
    assert 10**6 < before.memory <= after.peak


def test_record_that_is_not_complete_yet_is_left_for_later(tmp_path: Path) -> None:
    path = tmp_path / 'records'
    assert list(read_records(path)) == []
    with RecordWriter(path) as records:
        records.write(share=0.5)
        assert list(read_records(path)) == [{'share': 0.5}]
    with path.open('a') as file:
        file.write('{"share": ')
    assert list(read_records(path)) == [{'share': 0.5}]


def test_domain_in_use_is_left_alone_and_the_environment_is_put_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    monkeypatch.setenv('ROS_PYTHON_CHECK_FIELDS', '1')
    with own_domain() as first:
        assert os.environ['ROS_DOMAIN_ID'] == str(first)
        assert first in DOMAIN_IDS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(('', 7400 + 250 * first + 10))
        with own_domain() as second:
            assert second != first
    assert 'ROS_DOMAIN_ID' not in os.environ
    assert os.environ['ROS_PYTHON_CHECK_FIELDS'] == '1'


def test_machine_is_described_and_not_named() -> None:
    facts = machine_facts()
    assert facts['numpy'] == np.__version__
    assert facts['python'] == platform.python_version()
    assert 1 <= int(facts['cores']) <= (os.cpu_count() or 1)
    text = json.dumps(facts)
    assert platform.node() not in text
    assert '/' not in text


@pytest.mark.parametrize(
    ('seconds', 'text'),
    [
        (2.5, '2.5 s'),
        (0.0123, '12.3 ms'),
        (1.234e-4, '123 µs'),
        (2e-9, '2 ns'),
        (5e-11, '0.05 ns'),
    ],
)
def test_durations_have_a_unit_that_suits_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ('value', 'text'),
    [(2.0, '2'), (0.25, '1/4'), (0.9999, '1'), (1 / 4500, '1/4,500')],
)
def test_ratio_below_one_reads_as_a_part(value: float, text: str) -> None:
    assert ratio(value) == text


def test_planning_is_shown_beside_primitive_value_iteration() -> None:
    console = Console(width=200)
    with console.capture() as shown:
        console.print(section_table('planning', planned()))
    lines = shown.get().splitlines()
    assert sum(line.split()[-1:] == ['1/2'] for line in lines) == 2
    assert sum(line.split()[:1] == ['2,000'] for line in lines) == 2


@pytest.mark.parametrize('suffix', SUFFIXES)
def test_figure_is_drawn(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'figure{suffix}'
    write_figure(path, planned())
    data = path.read_bytes()
    if suffix == '.png':
        assert data.startswith(b'\x89PNG')
    else:
        text = data.decode()
        assert [word for word in (*SOLVERS, '500', '2,000', 'states') if word not in text] == []


def test_results_are_data() -> None:
    sections = {'planning': planned(), 'games': [compare('a', [1.0], 'b', [2.0], target=3.0)]}
    data = json.loads(json.dumps(results_to_dict(sections, {'cores': 2}, quick=True)))
    assert (data['format'], data['version'], data['quick']) == ('humanopts-bench', 1, True)
    assert [row['ratio'] for row in data['planning']] == pytest.approx([0.5, 1.0] * 2)
    assert data['planning'][0]['yardstick'] == 'primitive value iteration'
    assert (data['games'][0]['ratio'], data['games'][0]['target']) == (0.5, 3.0)
