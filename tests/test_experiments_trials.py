"""Trials of a reproduction: computed once, resumed, failed."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from humanopts_teach.bags.mcap_file import ignore_progress
import pytest

from experiments import figure2
from experiments import trials as experiment_trials
from experiments.command import trial_progress
from experiments.people import CAREFUL, participants, VARIED
from experiments.trials import ClusterError, digest, Rows, run_trials, Trial

PICKUP = 'go to passenger and pickup'
COSTS = {7: 9.0, 6: 5.0}


class Work:
    """Something to compute, which counts how often it is."""

    def __init__(self, folder: Path, broken: Mapping[int, BaseException] | None = None) -> None:
        self.folder, self.asked = folder, list[int]()
        self.broken = dict(broken or {})

    def square(self, parameters: Mapping[str, Any]) -> Rows:
        number: int = parameters['number']
        self.asked.append(number)
        if number in self.broken:
            raise self.broken[number]
        return [{'square': number**2}]

    def run(self, *numbers: int) -> list[int]:
        trials = [Trial('squares', {'number': n}, self.square, COSTS.get(n, 1.0)) for n in numbers]
        self.outcome = run_trials(trials, self.folder, ignore_progress, jobs=1)
        return [row['square'] for row in self.outcome.rows_of(trials)]


def tiny(*strategies: str) -> list[Trial]:
    """Return real trials of figure 2 that take no time."""
    person = asdict(participants(CAREFUL, 1, seed=3)[0])
    known = {'domain': 'taxi', 'domain_parameters': '{}', 'option': PICKUP, 'person': person}
    known['demonstrations'] = 2
    return [
        Trial('fig2', {**known, 'strategy': name}, figure2.learn_from_simulated)
        for name in strategies
    ]


def test_what_is_done_is_not_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results depend on the code."""
    work = Work(tmp_path)
    assert work.run(2, 3) == [4, 9]
    assert work.run(5, 3, 2) == [25, 9, 4]
    assert (work.asked, work.outcome.computed) == ([2, 3, 5], 1)
    monkeypatch.setattr(experiment_trials, 'code_version', lambda: 'other')
    work.run(2)
    assert work.asked == [2, 3, 5, 2]


def test_code_is_another_when_a_file_changes_that_is_not_of_a_node(tmp_path: Path) -> None:
    for name in ('ros', 'planning'):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'a.py').write_text('x = 1')
    before = digest([tmp_path])
    (tmp_path / 'ros' / 'a.py').write_text('x = 2')
    assert digest([tmp_path]) == before
    (tmp_path / 'planning' / 'a.py').write_text('x = 2')
    assert digest([tmp_path]) != before


def test_failing_trial_is_named_the_others_are_kept_and_it_is_tried_again(tmp_path: Path) -> None:
    work = Work(tmp_path, {3: ValueError('no threes')})
    assert work.run(2, 3, 4) == [4, 16]
    assert [*work.outcome.failures.values()] == ['squares (number 3): ValueError: no threes']
    work.broken = {4: KeyboardInterrupt()}
    assert work.run(2, 3, 4) == [4, 9, 16]
    assert work.asked == [2, 3, 4, 3]


def test_interrupted_run_goes_on_where_it_stopped_with_the_costliest_first(tmp_path: Path) -> None:
    work = Work(tmp_path, {6: KeyboardInterrupt()})
    with pytest.raises(KeyboardInterrupt):
        work.run(2, 5, 6, 7)
    work.broken.clear()
    assert work.run(2, 5, 6, 7) == [4, 25, 36, 49]
    assert work.asked == [7, 6, 6, 2, 5]


@pytest.mark.parametrize('damage', ['', '{"trial": ', '[]', '{"trial": {}, "result": 99}'])
def test_file_that_is_not_the_trial_counts_as_missing(tmp_path: Path, damage: str) -> None:
    work = Work(tmp_path)
    work.run(2)
    next(tmp_path.glob('*.json')).write_text(damage, 'utf-8')
    assert work.run(2) == [4]
    assert work.asked == [2, 2]


def test_lines_show_progress_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = [0.0]
    with trial_progress(clock=lambda: now[0]) as progress:
        for seconds, done, text in ((0.0, 0.0, 'begun'), (1.0, 1.0, 'soon'), (60.0, 2.0, 'later')):
            now[0] = seconds
            progress(done, 4.0, text)
        progress(4.0, 4.0, 'done')
    assert capsys.readouterr().err.splitlines() == ['begun', 'later', 'done']


def test_more_participants_leave_the_first_as_they_are() -> None:
    few, many = participants(VARIED, 2, seed=1), participants(VARIED, 6, seed=1)
    assert many[:2] == few
    assert max(person.error_rate for person in many) > 0.03
    assert min(person.error_rate for person in many) < 0.02
    assert participants(VARIED, 2, seed=2) != few
    assert all(p.error_rate == p.needless_rate == 0 for p in participants(CAREFUL, 3, seed=1))


def test_without_dask_it_is_said_what_is_missing(tmp_path: Path) -> None:
    try:
        import distributed  # noqa: F401
    except ImportError:
        with pytest.raises(ClusterError, match='dask and distributed'):
            run_trials(tiny('random'), tmp_path, ignore_progress, 1, 'tcp://127.0.0.1:1')


CLUSTER = """
import asyncio, sys
from distributed import Scheduler, Worker
async def main():
    async with Scheduler(host='127.0.0.1', port=0, dashboard=False) as scheduler:
        async with Worker(scheduler.address, host='127.0.0.1', nthreads=1):
            print(scheduler.address, flush=True)
            await asyncio.to_thread(sys.stdin.read)
asyncio.run(main())
"""


@contextmanager
def started(folder: Path, path: str) -> Iterator[str]:
    """Start a Dask scheduler and a worker in a folder, with a PYTHONPATH; yield the address."""
    with subprocess.Popen(
        [sys.executable, '-c', CLUSTER],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': path},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()


@pytest.fixture(scope='module')
def cluster() -> Iterator[str]:
    """A cluster that has the experiments."""
    pytest.importorskip('distributed')
    with started(Path.cwd(), os.environ.get('PYTHONPATH', '')) as address:
        yield address


def test_dask_cluster_computes_what_this_machine_does(tmp_path: Path, cluster: str) -> None:
    trials = tiny('random', 'coverage', 'failures')
    here, there = (
        run_trials(trials, tmp_path / name, ignore_progress, 1, address)
        for name, address in (('here', ''), ('there', cluster))
    )
    assert there.failures == {}
    assert here.results == there.results


def test_cluster_with_other_code_is_named(
    tmp_path: Path, cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment_trials, 'code_version', lambda: 'other')
    with pytest.raises(ClusterError, match=r'scheduler has other code'):
        run_trials(tiny('random'), tmp_path, ignore_progress, 1, cluster)


def test_scheduler_without_the_experiments_is_named(tmp_path: Path) -> None:
    pytest.importorskip('distributed')
    with (
        started(tmp_path, '') as address,
        pytest.raises(ClusterError, match=r'scheduler cannot import .* PYTHONPATH'),
    ):
        run_trials(tiny('random'), tmp_path, ignore_progress, 1, address)


def test_scheduler_that_does_not_answer_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('distributed')
    monkeypatch.setattr(experiment_trials, 'ANSWERS_WITHIN', 0.5)
    with pytest.raises(ClusterError, match='answers at tcp:'):
        run_trials(tiny('random'), tmp_path, ignore_progress, 1, 'tcp://127.0.0.1:1')
