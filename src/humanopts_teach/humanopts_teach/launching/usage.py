"""What a process uses of the machine."""

from dataclasses import dataclass
from pathlib import Path
import re
import time

import psutil


@dataclass(frozen=True)
class Usage:
    """What a process uses."""

    time: float  # s, of a clock that only goes on
    cpu: float  # s of processor time since it began, over all threads
    memory: int  # bytes that it has now
    peak: int  # the most that it has had at once


def usage_of(pid: int) -> Usage:
    """
    Return what a process uses.

    :raises psutil.Error: it is gone.
    """
    process = psutil.Process(pid)
    cpu, memory = process.cpu_times(), process.memory_info().rss
    # psutil has no peak on Linux, and getrusage counts the memory of the program that started it.
    peak = re.search(r'VmHWM:\s+(\d+)', Path(f'/proc/{pid}/status').read_text('utf-8'))
    if peak is None:
        raise psutil.NoSuchProcess(pid)
    return Usage(time.monotonic(), cpu.user + cpu.system, memory, 1024 * int(peak[1]))


def memory_of_children() -> list[int]:
    """Return the bytes of each child of this process with all below it; shared ones count once."""
    return [_memory_of_tree(child) for child in psutil.Process().children()]


def _memory_of_tree(process: psutil.Process) -> int:
    try:
        own = int(process.memory_full_info().pss)
        return own + sum(map(_memory_of_tree, process.children()))
    except psutil.Error:
        return 0  # it has ended just now
