"""
Confidence intervals of everything that is estimated, and what can be decided by them.

The units of a sample are independent: games of one plan, people, or seeds. Values that belong to
the same unit are averaged first. Where two samples have the same units, as two plans in the same
games, the interval is that of the differences within the units. A claim holds where the whole
interval says so, and is refuted where the whole interval says the opposite; otherwise the data do
not decide it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
import math

from humanopts_env.arrays import Flags
import numpy as np
from numpy.typing import ArrayLike, NDArray

LEVEL = 0.95  # confidence, two-sided


@dataclass(frozen=True)
class Interval:
    """An estimate, such as a mean, and its confidence interval; NaN: the data give no limits."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: ArrayLike, level: float = LEVEL) -> 'Interval':
        """
        Return the mean of independent values and its interval by Student's t (1908).

        Flags are a share, with the interval of ``of_share``.

        :param values: (N,) without NaN; of one value there are no limits, and of none no mean.
        :param level: two-sided; ``low`` at 0.9 is the one-sided limit at 0.95.
        """
        found = np.asarray(values)
        if found.dtype == np.bool_:
            return cls.of_share(found, level)
        if len(found) < 2:
            return cls(float(found[0]) if len(found) else math.nan, math.nan, math.nan)
        error = float(found.std(ddof=1)) / math.sqrt(len(found))
        return cls._around(float(found.mean()), error, len(found) - 1, level)

    @classmethod
    def of_share(cls, flags: Flags, level: float = LEVEL) -> 'Interval':
        """
        Return a share and its score interval (Wilson 1927), which stays within 0 and 1.

        It has a width even where all flags are alike.

        :param flags: (N,); of none there is no share.
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
        cls, first: ArrayLike, second: ArrayLike, level: float = LEVEL
    ) -> 'Interval':
        """
        Return the mean difference, first - second, of two samples of the same units, paired.

        :param first: (N,) by unit.
        :param second: (N,) of the same units in the same order.
        :raises ValueError: the samples are not of equal length.
        """
        return cls.of(np.subtract(*_paired(first, second)), level)

    @classmethod
    def of_ratio(cls, first: ArrayLike, second: ArrayLike, level: float = LEVEL) -> 'Interval':
        """
        Return the geometric mean of the ratios, first / second, of the same units, paired.

        The interval is that of the mean logarithm, so that of second / first is its inverse.

        :param first: (N,) by unit, above 0.
        :param second: (N,) of the same units in the same order, above 0.
        :raises ValueError: the samples are not of equal length.
        """
        logs = cls.of(np.subtract(*np.log(_paired(first, second))), level)
        return cls(*(math.exp(value) for value in (logs.mean, logs.low, logs.high)))

    @classmethod
    def of_independent(
        cls, first: ArrayLike, second: ArrayLike, level: float = LEVEL
    ) -> 'Interval':
        """
        Return the difference of the means, first - second, of two samples of different units.

        The interval is by Student's t with the degrees of freedom of Welch (1947).

        :param first: (N,); of one value there are no limits, as of ``second``.
        :param second: (M,).
        """
        samples = [np.asarray(sample, dtype=float) for sample in (first, second)]
        means = [float(sample.mean()) if len(sample) else math.nan for sample in samples]
        mean = means[0] - means[1]
        if min(map(len, samples)) < 2:
            return cls(mean, math.nan, math.nan)
        squares = [float(sample.var(ddof=1)) / len(sample) for sample in samples]
        if not (total := sum(squares)):
            return cls(mean, mean, mean)
        freedom = total**2 / sum(q**2 / (len(s) - 1) for q, s in zip(squares, samples))
        return cls._around(mean, math.sqrt(total), freedom, level)

    @classmethod
    def _around(cls, mean: float, error: float, freedom: float, level: float) -> 'Interval':
        from scipy.special import stdtrit  # slow to import

        half = float(stdtrit(freedom, (1 + level) / 2)) * error
        return cls(mean, mean - half, mean + half)

    def above(self, value: float = 0.0) -> bool | None:
        """Return whether all of it lies above a value (True) or below (False); None: neither."""
        if self.low > value:
            return True
        return False if self.high < value else None

    def at_least(self, value: float = 0.0) -> bool | None:
        """Return whether all of it lies at or above a value, or all below; None: neither."""
        return True if self.low >= value else self.above(value)


def all_hold(verdicts: Iterable[bool | None]) -> bool | None:
    """Return whether all claims hold: False where one is refuted, else None where one is open."""
    found = list(verdicts)
    if False in found:
        return False
    return None if None in found else True


def _paired(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """Return two samples (2, N) of the same units."""
    samples = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if len(samples[0]) != len(samples[1]):
        raise ValueError(f'{len(samples[0])} and {len(samples[1])} values: not of the same units')
    return np.stack(samples)
