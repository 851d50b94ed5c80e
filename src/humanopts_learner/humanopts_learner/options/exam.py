"""
The exam of an option: runs that the person watched, all of which must be right.

Starts are drawn as the task draws them, so the share of right runs estimates that of all starts,
with the interval of Wilson (1927). After a failed exam, another one is taken, and passing one of
several by luck is more likely than passing a single one. So exam number k has more runs: it gives
the same lower limit at a confidence level of 1 - 0.05 / k**2. An option with exactly that share of
right runs (57 % if the first exam has 5) passes the first exam with a probability of 0.06, and any
of all its exams with a probability below 0.07.

The exam does not change the criteria that precede it: its runs are evidence for them only after a
further demonstration has made another version of the option.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

from humanopts_learner.demonstrations import Demonstration, judged, version_of
from humanopts_learner.summary import OptionSummary, share_right


@cache
def exam_length(first: int, failed: int) -> int:
    """
    Return the number of runs of an exam.

    :param first: number of runs of the first exam; 0: no exam.
    :param failed: number of exams failed earlier.
    """
    runs = first
    while share_right(runs, runs, failed).low < share_right(first, first, 0).low:
        runs += 1
    return runs


def before_exam(demonstrations: Sequence[Demonstration]) -> list[Demonstration]:
    """Return demonstrations and judged runs without those of the current version's exam."""
    version = version_of(demonstrations)
    return [demo for demo in demonstrations if not (demo.exam and demo.option_version == version)]


def with_verdicts(
    summary: OptionSummary, demonstrations: Sequence[Demonstration], first: int
) -> OptionSummary:
    """
    Return a summary with the person's verdicts on runs of the option.

    :param demonstrations: all demonstrations and judged runs of the option, none withdrawn.
    :param first: number of runs of the first exam; 0: no exam.
    """
    runs, version = judged(demonstrations), version_of(demonstrations)
    exam = [run for run in runs if run.exam]
    now = [run.right for run in exam if run.option_version == version]
    wrong = {run.option_version for run in exam if not run.right} - {version}
    return replace(
        summary,
        n_questions=len(runs) - len(exam),
        exam_right=sum(now),
        exam_runs=len(now),
        exam_needed=exam_length(first, len(wrong)),
        exams_failed=len(wrong),
    )
