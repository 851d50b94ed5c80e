"""
When an option is taught well enough: three criteria, by ten-fold cross-validation.

The paper (section 6) compares the return of the learned policy with that of the demonstrations,
and takes the cross-validation error of I and beta. Here the folds are grouped by demonstration,
because rows of one trajectory on both sides would make the errors look like nothing, and the
return is held out as well: each option runs from the start of the demonstrations that it did not
see. Where chance plays a part, returns differ by luck: a shortfall counts as far as luck does not
explain it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.conflicts import find_conflicts
from humanopts_learner.options.learn import Dataset, Examples, fit_option, make_dataset
from humanopts_learner.options.option import LearnedOption, MEMBER
from humanopts_learner.options.rollout import is_deterministic, rollouts
import numpy as np

FOLDS = 10
FEWEST = FOLDS  # trajectories without which nothing is measurable
LUCK = 1.645  # standard errors; chance alone makes a larger shortfall in 5 of 100 cases
CUT_OFF = 2  # a held-out run may take so many times the steps of its demonstration
RETURN, INITIATION, TERMINATION = 'return', 'initiation', 'termination'


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The largest values with which the criteria are met."""

    return_delta: float = 2.0  # mean held-out shortfall, less what luck explains, reward units
    initiation_error: float = 0.05  # balanced error, 0..1
    termination_error: float = 0.05  # balanced error, 0..1

    def __post_init__(self) -> None:
        """
        Check the values.

        :raises ValueError: one is not finite, or an error is not in 0..1.
        """
        errors = self.initiation_error, self.termination_error
        if not math.isfinite(self.return_delta) or not all(0 <= e <= 1 for e in errors):
            raise ValueError(
                'thresholds are a number of reward units and two errors from 0 to 1, '
                f'not {self.return_delta}, {errors[0]}, {errors[1]}'
            )


@dataclass(frozen=True, slots=True)
class Criterion:
    """One stopping criterion."""

    name: str  # RETURN, INITIATION or TERMINATION
    value: float | None  # None: not measurable yet
    threshold: float

    @property
    def measurable(self) -> bool:
        """Whether there are enough demonstrations, of both classes, to measure it."""
        return self.value is not None

    @property
    def met(self) -> bool:
        """Whether it is measurable and the value is at most the threshold."""
        return self.value is not None and self.value <= self.threshold


def usual_thresholds(domain: Domain[Any]) -> Thresholds:
    """
    Return the default thresholds of a domain.

    :raises ValueError: the domain's own are out of range.
    """
    own = domain.teaching.thresholds if isinstance(domain, HasTeachingDefaults) else {}
    return Thresholds(**own)


@dataclass(frozen=True)
class Judgement:
    """How well an option is learned from its demonstrations."""

    criteria: tuple[Criterion, ...]  # return, initiation, termination
    mean_return_demonstrations: float  # undiscounted
    mean_return_policy: float  # in-sample: from the same start states
    more_needed: int  # estimate of further demonstrations; 0: none; -1: unknown
    conflicts: tuple[str, ...]  # situations alike in the features but answered differently
    suggested_feature: str | None  # would separate most of them

    @property
    def criteria_met(self) -> bool:
        """Whether all three criteria are met."""
        return all(criterion.met for criterion in self.criteria)


def judge(
    demonstrations: Sequence[Demonstration],
    domain: Domain[Any],
    thresholds: Thresholds,
    seed: int,
    option: LearnedOption | None = None,
) -> Judgement:
    """
    Judge an option by its demonstrations.

    :param demonstrations: of one participant and option, checked.
    :param option: what ``learn_option`` made of the same arguments; None: learned here.
    :raises NotLearnableError: as ``learn_option``.
    """
    data = make_dataset(demonstrations, domain)
    option = option or fit_option(data, domain, seed)
    shown = np.array([demo.total_reward for demo in data.trajectories])
    starts = [domain.decode(demo.states[0]) for demo in data.trajectories]
    uuids = [demo.uuid for demo in data.trajectories]
    in_sample = rollouts(option, domain, starts, seed, [f'in-sample {uuid}' for uuid in uuids])
    criteria = _criteria(data, domain, thresholds, seed)
    conflicts = find_conflicts(data, domain)
    return Judgement(
        criteria=criteria,
        mean_return_demonstrations=float(shown.mean()),
        mean_return_policy=float(in_sample.total_reward.mean()),
        more_needed=more_needed(criteria, len(shown)),
        conflicts=conflicts.texts,
        suggested_feature=conflicts.suggested_feature,
    )


def more_needed(criteria: Sequence[Criterion], n_demonstrations: int) -> int:
    """
    Estimate how many more demonstrations it takes to meet all criteria.

    What is wrong in held-out demonstrations is what they hold that no other one showed, and its
    share falls about as 1 / n: a value that is twice its threshold needs about n more.

    :return: 0: none; -1: unknown, because a criterion is not measurable or its
        threshold is 0 or less.
    """
    missed = [criterion for criterion in criteria if not criterion.met]
    ratios = [
        criterion.value / criterion.threshold
        for criterion in missed
        if criterion.value is not None and criterion.threshold > 0
    ]
    if len(ratios) < len(missed):
        return -1
    return max([0, *(math.ceil(n_demonstrations * (ratio - 1)) for ratio in ratios)])


def _criteria(
    data: Dataset, domain: Domain[Any], thresholds: Thresholds, seed: int
) -> tuple[Criterion, ...]:
    values: tuple[float | None, ...] = (None, None, None)
    if len(data.trajectories) >= FEWEST:
        folds = fold_of(data, seed)
        options = fit_leave_fold_out(data, folds, domain, seed)
        initiation = [option.can_start for option in options]
        termination = [option.ends for option in options]
        values = (
            held_out_shortfall(data, domain, options, folds, seed),
            balanced_error(data.initiation, initiation, folds, starts_anywhere(data)),
            balanced_error(data.termination, termination, folds),
        )
    limits = thresholds.return_delta, thresholds.initiation_error, thresholds.termination_error
    names = RETURN, INITIATION, TERMINATION
    return tuple(Criterion(n, v, limit) for n, v, limit in zip(names, values, limits))


def starts_anywhere(data: Dataset) -> bool:
    """Return whether every answer was that the option could start again where it ended."""
    asked = [demo.can_start_at_end for demo in data.trajectories if not demo.terminated]
    return bool(asked) and all(asked) and bool((data.initiation.labels == MEMBER).all())


def fold_of(data: Dataset, seed: int) -> Ints:
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
    data: Dataset, folds: Ints, domain: Domain[Any], seed: int
) -> list[LearnedOption]:
    """Return what is learned without fold 0, 1, ...; there must be two trajectories or more."""
    return [fit_option(data.of(folds != fold), domain, seed) for fold in range(folds.max() + 1)]


def held_out_shortfall(
    data: Dataset,
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    folds: Ints,
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
    starts = [domain.decode(demo.states[0]) for demo in demos]
    keys = [f'held-out {demo.uuid}' for demo in demos]
    held_out = [options[f] for f in fold.tolist()]
    runs = rollouts(held_out, domain, starts, seed, keys, max_steps=limit)
    other_end = runs.reached & (runs.over != np.array([demo.terminated for demo in demos]))
    worst = np.array([min(0.0, *demo.rewards) for demo in demos])
    returns = runs.total_reward + other_end * (limit - runs.steps) * worst
    missing = [demo.total_reward for demo in demos] - returns
    luck = (
        0.0 if is_deterministic(domain) else LUCK * missing.std(ddof=1) / math.sqrt(len(missing))
    )
    return float(missing.mean() - luck)


def balanced_error(
    examples: Examples,
    predict: Sequence[Callable[[Rows], Flags]],
    folds: Ints,
    members_only: bool = False,
) -> float | None:
    """
    Return the mean of the error among members and among others; None: one class only.

    :param predict: for each fold, the prediction for rows (N, F) learned without it.
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
