"""
Ways to play compared in the real game, and the score of plans against planning time.

Baselines are plans, random choice among the options that can start, and a heuristic written by
hand where the domain has one; each plays as many games under the same rules.

The curve of score against planning time has the same protocol for every action set. A plan is made
from a budget of game steps and judged in new games. The budget is doubled until the 95 % interval
of the mean score lies at or above the target, or the largest budget is spent, or planning has
taken as long as anyone wants to wait. Planning seconds are those of one plan made from scratch,
models counted; judging is not.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import Baselines, HasBaselines
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_learner.planning.action_sets import HUMAN, Progress
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.errors import ForeignOptionError, PlanError
from humanopts_learner.planning.evaluate import Interval, Returns
from humanopts_learner.planning.plan import Clock
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.games import play_games
from humanopts_learner.planning.sampled.plan import make_sampled_plan, Sampling
from humanopts_learner.planning.sampled.policies import UniformPolicy
from humanopts_learner.planning.sampled.state_abstraction import batch_games, StateAbstraction
import numpy as np
from numpy.typing import NDArray

PLAN, RANDOM, HEURISTIC = 'plan', 'chance', 'rule'  # kinds of baseline, as in summary.json
Report = Callable[[str, float], object]  # called with the work under way and the share done
OnRow = Callable[['CurveRow'], object]


@dataclass(frozen=True)
class Baseline:
    """One way to play."""

    name: str
    kind: str  # PLAN, RANDOM or HEURISTIC
    action_set: str = HUMAN  # of PLAN and RANDOM
    options: Sequence[LearnedOption] = ()  # of PLAN and RANDOM
    budget_steps: int = 0  # game steps that the plan is made from
    gamma: float | None = None  # of the plan; None: the domain's own
    sampling: Sampling = field(default_factory=Sampling)  # of the plan
    execution: Execution = Execution.RUN_TO_END  # of the plan
    to_end: bool = True  # HEURISTIC: options run to their end; False: one is chosen at every step


@dataclass(frozen=True)
class ComparisonRow:
    """Results of one way to play."""

    name: str
    kind: str
    options: tuple[str, ...]  # names of the learned ones that it chooses among
    games: int
    score: Interval
    outcomes: Mapping[str, Interval]  # that the domain reports; shares, or means
    decisions: float | None = None  # options begun in a game, mean; None: not counted
    fallbacks: float | None = None  # decisions for a primitive action: no option could start
    game_steps: int = 0  # that planning sampled
    seconds: float | None = None  # of planning; None: nothing was planned


def compare(
    domain: Domain[Any],
    baselines: Sequence[Baseline],
    seed: int,
    games: int = 1000,
    progress: Report | None = None,
    clock: Clock = time.perf_counter,
) -> list[ComparisonRow]:
    """
    Return a row for each baseline, in order.

    :param seed: of the plans, and of the games, which are drawn independently.
    :param games: that each plays, two or more.
    :param progress: called as the work goes on; what it raises passes through.
    :raises PlanError: as ``make_sampled_plan``; or the domain has no rule written by hand.
    """
    match = _Match(domain, seed, games, clock)
    rows = []
    for number, baseline in enumerate(baselines):

        def report(share: float, name: str = baseline.name, before: int = number) -> None:
            if progress is not None:
                progress(name, (before + share) / len(baselines))

        report(0.0)
        rows.append(match.row(baseline, report))
    return rows


def baselines_of(domain: Domain[Any]) -> Baselines:
    """Return what plans are compared with in a domain; nothing where it does not say."""
    return domain.baselines() if isinstance(domain, HasBaselines) else Baselines()


def carried_over(option: LearnedOption, domain: Domain[Any]) -> LearnedOption:
    """
    Return an option that was learned in the same game with other parameters, for use in this one.

    :raises ForeignOptionError: another game, or its features or actions are others there.
    """
    moved = replace(option, domain_parameters=parameters_json(domain))
    try:
        moved.check_domain(domain)
    except OptionError as error:
        raise ForeignOptionError(str(error)) from error
    return moved


@dataclass(frozen=True)
class _Match:
    """The settings that all baselines share."""

    domain: Domain[Any]
    seed: int
    games: int
    clock: Clock

    def row(self, baseline: Baseline, report: Callable[[float], object]) -> ComparisonRow:
        """
        Have one baseline play.

        :param report: called with the share of its work that is done.
        """
        if baseline.kind == PLAN:
            return self._planned(baseline, report)
        if baseline.kind == RANDOM:
            return self._random(baseline)
        return self._heuristic(baseline)

    def _planned(self, baseline: Baseline, report: Callable[[float], object]) -> ComparisonRow:
        def progress(stage: str, fraction: float, sweeps: int, residual: float) -> None:
            if stage == 'models':
                report(0.8 * fraction)

        plan = make_sampled_plan(
            self.domain,
            baseline.action_set,
            baseline.options,
            baseline.budget_steps,
            self.seed,
            baseline.gamma,
            baseline.sampling,
            progress=progress,
            clock=self.clock,
            execution=baseline.execution,
        )
        row = _counted(baseline, plan.play(self.seed, self.games))
        return replace(row, game_steps=plan.game_steps, seconds=plan.seconds)

    def _random(self, baseline: Baseline) -> ComparisonRow:
        abstraction = StateAbstraction(batch_games(self.domain), baseline.action_set)
        actions = ActionSet(self.domain, baseline.action_set, baseline.options)
        policy, gamma = UniformPolicy(actions), self.domain.gamma
        returns = play_games(abstraction, actions, policy, gamma, self.seed, self.games)
        return _counted(baseline, returns)

    def _heuristic(self, baseline: Baseline) -> ComparisonRow:
        play = baselines_of(self.domain).heuristic
        if play is None:
            raise PlanError(f'{self.domain.name} has no rule that was written by hand')
        scores = play(self.games, self.seed, to_end=baseline.to_end)
        return _row(baseline, scores.total, scores.outcomes)


def _counted(baseline: Baseline, returns: Returns) -> ComparisonRow:
    decisions, fallbacks = float(returns.decisions.mean()), float(returns.fallbacks.mean())
    row = _row(baseline, returns.total, returns.outcomes)
    return replace(row, decisions=decisions, fallbacks=fallbacks)


def _row(
    baseline: Baseline, total: NDArray[Any], outcomes: Mapping[str, NDArray[Any]]
) -> ComparisonRow:
    return ComparisonRow(
        name=baseline.name,
        kind=baseline.kind,
        options=tuple(option.name for option in baseline.options),
        games=len(total),
        score=Interval.of(total),
        outcomes={
            name: Interval.of_share(values) if values.dtype == np.bool_ else Interval.of(values)
            for name, values in outcomes.items()
        },
    )


@dataclass(frozen=True)
class CurveRow:
    """One plan and its score."""

    action_set: str
    budget_steps: int
    seconds: float  # of planning
    score: Interval
    n_states: int  # abstract states that were visited


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
    options: Sequence[LearnedOption],
    target: float,
    seed: int,
    budgets: Budgets = Budgets(),
    episodes: int = 1000,
    sampling: Sampling = Sampling(),  # noqa: B008
    gamma: float | None = None,
    progress: Progress | None = None,
    on_row: OnRow | None = None,
    enough_seconds: float = math.inf,
    clock: Clock = time.perf_counter,
) -> list[CurveRow]:
    """
    Return a row for each budget, until the target is reached or the largest budget is spent.

    :param options: ignored in the set ``primitive``.
    :param target: mean score.
    :param seed: of the plans, and of the games, which are drawn independently.
    :param gamma: as in ``make_sampled_plan``.
    :param on_row: called with each row as it comes.
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
            sampling,
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
