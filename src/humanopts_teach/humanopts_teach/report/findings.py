"""The findings of a report: sentences that follow from its numbers."""

from collections.abc import Iterator, Mapping, Sequence
import math

from humanopts_learner.intervals import Interval, level_of_each
from humanopts_learner.planning.request import HUMAN, PRIMITIVE
from humanopts_teach.bags.info import TopicRow
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation
from humanopts_teach.evaluation.games import (
    ComparisonRow,
    Curve,
    GamesEvaluation,
    PLAN,
    RANDOM,
    Setting,
    TENFOLD,
)
from humanopts_teach.evaluation.measures import PlanningRow
from humanopts_teach.evaluation.summary import differences, Execution, Live
from humanopts_teach.report.pages import counted, Finding, number
from humanopts_teach.report.people import people_findings
import numpy as np

ALLOWED = 0.02  # share of the return that options may lose against primitive actions
MARGIN = 80.0  # points by which a plan shall be better than random choice among its options


def findings(
    evaluation: BagEvaluation, live: Live | None = None, topics: Sequence[TopicRow] = ()
) -> Iterator[Finding]:
    """
    Yield the findings of a report, the most important first.

    :param live: what was seen while teaching; None: it is not known.
    :param topics: of the bag; none: they are not known.
    """
    yield _criteria(evaluation.options)
    for games in evaluation.games.values():
        yield from games_findings(games)
    planning = planning_rows(evaluation, live)
    sampled = any(row.game_steps for row in planning.values())
    if live is not None:
        yield _execution(live.execution, sampled=sampled)
    if not evaluation.games:
        yield from _sampled_plans(planning) if sampled else _exact_plans(evaluation, planning)
    yield from _unready(evaluation)
    if topics:
        yield _loss(topics)
    if live is not None:
        yield _offline(live, evaluation)
    yield from people_findings(evaluation)
    compared = [each.reproduced for each in evaluation.options if each.reproduced is not None]
    if compared and all(compared):  # a warning reports one that is not
        yield Finding(
            True,
            f'{counted(len(compared), "option")} learned again from the bag alone: equal to the '
            'option files in it, to the last digit.',
        )
    for warning in evaluation.warnings:
        yield Finding(False, f'{warning}.')


def planning_rows(evaluation: BagEvaluation, live: Live | None) -> dict[str, PlanningRow]:
    """Return the results of planning by the names of the plans: live ones where they are known."""
    if live is not None:
        return {row.action_set: row for row in live.planning}
    return {name: plan.row for name, plan in evaluation.named_plans.items()}


def _unready(evaluation: BagEvaluation) -> Iterator[Finding]:
    """Name the plans that use options whose criteria do not hold."""
    for name, plan in evaluation.named_plans.items():
        if unready := evaluation.unready(plan):
            listed = ', '.join(f'“{option}”' for option in unready)
            yield Finding(
                False,
                f'The plan with the action set {name} uses {listed}: the criteria do not hold, '
                'so what is learned may differ from what was meant.',
            )


def _execution(execution: Execution, *, sampled: bool) -> Finding:
    """Judge the episodes that were played live; failures are expected of a sampled plan."""
    count, good = execution.episodes, execution.successes
    share = Interval.of_share(np.arange(count) < good)
    limits = f' (95 % interval {share.low:.0%} to {share.high:.0%})' if count else ''
    return Finding(
        None if sampled else good == count > 0 and execution.fallbacks == 0,
        f'{good} of {count} episodes{limits} reached the end of the '
        f'{"game" if sampled else "task"}, with {counted(execution.fallbacks, "fallback")} to a '
        f'primitive action; their mean return is {number(execution.mean_return)}.',
    )


def _criteria(options: Sequence[OptionEvaluation]) -> Finding:
    if not options:
        return Finding(None, 'No option was learned.')
    blocks = [option.last.block for option in options]
    short = [option for option in options if not option.last.block.criteria_met]
    if not short:
        taught = ', '.join(
            f'“{block.name}” after {counted(block.n_demonstrations, "demonstration")}'
            for block in blocks
        )
        return Finding(True, f'Every option meets all three criteria: {taught}.')
    missing = '; '.join(f'“{each.last.block.name}” ({_unmet(each)})' for each in short)
    return Finding(
        False,
        f'{len(options) - len(short)} of {counted(len(options), "option")} meet all three '
        f'criteria. Not yet: {missing}.',
    )


def _unmet(option: OptionEvaluation) -> str:
    return ', '.join(
        f'{c.name} {c.verdict}'
        if not c.measurable
        else f'{c.name} {c.verdict}: at most {number(c.high)}, needs {c.threshold:g}'
        if c.undecided
        else f'{c.name} {number(c.value)}, needs {c.threshold:g}'
        for c in option.last.judgement.criteria
        if not c.met
    )


def _sampled_plans(rows: Mapping[str, PlanningRow]) -> Iterator[Finding]:
    """Describe plans whose returns are estimates."""
    for name, row in rows.items():
        yield Finding(
            None,
            f'The plan with the action set {name}, from {row.game_steps:,} game steps in '
            f'{row.seconds:.1f} s, has a mean return of {number(row.mean_return)} '
            f'({number(row.mean_return_low)} to {number(row.mean_return_high)}) in '
            f'{row.episodes:,} games.',
        )


def _exact_plans(evaluation: BagEvaluation, rows: Mapping[str, PlanningRow]) -> Iterator[Finding]:
    """Compare plans with options with the one of primitive actions, from the same start states."""
    primitive, plans = rows.get(PRIMITIVE), evaluation.named_plans
    for name, human in rows.items():
        if primitive is None or human.action_set != HUMAN:
            continue
        whose = f' ({name})' if name != HUMAN else ''
        if name in plans and PRIMITIVE in plans:
            totals = plans[PRIMITIVE].judged.totals, plans[name].judged.totals
            loss = Interval.of_difference(*totals)
            yield Finding(
                loss.at_most(ALLOWED * abs(primitive.mean_return or 0.0)),
                f'The plan with the learned options{whose} has a mean return of '
                f'{number(human.mean_return)}, that with primitive actions '
                f'{number(primitive.mean_return)}; from the same start states, the options '
                f'{_lost(loss)}.',
            )
        times = ' against '.join(
            f'{1e3 * row.seconds:.3g} ms in {counted(row.sweeps, "sweep")}'
            for row in (human, primitive)
        )
        yield Finding(
            None, f'Planning with the learned options{whose} took {times} with primitives.'
        )


def _lost(loss: Interval) -> str:
    """Return what is lost within each episode in words."""
    if loss.low == loss.high == 0.0:
        return 'lose nothing'
    words = {True: 'lose', False: 'gain', None: 'are not distinguishable: they lose'}
    sign = -1.0 if loss.above() is False else 1.0
    low, high = sorted((sign * loss.low, sign * loss.high))
    return f'{words[loss.above()]} {number(sign * loss.mean)} ({number(low)} to {number(high)})'


def _loss(topics: Sequence[TopicRow]) -> Finding:
    known = [topic for topic in topics if topic.lost is not None]
    lost = sum(topic.lost or 0 for topic in known)
    others = len(topics) - len(known)
    rest = f' Another {counted(others, "topic")} carry no numbers.' if others else ''
    if lost:
        where = ', '.join(topic.name for topic in known if topic.lost)
        return Finding(False, f'{counted(lost, "message")} lost, on {where}.{rest}')
    messages = sum(topic.messages for topic in known)
    return Finding(
        True,
        f'No message was lost: {messages:,} numbered messages on '
        f'{counted(len(known), "topic")}.{rest}',
    )


def _offline(live: Live, evaluation: BagEvaluation) -> Finding:
    if different := differences(live, evaluation):
        return Finding(False, f'Offline and live numbers differ: {"; ".join(different)}.')
    return Finding(
        True,
        'Learned and planned again from the bag alone, every number but seconds equals the live '
        'one to the last digit.',
    )


def games_findings(games: GamesEvaluation) -> Iterator[Finding]:
    """Yield the findings of a comparison in games."""
    for setting in games.settings:
        yield _scores(games, setting)
    if games.targets:
        planned = games.settings[0].largest(PLAN)
        target = max(games.targets)
        good = planned.score.at_least(target)
        verbs = {True: 'reaches', False: 'does not reach', None: 'is not distinguishable from'}
        where = f'a mean score of {target:,.0f} with {games.curve_setting}'
        yield Finding(good, f'“{planned.name}” {verbs[good]} {where}: {_limits(planned.score)}.')
    for target in games.targets:
        yield _time(games.curves, target)


def _scores(games: GamesEvaluation, setting: Setting) -> Finding:
    """Compare the plan with all options with random choice among them, game by game."""
    planned, gain = setting.largest(PLAN), setting.gain
    where = f'With {setting.name}, ' if setting.name else ''
    words = {True: 'more than', False: 'less than', None: 'not distinguishable from'}
    text = (
        f'{where}“{planned.name}” scores {_limits(planned.score)} in {games.games:,} games, '
        f'{words[gain.above()]} random choice among the same options: the difference is '
        f'{_limits(gain)}.{_share(setting)}{_best(setting, planned)}'
    )
    judged = bool(games.targets) and setting.name == games.curve_setting
    return Finding(gain.at_least(MARGIN) if judged else None, text)


def _share(setting: Setting) -> str:
    """Return how much of the score of the plan the options bring by themselves."""
    planned, chosen = (setting.largest(kind).scores.mean() for kind in (PLAN, RANDOM))
    if planned <= 0 or chosen < 0:
        return ''
    return f' Random choice has {chosen / planned:.0%} of the score of the plan.'


def _best(setting: Setting, planned: ComparisonRow) -> str:
    """Return what plays best, and whether it is known to play better than the plan."""
    best = max(setting.rows, key=lambda row: row.score.mean)
    if best is planned:
        return ''
    level = level_of_each(len(setting.rows) - 1)  # the best of all the others was taken
    better = Interval.of_difference(best.scores, planned.scores, level).above()
    doubt = '' if better else ', not distinguishable from it'
    return f' The highest mean is that of “{best.name}”: {best.score.mean:,.0f}{doubt}.'


def _limits(found: Interval) -> str:
    """Return a number of points with its interval."""
    return f'{found.mean:,.0f} ({found.low:,.0f} to {found.high:,.0f})'


def _time(curves: Sequence[Curve], target: float) -> Finding:
    """Judge whether options reached a score in a tenth of the time of primitive actions."""
    options, primitive = curves
    times = primitive.times_as_long(options, target)
    both = ', '.join(f'with {curve.name} {curve.reached(target)}' for curve in curves)
    text = f'Planning to a score of {target:,.0f} (the whole interval above it): {both}'
    if times is None:
        missed = options.rows[-1].score.at_least(target) is False
        return Finding(False if missed else None, f'{text}.')
    if primitive.seconds_to_reach(target) is None:
        long = f'more than {_times(times.low)} times as long'
    else:
        high = '' if math.isinf(times.high) else f', at most {_times(times.high)}'
        long = f'{_times(times.mean)} times as long (at least {_times(times.low)}{high})'
    good = times.at_least(TENFOLD)
    undecided = '; whether it takes ten times as long is not decided' if good is None else ''
    return Finding(good, f'{text}: {long}{undecided}.')


def _times(times: float) -> str:
    return f'{math.floor(times * 10) / 10:g}' if times < TENFOLD else f'{math.floor(times)}'
