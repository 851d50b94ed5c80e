"""
Three stopping criteria for teaching an option, by ten-fold cross-validation.

The paper (section 6) compares the return of the learned policy with that of the demonstrations,
and uses the cross-validation error of I and beta. Here folds are grouped by demonstration, because
rows of one trajectory on both sides would hide errors, and the return is held out as well: each
option runs from the starts of the demonstrations that it was not trained on. With chance, returns
vary randomly: the criterion is met if the upper confidence limit of the shortfall is small enough,
so few or noisy demonstrations do not meet it.

The threshold depends on the game: a shortfall of two is large if all returns are between 0 and 1.
By default it is a tenth of the range between the demonstrated return and that of random actions,
which run from the same starts as the held-out option, with the same ends and the same maximum
number of steps. If random actions return as much as the demonstrations, there is no range: the
criterion cannot be measured, and is not met.

Start states chosen because the option fails there bias the held-out return downwards. If all
states can be listed and there is no chance, the return from every start is known: the return
criterion is also met if the option reaches a demonstrated end from every state where it can start,
and never falls short of the best path by more than the threshold (``failures.py``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, action_index, Domain
from humanopts_env.domains.described import can_simulate
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, GOAL, Kind
from humanopts_learner.intervals import Interval
from humanopts_learner.option import RandomActions
from humanopts_learner.options.conflicts import find_conflicts
from humanopts_learner.options.exam import before_exam, with_verdicts
from humanopts_learner.options.failures import largest_shortfall
from humanopts_learner.options.learn import Dataset, Examples, fit_option, make_dataset
from humanopts_learner.options.learned_option import LearnedOption, MEMBER
from humanopts_learner.options.rollout import is_deterministic, rollouts, run_once
from humanopts_learner.summary import (
    Criterion,
    INITIATION,
    NO_RANGE,
    NO_RULES,
    OptionSummary,
    RETURN,
    TERMINATION,
    UNKNOWN,
    unmeasured,
)
import numpy as np
from numpy.typing import NDArray

FOLDS = 10
MIN_TRAJECTORIES = FOLDS  # minimum for any criterion to be measurable
MIN_TO_A_GOAL = 3  # if the policy is planned: only I, beta and goal are learned
LEVEL = 0.9  # two-sided: the shortfall is above the upper limit in 5 of 100 cases
CUT_OFF = 2  # maximum length of a held-out run, relative to its demonstration
SHARE = 0.1  # default threshold of the shortfall, relative to the range of returns
RANDOM_RUNS = 200  # minimum over all starts
RANDOM_RUNS_EACH = 10  # minimum per start
ONE_SIDED = 1.645  # standard errors below the range with 5 % confidence
ROUNDING = 1e-9  # reward units


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The largest values that meet the criteria."""

    return_delta: float | None = None  # shortfall of the return, reward units; None: by the range
    initiation_error: float = 0.05  # balanced error, 0..1
    termination_error: float = 0.05  # balanced error, 0..1
    exam: int = 5  # runs of the first exam, all of which must be right; 0: no exam

    def __post_init__(self) -> None:
        """
        Check the values.

        :raises ValueError: a value is not finite, or an error is not in 0..1.
        """
        if self.exam < 0:
            raise ValueError(f'an exam has 0 or more runs, not {self.exam}')
        errors = self.initiation_error, self.termination_error
        if not math.isfinite(self.return_delta or 0.0) or not all(0 <= e <= 1 for e in errors):
            raise ValueError(
                'thresholds are a number of reward units and two errors from 0 to 1, '
                f'not {self.return_delta}, {errors[0]}, {errors[1]}'
            )


def judge(
    demonstrations: Sequence[Demonstration],
    domain: ActableDomain,
    thresholds: Thresholds,
    seed: int,
    option: LearnedOption | None = None,
) -> OptionSummary:
    """
    Evaluate the stopping criteria of an option.

    The return cannot be measured in a domain that cannot be simulated.

    :param demonstrations: checked demonstrations and judged runs of one participant and option.
    :param option: result of ``learn_option`` with the same arguments; None: learn it here.
    :raises NotLearnableError: as ``learn_option``.
    """
    everything, demonstrations = demonstrations, before_exam(demonstrations)
    data = make_dataset(demonstrations, domain)
    option = option or fit_option(data, domain, seed)
    shown = np.array([demo.total_reward for demo in data.trajectories])
    known, gain, mean_return = None, UNKNOWN, math.nan
    if can_simulate(domain):
        keys = [f'in-sample {demo.uuid}' for demo in data.trajectories]
        returns = rollouts(option, domain, _starts(data, domain), seed, keys).total_reward
        gain, mean_return = Interval.of_difference(returns, shown), float(returns.mean())
        if option.method != GOAL and is_deterministic(domain):
            known = largest_shortfall(option, domain, demonstrations)
    criteria = _criteria(data, domain, thresholds, seed, option, known)
    waits = known is not None and not criteria[0].met  # no estimate of when it will be met
    conflicts, suggested = find_conflicts(data, domain)
    summary = replace(
        unmeasured(data.demonstrations),
        features=data.features,
        criteria=criteria,
        mean_return_demonstrations=float(shown.mean()),
        mean_return_policy=mean_return,
        more_needed=-1 if waits else more_needed(criteria, len(shown)),
        conflicts=conflicts,
        suggested_feature=suggested,
        gain=gain,
    )
    return with_verdicts(summary, everything, thresholds.exam)


def _starts(data: Dataset, domain: Domain) -> list[Any]:
    return [domain.decode(demo.states[0]) for demo in data.trajectories]


def more_needed(criteria: Sequence[Criterion], n_demonstrations: int) -> int:
    """
    Estimate the number of further demonstrations needed to meet all criteria.

    Held-out errors come from situations in only one demonstration, whose share decreases roughly
    as 1 / n: a value of twice its threshold needs about n more. The distance from the value to its
    upper limit decreases as 1 / sqrt(n).

    :return: 0: none; -1: unknown, because a criterion is not measurable or its threshold is not
        above the limit of the value.
    """
    times = 1.0
    for criterion in criteria:
        if criterion.met:
            continue
        if criterion.value is None or criterion.threshold is None:
            return -1
        high = criterion.value if criterion.high is None else criterion.high
        width, falling = high - criterion.value, max(criterion.value, 0.0)
        room = criterion.threshold - min(criterion.value, 0.0)
        if room <= 0:
            return -1
        # With x = 1 / sqrt(times), solve falling * x**2 + width * x = room.
        root = math.sqrt(width**2 + 4 * falling * room)
        times = max(times, ((width + root) / (2 * room)) ** 2)
    return math.ceil(round(n_demonstrations * (times - 1), 6))


def likely_range(more: int) -> tuple[int, int]:
    """
    Return a likely range for an estimate of ``more_needed``.

    The estimate is that of the worst criterion, which may change with every demonstration. In 20
    simulated lessons in Pac-Man (its five options, strategy ``failures``, two seeds, with 0 % and
    2 % wrong steps), 75 of 87 ranges contained the true number.

    :param more: the estimate, above 0.
    """
    return max(1, more // 4), 3 * more


def _criteria(
    data: Dataset,
    domain: ActableDomain,
    thresholds: Thresholds,
    seed: int,
    option: LearnedOption,
    known: float | None,
) -> tuple[Criterion, ...]:
    """
    Return the three criteria.

    :param option: option learned from all of the data.
    :param known: largest shortfall from any state; None: unknown.
    """
    delta, shortfall = thresholds.return_delta, None
    obstacle = '' if can_simulate(domain) else NO_RULES
    if len(data.trajectories) < min_trajectories(data.method):
        initiation_error, termination_error = None, None
    else:
        if delta is None and can_simulate(domain):
            found = return_range(data, domain, option, seed)
            obstacle, delta = (NO_RANGE, None) if found is None else ('', SHARE * found)
        folds = fold_of(data, seed)
        options = fit_leave_fold_out(data, folds, domain, seed)
        initiation = [option.can_start for option in options]
        termination = [option.ends for option in options]
        if can_simulate(domain) and not obstacle:
            shortfall = held_out_shortfall(data, domain, options, folds, seed)
        asked = [demo.can_start_at_end for demo in data.trajectories if not demo.terminated]
        anywhere = (bool(asked) and all(asked)) or data.ends_with_task
        initiation_error = balanced_error(data.initiation, initiation, folds, anywhere)
        termination_error = balanced_error(
            data.termination, termination, folds, data.ends_with_task
        )
    mean, high = (shortfall.mean, shortfall.high) if shortfall else (None, None)
    if shortfall and known is not None and delta is not None and known <= delta:
        mean = high = known
    return (
        replace(Criterion.of(RETURN, mean, delta, high), obstacle=obstacle),
        Criterion.of(INITIATION, initiation_error, thresholds.initiation_error),
        Criterion.of(TERMINATION, termination_error, thresholds.termination_error),
    )


def min_trajectories(method: str) -> int:
    """Return the minimum number of trajectories for measurable criteria."""
    return MIN_TO_A_GOAL if method == GOAL else MIN_TRAJECTORIES


def fold_of(data: Dataset, seed: int) -> Ints:
    """
    Return (D,): the fold of each demonstration, with ten folds or one per demonstration.

    Demonstrations are ranked by draws keyed by seed, option and uuid, and dealt out in that order,
    separately for trajectories and "not here" answers, so fold sizes differ by at most one.
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
    data: Dataset, folds: Ints, domain: ActableDomain, seed: int
) -> list[LearnedOption]:
    """Return the options learned without fold 0, 1, ...; needs two or more trajectories."""
    return [fit_option(data.of(folds != fold), domain, seed) for fold in range(folds.max() + 1)]


def held_out_shortfall(
    data: Dataset,
    domain: Domain,
    options: Sequence[LearnedOption],
    folds: Ints,
    seed: int,
) -> Interval:
    """
    Return the mean of demonstrated return - return of the policy trained without it.

    A run has reached a different end if it ends with the task over and the demonstration did not,
    or vice versa: each of its remaining steps then costs as much as the worst demonstrated step.

    As long as a run takes the demonstrated actions, it gets the same random outcomes (common
    random numbers), so chance makes no difference between equal steps; it diverges where the
    option first acts or ends differently. The limits are those of the mean over demonstrations by
    Student's t. Without chance, the limits are the mean itself, and exceeding one demonstration
    does not compensate for falling short of another.
    """
    demos, limit = data.trajectories, held_out_limits(data, options[0])
    fold = folds[[demo.kind is Kind.TRAJECTORY for demo in data.demonstrations]]
    held_out = [options[f] for f in fold.tolist()]
    lengths = np.array([len(demo.actions) for demo in demos])
    steps, reached = _follow(held_out, demos, domain)
    over = reached & (steps == lengths) & [demo.terminated for demo in demos]
    returns = np.array([math.fsum(demo.rewards[:n]) for demo, n in zip(demos, steps.tolist())])
    on = np.flatnonzero(~reached & (steps < limit))
    if on.size:
        runs = rollouts(
            [held_out[run] for run in on],
            domain,
            [domain.decode(demos[run].states[steps[run]]) for run in on],
            seed,
            [f'held-out {demos[run].uuid}' for run in on],
            max_steps=(limit - steps)[on],
        )
        returns[on] += runs.total_reward
        steps[on] += runs.steps
        reached[on], over[on] = runs.reached, runs.over
    returns += _cost_of_other_end(demos, reached, over, limit - steps)
    missing = [demo.total_reward for demo in demos] - returns
    if is_deterministic(domain):
        return Interval(*[float(np.maximum(missing, 0.0).mean())] * 3)
    return Interval.of(missing, LEVEL)


def held_out_limits(data: Dataset, option: LearnedOption) -> NDArray[np.int64]:
    """Return (D,): the maximum length of a run from the start of each demonstration."""
    lengths = np.array([len(demo.actions) for demo in data.trajectories], dtype=np.int64)
    return np.minimum(option.max_steps, CUT_OFF * lengths)


def _cost_of_other_end(
    demos: Sequence[Demonstration], reached: Flags, over: Flags, left: NDArray[np.int64]
) -> Floats:
    """
    Return the amounts added to the returns of runs whose end differs from the demonstration's.

    :param demos: (N,) demonstration with the start state of each run.
    :param left: (N,) remaining steps of each run.
    """
    other_end = reached & (over != np.array([demo.terminated for demo in demos]))
    worst: Floats = np.array([min(0.0, *demo.rewards) for demo in demos])
    cost: Floats = worst * other_end * left
    return cost


def return_range(data: Dataset, domain: Domain, option: LearnedOption, seed: int) -> float | None:
    """
    Return the mean of demonstrated return - return of random actions from the same start.

    Random actions run like a held-out option: to an end of the option, the end of the task, or
    twice the steps of the demonstration. The range is thus the shortfall of a worthless policy. It
    neither grows with the option's step limit, nor vanishes if random actions eventually reach the
    same end.

    :param option: option that determines where the runs end.
    :return: None: random actions return as much, as far as these runs show.
    """
    demos = data.trajectories
    runs = max(RANDOM_RUNS_EACH, math.ceil(RANDOM_RUNS / len(demos)))
    key = (option.name, *(demo.uuid for demo in demos))
    limit = np.tile(held_out_limits(data, option), runs)
    rng = generator(seed, 'random actions', *key)
    played = run_once(
        domain,
        _starts(data, domain) * runs,
        [RandomActions(option, len(domain.actions), rng)],
        np.zeros_like(limit),
        limit,
        generator(seed, 'chance of random actions', *key),
    )
    left = limit - played.steps
    total = played.total_reward
    total += _cost_of_other_end(demos * runs, played.reached, played.over, left)
    total = total.reshape(runs, len(demos))
    found = Interval.of([demo.total_reward for demo in demos] - total.mean(axis=0), LEVEL)
    if is_deterministic(domain):  # the demonstrated returns are exact
        error = math.sqrt(float(total.var(axis=0, ddof=1).sum()) / runs) / len(demos)
        found = replace(found, low=found.mean - ONE_SIDED * error)
    return found.mean if found.low > ROUNDING else None


def _follow(
    options: Sequence[LearnedOption], demos: Sequence[Demonstration], domain: Domain
) -> tuple[NDArray[np.int64], Flags]:
    """
    Follow demonstrations for as long as options would have acted the same.

    :param options: (N,) one per demonstration.
    :return: steps (N,) until the option acts or ends differently, or the demonstration ends; and
        whether the option ends there, (N,).
    """
    steps, ended = np.zeros(len(demos), dtype=np.int64), np.zeros(len(demos), dtype=np.bool_)
    for index, (option, demo) in enumerate(zip(options, demos, strict=True)):
        rows = demo.feature_rows
        shown = [action_index(domain, action) for action in demo.actions]
        acts_otherwise = np.append(option.action(rows[:-1]) != shown, True)
        ends = option.ends(rows)
        ends[0] = False  # not checked before the first step
        ends[-1] |= demo.terminated
        steps[index] = (acts_otherwise | ends).argmax()
        ended[index] = ends[steps[index]]
    return steps, ended


def balanced_error(
    examples: Examples,
    predict: Sequence[Callable[[Rows], Flags]],
    folds: Ints,
    one_class: bool = False,
) -> float | None:
    """
    Return the mean of the errors among members and among non-members.

    :param predict: for each fold, the prediction for rows (N, F) learned without it.
    :param one_class: if there is only one class, the other cannot be demonstrated; return the
        error in it, instead of None.
    """
    predicted = np.empty(len(examples.labels), dtype=np.bool_)
    fold_of_row = folds[examples.source]
    for fold, says in enumerate(predict):
        predicted[fold_of_row == fold] = says(examples.rows[fold_of_row == fold])
    member = examples.labels == MEMBER
    errors = [(predicted != member)[of].mean() for of in (member, ~member) if of.any()]
    return float(np.mean(errors)) if one_class or len(errors) > 1 else None
