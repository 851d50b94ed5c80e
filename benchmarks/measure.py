"""Samples of times beside those of a yardstick, statistics of both, and facts of the machine."""

from collections.abc import Callable, Mapping, Sequence
import importlib.metadata
import os
from pathlib import Path
import platform
from typing import Any

import numpy as np

OnMeasured = Callable[[float, str], object]  # share that is done, name of the next measurement
Row = dict[str, Any]  # JSON data
SLOW = 99  # percentile
PACKAGES = ('numpy', 'scipy', 'scikit-learn', 'rclpy', 'quantecon')
_PROCESSOR = 'model name'  # as Linux calls it


def in_turns(works: Sequence[Callable[[], float]], repeats: int) -> list[list[float]]:
    """
    Run several works in turns, so that a busy machine slows all of them alike.

    :param works: each returns the seconds that it measured.
    :param repeats: samples of each; one more is taken first, and not counted.
    """
    samples: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, kept in zip(works, samples):
            seconds = work()
            if turn:
                kept.append(seconds)
    return samples


def compare(
    what: str,
    seconds: Sequence[float],
    yardstick: str,
    yardstick_seconds: Sequence[float],
    *,
    target: float | None = None,
    facts: Mapping[str, int] | None = None,
) -> Row:
    """
    Return the statistics of a measurement beside its yardstick.

    :param seconds: samples of one thing, at least one, as of the yardstick.
    :param target: how many a second are wanted; None: nothing was asked.
    :param facts: what was counted, by name.
    :return: medians and, where there are a hundred samples, 99th percentiles (else None) of
        both; how many there are a second, and the ratio of the medians.
    """
    (own, slow), (other, other_slow) = _median(seconds), _median(yardstick_seconds)
    return {
        'what': what,
        'seconds': own,
        'slow_seconds': slow,
        'samples': len(seconds),
        'yardstick': yardstick,
        'yardstick_seconds': other,
        'yardstick_slow_seconds': other_slow,
        'yardstick_samples': len(yardstick_seconds),
        'target': target,
        'facts': dict(facts or {}),
        'per_second': 1.0 / own,
        'ratio': own / other,
    }


def _median(samples: Sequence[float]) -> tuple[float, float | None]:
    slow = float(np.percentile(samples, SLOW)) if len(samples) > SLOW else None
    return float(np.median(samples)), slow


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
