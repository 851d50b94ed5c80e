"""
Planning in any domain: exact where its states can all be listed, from samples elsewhere.

``check_plan_request``, ``plan_in`` and ``judge_plan`` take domains and plans of both kinds. The
same request, options and seed always give the same numbers, seconds apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.library import taught_nothing
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import (
    HUMAN_AND_PRIMITIVE,
    ignore_progress,
    MACHINE,
    OF_MACHINES,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.errors import check_limits, NoOptionsError, PlanError
from humanopts_learner.planning.evaluate import episode_starts, Interval, play
from humanopts_learner.planning.plan import check_request, Clock, make_plan, Plan
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan, Sampling
from humanopts_learner.planning.sampled.state_abstraction import batch_games
from numpy.typing import NDArray

TOLERANCE, SAMPLED_TOLERANCE = 1e-8, 1e-3  # reward units
MAX_SWEEPS, GAME_STEPS = 10_000, 800_000

AnyPlan = Plan | SampledPlan
"""
Both have domain, action_set, gamma, names, first_fallback, solution, game_steps (0: exact),
table_seconds, model_seconds, sweep_seconds, and ``choose(state)``.
"""


@dataclass(frozen=True)
class PlanRequest:
    """The settings of a plan; a number of 0 means the default."""

    action_set: str  # one of ``ACTION_SETS``
    gamma: float = 0.0  # discount per primitive step; default: the domain's own
    tol: float = 0.0  # of the last sweep, reward units; default: 1e-8 exact, 1e-3 sampled
    max_sweeps: int = 0  # default: 10,000
    game_steps: int = 0  # sampled in all; default: 800,000. Exact models need none: always 0
    seed: int = 0  # of the samples

    def in_force(self, domain: Domain[Any]) -> 'PlanRequest':
        """Return the request with defaults filled in."""
        exact = is_enumerable(domain)
        return replace(
            self,
            gamma=self.gamma or domain.gamma,
            tol=self.tol or (TOLERANCE if exact else SAMPLED_TOLERANCE),
            max_sweeps=self.max_sweeps or MAX_SWEEPS,
            game_steps=0 if exact else self.game_steps or GAME_STEPS,
        )


@dataclass(frozen=True)
class Performance:
    """The results of a plan in episodes; intervals of a single episode have no bounds."""

    episodes: int
    total: Interval  # undiscounted return
    discounted: Interval
    fallbacks: int  # primitive actions because no option could start
    outcomes: Mapping[str, Interval]  # other results that the domain reports; exact: none


def select_options(
    options: Sequence[LearnedOption],
    action_set: str,
    participant: str = '',
    names: Sequence[str] = (),
) -> list[LearnedOption]:
    """
    Return the options to plan with, in the order given; none for the set ``primitive``.

    The sets ``automatic`` have the options of participants whose code begins with ``MACHINE``,
    the sets ``human`` those of all others.

    :param participant: who taught the options; empty: the only participant there is.
    :param names: of the options to plan with; empty: all.
    :raises PlanError: there are several participants and none is named, or a name is unknown.
    :raises NoOptionsError: the participant has none, and others have.
    """
    if action_set == PRIMITIVE:
        return []
    machine = action_set in OF_MACHINES
    kind = [option for option in options if option.participant.startswith(MACHINE) == machine]
    people = sorted({option.participant for option in kind})
    if not participant and len(people) > 1:
        raise PlanError(f'options are of several participants: name one of {", ".join(people)}')
    theirs = [option for option in kind if participant in ('', option.participant)]
    if people and not theirs:
        raise NoOptionsError(taught_nothing(participant, people))
    known = [option.name for option in theirs]
    unknown = [repr(name) for name in names if name not in known]
    if known and unknown:
        raise PlanError(f'no option {", ".join(unknown)}; there is {", ".join(map(repr, known))}')
    return [option for option in theirs if not names or option.name in names]


def check_plan_request(
    domain: Domain[Any], options: Sequence[LearnedOption], request: PlanRequest
) -> PlanRequest:
    """
    Check a request of ``plan_in``, without planning; return the request in force.

    :raises PlanError: it makes no sense; its subclasses say which part.
    """
    asked = request.in_force(domain)
    used = () if asked.action_set == PRIMITIVE else options
    check_request(domain, asked.action_set, used, asked.gamma)
    check_limits(asked.tol, asked.max_sweeps)
    if not is_enumerable(domain):
        batch_games(domain)
        if asked.game_steps < (fewest := Sampling().game_steps):
            raise PlanError(f'game_steps is {asked.game_steps}, and must be at least {fewest}')
    return asked


def plan_in(
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    request: PlanRequest,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> AnyPlan:
    """
    Plan with exact models where all states can be listed, and with sampled ones elsewhere.

    :param options: ignored in the set ``primitive``.
    :param progress: called with the stages tables, models and sweeps; models and sweeps alternate
        where they are sampled.
    :raises PlanError: as ``check_plan_request``.
    :raises PlanCanceled: from ``progress``.
    """
    asked = check_plan_request(domain, options, request)
    limits: Any = {'gamma': asked.gamma, 'tol': asked.tol, 'max_sweeps': asked.max_sweeps}
    watched: Any = {'progress': progress, 'clock': clock}
    if is_enumerable(domain):
        return make_plan(domain, asked.action_set, options, **limits, **watched)
    return make_sampled_plan(
        domain, asked.action_set, options, asked.game_steps, asked.seed, **limits, **watched
    )


def plan(
    domain: Domain[Any],
    options: Sequence[LearnedOption] = (),
    action_set: str = '',
    gamma: float = 0.0,
    max_sweeps: int = 0,
    game_steps: int = 0,
    seed: int = 0,
) -> AnyPlan:
    """
    Plan with options and primitive actions; ``plan_in`` with the settings that people change.

    :param action_set: one of ``ACTION_SETS``; empty: ``human+primitive``, or ``primitive``
        without options.
    :param gamma: discount per primitive step; 0: the domain's own.
    :param max_sweeps: of value iteration; 0: 10,000.
    :param game_steps: to be sampled, where states cannot all be listed; 0: 800,000.
    :param seed: of the samples.
    :return: the plan; its ``choose(state)`` says which option to run.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    """
    usual = HUMAN_AND_PRIMITIVE if options else PRIMITIVE
    request = PlanRequest(
        action_set or usual, gamma, max_sweeps=max_sweeps, game_steps=game_steps, seed=seed
    )
    return plan_in(domain, options, request)


def judge_plan(
    plan: AnyPlan, seed: int, episodes: int, progress: Progress | None = None
) -> Performance:
    """
    Play episodes by a plan in the real rules, each option run to its end.

    :param seed: of start states and chance.
    :param episodes: 1 or more.
    :param progress: called with the stage evaluation.
    :raises PlanError: the domain never cuts an episode off, or ``episodes`` is below 1.
    :raises PlanCanceled: from ``progress``.
    """
    if episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes')
    report = progress or ignore_progress
    if isinstance(plan, Plan):
        starts = episode_starts(plan.domain, seed, episodes, report)
        returns = play(plan, starts, seed=seed, progress=report)
    else:
        returns = plan.play(seed, episodes, progress=report)
    report('evaluation', 1.0, 0, math.nan)
    return Performance(
        episodes=episodes,
        total=_interval(returns.total),
        discounted=_interval(returns.discounted),
        fallbacks=int(returns.fallbacks.sum()),
        outcomes={name: _interval(values) for name, values in returns.outcomes.items()},
    )


def _interval(values: NDArray[Any]) -> Interval:
    """Return the mean of one or more values, with NaN for the bounds of one."""
    if len(values) > 1:
        return Interval.of(values)
    return Interval(float(values.mean()), math.nan, math.nan)
