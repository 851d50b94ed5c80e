"""Table 2 where models are sampled: a search that is equally long for all, then fresh seeds."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.baselines import INTERRUPTED
from humanopts_env.domains.pacman.baselines import PRIMITIVE as PRIMITIVE_SETTINGS
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import PRIMITIVE
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.sampled.columns import BatchOption
from humanopts_learner.planning.sampled.curve import Budgets
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan, Sampling
import numpy as np

from experiments.table2_kinds import Kind, OTHER_WAYS, TO_END
from experiments.table2_record import record

Options = Sequence[LearnedOption | BatchOption]


@dataclass(frozen=True)
class Effort:
    """How much is sampled and played; with primitive actions alone more, as steps cost less."""

    tried: int = 5  # settings, at most
    search_games: int = 60
    search_steps: int = 50_000  # game steps that a plan is made from in the search
    largest: int = 200_000  # of the last point of the curve, and of the plans of the table
    primitive_search_steps: int = 200_000
    primitive_largest: int = 3_200_000
    first: int = 25_000  # of the first point of the curve; then doubled
    games: int = 150  # that every plan is judged in

    def steps(self, kind: Kind) -> tuple[int, int]:
        """Return the game steps of a plan in the search, and of one in the table."""
        if kind.action_set == PRIMITIVE:
            return self.primitive_search_steps, self.primitive_largest
        return self.search_steps, self.largest


@dataclass(frozen=True)
class Setting:
    """One way to plan from samples."""

    gamma: float
    rounds: int
    explore: float
    min_samples: int
    penalty: float
    pooling: float
    margin: float

    @property
    def sampling(self) -> Sampling:
        """The same for planning."""
        known = {part.name: getattr(self, part.name) for part in fields(self)}
        del known['gamma']
        return Sampling(**known)


def settings_to_try(gamma: float, count: int) -> list[Setting]:
    """
    Return settings, the same for every action set; the first is the usual one.

    The second was found by hand with primitive actions, the third and fourth with the reference
    options, in either kind of ghosts; the last looks farther ahead.

    :param gamma: the domain's own.
    :param count: 1 to 5.
    """
    usual = _parts(Sampling())
    settings = [
        Setting(gamma, **usual),
        *(
            Setting(by_hand.gamma, **_parts(Sampling(**by_hand.sampling)))
            for by_hand in (PRIMITIVE_SETTINGS, *INTERRUPTED.values())
        ),
        Setting(0.985, **usual),
    ]
    return settings[:count]


def _parts(sampling: Sampling) -> dict[str, Any]:
    """Return what a ``Setting`` has of it."""
    known = {part.name for part in fields(Setting)}
    return {name: value for name, value in asdict(sampling).items() if name in known}


def plan_from_samples(
    domain: Domain[Any],
    asked: Sequence[tuple[Kind, Options]],
    plans: int,
    effort: Effort,
    seed: int,
) -> dict[str, Any]:
    """
    Search with each kind and its options, then plan with what was best.

    :param plans: how many are made of the largest budget, each by chance of its own.
    :param seed: of plans and games; those of the search are others.
    :return: by kind a curve (an entry for each budget), plans, and the search; and what each other
        way to carry out the same human plan gains, by plan.
    """
    settings = settings_to_try(domain.gamma, effort.tried)
    found: dict[str, Any] = {}
    gains: dict[str, list[float]] = {}
    for kind, options in asked:
        work = _Work(domain, kind, options, effort, seed)
        few, most = effort.steps(kind)
        tried = [work.searched(setting, few) for setting in settings]
        best = settings[int(np.argmax(tried))]
        *curve, last = [work.judged(best, budget, 0) for budget in Budgets(effort.first, most)]
        judged = [last, *(work.judged(best, most, number) for number in range(1, plans))]
        found[kind.name] = {
            'curve': [*(one.record for one in curve), last.record],
            'plans': [one.record for one in judged],
            'tried': tried,
            'chosen': asdict(best),
        }
        if kind == TO_END:
            gains = {way.name: [work.gain(one, way) for one in judged] for way in OTHER_WAYS}
    return {'kinds': found, 'gains': gains}


@dataclass(frozen=True)
class _Judged:
    """A plan, and the games that it was judged in."""

    number: int
    budget: int
    plan: SampledPlan
    returns: Returns

    @property
    def record(self) -> dict[str, Any]:
        """What is kept of it."""
        done = self.returns.outcomes['cleared']
        return record(self.budget, self.plan, self.returns, done)


@dataclass(frozen=True)
class _Work:
    """Planning and playing with one kind."""

    domain: Domain[Any]
    kind: Kind
    options: Options
    effort: Effort
    seed: int

    def searched(self, setting: Setting, budget: int) -> float:
        """Return the mean return of a small plan in a few games."""
        seed = self._seed('search', 0)
        plan = self._made(setting, budget, seed)
        return float(plan.play(seed, self.effort.search_games).total.mean())

    def judged(self, setting: Setting, budget: int, number: int) -> _Judged:
        """Make one of the plans that are judged, and play."""
        plan = self._made(setting, budget, self._seed('plan', number))
        return _Judged(number, budget, plan, self._play(plan, number))

    def gain(self, one: _Judged, way: Kind) -> float:
        """Return what is gained when the same plan is carried out in another way."""
        returns = self._play(one.plan, one.number, way.execution)
        return float(returns.total.mean() - one.returns.total.mean())

    def _play(self, plan: SampledPlan, number: int, execution: Execution | None = None) -> Returns:
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
