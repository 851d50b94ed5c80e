"""Work done side by side by other processes."""

from functools import partial
import os
import subprocess
import sys
import time

from humanopts_teach.evaluation.side_by_side import all_of, import_ahead, processes
import psutil
import pytest


def test_each_call_is_made_by_another_process_and_the_costliest_begins_first() -> None:
    told: list[tuple[float, float, str]] = []
    calls = [os.getpid] * 6
    names = [f'call {number}' for number in range(6)]
    found = all_of(calls, names, range(6), lambda *now: told.append(now), 2)
    assert os.getpid() not in found
    assert [done for done, _, _ in told] == [1, 2, 3, 4, 5, 6]
    assert sorted(name for *_, name in told) == names
    alone = list[tuple[float, float, str]]()
    assert all_of(calls, names, range(6), lambda *now: alone.append(now), 1) == [os.getpid()] * 6
    assert [name for *_, name in alone] == names[::-1]


def test_one_executor_with_modules_imported_ahead_serves_several_times() -> None:
    with processes(2) as executor:
        import_ahead(['this.is.no.module'], executor)  # must not harm what comes later
        assert executor is not None
        rounds = [
            all_of([os.getpid] * 4, ['call'] * 4, range(4), lambda *_: None, executor)
            for _ in range(2)
        ]
    assert len({*rounds[0], *rounds[1]}) <= 2
    assert os.getpid() not in rounds[0] + rounds[1]


def test_what_a_call_raises_passes_through_and_ends_the_processes_at_once() -> None:
    calls = [partial(int, 'no number'), partial(time.sleep, 600.0)]
    with pytest.raises(ValueError, match='no number'):
        all_of(calls, ['error', 'too long'], [1.0, 2.0], lambda *_: None, 2)
    children = psutil.Process().children(recursive=True)
    assert not [child for child in children if 'spawn_main' in ' '.join(child.cmdline())]


def test_processes_end_with_the_one_that_began_them_even_where_that_is_killed() -> None:
    first = subprocess.Popen([sys.executable, '-c', _KILLED], stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    processes = [psutil.Process(int(pid)) for pid in first.stdout.readline().split()]
    first.kill()
    first.communicate()
    assert processes
    for process in processes:
        process.wait(timeout=30.0)


_KILLED = """
from functools import partial
import os, time
from humanopts_teach.evaluation.side_by_side import completed_calls, processes
with processes(2) as executor:
    ended = completed_calls([os.getpid, partial(time.sleep, 600.0)], [2.0, 1.0], executor)
    next(ended)
    print(*executor._processes, flush=True)
    time.sleep(600.0)
"""
