"""The findings of a report: sentences that follow from its numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

from humanopts_learner.planning.action_sets import HUMAN, PRIMITIVE
from humanopts_learner.planning.evaluate import Interval
from humanopts_teach.evaluation.bag_evaluation import OptionEvaluation
from humanopts_teach.evaluation.comparison import ComparisonRow, PLAN, RANDOM
from humanopts_teach.evaluation.games import Curve, GamesEvaluation, Setting, TENFOLD
from humanopts_teach.evaluation.summary import (
    differences,
    Execution,
    plan_differences,
    PlanningRow,
)
from humanopts_teach.report.data import ReportData, TopicRow

DASH = '\N{EN DASH}'  # no number
MARGIN = 80.0  # points by which a plan shall be better than random choice among its options


@dataclass(frozen=True)
class Finding:
    """One sentence, and whether it is a good result; None: neither good nor bad."""

    good: bool | None
    text: str

    @property
    def mark(self) -> str:
        """A tick, a cross or a dot."""
        return {True: '✓', False: '✗', None: '·'}[self.good]


def findings(data: ReportData, games: Sequence[Finding] = ()) -> list[Finding]:
    """
    Return the findings of a report, the most important first.

    :param games: what came out in many games.
    """
    found = [_criteria(data.evaluation.options), *games]
    planning = planning_rows(data)
    sampled = any(row.game_steps for row in planning.values())
    if data.summary is not None:
        found.append(_execution(data.summary.execution, sampled=sampled))
    if not games:
        found += _planning_sampled(planning) if sampled else _planning(planning)
    if data.topics:
        found.append(_loss(data.topics))
    if data.summary is not None:
        found.append(_offline(data))
    found += _reproduced(data.evaluation.options)
    return [*found, *(Finding(False, text + '.') for text in data.evaluation.warnings)]


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
    short = [option for option in options if not option.block.criteria_met]
    taught = ', '.join(
        f'“{o.block.name}” after {counted(o.block.n_demonstrations, "demonstration")}'
        for o in options
    )
    if not short:
        return Finding(True, f'Every option meets all three criteria: {taught}.')
    missing = '; '.join(f'“{o.block.name}” ({_unmet(o)})' for o in short)
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
        for c in option.judgement.criteria
        if not c.met
    )


def planning_rows(data: ReportData) -> dict[str, PlanningRow]:
    """Return what planning came to, live where it is known, by what each plan is called."""
    if data.summary is not None:
        return {row.action_set: row for row in data.summary.planning}
    return dict(zip(data.evaluation.plan_names, data.evaluation.planning))


def _planning(rows: Mapping[str, PlanningRow]) -> list[Finding]:
    if PRIMITIVE not in rows:
        return []
    planned = [pair for pair in rows.items() if pair[1].action_set == HUMAN]
    return [finding for name, row in planned for finding in _compare(name, row, rows[PRIMITIVE])]


def _planning_sampled(rows: Mapping[str, PlanningRow]) -> list[Finding]:
    """Describe plans whose returns are estimates."""
    return [
        Finding(
            None,
            f'The plan with the action set {name}, from {row.game_steps:,} game steps in '
            f'{row.seconds:.1f} s, has a mean return of {number(row.mean_return)} '
            f'({number(row.mean_return_low)} to {number(row.mean_return_high)}) in '
            f'{row.episodes:,} games.',
        )
        for name, row in rows.items()
    ]


def _compare(name: str, human: PlanningRow, primitive: PlanningRow) -> list[Finding]:
    whose = f' ({name})' if name != HUMAN else ''
    times = ' against '.join(
        f'{1e3 * r.seconds:.3g} ms in {counted(r.sweeps, "sweep")}' for r in (human, primitive)
    )
    found = [
        Finding(None, f'Planning with the learned options{whose} took {times} with primitives.')
    ]
    if human.mean_return is None or primitive.mean_return is None:
        return found
    gap = primitive.mean_return - human.mean_return
    share = gap / abs(primitive.mean_return) if primitive.mean_return else float(gap != 0)
    compared = 'the same as' if gap == 0 else f'{abs(share):.1%} {"below" if gap > 0 else "above"}'
    text = (
        f'The plan with the learned options{whose} has a mean return of '
        f'{number(human.mean_return)}, {compared} that with primitive actions '
        f'({number(primitive.mean_return)}) from the same start states.'
    )
    return [Finding(share <= 0.02, text), *found]


def _loss(topics: Sequence[TopicRow]) -> Finding:
    known = [topic for topic in topics if topic.lost is not None]
    lost = sum(topic.lost or 0 for topic in known)
    messages = sum(topic.messages for topic in known)
    others = len(topics) - len(known)
    rest = f' Another {counted(others, "topic")} carry no numbers.' if others else ''
    if lost:
        where = ', '.join(topic.name for topic in known if topic.lost)
        return Finding(False, f'{counted(lost, "message")} lost, on {where}.{rest}')
    return Finding(
        True,
        f'No message was lost: {messages:,} numbered messages on '
        f'{counted(len(known), "topic")}.{rest}',
    )


def _offline(data: ReportData) -> Finding:
    assert data.summary is not None
    summary = data.summary
    different = differences(summary.options, summary.offline)
    different += plan_differences(summary.planning, summary.offline_planning)
    if different:
        return Finding(False, 'Offline and live numbers differ: ' + '; '.join(different) + '.')
    return Finding(
        True,
        'Learned and planned again from the bag alone, every number but seconds equals the live '
        'one to the last digit.',
    )


def _reproduced(options: Sequence[OptionEvaluation]) -> list[Finding]:
    """Report that options equal their files in the bag; a warning reports one that does not."""
    compared = [option.reproduced for option in options if option.reproduced is not None]
    if not compared or not all(compared):
        return []
    text = f'{counted(len(compared), "option")} learned again from the bag alone: equal to the '
    return [Finding(True, f'{text}option files in it, to the last digit.')]


def reached(curve: Curve, target: float) -> str:
    """Return the planning time until a score was reached."""
    seconds = curve.seconds_to_reach(target)
    if seconds is None:
        return f'not reached in {curve.most_seconds:.1f} s'
    return f'in {seconds:.1f} s'


def games_findings(games: GamesEvaluation) -> list[Finding]:
    """Return the findings of a comparison in games."""
    found = [_scores(games, setting) for setting in games.settings]
    planned = _largest(games.settings[0].rows, PLAN)
    found += _targets(games, planned)
    return [*found, *(_time(games.curves, target) for target in games.targets)]


def _scores(games: GamesEvaluation, setting: Setting) -> Finding:
    """Compare the plan with all options with random choice among them."""
    planned, chance = (_largest(setting.rows, kind) for kind in (PLAN, RANDOM))
    gap, half = _difference(planned.score, chance.score)
    where = f'With {setting.name}, ' if setting.name else ''
    best = max(setting.rows, key=lambda row: row.score.mean)
    others = f' The best of all is “{best.name}” with {best.score.mean:,.0f}.'
    text = (
        f'{where}“{planned.name}” scores {_written(planned.score)} in {games.games:,} games: '
        f'{abs(gap):,.0f} ± {half:,.0f} {"more" if gap >= 0 else "less"} than random choice among '
        'the same options.'
        f'{others if best is not planned else ""}'
    )
    good = gap >= MARGIN if games.targets and setting.name == games.curve_setting else None
    return Finding(good, text)


def _targets(games: GamesEvaluation, planned: ComparisonRow) -> list[Finding]:
    if not games.targets:
        return []
    target = max(games.targets)
    verb = 'reaches' if planned.score.mean >= target else 'does not reach'
    text = f'“{planned.name}” {verb} a mean score of {target:,.0f} with {games.curve_setting}.'
    return [Finding(planned.score.mean >= target, text)]


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


def _difference(one: Interval, other: Interval) -> tuple[float, float]:
    """Return the difference of two independent means, and half its 95 % interval."""
    half = math.hypot(one.high - one.mean, other.high - other.mean)
    return one.mean - other.mean, half


def _written(found: Interval) -> str:
    return f'{found.mean:,.0f} ± {found.high - found.mean:,.0f}'


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people; a dash where there is none."""
    if value is None or value != value:
        return DASH
    return f'{value:.{digits}g}'.replace('-', '\N{MINUS SIGN}')


def duration(seconds: float) -> str:
    """Return a time for people."""
    return f'{seconds:.1f} s' if seconds < 100 else f'{seconds / 60:.1f} min'


def counted(count: int, thing: str) -> str:
    """Return such as ``1 fallback`` or ``no fallbacks``."""
    return f'{count or "no"} {thing}{"" if count == 1 else "s"}'


def percent(value: float | None) -> str:
    """Return a share for people; a dash where there is none."""
    return DASH if value is None else f'{value:.1%}'.replace('.0%', '%')
