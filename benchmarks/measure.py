"""Samples of times beside those of a yardstick, statistics of both, and facts of the machine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
import importlib.metadata
import math
import os
from pathlib import Path
import platform
import time
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_learner.intervals import Interval
import numpy as np

OnMeasured = Callable[[float, str], object]  # share that is done, name of the next measurement
Row = dict[str, Any]  # JSON data
# Seconds by a clock on the wall, which other programs make longer, and of processor time, over all
# threads and processes that did it: (2,); of several samples in each of several turns (T, N, 2).
Times = Floats
PERCENTILE = 99
PACKAGES = ('numpy', 'scipy', 'scikit-learn', 'rclpy', 'quantecon', 'numba')


def part_of(progress: OnMeasured, name: str, begun: float, length: float) -> Callable[..., object]:
    """Return what shows how far a part of the work is, which begins at a share of all of it."""
    return lambda share, text='': progress(begun + length * share, name + text)


def clocks() -> Times:
    """Return what the clocks of this process show."""
    return np.array([time.perf_counter(), time.process_time()])


def timed(work: Callable[[], object]) -> Times:
    """Return the time of some work."""
    began = clocks()
    work()
    return clocks() - began


def in_turns(works: Sequence[Callable[[], Times]], repeats: int) -> list[Times]:
    """
    Run several works in turns, so that a busy machine slows all of them alike.

    :param works: each returns the time that it measured.
    :param repeats: turns of each, of one sample; one more comes first, and is not counted.
    :return: (repeats, 1, 2) of each work.
    """
    turns = [[work() for work in works] for _ in range(repeats + 1)]
    return [np.array(samples)[:, None] for samples in zip(*turns[1:])]


def compare(
    what: str,
    turns: Times,
    yardstick: str,
    yardstick_turns: Times,
    *,
    target: float | None = None,
    facts: Mapping[str, int] | None = None,
) -> Row:
    """
    Return the statistics of a measurement beside its yardstick.

    :param turns: (T, N, 2) samples of one thing.
    :param yardstick_turns: (T, M, 2) those of the yardstick, from the same turns.
    :param target: how many a second are wanted; None: nothing was asked.
    :param facts: what was counted, by name.
    :return: medians and, where there are a hundred samples, 99th percentiles (else None) of
        both; how many there are a second, and what ``ratios`` returns.
    """
    own, other = _statistics(turns), _statistics(yardstick_turns)
    return {
        'what': what,
        **own,
        'yardstick': yardstick,
        **{f'yardstick_{name}': value for name, value in other.items()},
        'target': target,
        'facts': dict(facts or {}),
        'per_second': 1.0 / own['seconds'],
        'ratio': own['seconds'] / other['seconds'],
        **ratios(np.median(turns, axis=1), np.median(yardstick_turns, axis=1)),
    }


def _statistics(turns: Times) -> Row:
    samples = turns.reshape(-1, 2)
    seconds, processor = np.median(samples, axis=0).tolist()
    many = len(samples) > PERCENTILE
    return {
        'seconds': seconds,
        'processor_seconds': processor,
        'slow_seconds': float(np.percentile(samples[:, 0], PERCENTILE)) if many else None,
        'samples': len(samples),
    }


def ratios(own: Times, yardstick: Times) -> Row:
    """
    Return the intervals of the ratios to the yardstick, over turns that both had.

    :param own: (T, 2), as of the yardstick.
    :return: the geometric mean of the turns' ratios and its 95 % interval (None: of one turn),
        by the clock on the wall and in processor time.
    """
    return {
        name: {
            limit: value if math.isfinite(value) else None
            for limit, value in asdict(Interval.of_ratio(first, second)).items()
        }
        for name, first, second in zip(('wall_ratio', 'processor_ratio'), own.T, yardstick.T)
    }


def machine_facts() -> dict[str, str | int]:
    """Return system, processor, cores that may be used, and versions of the libraries."""
    facts: dict[str, str | int] = {
        'system': platform.system(),
        'architecture': platform.machine(),
        'processor': _processor(),
        'cores': len(os.sched_getaffinity(0)),
        'python': platform.python_version(),
    }
    for name in PACKAGES:
        try:
            facts[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return facts


def _processor() -> str:
    """Return the processor as Linux calls it."""
    try:
        lines = Path('/proc/cpuinfo').read_text('utf-8').splitlines()
    except OSError:
        return 'unknown'
    named = (line.partition(':')[2].strip() for line in lines if line.startswith('model name'))
    return next(named, 'unknown')
