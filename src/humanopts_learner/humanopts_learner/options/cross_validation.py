"""
Ten-fold cross-validation of what is learned of an option.

Folds are grouped by demonstration, because rows of one trajectory on both sides would make the
errors look like nothing. The return is held out as well: each option runs from the start of the
demonstrations that it did not see.
"""

from collections.abc import Callable, Sequence
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import Dataset, Examples, fit_option
from humanopts_learner.options.option import LearnedOption, MEMBER, tabulate
from humanopts_learner.options.rollout import (
    deterministic_rollouts,
    is_deterministic,
    Rollouts,
    rollouts_of,
)
import numpy as np
from numpy.typing import NDArray

FOLDS = 10
LUCK = 1.645  # standard errors; chance alone makes a larger shortfall in 5 of 100 cases
CUT_OFF = 2  # a held-out run may take so many times the steps of its demonstration


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
    return [fit_option(data, domain, seed, folds != fold) for fold in range(folds.max() + 1)]


def held_out_shortfall(
    data: Dataset,
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    folds: NDArray[np.int64],
    seed: int,
) -> float:
    """
    Return the mean of demonstrated return - return of the policy that did not see it.

    A run that ends with the task over where the demonstration did not, or the other way round, has
    come to another end: the steps that it has left then cost what the demonstration's worst did.
    In domains with chance, ``LUCK`` standard errors of the mean are taken off.
    """
    demos = data.trajectories
    fold = folds[[demo.kind is Kind.TRAJECTORY for demo in data.demonstrations]]
    limit = np.array([min(options[0].max_steps, CUT_OFF * len(demo.actions)) for demo in demos])
    runs = _held_out_runs(demos, domain, [options[f] for f in fold.tolist()], limit, seed)
    other_end = runs.reached & (runs.over != np.array([demo.terminated for demo in demos]))
    worst = np.array([min(0.0, *demo.rewards) for demo in demos])
    returns = runs.total_reward + other_end * (limit - runs.steps) * worst
    missing = [demo.total_reward for demo in demos] - returns
    luck = (
        0.0 if is_deterministic(domain) else LUCK * missing.std(ddof=1) / math.sqrt(len(missing))
    )
    return float(missing.mean() - luck)


def _held_out_runs(
    demos: Sequence[Demonstration],
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    limit: NDArray[np.int64],
    seed: int,
) -> Rollouts:
    """Run each option from the start of its demonstration."""
    starts = [domain.decode(demo.states[0]) for demo in demos]
    if is_deterministic(domain):
        several = {id(option): tabulate(option, domain) for option in options}
        which = {key: number for number, key in enumerate(several)}
        return deterministic_rollouts(
            domain,
            np.stack([tables.action for tables in several.values()]),
            np.stack([tables.termination for tables in several.values()]),
            np.array([which[id(option)] for option in options]),
            np.array([domain.index(state) for state in starts]),
            limit,
        )
    keys = [f'held-out {demo.uuid}' for demo in demos]
    return rollouts_of(options, domain, starts, seed, keys, limit)


def balanced_error(
    examples: Examples,
    predict: Sequence[Callable[..., NDArray[np.bool_]]],
    folds: NDArray[np.int64],
    members_only: bool = False,
) -> float | None:
    """
    Return the mean of the error among members and among others; None: one class only.

    :param predict: of each fold, what was learned without it says of rows (N, F).
    :param members_only: there are no others to be shown; the error is that among members.
    """
    predicted = np.empty(len(examples.labels), dtype=np.bool_)
    fold_of_row = folds[examples.source]
    for fold, says in enumerate(predict):
        predicted[fold_of_row == fold] = says(examples.rows[fold_of_row == fold])
    member = examples.labels == MEMBER
    if members_only:
        return float((~predicted).mean())
    if member.all() or not member.any():
        return None
    return float(((~predicted[member]).mean() + predicted[~member].mean()) / 2)
