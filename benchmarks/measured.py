"""What a benchmark measured, beside the yardstick of the same run."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

OnMeasured = Callable[[float, str], object]  # share that is done, what is next
SLOW = 99  # percentile


@dataclass(frozen=True)
class Comparison:
    """How long one thing takes, and how long its yardstick takes in the same run."""

    what: str
    seconds: float  # median
    slow_seconds: float | None  # 99 of 100 take at most so long; None: the samples are too few
    samples: int
    yardstick: str
    yardstick_seconds: float  # median
    yardstick_slow_seconds: float | None
    yardstick_samples: int
    target: float | None = None  # how many a second are wanted
    facts: dict[str, int] = field(default_factory=dict)  # what was counted, by name

    @property
    def per_second(self) -> float:
        """How many there are a second, at the median."""
        return 1.0 / self.seconds

    @property
    def ratio(self) -> float:
        """How many times the yardstick's time it takes."""
        return self.seconds / self.yardstick_seconds

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        return {**asdict(self), 'per_second': self.per_second, 'ratio': self.ratio}


def compare(
    what: str,
    seconds: Sequence[float],
    yardstick: str,
    yardstick_seconds: Sequence[float],
    *,
    target: float | None = None,
    facts: dict[str, int] | None = None,
) -> Comparison:
    """
    Set what was measured beside its yardstick.

    :param seconds: samples of one thing, at least one, as of the yardstick.
    :param target: how many a second are wanted; None: nothing was asked.
    """
    own, other = _middle(seconds), _middle(yardstick_seconds)
    return Comparison(what, *own, yardstick, *other, target, dict(facts or {}))


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


def _middle(samples: Sequence[float]) -> tuple[float, float | None, int]:
    """Return the median, the 99th percentile where there are a hundred samples, their number."""
    slow = float(np.percentile(samples, SLOW)) if len(samples) > SLOW else None
    return float(np.median(samples)), slow, len(samples)
