"""Tables, figures and arithmetic of ``humanopts bench``, without the graph."""

from dataclasses import asdict, replace
import importlib.util
import json
import os
from pathlib import Path
import platform
import socket
import subprocess
import time
from typing import Any

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import check_demonstration
from humanopts_learner.intervals import Interval
from humanopts_teach.launching.usage import usage_of
import numpy as np
import pytest
from rich.console import Console

from benchmarks import games, learning, planning
from benchmarks.games import BATCH
from benchmarks.graph import latencies, LENGTHS, SIDE, start_of
from benchmarks.learning import demonstrations
from benchmarks.measure import compare, in_turns, machine_facts, Times
from benchmarks.planning import OPTIONS, solvers, TaxiCase
from benchmarks.processes import DOMAIN_IDS, own_domain, processor_time
from benchmarks.recording import Load, READERS, RECORDER, recording, Run
from benchmarks.show import duration, ratio, remarks, section_table, SUFFIXES, write_figure

SOLVERS = ('options by composition', 'primitive value iteration')


def no_progress(share: float, text: str) -> None:
    """Show nothing."""


def planned() -> list[dict[str, Any]]:
    """Two solvers on two grids, with made up times."""
    return [
        {
            'n_states': 20 * side * side,
            'solver': solver,
            'obtained': 'nothing',
            'obtained_seconds': 0.5,
            'table_seconds': 0.0,
            'model_seconds': 1e-3 * factor * side,
            'sweep_seconds': 2e-3 * factor * side,
            'seconds': 3e-3 * factor * side,
            'sweeps': 7,
            'error': 1e-9,
            'compile_seconds': None,
            'bytes_a_state': 300.0,
            'processor_seconds': 4e-3 * factor * side,
            'ratio': factor / 2,
            'wall_ratio': {'mean': factor / 2, 'low': factor / 4, 'high': factor / 1},
            'processor_ratio': {'mean': factor / 2, 'low': factor / 4, 'high': factor / 1},
        }
        for side in (5, 10)
        for factor, solver in enumerate(SOLVERS, start=1)
    ]


def shown(name: str, rows: list[dict[str, Any]]) -> list[str]:
    """Return the lines of a table."""
    console = Console(width=200)
    with console.capture() as captured:
        console.print(section_table(name, rows))
    return captured.get().splitlines()


@pytest.mark.parametrize('steps', LENGTHS)
def test_timed_runs_take_the_steps_of_their_names(steps: int) -> None:
    domain, option = Taxi(SIDE, SIDE), TaxiCase(SIDE).learned[0]
    state = domain.decode(start_of(option, steps))
    assert option.can_start(domain.feature_values(state)[None])[0]
    for step in range(1, steps + 1):
        action = option.greedy_action(domain.feature_values(state)[None])[0]
        state = domain.step(state, int(action), generator(0, 'no chance')).state
        ended = option.ends(domain.feature_values(state)[None])[0]
        assert ended == (step == steps)


def test_each_latency_stands_beside_its_own_bare_form() -> None:
    known = {'step': [3.0, 3.0], 'bare step': [1.0], 'bare service': [2.0], 'bare action': [4.0]}
    for k in LENGTHS:
        known |= {f'service {k}': [8.0 * k], f'action {k}': [16.0 * k]}
    first, second = (
        {name: [np.array([busy * s, s / 10]) for s in found] for name, found in known.items()}
        for busy in (1.0, 5.0)
    )
    rows = {row['what']: row for row in latencies([first, second])}
    long = LENGTHS[-1]
    assert {what: row['ratio'] for what, row in rows.items()} == {
        'a command, to the next state': 3.0,
        'run_option, 1 step': 4.0,
        f'run_option, {long} steps': 4.0 * long,
        f'run_option, {long} steps: a step': 8.0,
        'execute_option, goal to result, 1 step': 4.0,
        f'execute_option, goal to result, {long} steps': 4.0 * long,
        f'execute_option, goal to result, {long} steps: a step': 16.0,
    }
    step = rows['a command, to the next state']
    assert step['samples'] == 4
    assert (step['processor_seconds'], step['yardstick_processor_seconds']) == (0.3, 0.1)
    for name in ('wall_ratio', 'processor_ratio'):  # a busy round is so for both
        assert list(step[name].values()) == pytest.approx([3.0, 3.0, 3.0])


def run(taken: int, seconds: float, memory: int = 10**7) -> Run:
    """A turn with 100 messages, of which the last are lost."""
    lost = 100 - taken
    return Run(100, taken, lost, 20_000, seconds, 0.25, memory, memory // 10, 0.005, seconds / 4)


def test_what_the_recorder_lost_and_cost_stands_beside_readers_that_write_nothing() -> None:
    runs = {name: [run(100, 1.0), run(100, 3.0)] for name in READERS}
    runs[RECORDER] = [run(98, 2.0), run(100, 6.0, memory=2 * 10**7)]
    rows = recording(Load(100, 0, 2), runs)
    assert {row['what']: row['throughput'] for row in rows} == {
        name: 0.5 if name == RECORDER else 1.0 for name in READERS
    }
    (row,) = [row for row in rows if row['what'] == RECORDER]
    counts = [row[name] for name in ('sent', 'taken', 'lost', 'per_second')]
    assert counts == [200, 198, 2, 25.0]
    sizes = [row[name] for name in ('memory', 'grown', 'message_bytes')]
    assert sizes == [2 * 10**7, 2 * 10**6, 200.0]
    assert (row['processor_seconds'], row['yardstick_processor_seconds']) == (0.01, 0.005)
    assert row['processor_ratio'] == pytest.approx({'mean': 2.0, 'low': 2.0, 'high': 2.0})
    (line,) = [line for line in shown('recording', rows) if RECORDER in line]
    table = '200  2  25  0.50  25%  20.0  MB  2.0  MB  5  ms  2  (2  to  2)  2  (2  to  2)'
    assert '  '.join(line.split()[-19:]) == table
    (once, *_) = recording(Load(100, 0, 1), {name: [run(100, 1.0)] for name in READERS})
    assert once['wall_ratio'] == pytest.approx({'mean': 1.0, 'low': None, 'high': None})


def test_messages_that_a_reader_lost_or_did_not_get_are_named_in_words() -> None:
    lossy = {name: [run(100, 1.0)] * 2 for name in READERS}
    lossy[RECORDER] = [run(98, 2.0), replace(run(50, 2.0), sent=50, lost=0)]
    rows = recording(Load(100, 0, 2, longest=3.0), lossy)
    slow = 'was too slow: 150 of 200 messages could be sent to it in 3 s a turn'
    lost = 'lost 2 of the 150 messages that were sent to it'
    assert remarks(rows) == [f'as fast as they are taken: {RECORDER} {slow}; {lost}.']
    assert remarks(planned()) == []


def test_processor_time_and_memory_of_a_process_are_seen() -> None:
    before = usage_of(os.getpid())
    while time.process_time() < before.cpu + 0.03:
        sum(range(1000))
    after = usage_of(os.getpid())
    assert after.cpu > before.cpu
    assert after.time > before.time
    assert 10**6 < before.memory <= after.peak


def test_processor_time_of_another_process_is_its_own() -> None:
    with subprocess.Popen(['sleep', '60']) as other:
        first = processor_time(os.getpid())
        idle = processor_time(other.pid)
        while processor_time(os.getpid()) < first + 0.03:
            sum(range(1000))
        assert processor_time(os.getpid()) == pytest.approx(time.process_time(), abs=0.01)
        assert processor_time(other.pid) - idle < 0.02
        other.kill()


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
    [(2.0, '2'), (0.25, '1/4'), (0.9999, '1'), (1 / 4500, '1/4,500'), (4e-19, '1/2.5e+18')],
)
def test_ratio_below_one_reads_as_a_part(value: float, text: str) -> None:
    assert ratio(value) == text


def test_planning_is_shown_beside_primitive_value_iteration() -> None:
    lines = shown('planning', planned())
    shares = '1/2 (1/4 to 1)'
    assert sum(line.split('  ')[-1].strip() == shares for line in lines) == 2
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


def test_ratio_is_of_the_medians() -> None:
    row = compare('a', one_a_turn(0.5, 9.0, 0.1), 'b', one_a_turn(0.25, 0.5, 0.25))
    assert (row['seconds'], row['samples'], row['per_second']) == (0.5, 3, 2.0)
    assert (row['yardstick_seconds'], row['yardstick_samples'], row['ratio']) == (0.25, 3, 2.0)
    assert (row['processor_seconds'], row['yardstick_processor_seconds']) == (0.25, 0.125)


def one_a_turn(*seconds: float) -> Times:
    """Return a sample a turn, with half of it as processor time."""
    return np.array([[[each, each / 2]] for each in seconds])


def test_intervals_of_ratios_are_those_of_the_turns() -> None:
    """A busy machine makes both longer within a turn, and the ratio stays."""
    busy = [1.0, 4.0, 30.0, 2.0]
    own, other = [2.0, 2.2, 1.9, 2.1], [1.0, 1.0, 1.1, 0.9]
    row = compare(
        *('a', np.array([[[load * each, each]] for load, each in zip(busy, own)])),
        *('b', np.array([[[load * each, each]] for load, each in zip(busy, other)])),
    )
    known = asdict(Interval.of_ratio(own, other))
    assert known['low'] < 2.0 < known['high']
    assert row['wall_ratio'] == pytest.approx(known)
    assert row['processor_ratio'] == pytest.approx(known)


@pytest.mark.parametrize(('count', 'slow'), [(99, None), (101, 1.0)])
def test_percentile_needs_a_hundred_samples(count: int, slow: float | None) -> None:
    turns = one_a_turn(*((number + 1) / 100 for number in range(count)))
    row = compare('a', turns, 'b', turns)
    assert (row['slow_seconds'], row['yardstick_slow_seconds']) == (slow, slow)


def test_works_take_turns_and_the_first_turn_is_not_counted() -> None:
    calls: list[str] = []

    def work(name: str) -> Times:
        calls.append(name)
        return np.array([float(len(calls)), 0.0])

    found = in_turns([lambda: work('a'), lambda: work('b')], 2)
    seconds = [turns[:, 0, 0].tolist() for turns in found]
    assert seconds == [[3.0, 5.0], [4.0, 6.0]]
    assert ''.join(calls) == 'ababab'


def test_what_is_learned_from_are_whole_demonstrations_of_the_option() -> None:
    domain = Taxi()
    reference = reference_options(domain)[OPTIONS[0]]
    given = demonstrations(domain, OPTIONS[0], 12)
    assert len(given) == 12
    assert len({demo.uuid for demo in given}) == 12
    for demo in given:
        check_demonstration(demo, domain)
        assert reference.can_start(domain.decode(demo.states[0]))
        ends = [reference.ends(domain.decode(text)) for text in demo.states]
        assert ends == [False] * len(demo.actions) + [True]


def test_learning_has_rows_for_trees_and_criteria_beside_one_tree() -> None:
    heard: list[float] = []
    rows = learning.measure(lambda share, text: heard.append(share), (2, 3), 1)
    assert [row['what'] for row in rows] == [
        f'after {count} demonstrations: {what}'
        for count in (2, 3)
        for what in ('three trees fitted', 'the criteria judged')
    ]
    domain = Taxi()
    given = demonstrations(domain, OPTIONS[0], 3)
    steps = sum(len(demo.actions) for demo in given)
    assert rows[-1]['facts'] == {'demonstrations': 3, 'rows': steps}
    assert heard == [0.0, 0.5]


def test_games_are_counted_in_steps_of_single_games() -> None:
    rows = games.measure(no_progress, batch_steps=1, single_steps=20, repeats=1)
    assert [row['facts']['steps'] for row in rows] == [BATCH] * 4
    assert [row['facts']['yardstick_steps'] for row in rows] == [20] * 4
    names = {PacMan().name, Taxi().name}
    assert {row['what'].partition(':')[0].lower().replace('-', '') for row in rows} == names
    assert all(min(times(row)) > 0 for row in rows)


def times(row: dict[str, Any]) -> list[float]:
    """Return the times of a row by both clocks, and of its yardstick."""
    names = ('seconds', 'processor_seconds')
    return [row[prefix + name] for prefix in ('', 'yardstick_') for name in names]


@pytest.mark.parametrize('side', [4, 5, 9])
def test_all_solvers_come_to_the_same_values(side: int) -> None:
    case = TaxiCase(side)
    solved = {solver.name: solver.solve(case).values for solver in solvers()}
    truth = solved['breadth-first search backwards']
    assert truth.min() < -4.0
    for name, values in solved.items():
        assert np.abs(values - truth).max() < 1e-9, name


def test_the_trees_act_as_the_shortest_ways_do() -> None:
    case = TaxiCase(6)
    for option, learned in zip(case.optimal, case.learned):
        rows = case.domain.feature_table()
        can = option.initiation
        assert (learned.greedy_action(rows)[can] == option.action[can]).all()
        assert (learned.can_start(rows) == can)[~case.domain.over()].all()


def test_every_solver_has_a_row_on_every_grid() -> None:
    heard: list[float] = []
    turns: list[str] = []

    def progress(share: float, text: str) -> None:
        heard.append(share)
        turns.append(text.partition(': ')[2])

    names = [solver.name for solver in solvers()]
    every = planning.measure(progress, [4, 5], repeats=2)
    assert turns == [*names * 3, 'single sweeps'] * 2  # one turn more on each grid
    rows = [row for row in every if row['solver'] in names]
    assert [(row['side'], row['n_states'], row['solver']) for row in rows] == [
        (side, 20 * side * side, name) for side in (4, 5) for name in names
    ]
    for row in rows:
        assert min(times(row)) > 0
        assert row['samples'] == 2
        assert row['processor_ratio']['low'] <= row['processor_ratio']['mean']
        assert row['error'] < 1e-9
        assert row['ratio'] == row['seconds'] / row['yardstick_seconds']
        assert (row['obtained_seconds'] > 0) == row['solver'].startswith('options')
    assert rows[1]['obtained_seconds'] > rows[0]['obtained_seconds']
    assert heard == sorted(heard)
    assert heard[-1] < 1


def test_single_sweeps_stand_beside_a_copy_and_quantecons_beside_ours() -> None:
    side, names = 23, ['a copy of as many bytes', 'one sweep over all actions']
    rows = planning.sweep_rows(TaxiCase(side), side, repeats=2)
    installed = importlib.util.find_spec('quantecon') is not None
    assert [row['yardstick'] for row in rows] == names[: 1 + installed]
    for row in rows:
        assert (row['side'], row['n_states']) == (side, 20 * side * side)
        # six successors of 4 bytes, six rewards of 8, and two values of 8
        assert row['sweep_bytes'] == row['n_states'] * (6 * 4 + 6 * 8 + 2 * 8)
        assert min(times(row)) > 0
        assert row['wall_ratio']['low'] <= row['wall_ratio']['mean']
    assert sum('one sweep' in line for line in shown('planning', planned() + rows)) == 1


def test_small_grids_have_quantecons_sweep_beside_ours_and_no_copy() -> None:
    rows = planning.sweep_rows(TaxiCase(4), 4, repeats=2)
    installed = importlib.util.find_spec('quantecon') is not None
    assert [row['yardstick'] for row in rows] == ['one sweep over all actions'] * installed


def test_memory_is_what_arrays_take_at_once_and_keep() -> None:
    kept, bytes_kept, most = planning.traced(lambda: np.ones(10**6) + np.ones(10**6))
    assert kept.nbytes == 8 * 10**6
    assert bytes_kept == pytest.approx(8 * 10**6, rel=0.01)
    assert 16 * 10**6 <= most < 25 * 10**6


def test_a_plan_takes_more_memory_than_one_sweep_reads() -> None:
    rows = {row['solver']: row for row in planning.measure(no_progress, [20], repeats=1)}
    row = rows[planning.YARDSTICK]
    assert [name for name in rows if rows[name]['compile_seconds'] is not None] == [row['solver']]
    assert row['bytes_a_state'] == (row['table_bytes'] + row['memory_bytes']) / row['n_states']
    assert planning.SWEEP_BYTES < row['bytes_a_state'] < 500
    assert row['process_bytes'] > row['table_bytes'] + row['memory_bytes']


def test_larger_grids_come_after_the_usual_ones() -> None:
    assert planning.sides_up_to(300) == (5, 25, 50, 100, 200, 300)
    assert planning.sides_up_to(1000) == (5, 25, 50, 100, 200, 500, 1000)
    names = [solver.name for solver in solvers(1000)]
    assert names == [*SOLVERS, 'breadth-first search backwards']
    assert planning.memory_needed(1000) < 16e9


def test_quantecon_is_a_solver_where_it_is_installed() -> None:
    installed = importlib.util.find_spec('quantecon') is not None
    assert any('quantecon' in solver.name for solver in solvers()) == installed
