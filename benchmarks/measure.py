"""Samples of times beside those of a yardstick, statistics of both, and facts of the machine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
import importlib.metadata
import math
import os
from pathlib import Path
import platform
import time
from typing import Any, NamedTuple

from humanopts_learner.intervals import Interval
import numpy as np

OnMeasured = Callable[[float, str], object]  # share that is done, name of the next measurement
Row = dict[str, Any]  # JSON data
SLOW = 99  # percentile
PACKAGES = ('numpy', 'scipy', 'scikit-learn', 'rclpy', 'quantecon', 'numba')
_PROCESSOR = 'model name'  # as Linux calls it


class Timed(NamedTuple):
    """How long something took."""

    seconds: float  # by a clock on the wall, which other programs make longer
    processor: float  # s of processor time, over all threads and processes that did it

    def per(self, count: int) -> 'Timed':
        """Return the time of each of several things."""
        return Timed(self.seconds / count, self.processor / count)


Turns = Sequence[Sequence[Timed]]  # samples by turn


def since(began: Timed) -> Timed:
    """Return the time since then."""
    now = clocks()
    return Timed(now.seconds - began.seconds, now.processor - began.processor)


def clocks() -> Timed:
    """Return what the clocks of this process show."""
    return Timed(time.perf_counter(), time.process_time())


def in_turns(works: Sequence[Callable[[], Timed]], repeats: int) -> list[Turns]:
    """
    Run several works in turns, so that a busy machine slows all of them alike.

    :param works: each returns the time that it measured.
    :param repeats: turns of each, of one sample; one more comes first, and is not counted.
    """
    samples: list[list[list[Timed]]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, kept in zip(works, samples):
            timed = work()
            if turn:
                kept.append([timed])
    return list(samples)


def compare(
    what: str,
    turns: Turns,
    yardstick: str,
    yardstick_turns: Turns,
    *,
    target: float | None = None,
    facts: Mapping[str, int] | None = None,
) -> Row:
    """
    Return the statistics of a measurement beside its yardstick.

    :param turns: samples of one thing, at least one a turn.
    :param yardstick_turns: those of the yardstick, from the same turns.
    :param target: how many a second are wanted; None: nothing was asked.
    :param facts: what was counted, by name.
    :return: medians and, where there are a hundred samples, 99th percentiles (else None) of
        both; how many there are a second, and what ``ratios`` returns.
    """
    own, other = ([one for turn in every for one in turn] for every in (turns, yardstick_turns))
    (median, slow), (usual, usual_slow) = _statistics(own), _statistics(other)
    return {
        'what': what,
        'seconds': median.seconds,
        'processor_seconds': median.processor,
        'slow_seconds': slow,
        'samples': len(own),
        'yardstick': yardstick,
        'yardstick_seconds': usual.seconds,
        'yardstick_processor_seconds': usual.processor,
        'yardstick_slow_seconds': usual_slow,
        'yardstick_samples': len(other),
        'target': target,
        'facts': dict(facts or {}),
        'per_second': 1.0 / median.seconds,
        'ratio': median.seconds / usual.seconds,
        **ratios([_middle(turn) for turn in turns], [_middle(turn) for turn in yardstick_turns]),
    }


def ratios(own: Sequence[Timed], yardstick: Sequence[Timed]) -> Row:
    """
    Return the intervals of the ratios to the yardstick, over turns that both had.

    :param own: one for each turn, as of the yardstick.
    :return: the geometric mean of the turns' ratios and its 95 % interval (None: of one turn),
        by the clock on the wall and in processor time.
    """
    return {
        name: {
            limit: value if math.isfinite(value) else None
            for limit, value in asdict(Interval.of_ratio(first, second)).items()
        }
        for name, first, second in zip(
            ('wall_ratio', 'processor_ratio'), zip(*own), zip(*yardstick), strict=True
        )
    }


def _middle(turn: Sequence[Timed]) -> Timed:
    return _statistics(turn)[0]


def _statistics(samples: Sequence[Timed]) -> tuple[Timed, float | None]:
    """Return the medians, and the 99th percentile of the seconds."""
    seconds, processor = zip(*samples)
    slow = float(np.percentile(seconds, SLOW)) if len(samples) > SLOW else None
    return Timed(float(np.median(seconds)), float(np.median(processor))), slow


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
    try:
        lines = Path('/proc/cpuinfo').read_text('utf-8').splitlines()
    except OSError:
        return 'unknown'
    named = (line.partition(':')[2].strip() for line in lines if line.startswith(_PROCESSOR))
    return next(named, 'unknown')
