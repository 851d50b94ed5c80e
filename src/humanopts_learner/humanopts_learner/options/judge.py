"""
Stopping criteria for teaching an option, measured on held-out or fresh starts where possible.

The paper (section 6) compares the return of the learned policy with that of the demonstrations,
and uses the cross-validation error of I and beta. Here, the strongest possible evidence is used.

*Success* is the share of starts from which the option reaches an end like a demonstrated one
(``KnownEnds``). If all states can be listed, it is exact: the option runs from all starts or, if
actions have several outcomes, its success probabilities are computed. If the domain can only be
simulated or replayed, fresh starts are drawn as the task draws them, and what counts is the lower
limit of the share (Wilson 1927). The required share (``_required``) is higher if success is exact,
because some starts succeed by accident, and lower if actions have several outcomes. A domain that
cannot be simulated gives *agreement* instead: the share of held-out demonstrations that the option
would repeat. If actions have several outcomes and runs can only be sampled, both are required,
because an end reached by chance does not reveal wrong steps. In a domain without chance,
*imitation* is also required: from the start of a demonstration, the option must reach the end of
that demonstration, not just any end.

Folds are grouped by demonstration, because rows of one trajectory in both training and test data
would hide errors. The *return* is also held out: each option runs from the starts of
demonstrations that it was not trained on. The shortfall is a share of the range between the
demonstrated return and that of random actions with the same starts, ends and maximum number of
steps. If random actions return as much as the demonstrated ones, the return is not measurable.
Start states chosen because the option fails there bias the held-out return downwards. So if all
states can be listed, the criterion is also met if the shortfall from the best policy is within the
threshold at every start. In a domain with chance, the lower limit of the shortfall counts if there
is an exam, which judges outcomes; otherwise, its upper limit counts.

*Termination* counts demonstrations, because an error balanced over rows would hide that one run
in five ends in the wrong place. A criterion that cannot fail is not measurable.

Limits hold jointly for all evaluations in a lesson (``level_of_look``), so evaluating after every
demonstration does not make an option pass by luck.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
import math

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, action_index, Domain, is_enumerable
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.formulas import stacked
from humanopts_env.domains.registry import KeyedDomain
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.games import games_at, HasGames
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, judged, Kind
from humanopts_learner.intervals import Interval, LEVEL, level_of_look, runs_needed
from humanopts_learner.option import Option
from humanopts_learner.options.conflicts import advise, find_conflicts, find_needless
from humanopts_learner.options.exam import before_exam, with_verdicts
from humanopts_learner.options.failures import (
    Chances,
    Failures,
    find_failures,
    KnownEnds,
    repeats,
    successes_by_chance,
)
from humanopts_learner.options.learn import (
    Dataset,
    Examples,
    fit_leave_fold_out,
    fit_option,
    fold_of,
    learn_option,
    make_dataset,
)
from humanopts_learner.options.learned_option import LearnedOption, loops_of, MEMBER
from humanopts_learner.options.rollout import (
    is_deterministic,
    Rollouts,
    rollouts,
    run_once,
    without_chance,
)
from humanopts_learner.options.starts import fresh_starts
from humanopts_learner.summary import (
    AGREEMENT,
    Criterion,
    EVERY_START,
    IMITATION,
    INITIATION,
    NO_OTHER_END,
    NO_RANGE,
    NO_REFUSAL,
    OptionSummary,
    RECORDED,
    RETURN,
    SAMPLED_STARTS,
    SUCCESS,
    TERMINATION,
    UNKNOWN,
    unmeasured,
)
import numpy as np
from numpy.typing import NDArray

MIN_HELD_OUT = 3  # minimum number of trajectories for held-out criteria
CUT_OFF = 2  # maximum length of a held-out run, relative to its demonstration
LONGEST = 4  # maximum length of a run from a fresh start, relative to the longest demonstration
FEWEST = 20  # minimum number of runs from fresh starts, even if the threshold needs fewer
SPARE = 1.5  # their maximum number, relative to the fewest that can meet the threshold
AMPLE = 4  # the same, where many games run in parallel
MAX_RUNS = 2000  # their absolute maximum
REPEATED = 0.5  # smallest share of recorded demonstrations that the option would repeat
OTHER_END = 0.2  # largest share of demonstrations with another end; one in five may be a slip
RANDOM_RUNS = 200  # minimum number of random runs, unless fewer give a precise range
RANDOM_RUNS_EACH = 10  # random runs per start in each group; at least one group
PRECISE = 0.1  # largest standard error of a precise range, relative to it
MAX_GROUPS = 256  # number of cached groups of random runs
RANGE_LEVEL = 0.9  # two-sided level: the range is below its lower limit in 5 % of cases
ONE_SIDED = 1.645  # standard errors from the mean to a one-sided 95 % limit
ROUNDING = 1e-9  # reward units


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The thresholds of the criteria."""

    success: float = 0.95  # smallest share of starts, 0..1
    return_share: float = 0.1  # largest shortfall in the return, as a share of its range
    initiation_error: float = 0.05  # largest balanced error, 0..1
    termination_error: float = 0.1  # largest share of demonstrations, 0..1
    exam: int = 5  # runs of the first exam, all of which must be right; 0: no exam

    def __post_init__(self) -> None:
        """
        Check the values.

        :raises ValueError: ``return_share`` is not finite, another share is not in 0..1, or
            ``exam`` is negative.
        """
        if self.exam < 0:
            raise ValueError(f'an exam has 0 or more runs, not {self.exam}')
        shares = self.success, self.initiation_error, self.termination_error
        if not math.isfinite(self.return_share) or not all(0 <= each <= 1 for each in shares):
            raise ValueError(
                'thresholds are a share of starts, a share of the range of returns and two '
                f'errors, from 0 to 1, not {self.success}, {self.return_share}, {shares[1]}, '
                f'{shares[2]}'
            )


@dataclass(frozen=True)
class _Look:
    """The inputs of one evaluation of the criteria."""

    data: Dataset
    option: LearnedOption  # learned from all of the data
    judged: Sequence[Demonstration]  # the demonstrations, and the runs that the person judged
    others: Sequence[Option]
    seed: int

    @property
    def level(self) -> float:
        """Confidence level of limits."""
        return level_of_look(max(self.data.demonstrations[-1].number, 1))


@dataclass(frozen=True)
class HeldOut:
    """The demonstrations, each with an option learned without it."""

    data: Dataset
    folds: Ints  # (D,) fold of each demonstration
    of_fold: Sequence[LearnedOption]

    @property
    def options(self) -> list[LearnedOption]:
        """For each trajectory, an option learned without it."""
        fold = self.folds[[demo.kind is Kind.TRAJECTORY for demo in self.data.demonstrations]]
        return [self.of_fold[f] for f in fold.tolist()]

    @classmethod
    def of(cls, data: Dataset, domain: ActableDomain, seed: int) -> 'HeldOut':
        """Relearn the option without each fold."""
        folds = fold_of(data, seed)
        return cls(data, folds, fit_leave_fold_out(data, folds, domain, seed))


def judge(
    demonstrations: Sequence[Demonstration],
    domain: ActableDomain,
    thresholds: Thresholds,
    seed: int,
    option: LearnedOption | None = None,
    others: Sequence[Option] = (),
) -> OptionSummary:
    """
    Evaluate the stopping criteria of an option.

    :param demonstrations: checked demonstrations of one participant and option, with the runs that
        the person judged.
    :param option: result of ``learn_option`` with the same arguments; None: learn it here.
    :param others: in a replayed domain, the options that lead to the starts of this one
        (``taught_before``).
    :raises NotLearnableError: as ``learn_option``.
    """
    everything, demonstrations = demonstrations, before_exam(demonstrations)
    data = make_dataset(demonstrations, domain)
    option = option or fit_option(data, domain, seed)
    look = _Look(data, option, demonstrations, others, seed)
    demos, criteria, evidence = data.trajectories, list[Criterion](), RECORDED
    returns = np.array([demo.total_reward for demo in demos])
    enough = len(demos) >= MIN_HELD_OUT
    held_out = HeldOut.of(data, domain, seed) if enough else None
    gain, mean_return, ends = UNKNOWN, math.nan, (0, 0, 0)
    known: Failures | Chances | None = None
    if can_simulate(domain):
        if is_deterministic(domain):
            known = find_failures(option, domain, demonstrations)
        elif is_enumerable(domain):
            known = successes_by_chance(option, domain, demonstrations)
        keys = [f'in-sample {demo.uuid}' for demo in demos]
        starts = [domain.decode(demo.states[0]) for demo in demos]
        in_sample = rollouts(option, domain, starts, seed, keys)
        gain = Interval.of_difference(in_sample.total_reward, returns)
        mean_return = float(in_sample.total_reward.mean())
        if without_chance(domain):
            criteria.append(_imitation(look, domain, in_sample))
        elif known is None:
            criteria.append(_agreement(look, domain, held_out, thresholds.exam))
        criteria.append(_return(look, domain, thresholds, held_out, known))
    else:
        criteria.append(_agreement(look, domain, held_out, thresholds.exam))
    errors: list[float | None] = [None, None]
    if held_out is not None:
        ends = held_out_ends(held_out, domain, seed)
        initiation = [each.can_start for each in held_out.of_fold]
        errors = [
            balanced_error(data.initiation, initiation, held_out.folds),
            sum(ends) / len(demos),
        ]
    obstacles = ['', '']
    asked = [demo.can_start_at_end for demo in demos if not demo.terminated]
    if enough and ((bool(asked) and all(asked)) or data.ends_with_task) and errors[0] is None:
        obstacles[0] = NO_REFUSAL
    if data.ends_with_task and not (data.termination.labels == MEMBER).any():
        errors[1], obstacles[1] = None, NO_OTHER_END
    for name, error, obstacle, threshold in zip(
        (INITIATION, TERMINATION),
        errors,
        obstacles,
        (thresholds.initiation_error, thresholds.termination_error),
    ):
        found = Criterion.of(name, error, threshold, count=len(demos))
        criteria.append(replace(found, obstacle=obstacle))
    more = more_needed(criteria, len(demos))
    if can_simulate(domain):
        decides = all(criterion.met or criterion.obstacle for criterion in criteria)
        success, evidence = _success(look, domain, thresholds.success, known, decides)
        criteria.insert(0, success)
        if decides or not success.undecided:
            more = more_needed(criteria, len(demos))
    needless = find_needless(held_out.of_fold, data, held_out.folds, domain) if held_out else ()
    summary = replace(
        unmeasured(data.demonstrations),
        features=data.features,
        criteria=tuple(criteria),
        evidence=evidence,
        ended_early=ends[0],
        ended_late=ends[1],
        ended_never=ends[2],
        mean_return_demonstrations=float(returns.mean()),
        mean_return_policy=mean_return,
        more_needed=more,
        conflicts=find_conflicts(data),
        advice=(*advise(data, domain), *needless),
        gain=gain,
    )
    return with_verdicts(summary, everything, thresholds.exam)


def taught_before(
    name: str, demonstrations: Sequence[Demonstration], domain: ActableDomain, seed: int
) -> list[LearnedOption]:
    """
    Return the options taught before an option, which lead to its starts.

    They are learned only from demonstrations before the option's first, so that later ones do not
    affect its criteria.

    :param demonstrations: all demonstrations of the participant, in order.
    :return: the options; empty unless the domain is replayed.
    """
    if not isinstance(domain, ReplayedDomain):
        return []
    groups: dict[str, list[Demonstration]] = {}
    for demo in demonstrations:
        if demo.option_name == name:
            break
        if not demo.withdrawn:
            groups.setdefault(demo.option_name, []).append(demo)
    return [
        learn_option(demos, domain, seed)
        for demos in groups.values()
        if any(demo.kind is Kind.TRAJECTORY for demo in demos)
    ]


def more_needed(criteria: Sequence[Criterion], n_demonstrations: int) -> int:
    """
    Estimate the number of further demonstrations needed to meet all criteria.

    Errors come from situations that occur in only one demonstration. Their share decreases roughly
    as 1 / n, so a criterion at twice its threshold needs about n more demonstrations. The distance
    from a value to its confidence limit decreases as 1 / sqrt(n).

    :return: 0: none; -1: unknown, because a criterion is not yet measurable, a share that must be
        large has no confidence limit, or further demonstrations cannot reach the threshold.
    """
    times = 1.0
    for criterion in criteria:
        if criterion.met or criterion.obstacle:
            continue
        if criterion.value is None or criterion.threshold is None:
            return -1
        value, threshold, high = criterion.value, criterion.threshold, criterion.limit
        if criterion.at_least:
            if high is None:
                return -1
            value, threshold, high = 1 - value, 1 - threshold, 1 - high
        high = value if high is None else high
        width, falling = high - value, max(value, 0.0)
        room = threshold - min(value, 0.0)
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


def _success(
    look: _Look,
    domain: Domain,
    threshold: float,
    known: Failures | Chances | None,
    decides: bool,
) -> tuple[Criterion, str]:
    """
    Return the success criterion and its evidence.

    :param known: outcomes from all states; None: states cannot be listed.
    :param decides: whether all other measurable criteria are met.
    """
    threshold = _required(threshold, exact=known is not None, chance=not without_chance(domain))
    if known is None:
        right = _from_fresh_starts(look, domain, threshold, decides)
        share = Interval.of_share(right, look.level)
        mean, low = (share.mean, share.low) if len(right) else (0.0, 0.0)
        return Criterion.of(SUCCESS, mean, threshold, low, len(right)), SAMPLED_STARTS
    found = [flags[known.candidate] for flags in (known.right, known.possible)]
    count = len(found[0])
    value, possible_value = (float(flags.mean()) if count else 0.0 for flags in found)
    criterion = Criterion.of(SUCCESS, value, threshold, None, count, possible_value)
    return criterion, EVERY_START


def _required(share: float, *, exact: bool, chance: bool) -> float:
    """Return the share of starts from which an option must succeed."""
    room = 1.0
    room -= 0.5 * exact  # some starts succeed by accident
    room += 0.5 * chance  # bad luck makes even a right option fail
    return max(1 - room * (1 - share), 0.0)


def _from_fresh_starts(look: _Look, domain: Domain, threshold: float, decides: bool) -> Flags:
    """
    Return (N,): whether the option reaches an end like a demonstrated one from each fresh start.

    If all runs are right, the smallest number that meets the threshold suffices. Otherwise, there
    are more runs, up to a maximum or until the limit can no longer reach the threshold. While
    another criterion is not met, a few runs give an estimate.
    """
    option, data, level = look.option, look.data, look.level
    needed = MAX_RUNS if threshold == 1 else runs_needed(threshold, level)
    fewest = min(max(needed, FEWEST), MAX_RUNS) if decides else FEWEST
    side_by_side = isinstance(domain, HasGames) and not isinstance(domain, ReplayedDomain)
    total = min(math.ceil((AMPLE if side_by_side else SPARE) * fewest), MAX_RUNS)
    longest = LONGEST * max(len(demo.actions) for demo in data.trajectories)
    steps = min(option.max_steps, longest)
    rng = generator(look.seed, 'runs from fresh starts', option.name, data.demonstrations[-1].uuid)
    found, ends = np.zeros(0, dtype=np.bool_), KnownEnds(domain, data.features, look.judged)
    for group in fresh_starts(option, domain, look.seed, rng, look.others):
        missing = (fewest if found.all() else total) - len(found)
        if not (states := group[:missing]):
            continue
        count = len(states)
        runs = run_once(
            domain,
            states,
            [option],
            np.zeros(count, dtype=np.intp),
            np.full(count, steps),
            rng,
            loops_of(domain, [option], count, None),
        )
        right = ends.like_shown(runs.rows, runs.over, runs.last_reward)
        right &= ~ends.called_wrong(runs.rows, runs.over)
        found = np.append(found, runs.reached & right)
        best = np.append(found, np.ones(total - len(found), dtype=np.bool_))
        enough = len(found) == (fewest if found.all() else total)
        if enough or Interval.of_share(best, level).low < threshold:
            break
    return found


def _imitation(look: _Look, domain: Domain, in_sample: Rollouts) -> Criterion:
    """
    Return the imitation criterion, in a domain without chance.

    The value is 1 if the option would repeat a run that the person called wrong.
    """
    demos, data = look.data.trajectories, look.data
    same = in_sample.reached & (in_sample.over == [demo.terminated for demo in demos])
    if is_enumerable(domain):
        ends = np.stack([demo.feature_rows[-1] for demo in demos])
        same &= (stacked(data.chosen, in_sample.rows) == stacked(data.chosen, ends)).all(axis=1)
    else:
        ends_known = KnownEnds(domain, data.features, look.judged)
        same &= ends_known.like_shown(in_sample.rows, in_sample.over, in_sample.last_reward)
    wrong = [run for run in judged(look.judged) if not run.right]
    again = any(repeats(look.option, domain, run) for run in wrong)
    value = 1.0 if again else 1 - float(same.mean())
    return Criterion.of(IMITATION, value, OTHER_END, count=len(demos))


def _return(
    look: _Look,
    domain: Domain,
    thresholds: Thresholds,
    held_out: HeldOut | None,
    known: Failures | Chances | None,
) -> Criterion:
    """
    Return the criterion ``return``.

    Rewards that have little to do with the option, such as food along the way, may vary too much
    to average out over the demonstrations. So, if there is an exam, only the part of the shortfall
    that chance does not explain counts: its lower limit.
    """
    data, count = look.data, len(look.data.trajectories)
    threshold = thresholds.return_share
    if held_out is None:
        return Criterion.of(RETURN, None, threshold, count=count)
    span = return_range(data, domain, look.option, look.seed)
    if span is None:
        return replace(Criterion.of(RETURN, None, threshold, count=count), obstacle=NO_RANGE)
    if known is not None and known.candidate.any():
        largest = float(known.shortfall[known.candidate].max()) / span
        if largest <= threshold:
            return Criterion.of(RETURN, largest, threshold, count=count)
    level = LEVEL if thresholds.exam else look.level
    found = held_out_shortfall(held_out, domain, look.seed, level)
    if thresholds.exam:
        certain = min(found.mean, max(found.low, 0.0))
        return Criterion.of(RETURN, certain / span, threshold, count=count)
    return Criterion.of(RETURN, found.mean / span, threshold, found.high / span, count)


def _agreement(
    look: _Look, domain: ActableDomain, held_out: HeldOut | None, exam: int
) -> Criterion:
    """
    Return the agreement criterion, used if runs are impossible or, with chance, sampled.

    An option would repeat a demonstration if it can start where the demonstration starts, takes
    most of the demonstrated actions, and ends in the last demonstrated state. Wrong actions are
    allowed, because the run may still reach its end. The limit counts only without an exam,
    because an exam judges outcomes with its own limits.
    """
    if held_out is None:
        return Criterion.of(AGREEMENT, None, REPEATED, count=len(look.data.trajectories))
    repeated = []
    for option, demo in zip(held_out.options, look.data.trajectories):
        rows = demo.feature_rows
        actions = [action_index(domain, name) for name in demo.actions]
        most = (option.action(rows[:-1]) == actions).mean() > 0.5
        ends = _ends_along(option, demo)
        repeated.append(
            option.can_start(rows[:1])[0] and most and ends.argmax() == len(actions) > 0
        )
    share = Interval.of_share(np.array(repeated), look.level)
    low = None if exam else share.low
    return Criterion.of(AGREEMENT, share.mean, REPEATED, low, len(repeated))


def _ends_along(option: LearnedOption, demo: Demonstration) -> Flags:
    """Return (T + 1,): whether an option ends in each state of a demonstration."""
    ends = option.ends(demo.feature_rows)
    ends[0] = False  # not checked before the first step
    ends[-1] |= demo.terminated
    return ends


def held_out_ends(held_out: HeldOut, domain: ActableDomain, seed: int) -> tuple[int, int, int]:
    """
    Return the numbers of demonstrations in which the option ends early, late and never.

    An option that has not ended by the end of the demonstration runs for as many steps again if
    the domain can be simulated. Otherwise, it counts as never ending.
    """
    early, missed = 0, []
    for option, demo in zip(held_out.options, held_out.data.trajectories):
        ends = _ends_along(option, demo)
        early += bool(ends[:-1].any())
        if not ends.any():
            missed.append((option, demo))
    late = 0
    if missed and can_simulate(domain):
        options, demos = zip(*missed)
        runs = rollouts(
            options,
            domain,
            [domain.decode(demo.states[-1]) for demo in demos],
            seed,
            [f'after {demo.uuid}' for demo in demos],
            max_steps=np.array([len(demo.actions) for demo in demos]),
        )
        late = int(runs.reached.sum())
    return early, late, len(missed) - late


def held_out_shortfall(held_out: HeldOut, domain: Domain, seed: int, level: float) -> Interval:
    """
    Return the mean shortfall of policies against demonstrations that they were not trained on.

    Ends differ if the task is over at the end of either the run or its demonstration, but not
    both. Each remaining step of the run then costs as much as the worst demonstrated step.

    While a run takes the demonstrated actions, it gets the demonstrated outcomes (common random
    numbers); it diverges where the option first acts or ends differently. The limits are those of
    Student's t for the mean over demonstrations. In a domain without chance, both limits equal the
    mean, and a surplus over one demonstration does not compensate for a shortfall from another.
    """
    options, demos = held_out.options, held_out.data.trajectories
    limit = held_out_limits(held_out.data, options[0])
    lengths = np.array([len(demo.actions) for demo in demos])
    steps, reached = _follow(options, demos, domain)
    over = reached & (steps == lengths) & [demo.terminated for demo in demos]
    returns = np.array([math.fsum(demo.rewards[:n]) for demo, n in zip(demos, steps.tolist())])
    on = np.flatnonzero(~reached & (steps < limit))
    if on.size:
        runs = rollouts(
            [options[run] for run in on],
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
    if without_chance(domain):
        return Interval(*[float(np.maximum(missing, 0.0).mean())] * 3)
    return Interval.of(missing, 2 * level - 1)  # one-sided


def held_out_limits(data: Dataset, option: LearnedOption) -> NDArray[np.int64]:
    """Return (D,): the maximum length of a run from the start of each demonstration."""
    lengths = np.array([len(demo.actions) for demo in data.trajectories], dtype=np.int64)
    return np.minimum(option.max_steps, CUT_OFF * lengths)


def _cost_of_other_end(
    demos: Sequence[Demonstration], reached: Flags, over: Flags, left: NDArray[np.int64]
) -> Floats:
    """
    Return what to add to returns of runs that end differently from their demonstration.

    :param demos: (N,) demonstration of each run.
    :param left: (N,) number of remaining steps of each run.
    """
    other_end = reached & (over != np.array([demo.terminated for demo in demos]))
    worst: Floats = np.array([min(0.0, *demo.rewards) for demo in demos])
    cost: Floats = worst * other_end * left
    return cost


def return_range(data: Dataset, domain: Domain, option: LearnedOption, seed: int) -> float | None:
    """
    Return the mean of the demonstrated return minus that of random actions from the same start.

    Random actions run like a held-out option: until the option or the task ends, or for twice the
    number of demonstrated steps. The range is thus the shortfall of a worthless policy. It neither
    grows with the option's step limit, nor vanishes if random actions eventually reach the same
    end. Runs are added until the standard error is small. All options learned from a demonstration
    share them, because only the ends of the runs depend on the option.

    :param option: option that determines where the runs end.
    :return: the range; None: the runs do not show that random actions return less.
    """
    demos, game = data.trajectories, KeyedDomain.of(domain)
    demonstrated = np.array([demo.total_reward for demo in demos])
    limits, total = held_out_limits(data, option), np.zeros((0, len(demos)))
    mean, error = 0.0, math.inf
    while total.size < RANDOM_RUNS and error > PRECISE * mean:
        group = np.zeros((RANDOM_RUNS_EACH, len(demos)))
        for number, (demo, limit) in enumerate(zip(demos, limits.tolist())):
            runs = _random_runs(game, demo.states[0], limit, len(total), seed, demo.uuid)
            ends = option.ends(runs.rows.reshape(-1, runs.rows.shape[2])).reshape(runs.over.shape)
            ends |= runs.over
            reached = np.asarray(ends.any(axis=1))
            last = np.where(reached, ends.argmax(axis=1), limit - 1)
            over = runs.over[np.arange(len(last)), last]
            taken = np.arange(runs.reward.shape[1]) <= last[:, None]
            cost = _cost_of_other_end([demo] * len(last), reached, over, limit - 1 - last)
            group[:, number] = (runs.reward * taken).sum(axis=1) + cost
        total = np.concatenate([total, group])
        mean = float((demonstrated - total.mean(axis=0)).mean())
        error = math.sqrt(float(total.var(axis=0, ddof=1).sum()) / len(total)) / len(demos)
    found = Interval.of(demonstrated - total.mean(axis=0), RANGE_LEVEL)
    if without_chance(domain):  # the demonstrated returns are exact
        found = replace(found, low=found.mean - ONE_SIDED * error)
    return found.mean if found.low > ROUNDING else None


@dataclass(frozen=True)
class _RandomRuns:
    """R runs of random actions, of at most T steps each; rewards after the task's end are 0."""

    reward: Floats  # (R, T)
    rows: Rows  # (R, T, F) features after each step
    over: Flags  # (R, T) whether the task is over after each step


@lru_cache(maxsize=MAX_GROUPS)
def _random_runs(
    game: KeyedDomain, start: str, limit: int, number: int, seed: int, uuid: str
) -> _RandomRuns:
    """Return ``RANDOM_RUNS_EACH`` runs from a state, following ``number`` earlier ones."""
    domain, rng = game.value, generator(seed, 'random actions', uuid, number)
    games = games_at(domain, [domain.decode(start)] * RANDOM_RUNS_EACH)
    shape, playing = (RANDOM_RUNS_EACH, limit), np.arange(RANDOM_RUNS_EACH)
    reward, over, step = np.zeros(shape), np.zeros(shape, dtype=np.bool_), 0
    rows = np.zeros((*shape, len(domain.features)))
    while playing.size and step < limit:
        taken = games.step(rng.integers(len(domain.actions), size=len(playing)), rng)
        reward[playing, step], rows[playing, step] = taken.reward, games.features()
        over[playing[taken.over], step:] = True
        on, step = np.flatnonzero(~taken.over), step + 1
        games, playing = games.take(on), playing[on]
    return _RandomRuns(reward[:, :step], rows[:, :step], over[:, :step])


def _follow(
    options: Sequence[LearnedOption], demos: Sequence[Demonstration], domain: Domain
) -> tuple[NDArray[np.int64], Flags]:
    """
    Follow demonstrations as long as the options would act as demonstrated.

    :param options: (N,) one per demonstration.
    :return: steps (N,) until the option acts or ends differently, or the demonstration ends; and
        whether the option ends there, (N,).
    """
    steps, ended = np.zeros(len(demos), dtype=np.int64), np.zeros(len(demos), dtype=np.bool_)
    for index, (option, demo) in enumerate(zip(options, demos, strict=True)):
        shown = [action_index(domain, action) for action in demo.actions]
        acts_otherwise = np.append(option.action(demo.feature_rows[:-1]) != shown, True)
        ends = _ends_along(option, demo)
        steps[index] = (acts_otherwise | ends).argmax()
        ended[index] = ends[steps[index]]
    return steps, ended


def balanced_error(
    examples: Examples, predict: Sequence[Callable[[Rows], Flags]], folds: Ints
) -> float | None:
    """
    Return the mean of the errors among members and among non-members; None: only one class.

    :param predict: for each fold, a predictor of rows (N, F) that was learned without the fold.
    """
    predicted = np.empty(len(examples.labels), dtype=np.bool_)
    fold_of_row = folds[examples.source]
    for fold, says in enumerate(predict):
        predicted[fold_of_row == fold] = says(examples.rows[fold_of_row == fold])
    member = examples.labels == MEMBER
    errors = [(predicted != member)[of].mean() for of in (member, ~member) if of.any()]
    return float(np.mean(errors)) if len(errors) > 1 else None
