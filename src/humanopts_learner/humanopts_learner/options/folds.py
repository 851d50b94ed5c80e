"""Demonstrations dealt into folds, and what is learned without each of them."""

from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Kind
from humanopts_learner.options.learn import assemble, Dataset, fit_trees
from humanopts_learner.options.option import LearnedOption
import numpy as np
from numpy.typing import NDArray

FOLDS = 10


def fold_of(data: Dataset, seed: int) -> NDArray[np.int64]:
    """
    Return (D,): the fold of each demonstration, ten folds or one for each demonstration.

    The demonstrations are ranked by draws keyed by seed, option and uuid and dealt out in that
    order, trajectories apart from "not here" answers, so folds differ by one at most.
    """
    demos = data.demonstrations
    draws = np.array(
        [generator(seed, 'fold', demo.option_name, demo.uuid).random() for demo in demos]
    )
    not_here = np.array([demo.kind is Kind.NOT_HERE for demo in demos])
    folds = np.empty(len(demos), dtype=np.int64)
    folds[np.lexsort((draws, not_here))] = np.arange(len(demos)) % FOLDS
    return folds


def fit_leave_fold_out(
    data: Dataset, folds: NDArray[np.int64], domain: Domain[Any], seed: int
) -> list[LearnedOption]:
    """Return what is learned without fold 0, 1, ...; there must be two trajectories or more."""
    return [
        assemble(data, fit_trees(data.of(folds != fold), domain, seed), domain)
        for fold in range(folds.max() + 1)
    ]
