"""
What a process uses of the machine, as Linux tells it.

What ``getrusage`` tells of memory begins with that of the program that started the process.
"""

from dataclasses import dataclass
import os
from pathlib import Path
import time

_TICK = 1 / os.sysconf('SC_CLK_TCK')  # s
_CPU = slice(11, 13)  # of the fields after the name in /proc/PID/stat: in user mode, in the kernel


@dataclass(frozen=True)
class Usage:
    """One look at a process."""

    time: float  # s, of a clock that only goes on
    cpu: float  # s of processor time since it began, over all threads
    memory: int  # bytes that it has now
    peak: int  # the most that it has had at once


def look(pid: int) -> Usage:
    """
    Look at a process.

    :raises OSError: it is gone.
    """
    stat = Path(f'/proc/{pid}/stat').read_text('utf-8').rpartition(')')[2].split()
    lines = Path(f'/proc/{pid}/status').read_text('utf-8').splitlines()
    sizes = {name: value for name, _, value in (line.partition(':') for line in lines)}
    memory, peak = (int(sizes[name].split()[0]) * 1024 for name in ('VmRSS', 'VmHWM'))
    return Usage(time.monotonic(), _TICK * sum(map(int, stat[_CPU])), memory, peak)
