"""
Score against planning time: the same protocol for every action set.

A plan is made from a budget of game steps and judged in new games. The budget is doubled until the
95 % interval of the mean score lies at or above the target, or the largest budget is spent, or
planning has taken as long as anyone wants to wait.
Planning seconds are those of one plan made from scratch, models counted; judging is not.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import Progress
from humanopts_learner.planning.evaluate import Interval
from humanopts_learner.planning.plan import Clock
from humanopts_learner.planning.sampled.columns import BatchOption
from humanopts_learner.planning.sampled.plan import make_sampled_plan, Sampling

OnRow = Callable[['CurveRow'], object]


@dataclass(frozen=True)
class CurveRow:
    """One plan, judged."""

    action_set: str
    budget_steps: int
    seconds: float  # of planning
    score: Interval
    n_states: int  # planning states that were visited


@dataclass(frozen=True)
class Budgets:
    """Budgets of game steps: the first, doubled while they are at most the largest."""

    first: int = 12_500
    largest: int = 25_600_000

    def __iter__(self) -> Iterator[int]:
        """Go through them."""
        budget = self.first
        while budget <= self.largest:
            yield budget
            budget *= 2


def planning_curve(
    domain: Domain[Any],
    action_set: str,
    options: Sequence[LearnedOption | BatchOption],
    target: float,
    seed: int,
    budgets: Budgets = Budgets(),
    episodes: int = 1000,
    how: Sampling = Sampling(),  # noqa: B008
    gamma: float | None = None,
    progress: Progress | None = None,
    on_row: OnRow | None = None,
    enough_seconds: float = math.inf,
    clock: Clock = time.perf_counter,
) -> list[CurveRow]:
    """
    Return a row for each budget, until the target is reached or the largest budget is spent.

    :param options: not looked at in the set ``primitive``.
    :param target: mean score.
    :param seed: of the plans, and of the games, which are drawn apart from them.
    :param gamma: as in ``make_sampled_plan``.
    :param on_row: told each row as it comes.
    :param enough_seconds: no larger budget is tried once a plan took so long.
    :raises PlanError: as ``make_sampled_plan``.
    :raises PlanCanceled: from ``progress``.
    """
    rows: list[CurveRow] = []
    for budget in budgets:
        plan = make_sampled_plan(
            domain,
            action_set,
            options,
            budget,
            seed,
            gamma,
            how,
            progress=progress,
            clock=clock,
        )
        score = Interval.of(plan.play(seed, episodes).total)
        row = CurveRow(action_set, budget, plan.seconds, score, len(plan.solution.values))
        rows.append(row)
        if on_row is not None:
            on_row(row)
        if score.low >= target or plan.seconds >= enough_seconds:
            break
    return rows


def seconds_to_reach(rows: Sequence[CurveRow], target: float) -> float | None:
    """Return the planning seconds of the first row that reaches a score; None: not reached."""
    return next((row.seconds for row in rows if row.score.low >= target), None)
