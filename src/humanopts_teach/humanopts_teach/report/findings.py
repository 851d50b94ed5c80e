"""The findings of a report: sentences made from its numbers with the template findings.txt."""

from collections.abc import Sequence
from functools import cache
from itertools import combinations
import re
from typing import Any, TYPE_CHECKING

from humanopts_learner.intervals import Interval, level_of_each
from humanopts_teach.bags.info import TopicRow
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.games import gains
from humanopts_teach.evaluation.summary import differences, Live
from humanopts_teach.evaluation.tables import SECONDS
from humanopts_teach.report.pages import Finding, MARKS, MINUS, number, templates
import numpy as np

if TYPE_CHECKING:
    import pandas as pd  # slow to import

ALLOWED = 0.02  # maximum loss against primitive actions, share of the return


def findings(
    evaluation: BagEvaluation, live: Live | None = None, topics: Sequence[TopicRow] = ()
) -> list[Finding]:
    """
    Return the findings of a report, the most important first.

    :param live: numbers from the running graph; None: unknown.
    :param topics: topics of the bag; empty: unknown.
    """
    different = [] if live is None else differences(live, evaluation)
    plans = plans_by_name(plans_shown(evaluation, live))
    text = _words().all(evaluation, live, plans, topics, different)
    marks = {mark: good for good, mark in MARKS.items()}
    # A line that does not start with a mark continues the previous finding.
    _, *parts = re.split(rf'^([{"".join(marks)}]) ', text, flags=re.M)
    return [
        Finding(marks[mark], ' '.join(text.split())) for mark, text in zip(parts[::2], parts[1::2])
    ]


def plans_shown(evaluation: BagEvaluation, live: Live | None) -> 'pd.DataFrame':
    """Return the plans by name, columns ``PLANS``: live plans if known."""
    if live is None:
        return evaluation.plan_table
    return live.plans.set_axis([*live.plans['action_set']])


def plans_by_name(plans: 'pd.DataFrame') -> dict[str, Any]:
    """Return the rows of plans by name: columns and planning time (s) as attributes."""
    plans = plans.assign(seconds=plans[[*SECONDS]].sum(axis=1))
    return {str(row.Index): row for row in plans.itertuples()}


@cache
def _words() -> Any:
    """Return the macros of the template, with the functions they call."""
    known: dict[str, Any] = {
        'mark': MARKS.get,
        'difference': Interval.of_difference,
        'share_of': lambda good, count: Interval.of_share(np.arange(count) < good),
        'level_of_each': level_of_each,
        'pairs': lambda plans: list(combinations(plans, 2)),
        'lost': _lost,
        'gains': gains,
        'points': lambda mean, low, high: f'{mean:,.0f} ({low:,.0f} to {high:,.0f})'.replace(
            '-', MINUS
        ),
        'more': lambda row: Interval(row['mean'], row['low'], row['high']).above(),
        'ALLOWED': ALLOWED,
    }
    return templates(__package__).get_template('findings.txt', globals=known).module


def _lost(loss: Interval) -> str:
    """Describe a loss, paired by episode, in words."""
    if loss.low == loss.high == 0.0:
        return 'lose nothing'
    words = {True: 'lose', False: 'gain', None: 'are not distinguishable: they lose'}
    sign = -1.0 if loss.above() is False else 1.0
    low, high = sorted((sign * loss.low, sign * loss.high))
    return f'{words[loss.above()]} {number(sign * loss.mean)} ({number(low)} to {number(high)})'
