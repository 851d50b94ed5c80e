"""What other processes do while this one has work that goes first."""

from collections.abc import Callable
from functools import partial
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from humanopts_teach.commands import interruptible
from humanopts_teach.evaluation.side_by_side import Meanwhile, NICE
import psutil
import pytest


def at_work() -> list[psutil.Process]:
    """Return the processes that make calls for this one."""
    children = psutil.Process().children(recursive=True)
    return [child for child in children if 'spawn_main' in ' '.join(child.cmdline())]


def test_calls_are_made_in_processes_that_others_go_before_until_their_end_or_ours() -> None:
    calls = {
        'niceness': partial(os.nice, 0),
        'error': partial(int, 'no number'),
        'process': os.getpid,
        'too long': partial(time.sleep, 600.0),
    }
    with Meanwhile[str, object]() as other:
        other.begin(calls)
        _wait_for(other, 2)
        pids = {process.pid for process in at_work()}
    assert len(pids) == len(os.sched_getaffinity(0))
    lowest = 19
    assert set(other.results) == {'niceness', 'process'}
    assert other.results['niceness'] == min(os.nice(0) + NICE, lowest)
    assert other.results['process'] in pids
    assert at_work() == []


def test_what_is_under_way_goes_on_and_what_waits_begins_again_the_costliest_first(
    tmp_path: Path,
) -> None:
    cores = len(os.sched_getaffinity(0))
    gate, told = tmp_path / 'open', list[tuple[float, float, str]]()
    with Meanwhile[str, object]() as other:
        busy = {f'busy {n}': partial(_wait_for_file, gate) for n in range(cores)}
        other.begin({'known': partial(int, '1'), **busy})
        _wait_until(lambda: len(list(tmp_path.glob('begun-*'))) == cores)
        handed = 3 * cores  # and more: calls that cannot be taken back
        queued = {f'queued {n}': partial(_order, tmp_path) for n in range(4 * handed)}
        other.begin(queued)
        calls = {**queued, 'dear': partial(_order, tmp_path), 'busy 0': partial(int, '0')}
        threading.Timer(0.2, gate.touch).start()
        costs = [*range(len(queued)), 1000.0, 1.0]
        found = other.all_of(calls, list(calls), costs, lambda *told_now: told.append(told_now))
        assert found[-1] == 'it went on'
        assert set(other.results) >= {'known', *calls}
    turns = {name: int(str(turn)) for name, turn in zip(calls, found[:-1])}
    assert sorted(turns.values()) == list(range(len(turns)))
    assert turns['dear'] < 2 * handed
    assert turns[f'queued {len(queued) - 1}'] < turns[f'queued {2 * handed}']
    assert [done for done, _, _ in told] == list(range(1, len(calls) + 1))
    assert {total for _, total, _ in told} == {len(calls)}
    assert sorted(name for _, _, name in told) == sorted(calls)


def test_what_raises_raises_when_it_is_needed() -> None:
    calls = {'error': partial(int, 'no number')}
    with Meanwhile[str, int]() as other:
        other.begin(calls)
        with pytest.raises(ValueError, match='no number'):
            other.all_of(calls, ['error'], [1.0], lambda *_: None)


def test_where_a_process_is_killed_the_results_so_far_stay_and_the_others_are_made_anew() -> None:
    with Meanwhile[str, int]() as other:
        other.begin({'first': os.getpid})
        _wait_for(other, 1)
        other.begin({'lost': partial(_sleep, 600.0)})
        for process in at_work():
            process.kill()
            process.wait(timeout=30.0)
        manager = '_ExecutorManagerThread'
        _wait_until(lambda: manager not in {type(t).__name__ for t in threading.enumerate()})
        other.begin({'second': os.getpid})
        calls = {'first': os.getpid, 'lost': os.getpid, 'second': os.getpid}
        first, *others = other.all_of(calls, list(calls), [1.0] * 3, lambda *_: None)
        assert first not in others
        assert {*others} <= {process.pid for process in at_work()}


def _sleep(seconds: float) -> int:
    time.sleep(seconds)
    return 0


def _wait_for_file(path: Path) -> str:
    (path.parent / f'begun-{os.getpid()}').touch()
    _wait_until(path.exists)
    return 'it went on'


def _order(folder: Path) -> int:
    """Return how many did this before."""
    for number in range(1000):
        try:
            (folder / f'turn-{number}').touch(exist_ok=False)
        except FileExistsError:
            continue
        return number
    raise AssertionError


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_what_interrupts_this_process_waits_until_the_other_has_started(
    number: signal.Signals,
) -> None:
    """It comes to another thread, as where a bar of progress is drawn."""
    asked, sent = threading.Event(), threading.Event()

    def interrupt() -> None:
        asked.wait()
        signal.raise_signal(number)
        sent.set()

    class Interrupted(dict[str, Callable[[], int]]):
        def items(self) -> Any:
            asked.set()
            assert sent.wait(30.0)
            return super().items()

    thread = threading.Thread(target=interrupt)
    thread.start()
    with interruptible(), Meanwhile[str, int]() as other:
        with pytest.raises(KeyboardInterrupt):
            other.begin(Interrupted({'process': os.getpid}))
        _wait_for(other, 1)
    thread.join()


def _wait_for(other: Meanwhile[Any, Any], count: int) -> None:
    _wait_until(lambda: len(other.results) >= count)


def _wait_until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_processes_end_with_the_one_that_began_them_even_where_that_is_killed() -> None:
    first = subprocess.Popen([sys.executable, '-c', _KILLED], stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    process = psutil.Process(int(first.stdout.readline()))
    first.kill()
    first.communicate()
    process.wait(timeout=30.0)


_KILLED = """
import os, time
from humanopts_teach.evaluation.side_by_side import Meanwhile
with Meanwhile() as other:
    other.begin({'process': os.getpid})
    while not other.results:
        time.sleep(0.01)
    print(other.results['process'], flush=True)
    time.sleep(600.0)
"""


def test_without_calls_no_process_is_started() -> None:
    with Meanwhile[str, object]() as other:
        other.begin({})
        assert at_work() == []
    assert other.results == {}
