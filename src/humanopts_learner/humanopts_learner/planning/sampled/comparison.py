"""
Ways to play compared in the real game: under the same rules, each in as many games.

Beside plans there may be chance, which draws among what can start, and a rule that was written by
hand, where the domain has one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import Baselines, HasBaselines
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_learner.planning.action_sets import HUMAN
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.errors import ForeignOptionError, PlanError
from humanopts_learner.planning.evaluate import Interval, NORMAL_95, Returns
from humanopts_learner.planning.plan import Clock
from humanopts_learner.planning.sampled.columns import BatchOption, Columns, LearnedBatchOption
from humanopts_learner.planning.sampled.games import batch_games, Watcher
from humanopts_learner.planning.sampled.judging import play_games
from humanopts_learner.planning.sampled.plan import make_sampled_plan, Sampling
from humanopts_learner.planning.sampled.policies import UniformPolicy
import numpy as np
from numpy.typing import NDArray

PLAN, CHANCE, RULE = 'plan', 'chance', 'rule'
Tell = Callable[[str, float], object]  # what is under way, and the share of the whole that is done


@dataclass(frozen=True)
class Baseline:
    """One way to play."""

    name: str
    kind: str  # PLAN, CHANCE or RULE
    action_set: str = HUMAN  # of plan and chance
    options: Sequence[LearnedOption | BatchOption] = ()  # of plan and chance
    budget_steps: int = 0  # game steps that a plan is made from
    gamma: float | None = None  # of a plan; None: the domain's own
    how: Sampling = field(default_factory=Sampling)  # a plan's samples are drawn
    execution: Execution = Execution.RUN_TO_END  # of a plan
    to_end: bool = True  # a rule's option runs to its end; False: one is chosen at every step


@dataclass(frozen=True)
class ComparisonRow:
    """What one way to play came to."""

    name: str
    kind: str
    options: tuple[str, ...]  # names of the learned ones that it chooses among
    games: int
    score: Interval
    outcomes: Mapping[str, Interval]  # by what the domain tells of its games; shares, or means
    decisions: float | None = (
        None  # columns begun in a game, mean; None: not counted, as in a rule
    )
    fallbacks: float | None = None  # of these, primitive actions because no option could start
    game_steps: int = 0  # that planning sampled
    seconds: float | None = None  # of planning; None: nothing was planned


def compare(
    domain: Domain[Any],
    contenders: Sequence[Baseline],
    seed: int,
    games: int = 1000,
    progress: Tell | None = None,
    clock: Clock = time.perf_counter,
) -> list[ComparisonRow]:
    """
    Return a row for each contender, in order.

    :param seed: of the plans, and of the games, which are drawn apart from them.
    :param games: that each plays, two or more.
    :param progress: called as the work goes on; what it raises passes through.
    :raises PlanError: as ``make_sampled_plan``; or the domain has no rule written by hand.
    """
    match = _Match(domain, seed, games, clock)
    rows = []
    for number, contender in enumerate(contenders):

        def tell(share: float, name: str = contender.name, before: int = number) -> None:
            if progress is not None:
                progress(name, (before + share) / len(contenders))

        tell(0.0)
        rows.append(match.row(contender, tell))
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


def share_interval(values: NDArray[np.bool_]) -> Interval:
    """
    Return a share and its 95 % interval, which stays within 0 and 1 (Wilson 1927).

    :param values: (E,) one or more.
    """
    count, share = len(values), float(values.mean())
    z = NORMAL_95**2 / count
    centre = (share + z / 2) / (1 + z)
    half = float(np.sqrt(z * share * (1 - share) + z * z / 4)) / (1 + z)
    return Interval(share, max(centre - half, 0.0), min(centre + half, 1.0))


@dataclass(frozen=True)
class _Match:
    """What is the same for all contenders."""

    domain: Domain[Any]
    seed: int
    games: int
    clock: Clock

    def row(self, contender: Baseline, tell: Callable[[float], object]) -> ComparisonRow:
        """
        Have one contender play.

        :param tell: told the share of its work.
        """
        if contender.kind == PLAN:
            return self._planned(contender, tell)
        if contender.kind == CHANCE:
            return self._by_chance(contender)
        return self._by_rule(contender)

    def _planned(self, contender: Baseline, tell: Callable[[float], object]) -> ComparisonRow:
        def progress(stage: str, fraction: float, sweeps: int, residual: float) -> None:
            if stage == 'models':
                tell(0.8 * fraction)

        plan = make_sampled_plan(
            self.domain,
            contender.action_set,
            contender.options,
            contender.budget_steps,
            self.seed,
            contender.gamma,
            contender.how,
            progress=progress,
            clock=self.clock,
            execution=contender.execution,
        )
        row = _counted(contender, plan.play(self.seed, self.games))
        return replace(row, game_steps=plan.game_steps, seconds=plan.seconds)

    def _by_chance(self, contender: Baseline) -> ComparisonRow:
        batch = batch_games(self.domain)
        options = [
            LearnedBatchOption(o) if isinstance(o, LearnedOption) else o for o in contender.options
        ]
        columns, watch = Columns(batch, contender.action_set, options), Watcher(batch, fine=False)
        policy, gamma = UniformPolicy(columns), self.domain.gamma
        returns = play_games(watch, columns, policy, gamma, self.seed, self.games)
        return _counted(contender, returns)

    def _by_rule(self, contender: Baseline) -> ComparisonRow:
        play = baselines_of(self.domain).heuristic
        if play is None:
            raise PlanError(f'{self.domain.name} has no rule that was written by hand')
        scores = play(self.games, self.seed, to_end=contender.to_end)
        return _row(contender, scores.total, scores.outcomes)


def _counted(contender: Baseline, returns: Returns) -> ComparisonRow:
    decisions, fallbacks = float(returns.decisions.mean()), float(returns.fallbacks.mean())
    row = _row(contender, returns.total, returns.outcomes)
    return replace(row, decisions=decisions, fallbacks=fallbacks)


def _row(
    contender: Baseline, total: NDArray[Any], outcomes: Mapping[str, NDArray[Any]]
) -> ComparisonRow:
    return ComparisonRow(
        name=contender.name,
        kind=contender.kind,
        options=tuple(option.name for option in contender.options),
        games=len(total),
        score=Interval.of(total),
        outcomes={
            name: share_interval(values) if values.dtype == np.bool_ else Interval.of(values)
            for name, values in outcomes.items()
        },
    )
