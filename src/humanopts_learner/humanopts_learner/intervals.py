"""
Confidence intervals of estimates, and decisions based on them.

The units of a sample are independent: games of one plan, people, or seeds. Values of the same unit
are averaged first. If two samples share their units, such as two plans in the same games, the
interval is that of the differences within units. A claim holds if the whole interval supports it,
and is refuted if the whole interval contradicts it; otherwise, it is undecided.
"""

from collections.abc import Iterable
from dataclasses import dataclass
import math

from humanopts_env.arrays import Flags, Floats
import numpy as np
from numpy.typing import ArrayLike

LEVEL = 0.95  # two-sided confidence level


@dataclass(frozen=True)
class Interval:
    """An estimate, such as a mean, and its confidence interval; NaN: not enough data."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: ArrayLike, level: float = LEVEL) -> 'Interval':
        """
        Return the mean of independent values and its interval by Student's t (1908).

        For flags, return their share and its interval, as ``of_share``.

        :param values: (N,) without NaN; a single value has no limits, and an empty array no mean.
        :param level: two-sided level; ``low`` at 0.9 is the one-sided limit at 0.95.
        """
        found = np.asarray(values)
        if found.dtype == np.bool_:
            return cls.of_share(found, level)
        if len(found) < 2:
            return cls(float(found[0]) if len(found) else math.nan, math.nan, math.nan)
        error = float(found.std(ddof=1)) / math.sqrt(len(found))
        return cls.around(float(found.mean()), error, len(found) - 1, level)

    @classmethod
    def of_share(cls, flags: Flags, level: float = LEVEL) -> 'Interval':
        """
        Return a share and its score interval (Wilson 1927), which stays within 0 and 1.

        Its width is positive even if all flags are equal.

        :param flags: (N,); an empty array has no share.
        """
        from scipy.special import ndtri  # slow to import

        if not (count := len(flags)):
            return cls(math.nan, math.nan, math.nan)
        share = float(np.mean(flags))
        z = float(ndtri((1 + level) / 2)) ** 2 / count
        centre = (share + z / 2) / (1 + z)
        half = math.sqrt(z * share * (1 - share) + z * z / 4) / (1 + z)
        return cls(share, max(centre - half, 0.0), min(centre + half, 1.0))

    @classmethod
    def of_difference(
        cls, first: ArrayLike, second: ArrayLike, level: float = LEVEL, *, paired: bool = True
    ) -> 'Interval':
        """
        Return the difference of two means, first - second.

        :param first: (N,) one value per unit.
        :param second: (N,) the same units in the same order; unpaired: (M,) other units.
        :param paired: whether the samples share units; if not, use Welch (1947).
        :raises ValueError: paired samples differ in length.
        """
        one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
        if not paired:
            return cls._of_independent(one, other, level)
        if len(one) != len(other):
            raise ValueError(f'{len(one)} and {len(other)} values are not of the same units')
        return cls.of(one - other, level)

    @classmethod
    def of_ratio(
        cls, first: ArrayLike, second: ArrayLike, level: float = LEVEL, *, paired: bool = True
    ) -> 'Interval':
        """
        Return the ratio of two geometric means, first / second, of positive values.

        Its logarithm is a difference of means, so the interval of second / first is the inverse.
        Parameters and errors are those of ``of_difference``.
        """
        logs = cls.of_difference(np.log(first), np.log(second), level, paired=paired)
        return cls(*(math.exp(value) for value in (logs.mean, logs.low, logs.high)))

    @classmethod
    def _of_independent(cls, first: Floats, second: Floats, level: float) -> 'Interval':
        mean = cls.of(first).mean - cls.of(second).mean
        if min(len(first), len(second)) < 2:
            return cls(mean, math.nan, math.nan)
        squares = [float(sample.var(ddof=1)) / len(sample) for sample in (first, second)]
        if not (total := sum(squares)):
            return cls(mean, mean, mean)
        counts = len(first), len(second)
        freedom = total**2 / sum(s**2 / (count - 1) for s, count in zip(squares, counts))
        return cls.around(mean, math.sqrt(total), freedom, level)

    @classmethod
    def around(cls, mean: float, error: float, freedom: float, level: float = LEVEL) -> 'Interval':
        """
        Return the interval of an estimate by Student's t.

        :param error: standard error of the estimate.
        :param freedom: degrees of freedom.
        """
        from scipy.special import stdtrit  # slow to import

        half = float(stdtrit(freedom, (1 + level) / 2)) * error
        return cls(mean, mean - half, mean + half)

    def above(self, value: float = 0.0) -> bool | None:
        """Return whether the interval is above a value (True) or below (False); None: neither."""
        if self.low > value:
            return True
        return False if self.high < value else None

    def below(self, value: float) -> bool | None:
        """Return whether the interval is below a value (True) or above (False); None: neither."""
        above = self.above(value)
        return None if above is None else not above

    def holds(self, value: float) -> bool | None:
        """Return whether a value is within the limits; None: no limits."""
        return None if math.isnan(self.low) else self.low <= value <= self.high

    def at_most(self, value: float) -> bool | None:
        """Return whether the interval is at most a value (True) or above; None: neither."""
        if self.high <= value:
            return True
        return False if self.low > value else None


def level_of_look(number: int) -> float:
    """
    Return the level of interval number 1, 2, ... at which all of them hold jointly.

    The errors 0.05 / (k * (k + 1)) sum to 0.05, so decisions after every demonstration are
    together as reliable as a single one at ``LEVEL``.
    """
    return 1 - (1 - LEVEL) / (number * (number + 1))


def runs_needed(share: float, level: float) -> int:
    """Return the smallest number of runs, all right, with a lower limit of at least a share."""
    from scipy.special import ndtri  # slow to import

    return math.ceil(float(ndtri((1 + level) / 2)) ** 2 * share / (1 - share))


def level_of_each(count: int) -> float:
    """Return the level per interval at which all hold jointly at ``LEVEL`` (Bonferroni)."""
    return 1 - (1 - LEVEL) / count


def all_hold(verdicts: Iterable[bool | None]) -> bool | None:
    """Return whether all claims hold: False if one is refuted, else None if one is undecided."""
    found = list(verdicts)
    if False in found:
        return False
    return None if None in found else True


def any_holds(verdicts: Iterable[bool | None]) -> bool | None:
    """Return whether any claim holds: True if one does, else None if one is undecided."""
    found = list(verdicts)
    if True in found:
        return True
    return None if None in found else False
