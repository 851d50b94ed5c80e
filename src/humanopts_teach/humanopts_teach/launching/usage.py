"""Processor time and memory used by processes, and memory available."""

from dataclasses import dataclass
from pathlib import Path
import re
import time

import psutil


@dataclass(frozen=True)
class Usage:
    """Resources that a process uses."""

    time: float  # s, of the monotonic clock
    cpu: float  # s of processor time since its start, all threads
    memory: int  # bytes
    peak: int  # bytes, maximum so far


def usage_of(pid: int) -> Usage:
    """
    Return the resources that a process uses.

    :raises psutil.Error: the process has ended.
    """
    process = psutil.Process(pid)
    cpu, memory = process.cpu_times(), process.memory_info().rss
    # psutil has no peak on Linux, and getrusage includes the program that started the process.
    # The kernel updates both values late, thread by thread, so its peak may be below current use.
    peak = re.search(r'VmHWM:\s+(\d+)', Path(f'/proc/{pid}/status').read_text('utf-8'))
    if peak is None:
        raise psutil.NoSuchProcess(pid)
    return Usage(time.monotonic(), cpu.user + cpu.system, memory, max(memory, 1024 * int(peak[1])))


def memory_left(
    groups: Path = Path('/sys/fs/cgroup'), own: Path = Path('/proc/self/cgroup')
) -> tuple[int, int]:
    """
    Return the bytes of memory that are available to this process, and the total.

    They are those of the machine, or of a container or service with its own limits.

    :param groups: mount point of the control groups (version 2).
    :param own: file that names the control group of this process.
    """
    memory = psutil.virtual_memory()
    left, total = memory.available, memory.total
    lines = own.read_text('utf-8').splitlines() if own.exists() else []
    folder = groups / next((line[3:] for line in lines if line.startswith('0::')), '').lstrip('/')
    for each in (folder, *folder.parents):  # each limits those below it
        if not each.is_relative_to(groups):
            break
        try:
            limit, used = (
                int((each / f'memory.{n}').read_text('utf-8')) for n in ('max', 'current')
            )
            stat = (each / 'memory.stat').read_text('utf-8')
        except (OSError, ValueError):  # "max", or the group is not visible
            continue
        # The kernel can reclaim cached pages of files.
        cache = re.search(r'^inactive_file (\d+)$', stat, re.MULTILINE)
        left = min(left, limit - used + (int(cache[1]) if cache else 0))
        total = min(total, limit)
    return left, total


def memory_of_children() -> list[int]:
    """Return the memory in bytes of each child process tree; shared pages count once."""
    return [_memory_of_tree(child) for child in psutil.Process().children()]


def _memory_of_tree(process: psutil.Process) -> int:
    try:
        own = int(process.memory_full_info().pss)
        return own + sum(map(_memory_of_tree, process.children()))
    except psutil.Error:
        return 0  # it has just ended
