"""
When an option is taught well enough: three criteria, all on held-out demonstrations.

The paper (section 6) compares the return of the learned policy with that of the demonstrations,
and takes the ten-fold cross-validation error of I and beta. Here the folds are grouped by
demonstration, because rows of one trajectory on both sides would make the errors look like
nothing, and the return is held out as well. Where chance plays a part, returns differ by luck: a
shortfall counts as far as luck does not explain it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.conflicts import find_conflicts
from humanopts_learner.options.cross_validation import (
    balanced_error,
    fit_leave_fold_out,
    fold_of,
    FOLDS,
    held_out_shortfall,
)
from humanopts_learner.options.learn import Dataset, fit_option, make_dataset
from humanopts_learner.options.option import LearnedOption, MEMBER
from humanopts_learner.options.rollout import rollouts
import numpy as np

FEWEST = FOLDS  # trajectories without which nothing is measurable
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
    Return the thresholds of a domain where nobody gives others.

    :raises ValueError: the domain's own are out of range.
    """
    own = domain.teaching.thresholds if isinstance(domain, HasTeachingDefaults) else {}
    return Thresholds(**own)


@dataclass(frozen=True)
class Judgement:
    """How well an option is learned from its demonstrations, by the criteria and in words."""

    criteria: tuple[Criterion, ...]  # return, initiation, termination
    mean_return_demonstrations: float  # undiscounted
    mean_return_policy: float  # in-sample: from the same start states
    more_needed: int  # estimate of further demonstrations; 0: none; -1: cannot be told yet
    conflicts: tuple[str, ...]  # situations alike in the features but answered differently
    suggested_feature: str | None  # would tell most of them apart

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
    Judge what was learned of one option.

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

    :return: 0: none; -1: it cannot be told, because a criterion is not measurable or its
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
    """Tell whether the person said, whenever asked, that it could start again where it ended."""
    asked = [demo.can_start_at_end for demo in data.trajectories if not demo.terminated]
    return bool(asked) and all(asked) and bool((data.initiation.labels == MEMBER).all())
