"""
Planning in any domain: exact if its states can all be listed, otherwise from samples.

``make_plan`` and ``judge_plan`` accept domains and plans of both kinds. The same request, options
and seed always give the same numbers, except for durations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import time

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.intervals import Interval
from humanopts_learner.option import Option
from humanopts_learner.planning.exact_plan import (
    episode_starts,
    ExactPlan,
    make_exact_plan,
    play_plan,
)
from humanopts_learner.planning.request import (
    Clock,
    HUMAN_AND_PRIMITIVE,
    ignore_progress,
    PlanError,
    PlanRequest,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan, SampledPlan
from humanopts_learner.summary import PlanSummary

AnyPlan = ExactPlan | SampledPlan


def make_plan(
    domain: Domain,
    options: Sequence[Option],
    request: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> AnyPlan:
    """
    Plan with exact models if all states can be listed, and otherwise with sampled models.

    :param options: ignored in the set ``primitive``.
    :param progress: called with the stages tables, models and sweeps; models and sweeps alternate
        if models are sampled.
    :raises PlanError: as ``PlanRequest.resolved``.
    :raises PlanCanceled: from ``progress``.
    """
    if is_enumerable(domain):
        return make_exact_plan(domain, options, request, progress, clock)
    return make_sampled_plan(domain, options, request, progress, clock)


def plan(
    domain: Domain,
    options: Sequence[Option] = (),
    action_set: str = '',
    gamma: float = 0.0,
    max_sweeps: int = 0,
    game_steps: int = 0,
    seed: int = 0,
) -> AnyPlan:
    """
    Plan with options and primitive actions; ``make_plan`` with its most common settings.

    :param action_set: one of ``ACTION_SETS``; empty: ``human+primitive``, or ``primitive``
        without options.
    :param gamma: discount per primitive step; 0: the domain's own.
    :param max_sweeps: maximum number of sweeps of value iteration; 0: 10,000.
    :param game_steps: number of sampled steps, if states cannot all be listed; 0: 800,000, or
        10,000 in a replayed domain.
    :param seed: random seed of the samples.
    :return: the plan; its ``choose(state)`` returns the option to run.
    :raises PlanError: the plan cannot be made.
    """
    usual = HUMAN_AND_PRIMITIVE if options else PRIMITIVE
    request = PlanRequest(
        action_set or usual, gamma, max_sweeps=max_sweeps, game_steps=game_steps, seed=seed
    )
    return make_plan(domain, options, request)


@dataclass(frozen=True)
class Performance:
    """The results of a plan in episodes; with a single episode, intervals have no limits."""

    episodes: int
    total: Interval  # undiscounted return
    discounted: Interval
    decisions: int  # number of options begun
    fallbacks: int  # primitive actions taken because no option could start
    random_moves: int  # moves taken because an option repeated itself
    outcomes: Mapping[str, Interval]  # other results reported by the domain; exact: none
    totals: Floats = field(compare=False, repr=False)  # (E,) undiscounted return per episode


def judge_plan(
    plan: AnyPlan, seed: int, episodes: int, progress: Progress = ignore_progress
) -> Performance:
    """
    Play episodes with a plan by the real rules, running each option to its end.

    :param seed: random seed of start states and chance.
    :param episodes: number of episodes, 1 or more.
    :param progress: called with the stage evaluation.
    :raises PlanError: the domain has no step limit, or ``episodes`` is below 1.
    :raises PlanCanceled: from ``progress``.
    """
    if episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes')
    if isinstance(plan, ExactPlan):
        starts = episode_starts(plan.domain, seed, episodes, progress)
        returns = play_plan(plan, starts, seed=seed, progress=progress)
    else:
        returns = plan.play(seed, episodes, progress=progress)
    progress('evaluation', 1.0, 0, math.nan)
    return Performance(
        episodes=episodes,
        total=Interval.of(returns.total),
        discounted=Interval.of(returns.discounted),
        decisions=int(returns.decisions.sum()),
        fallbacks=int(returns.fallbacks.sum()),
        random_moves=int(returns.random_moves.sum()),
        outcomes={name: Interval.of(values) for name, values in returns.outcomes.items()},
        totals=returns.total,
    )


def summarise_plan(plan: AnyPlan, judged: Performance | None = None) -> PlanSummary:
    """
    Return a summary of a plan.

    :param judged: results of evaluation episodes; None: not evaluated.
    """
    solution = plan.solution
    found = PlanSummary(
        action_set=plan.action_set,
        option_names=plan.names,
        gamma=plan.gamma,
        n_states=len(solution.values),
        game_steps=plan.game_steps,
        recorded_runs=plan.recorded_runs,
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=solution.sweeps,
        residual=solution.residual,
        converged=solution.converged,
    )
    if judged is None:
        return found
    return replace(
        found,
        evaluation_episodes=judged.episodes,
        mean_return=judged.total.mean,
        mean_return_low=judged.total.low,
        mean_return_high=judged.total.high,
        mean_discounted_return=judged.discounted.mean,
        fallbacks=judged.fallbacks,
        random_moves=judged.random_moves,
        outcomes=judged.outcomes,
    )
