"""Table 2 where models are sampled: a search that is equally long for all, then fresh seeds."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import PRIMITIVE
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.sampled.columns import BatchOption
from humanopts_learner.planning.sampled.curve import Budgets
from humanopts_learner.planning.sampled.judging import GameReturns
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan, Sampling
from humanopts_teach.experiments.table2_kinds import Kind, OTHER_WAYS
import numpy as np

Options = Sequence[LearnedOption | BatchOption]
GAMMAS = (0.95, 0.97, 0.985, 0.995)
CHOICES: dict[str, tuple[float, ...]] = {  # of ``Sampling``, that are tried
    'rounds': (4, 8),
    'explore': (0.1, 0.2),
    'penalty': (5.0, 15.0, 30.0),
    'pooling': (0.0, 100.0, 300.0),
    'margin': (10.0, 20.0, 40.0),
}


@dataclass(frozen=True)
class Effort:
    """How much is sampled and played; the same for every kind, but for the largest budget."""

    tried: int = 6  # settings
    search_steps: int = 50_000  # game steps that a plan is made from in the search
    search_games: int = 100
    first: int = 12_500  # game steps of the first point of the curve; then doubled
    largest: int = 200_000  # of the last one, and of the plans of the table
    largest_primitive: int = 1_600_000  # the same where there are no options
    games: int = 300  # that every plan is judged in

    def most(self, kind: Kind) -> int:
        """Return the game steps of the plans of the table."""
        return self.largest_primitive if kind.action_set == PRIMITIVE else self.largest


@dataclass(frozen=True)
class Setting:
    """One way to plan from samples."""

    gamma: float
    rounds: int
    explore: float
    penalty: float
    pooling: float
    margin: float

    @property
    def sampling(self) -> Sampling:
        """The same for planning."""
        known = {part.name: getattr(self, part.name) for part in fields(self)}
        del known['gamma']
        return Sampling(**known)


def drawn_settings(gamma: float, seed: int, count: int) -> list[Setting]:
    """Draw settings to try; the first is the usual one, with the domain's own ``gamma``."""
    usual, rng = Sampling(), generator(seed, 'table 2', 'settings')
    first = Setting(gamma, **{name: getattr(usual, name) for name in CHOICES})
    return [first, *(_setting(rng) for _ in range(count - 1))]


def _setting(rng: np.random.Generator) -> Setting:
    drawn: dict[str, Any] = {
        name: values[rng.integers(len(values))] for name, values in CHOICES.items()
    }
    return Setting(GAMMAS[rng.integers(len(GAMMAS))], **drawn)


def plan_from_samples(
    domain: Domain[Any],
    kinds: Sequence[Kind],
    options: Options,
    plans: int,
    effort: Effort,
    seed: int,
    settings_seed: int,
) -> dict[str, Any]:
    """
    Search, then plan with each kind.

    :param options: all of the same owner.
    :param plans: how many are made of the largest budget, each by chance of its own.
    :param seed: of plans and games; those of the search are others.
    :param settings_seed: of the settings to try.
    :return: by kind a curve (an entry for each budget), plans, and the search; and what each other
        way to carry out the same human plan gains, by plan.
    """
    settings = drawn_settings(domain.gamma, settings_seed, effort.tried)
    found: dict[str, Any] = {}
    gains: dict[str, list[float]] = {kind.name: [] for kind in kinds if kind in OTHER_WAYS}
    for kind in kinds:
        work = _Work(domain, kind, options, effort, seed)
        tried = [work.searched(setting) for setting in settings]
        best = settings[int(np.argmax(tried))]
        curve = [work.point(best, budget) for budget in Budgets(effort.first, effort.most(kind))]
        judged = []
        for number in range(plans):
            plan = work.plan(best, effort.most(kind), number)
            returns = work.play(plan, number)
            judged.append(_judged(plan, returns))
            if gains and kind.execution is Execution.RUN_TO_END and plan.first_fallback == len(options):
                for other in OTHER_WAYS:
                    more = work.play(plan, number, other.execution).total.mean()
                    gains[other.name].append(float(more - returns.total.mean()))
        found[kind.name] = {
            'curve': curve,
            'plans': judged,
            'tried': tried,
            'chosen': asdict(best),
        }
    return {'kinds': found, 'gains': gains}


@dataclass(frozen=True)
class _Work:
    """Planning and playing with one kind."""

    domain: Domain[Any]
    kind: Kind
    options: Options
    effort: Effort
    seed: int

    def searched(self, setting: Setting) -> float:
        """Return the mean return of a small plan in a few games."""
        seed = self._seed('search', 0)
        plan = self._made(setting, self.effort.search_steps, seed)
        return float(plan.play(seed, self.effort.search_games).total.mean())

    def point(self, setting: Setting, budget: int) -> dict[str, Any]:
        """Return one point of the curve."""
        plan = self.plan(setting, budget, 0)
        return {'budget': budget, **_judged(plan, self.play(plan, 0))}

    def plan(self, setting: Setting, budget: int, number: int) -> SampledPlan:
        """Return one of the plans that are judged."""
        return self._made(setting, budget, self._seed('plan', number))

    def play(
        self, plan: SampledPlan, number: int, execution: Execution | None = None
    ) -> GameReturns:
        """Play the games that a plan is judged in."""
        return plan.play(self._seed('games', number), self.effort.games, execution)

    def _made(self, setting: Setting, budget: int, seed: int) -> SampledPlan:
        return make_sampled_plan(
            self.domain,
            self.kind.action_set,
            self.options,
            budget,
            seed,
            setting.gamma,
            setting.sampling,
            clock=time.process_time,
            execution=self.kind.execution,
        )

    def _seed(self, purpose: str, number: int) -> int:
        return int(generator(self.seed, 'table 2', purpose, number).integers(2**31))


def _judged(plan: SampledPlan, returns: GameReturns) -> dict[str, Any]:
    return {
        'table_seconds': plan.table_seconds,
        'model_seconds': plan.model_seconds,
        'sweep_seconds': plan.sweep_seconds,
        'sweeps': plan.solution.sweeps,
        'states': len(plan.solution.values),
        'game_steps': plan.game_steps,
        'mean': float(returns.total.mean()),
        'discounted': float(returns.discounted.mean()),
        'done': float(returns.outcomes['cleared'].mean()),
        'fallbacks': float(returns.fallbacks.mean()),
        'games': len(returns.total),
    }
