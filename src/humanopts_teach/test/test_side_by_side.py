"""What another process does while this one has work that goes first."""

from functools import partial
import os
import subprocess
import sys
import time

from humanopts_teach.evaluation.side_by_side import meanwhile, NICE
import psutil


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
    deadline = time.monotonic() + 60.0
    with meanwhile(calls) as found:
        while len(found) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        (process,) = at_work()
    lowest = 19
    assert found == {'niceness': min(os.nice(0) + NICE, lowest), 'process': process.pid}
    assert at_work() == []


def test_the_process_ends_with_the_one_that_began_it_even_where_that_is_killed() -> None:
    first = subprocess.Popen([sys.executable, '-c', _KILLED], stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    process = psutil.Process(int(first.stdout.readline()))
    first.kill()
    first.communicate()
    process.wait(timeout=30.0)


_KILLED = """
import os, time
from humanopts_teach.evaluation.side_by_side import meanwhile
with meanwhile({'process': os.getpid}) as found:
    while not found:
        time.sleep(0.01)
    print(found['process'], flush=True)
    time.sleep(600.0)
"""


def test_without_calls_no_process_is_started() -> None:
    with meanwhile({}) as found:
        assert at_work() == []
    assert found == {}
