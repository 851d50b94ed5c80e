"""The findings of a report: sentences that follow from its numbers."""

from collections.abc import Iterator, Mapping, Sequence
import math

from humanopts_learner.intervals import Interval
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
        yield from _sampled_plans(planning) if sampled else _exact_plans(planning)
    if topics:
        yield _loss(topics)
    if live is not None:
        yield _offline(live, evaluation)
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


def _execution(execution: Execution, *, sampled: bool) -> Finding:
    """Judge the episodes that were played live; failures are expected of a sampled plan."""
    good = execution.successes == execution.episodes > 0 and execution.fallbacks == 0
    return Finding(
        None if sampled else good,
        f'{execution.successes} of {execution.episodes} episodes reached the end of the '
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
        f'{c.name} {number(c.value)}, needs {c.threshold:g}'
        if c.measurable
        else f'{c.name} not yet measurable'
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


def _exact_plans(rows: Mapping[str, PlanningRow]) -> Iterator[Finding]:
    """Compare plans with options with the one of primitive actions."""
    primitive = rows.get(PRIMITIVE)
    for name, human in rows.items():
        if primitive is None or human.action_set != HUMAN:
            continue
        whose = f' ({name})' if name != HUMAN else ''
        if human.mean_return is not None and primitive.mean_return is not None:
            gap = primitive.mean_return - human.mean_return
            most = abs(primitive.mean_return)
            share = gap / most if most else float(gap != 0)
            way = 'below' if gap > 0 else 'above'
            compared = 'the same as' if gap == 0 else f'{abs(share):.1%} {way}'
            yield Finding(
                share <= 0.02,
                f'The plan with the learned options{whose} has a mean return of '
                f'{number(human.mean_return)}, {compared} that with primitive actions '
                f'({number(primitive.mean_return)}) from the same start states.',
            )
        times = ' against '.join(
            f'{1e3 * row.seconds:.3g} ms in {counted(row.sweeps, "sweep")}'
            for row in (human, primitive)
        )
        yield Finding(
            None, f'Planning with the learned options{whose} took {times} with primitives.'
        )


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


def reached(curve: Curve, target: float) -> str:
    """Return the planning time until a score was reached."""
    seconds = curve.seconds_to_reach(target)
    if seconds is None:
        return f'not reached in {curve.most_seconds:.1f} s'
    return f'in {seconds:.1f} s'


def games_findings(games: GamesEvaluation) -> Iterator[Finding]:
    """Yield the findings of a comparison in games."""
    for setting in games.settings:
        yield _scores(games, setting)
    if games.targets:
        planned = _largest(games.settings[0].rows, PLAN)
        target = max(games.targets)
        good = planned.score.mean >= target
        verb = 'reaches' if good else 'does not reach'
        where = f'a mean score of {target:,.0f} with {games.curve_setting}'
        yield Finding(good, f'“{planned.name}” {verb} {where}.')
    for target in games.targets:
        yield _time(games.curves, target)


def _scores(games: GamesEvaluation, setting: Setting) -> Finding:
    """Compare the plan with all options with random choice among them."""
    planned, chance = (_largest(setting.rows, kind) for kind in (PLAN, RANDOM))
    gap = planned.score.mean - chance.score.mean
    half = math.hypot(_half(planned.score), _half(chance.score))  # of independent means
    where = f'With {setting.name}, ' if setting.name else ''
    best = max(setting.rows, key=lambda row: row.score.mean)
    others = f' The best of all is “{best.name}” with {best.score.mean:,.0f}.'
    text = (
        f'{where}“{planned.name}” scores {planned.score.mean:,.0f} ± {_half(planned.score):,.0f} '
        f'in {games.games:,} games: {abs(gap):,.0f} ± {half:,.0f} '
        f'{"more" if gap >= 0 else "less"} than random choice among the same options.'
        f'{others if best is not planned else ""}'
    )
    good = gap >= MARGIN if games.targets and setting.name == games.curve_setting else None
    return Finding(good, text)


def _half(found: Interval) -> float:
    """Return half the width of an interval."""
    return found.high - found.mean


def _time(curves: Sequence[Curve], target: float) -> Finding:
    """Judge whether options reached a score in a tenth of the time of primitive actions."""
    options, primitive = curves
    quick, slow = options.seconds_to_reach(target), primitive.seconds_to_reach(target)
    both = ', '.join(f'with {curve.name} {reached(curve, target)}' for curve in curves)
    text = f'Planning to a score of {target:,.0f} (the whole interval above it): {both}'
    if quick is None:
        return Finding(False, f'{text}.')
    times = (primitive.most_seconds if slow is None else slow) / quick
    if slow is None:
        good = True if times >= TENFOLD else None
        undecided = '' if good else '; whether it takes ten times as long is not decided'
        return Finding(good, f'{text}: more than {_times(times)} times as long{undecided}.')
    return Finding(times >= TENFOLD, f'{text}: {_times(times)} times as long.')


def _times(times: float) -> str:
    return f'{math.floor(times * 10) / 10:g}' if times < TENFOLD else f'{math.floor(times)}'


def _largest(rows: Sequence[ComparisonRow], kind: str) -> ComparisonRow:
    """Return the row of the largest set of options, of one kind."""
    return max((row for row in rows if row.kind == kind), key=lambda row: len(row.options))
