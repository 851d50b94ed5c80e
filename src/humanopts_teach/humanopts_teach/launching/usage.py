"""What a process uses of the machine."""

from dataclasses import dataclass
from pathlib import Path
import re
import sys
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
    # The kernel adds both figures up late, thread by thread: its peak may be the lower one.
    peak = re.search(r'VmHWM:\s+(\d+)', Path(f'/proc/{pid}/status').read_text('utf-8'))
    if peak is None:
        raise psutil.NoSuchProcess(pid)
    return Usage(time.monotonic(), cpu.user + cpu.system, memory, max(memory, 1024 * int(peak[1])))


def memory_left(
    groups: Path = Path('/sys/fs/cgroup'), own: Path = Path('/proc/self/cgroup')
) -> tuple[int, int]:
    """
    Return the bytes of memory that this process may still take, and those that it may have at all.

    They are the machine's, or fewer: a container, or a service, has limits of its own.

    :param groups: where the control groups are mounted, of version 1, 2 or both.
    :param own: which ones this process is in.
    """
    memory = psutil.virtual_memory()
    left, total = memory.available, memory.total
    for line in own.read_text('utf-8').splitlines() if own.exists() else []:
        _, kinds, path = line.split(':', 2)
        if kinds and 'memory' not in kinds.split(','):
            continue
        top, names = (groups / 'memory', _GROUP_1) if kinds else (groups, _GROUP_2)
        folder = top / path.lstrip('/')
        for each in (folder, *folder.parents):  # each of them limits what is below
            if each.is_relative_to(top):
                most, free = _left_in_group(each, *names)
                left, total = min(left, free), min(total, most)
    return left, total


_GROUP_1 = 'memory.limit_in_bytes', 'memory.usage_in_bytes', r'^total_inactive_file (\d+)$'
_GROUP_2 = 'memory.max', 'memory.current', r'^inactive_file (\d+)$'


def _left_in_group(folder: Path, limit: str, usage: str, cache: str) -> tuple[int, int]:
    """Return the limit of a control group, and what is left; a huge number: it has none."""
    try:
        most, used = (int((folder / name).read_text('utf-8')) for name in (limit, usage))
        stat = (folder / 'memory.stat').read_text('utf-8')
    except (OSError, ValueError):  # "max", or the group is not in this view of them
        return sys.maxsize, sys.maxsize
    found = re.search(cache, stat, re.MULTILINE)  # pages of files, which the kernel gives up
    return most, most - used + (int(found[1]) if found else 0)


def memory_of_children() -> list[int]:
    """Return the bytes of each child of this process with all below it; shared ones count once."""
    return [_memory_of_tree(child) for child in psutil.Process().children()]


def _memory_of_tree(process: psutil.Process) -> int:
    try:
        own = int(process.memory_full_info().pss)
        return own + sum(map(_memory_of_tree, process.children()))
    except psutil.Error:
        return 0  # it has ended just now
