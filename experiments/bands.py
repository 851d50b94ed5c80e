"""Means and their 95 % bands over a handful of people or runs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Band:
    """Means of N columns, with 95 % confidence limits by Student's t."""

    count: NDArray[np.int64]  # (N,) values that each is the mean of
    mean: Floats  # (N,) NaN where there is no value
    low: Floats  # (N,) NaN where there are fewer than two values
    high: Floats  # (N,)


def band(values: Floats, least: float = -np.inf, most: float = np.inf) -> Band:
    """
    Return the band of the mean of independent people or runs.

    :param values: (P, N), NaN where somebody has no value.
    :param least: what a value can be at least; limits are cut off there, and at ``most``.
    """
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = np.where(known, values, 0.0).sum(axis=0) / count
        squares = np.where(known, (values - mean) ** 2, 0.0).sum(axis=0)
        error = np.sqrt(squares / (count - 1) / count)
        half = t.ppf(0.975, np.maximum(count - 1, 1)) * error
    half = np.where(count > 1, half, np.nan)
    return Band(count, mean, np.maximum(mean - half, least), np.minimum(mean + half, most))
