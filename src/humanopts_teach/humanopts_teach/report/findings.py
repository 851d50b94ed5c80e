"""The findings of a report: sentences that follow from its numbers, worded in findings.txt."""

from collections.abc import Sequence
from functools import cache
from itertools import combinations
import math
import re
from typing import Any

from humanopts_learner.intervals import Interval, level_of_each
from humanopts_teach.bags.info import TopicRow
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.games import GamesEvaluation, TENFOLD
from humanopts_teach.evaluation.measures import PlanningRow
from humanopts_teach.evaluation.summary import differences, Live
from humanopts_teach.report.pages import counted, Finding, MARKS, number, templates
import numpy as np

ALLOWED = 0.02  # share of the return that options may lose against primitive actions
MARGIN = 80.0  # points by which a plan shall be better than random choice among its options


def findings(
    evaluation: BagEvaluation, live: Live | None = None, topics: Sequence[TopicRow] = ()
) -> list[Finding]:
    """
    Return the findings of a report, the most important first.

    :param live: what was seen while teaching; None: it is not known.
    :param topics: of the bag; none: they are not known.
    """
    different = [] if live is None else differences(live, evaluation)
    return _worded('all', evaluation, live, planning_rows(evaluation, live), topics, different)


def games_findings(games: GamesEvaluation) -> list[Finding]:
    """Return the findings of a comparison in games."""
    return _worded('games', games)


def planning_rows(evaluation: BagEvaluation, live: Live | None) -> dict[str, PlanningRow]:
    """Return the results of planning by the names of the plans: live ones where they are known."""
    if live is not None:
        return {row.action_set: row for row in live.planning}
    return {name: plan.row for name, plan in evaluation.named_plans.items()}


def _worded(macro: str, *values: Any) -> list[Finding]:
    """Return what a macro of the template says; a line that has no mark goes on with the last."""
    marks = {mark: good for good, mark in MARKS.items()}
    _, *parts = re.split(rf'^([{"".join(marks)}]) ', getattr(_words(), macro)(*values), flags=re.M)
    return [
        Finding(marks[mark], ' '.join(text.split())) for mark, text in zip(parts[::2], parts[1::2])
    ]


@cache
def _words() -> Any:
    """Return the macros of the template, with what they calculate by."""
    known: dict[str, Any] = {
        'counted': counted,
        'mark': MARKS.get,
        'difference': Interval.of_difference,
        'share_of': lambda good, count: Interval.of_share(np.arange(count) < good),
        'level_of_each': level_of_each,
        'pairs': lambda plans: list(combinations(plans, 2)),
        'lost': _lost,
        'points': lambda found: f'{found.mean:,.0f} ({found.low:,.0f} to {found.high:,.0f})',
        'times': _times,
        'ALLOWED': ALLOWED,
        'MARGIN': MARGIN,
        'TENFOLD': TENFOLD,
        'INFINITE': math.inf,
    }
    return templates(__package__).get_template('findings.txt', globals=known).module


def _lost(loss: Interval) -> str:
    """Return what is lost within each episode in words."""
    if loss.low == loss.high == 0.0:
        return 'lose nothing'
    words = {True: 'lose', False: 'gain', None: 'are not distinguishable: they lose'}
    sign = -1.0 if loss.above() is False else 1.0
    low, high = sorted((sign * loss.low, sign * loss.high))
    return f'{words[loss.above()]} {number(sign * loss.mean)} ({number(low)} to {number(high)})'


def _times(times: float) -> str:
    """Return so many times in words, never more than there are."""
    return f'{math.floor(times * 10) / 10:g}' if times < TENFOLD else f'{math.floor(times)}'
