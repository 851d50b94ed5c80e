"""What another process does while this one has work that goes first."""

from collections.abc import Callable, Mapping
from functools import partial
import os
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
    return [child for child in children if 'popen_loky' in ' '.join(child.cmdline())]


def test_calls_are_made_in_a_process_that_others_go_before_until_their_end_or_ours() -> None:
    calls = {
        'niceness': partial(os.nice, 0),
        'error': partial(int, 'no number'),
        'process': os.getpid,
        'too long': partial(time.sleep, 600.0),
    }
    with Meanwhile[str, object]() as other:
        other.begin(calls)
        _wait_for(other.results, 2)
        (process,) = at_work()
    lowest = 19
    assert other.results == {'niceness': min(os.nice(0) + NICE, lowest), 'process': process.pid}
    assert at_work() == []


def test_calls_that_are_begun_later_are_made_after_those_before_by_the_same_process() -> None:
    with Meanwhile[str, int]() as other:
        other.begin({'first': os.getpid})
        other.begin({'second': os.getpid})
        _wait_for(other.results, 2)
        found = other.end()
        assert at_work() == []
    assert list(found) == ['first', 'second']
    assert len(set(found.values())) == 1


def test_where_the_process_is_killed_the_results_so_far_stay_and_no_more_come() -> None:
    with Meanwhile[str, int]() as other:
        other.begin({'first': os.getpid})
        _wait_for(other.results, 1)
        (process,) = at_work()
        process.kill()
        process.wait(timeout=30.0)
        deadline = time.monotonic() + 60.0
        while at_work():
            assert time.monotonic() < deadline
        other.begin({'second': os.getpid})
        assert other.end() == {'first': process.pid}


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
        _wait_for(other.results, 1)
    thread.join()


def _wait_for(results: Mapping[str, object], count: int) -> None:
    deadline = time.monotonic() + 60.0
    while len(results) < count:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_process_ends_with_the_one_that_began_it_even_where_that_is_killed() -> None:
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
        assert other.end() == {}
