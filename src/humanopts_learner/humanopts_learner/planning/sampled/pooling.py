"""
Pooling of what similar planning states show.

Most planning states are visited too seldom to tell apart options of nearly the same value. How
much there is still to gain decides what a state is worth, but hardly which option is the better
one. So the *advantage* of an option (its value less that of the best one) is shrunk towards its
mean over the states that differ in such context only, as an empirical Bayes estimate would be
(Efron and Morris 1973).
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def pooled(values: Floats, count: Floats, group: NDArray[np.integer], strength: float) -> Floats:
    """
    Return the values (S, O) with advantages shrunk towards those of each state's group.

    A pair that was not sampled in a state, but in others of its group, has their mean.

    :param values: (S, O), -inf where not available.
    :param count: (S, O) samples of each pair.
    :param group: (S,) number of each state's group, from 0.
    :param strength: samples that the mean of the group counts as.
    """
    available = np.isfinite(values)
    known = np.asarray(available.any(axis=1))
    best = np.where(known, values.max(axis=1), 0.0)[:, None]
    weight = np.where(available, count, 0.0)
    advantage = np.where(available, values, best) - best
    total, samples = _sums(weight * advantage, group), _sums(weight, group)
    mean = total[group] / np.maximum(samples[group], 1.0)
    shrunk = (weight * advantage + strength * mean) / np.maximum(weight + strength, 1.0)
    found: Floats = np.where(
        np.logical_and(samples[group] > 0, known[:, None]), best + shrunk, -np.inf
    )
    return found


def _sums(values: Floats, group: NDArray[np.integer]) -> Floats:
    """Return the sums (G, O) of the rows of each group."""
    return np.stack([np.bincount(group, column) for column in values.T], axis=1)
