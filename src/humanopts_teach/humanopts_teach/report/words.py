"""A report in a few sentences, worked out from its numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from humanopts_learner.planning.action_sets import HUMAN, PRIMITIVE
from humanopts_teach.evaluation.bag_evaluation import OptionEvaluation
from humanopts_teach.evaluation.summary import (
    differences,
    Execution,
    plan_differences,
    PlanningRow,
)
from humanopts_teach.report.data import ReportData, TopicRow

DASH = '\N{EN DASH}'  # no number


@dataclass(frozen=True)
class Finding:
    """One sentence, and whether it is as one would wish; None: neither."""

    good: bool | None
    text: str

    @property
    def mark(self) -> str:
        """A character that says the same."""
        return {True: '✓', False: '✗', None: '·'}[self.good]


def findings(data: ReportData, games: Sequence[Finding] = ()) -> list[Finding]:
    """
    Return what the report comes to, the most important first.

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
    """Say how the episodes went that were played live; to fail is no fault of a sampled plan."""
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
    """Say what plans came to that are estimates."""
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
    """Say that options equal their files in the bag; where one does not, a warning says so."""
    compared = [option.reproduced for option in options if option.reproduced is not None]
    if not compared or not all(compared):
        return []
    text = f'{counted(len(compared), "option")} learned again from the bag alone: equal to the '
    return [Finding(True, f'{text}option files in it, to the last digit.')]


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
