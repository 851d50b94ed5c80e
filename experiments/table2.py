"""
Table 2: what planning with each action set takes and achieves (sections 7.3 and 8).

One trial is whose options are planned with: one person's, those of one extraction, or none. They
are made once, in the usual game, and planned with by every variant that they belong to. Where
models are exact, there is nothing to search for, and every start state is played; where they are
sampled, a search that is equally long for all variants comes first, and then fresh seeds.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.pacman.baselines import INTERRUPTED
from humanopts_env.domains.pacman.baselines import PRIMITIVE as PRIMITIVE_SETTINGS
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.options.option import LearnedOption, option_tables
from humanopts_learner.planning.action_sets import (
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PRIMITIVE,
    TabledOption,
)
from humanopts_learner.planning.any_domain import AnyPlan, MAX_SWEEPS
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.evaluate import play, Returns
from humanopts_learner.planning.interruption import as_executed, policy_values
from humanopts_learner.planning.plan import Plan, plan_with_tables
from humanopts_learner.planning.sampled.action_set import BatchOption
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan, Sampling
from humanopts_teach.evaluation.comparison import carried_over
import numpy as np
from numpy.typing import NDArray

from experiments import paper
from experiments.people import options_of, Study, teachers
from experiments.trials import Trial

NAME = 'table2'
NOBODY, PERSON, MACHINE = 'nobody', 'person', 'machine'  # whose options
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')
CLOCK = time.process_time
REPEATS = 7  # makings of one exact plan, for its seconds
COSTS = {  # of a trial, about seconds, by domain and whose options
    ('pacman', NOBODY): 45.0,
    ('pacman', PERSON): 180.0,
    ('pacman', MACHINE): 65.0,
    ('taxi', PERSON): 5.0,
    ('taxi', MACHINE): 4.0,
}


@dataclass(frozen=True)
class ComparedGame:
    """One game in which all variants are compared."""

    name: str
    domain: str
    exact: bool  # models; else they are sampled
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Variant:
    """What is planned with, and how the policy is executed: a row of the table."""

    name: str
    whose: str  # options
    action_set: str
    execution: Execution = Execution.RUN_TO_END
    of_section_7: bool = False  # only options that the paper's participants taught


TAXI = ComparedGame('Taxi', 'taxi', exact=True)
UNIFORM = ComparedGame('Pac-Man, random ghosts', 'pacman', exact=False)
CHASE = ComparedGame(
    'Pac-Man, chasing ghosts', 'pacman', exact=False, parameters={'ghosts': 'chase'}
)
GAMES = (TAXI, UNIFORM, CHASE)

TO_END = Variant('human', PERSON, HUMAN)
VARIANTS = (
    Variant('primitive', NOBODY, PRIMITIVE),
    TO_END,
    Variant(AS_IN_PAPER, PERSON, HUMAN, of_section_7=True),
    Variant('automatic', MACHINE, AUTOMATIC),
    Variant('human + primitive', PERSON, HUMAN_AND_PRIMITIVE),
    Variant('automatic + primitive', MACHINE, AUTOMATIC_AND_PRIMITIVE),
    Variant('human, interrupted', PERSON, HUMAN, Execution.INTERRUPTED),
    Variant('human, modular (greatest mass)', PERSON, HUMAN, Execution.MODULAR_MASS),
    Variant('human, modular (strongest)', PERSON, HUMAN, Execution.MODULAR_STRONGEST),
)
INTERRUPTING = tuple(v for v in VARIANTS if v.execution is not Execution.RUN_TO_END)


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

    def steps(self, variant: Variant) -> tuple[int, int]:
        """Return the game steps of a plan in the search, and of one in the table."""
        if variant.action_set == PRIMITIVE:
            return self.primitive_search_steps, self.primitive_largest
        return self.search_steps, self.largest

    def budgets(self, variant: Variant) -> Iterator[int]:
        """Yield the game steps of the points of the curve."""
        budget = self.first
        while budget <= self.steps(variant)[1]:
            yield budget
            budget *= 2


EFFORT = Effort()


def trials(study: Study) -> list[Trial]:
    """Return one trial for each domain that is taught, and person, extraction, repetition."""
    found = []
    for domain in dict.fromkeys(game.domain for game in GAMES):
        people = teachers(study, domain)
        count = len(people)
        sources: dict[str, list[dict[str, Any]]] = {
            NOBODY: [{'number': number} for number in range(1, count + 1)],
            PERSON: [{'teacher': teacher} for teacher in people],
            MACHINE: [{'extraction': study.seed + number} for number in range(count)],
        }
        for whose, members in sources.items():
            for source in members:
                parameters = {
                    'domain': domain,
                    'plans': math.ceil(study.seeds / count),
                    'seed': study.seed,
                    'effort': asdict(EFFORT),
                    'whose': whose,
                    **source,
                }
                cost = COSTS.get((domain, whose), 1.0)
                found.append(Trial(NAME, parameters, plan_all_games, cost))
    return found


def plan_all_games(parameters: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """
    Plan with every variant that some options belong to, in every game of their domain.

    :return: rows of tables: ``plans`` and ``curve`` (plans of smaller budgets), ``gains`` (what
        another execution of the same plan gains), ``settings`` that were chosen, and ``costs`` of
        the options.
    """
    effort, owned = Effort(**parameters['effort']), _options_by_variant(parameters)
    found: dict[str, list[dict[str, Any]]] = {
        'costs': [{'action set': variant.name, **options.cost} for variant, options in owned],
        **{name: [] for name in ('plans', 'curve', 'gains', 'settings')},
    }
    for game in GAMES:
        if game.domain != parameters['domain']:
            continue
        domain = make_domain(game.domain, game.parameters)
        asked = [(variant, _in_game(options.options, domain)) for variant, options in owned]
        if is_enumerable(domain):
            tables = plan_exactly(domain, asked, parameters['plans'])
        else:
            seed = _seed(parameters, game.name)
            tables = plan_from_samples(domain, asked, parameters['plans'], effort, seed)
        for name, rows in tables.items():
            found[name] += [{'game': game.name, **row} for row in rows]
    return found


def _in_game(options: Sequence[Any], domain: Any) -> list[Any]:
    """Return options for use in a game with other parameters than they were taught in."""
    return [
        carried_over(option, domain) if isinstance(option, LearnedOption) else option
        for option in options
    ]


@dataclass(frozen=True)
class OwnedOptions:
    """Options, and what it cost to get them; None: it is not of that kind."""

    options: Sequence[Any]  # as planning in the domain takes them
    demonstrations: int | None = None
    minutes: float | None = None  # of teaching
    seconds: float | None = None  # of a processor, for an extraction
    game_steps: int | None = None

    @property
    def cost(self) -> dict[str, Any]:
        """The cost as JSON data."""
        names = ('demonstrations', 'minutes', 'seconds', 'game_steps')
        return {'options': len(self.options), **{name: getattr(self, name) for name in names}}


def _options_by_variant(parameters: Mapping[str, Any]) -> list[tuple[Variant, OwnedOptions]]:
    """Return the variants of a trial, each with its options."""
    domain, whose = make_domain(parameters['domain']), parameters['whose']
    mine = [v for v in VARIANTS if v.whose == whose and not v.of_section_7]
    if whose == PERSON:
        return _taught(parameters['teacher'], domain, mine)
    owned = OwnedOptions(())
    if whose == MACHINE:
        found = find_options(domain, parameters['extraction'], clock=CLOCK)
        options = found.tabled if is_enumerable(domain) else found.batched
        owned = OwnedOptions(options, seconds=found.seconds, game_steps=found.game_steps)
    return [(variant, owned) for variant in mine]


def _taught(
    teacher: Mapping[str, Any], domain: Domain[Any], variants: Sequence[Variant]
) -> list[tuple[Variant, OwnedOptions]]:
    """Return variants with all that a person taught, and where that is more, with section 7's."""
    first = options_of(teacher, domain)
    paper_only = OwnedOptions(first.options, first.demonstrations, first.minutes)
    names = paper.ALSO_NAMED.get(domain.name, ())
    if not names or 'person' not in teacher:
        return [(variant, paper_only) for variant in variants]
    more = options_of(teacher, domain, names)
    everything = OwnedOptions(
        first.options + more.options,
        first.demonstrations + more.demonstrations,
        first.minutes + more.minutes,
    )
    of_section_7 = [(variant, paper_only) for variant in VARIANTS if variant.of_section_7]
    return [*((variant, everything) for variant in variants), *of_section_7]


def _seed(parameters: Mapping[str, Any], game: str) -> int:
    """Return a seed that differs between games, and between those whose options they are."""
    source = [str(parameters.get(name)) for name in ('number', 'teacher', 'extraction')]
    return int(generator(parameters['seed'], NAME, game, *source).integers(2**31))


def _record(budget: int, plan: AnyPlan, returns: Returns, done: NDArray[Any]) -> dict[str, Any]:
    """
    Return seconds, sizes and means of a plan and the games that it was judged in, as JSON data.

    :param budget: sweeps at most, or game steps.
    :param done: (E,) which games did what there is to do.
    """
    return {
        'budget': budget,
        **{name: getattr(plan, name) for name in SECONDS},
        'sweeps': plan.solution.sweeps,
        'states': len(plan.solution.values),
        'game_steps': plan.game_steps,
        'mean': float(returns.total.mean()),
        'discounted': float(returns.discounted.mean()),
        'done': float(done.mean()),
        'fallbacks': float(returns.fallbacks.mean()),
        'games': len(returns.total),
    }


# Exact models.

ExactOptions = Sequence[LearnedOption | TabledOption]


def plan_exactly(
    domain: EnumerableDomain[Any], asked: Sequence[tuple[Variant, ExactOptions]], plans: int
) -> dict[str, list[dict[str, Any]]]:
    """
    Plan with each variant and its options.

    :param plans: how often the same plan is made, for its seconds.
    :return: rows of plans, of the curve (one for each number of sweeps, doubled until converged),
        and of the gains by state.
    """
    domain.feature_table()  # built once for all plans, so it does not count as their time
    _exact_plan(domain, *asked[0])  # nor does what the first plan imports
    return {
        'curve': [
            {'action set': variant.name, **record}
            for variant, options in asked
            for record in _exact_curve(domain, variant, options)
        ],
        'plans': [
            {
                'action set': variant.name,
                **_judged_exactly(MAX_SWEEPS, *_timed(domain, variant, options)),
            }
            for variant, options in asked
            for _ in range(plans)
        ],
        'gains': [
            {'carried out as': variant.name, **_gain_by_state(domain, variant, options)}
            for variant, options in asked
            if variant in INTERRUPTING
        ],
    }


def _timed(
    domain: EnumerableDomain[Any],
    variant: Variant,
    options: ExactOptions,
    max_sweeps: int = MAX_SWEEPS,
) -> tuple[Plan, Plan]:
    """Make a plan several times, since it takes hardly any; return that of the median seconds."""
    made = [_exact_plan(domain, variant, options, max_sweeps) for _ in range(REPEATS)]
    return sorted(made, key=lambda pair: sum(getattr(pair[0], name) for name in SECONDS))[
        REPEATS // 2
    ]


def _exact_plan(
    domain: EnumerableDomain[Any],
    variant: Variant,
    options: ExactOptions,
    max_sweeps: int = MAX_SWEEPS,
) -> tuple[Plan, Plan]:
    """Return a plan, with all its seconds, and the one that executes it."""
    began = CLOCK()
    tabled = [_tabled(option, domain) for option in options]
    limits: Any = {'max_sweeps': max_sweeps, 'clock': CLOCK, 'table_seconds': CLOCK() - began}
    plan = plan_with_tables(domain, variant.action_set, tabled, domain.gamma, **limits)
    began = CLOCK()
    executed = as_executed(plan, variant.execution)
    return replace(plan, model_seconds=plan.model_seconds + CLOCK() - began), executed


def _tabled(option: LearnedOption | TabledOption, domain: EnumerableDomain[Any]) -> TabledOption:
    if isinstance(option, TabledOption):
        return option
    return TabledOption(option.name, option.max_steps, option_tables(option, domain))


def _judged_exactly(budget: int, plan: Plan, executed: Plan) -> dict[str, Any]:
    """Play from every start state, once."""
    returns = play(executed, plan.domain.start_states())
    return _record(budget, plan, returns, returns.successes)


def _exact_curve(
    domain: EnumerableDomain[Any], variant: Variant, options: ExactOptions
) -> list[dict[str, Any]]:
    """Judge plans of 1, 2, 4 ... sweeps, each made from scratch, until one has converged."""
    found: list[dict[str, Any]] = []
    converged, sweeps = False, 1
    while not converged and sweeps <= MAX_SWEEPS:
        plan, executed = _timed(domain, variant, options, sweeps)
        found.append(_judged_exactly(sweeps, plan, executed))
        converged, sweeps = plan.solution.converged, 2 * sweeps
    return found


def _gain_by_state(
    domain: EnumerableDomain[Any], variant: Variant, options: ExactOptions
) -> dict[str, float]:
    """Return how much more an execution is worth than running each option to its end."""
    plan, executed = _exact_plan(domain, variant, options)
    more = policy_values(executed) - policy_values(plan)
    return {'least': float(more.min()), 'most': float(more.max()), 'mean': float(np.mean(more))}


# Sampled models.

BatchOptions = Sequence[LearnedOption | BatchOption]


@dataclass(frozen=True)
class Setting:
    """One way to plan from samples."""

    gamma: float
    sampling: Sampling

    def to_dict(self) -> dict[str, float]:
        """Return as JSON data what differs between settings."""
        how = self.sampling
        return {
            'gamma': self.gamma,
            'rounds': how.rounds,
            'explore': how.explore,
            'min_samples': how.min_samples,
            'penalty': how.penalty,
            'pooling': how.shrinkage,
            'margin': how.interruption_margin,
        }


def settings_to_try(gamma: float, count: int) -> list[Setting]:
    """
    Return settings, the same for every variant; the first is the usual one.

    The second was found by hand with primitive actions, the third and fourth with the reference
    options, in either kind of ghosts; the last looks farther ahead.

    :param gamma: the domain's own.
    :param count: 1 to 5.
    """
    by_hand = [
        Setting(one.gamma, Sampling(**one.sampling))
        for one in (PRIMITIVE_SETTINGS, *INTERRUPTED.values())
    ]
    return [Setting(gamma, Sampling()), *by_hand, Setting(0.985, Sampling())][:count]


def plan_from_samples(
    domain: Domain[Any],
    asked: Sequence[tuple[Variant, BatchOptions]],
    plans: int,
    effort: Effort,
    seed: int,
) -> dict[str, list[dict[str, Any]]]:
    """
    Search with each variant and its options, then plan with what was best.

    :param plans: how many are made of the largest budget, each by random draws of its own.
    :param seed: of plans and games; those of the search are others.
    :return: rows of plans, of the curve (one for each budget), of the gains (one for each plan
        that runs options to their end), and of the settings that were chosen.
    """
    settings = settings_to_try(domain.gamma, effort.tried)
    names = ('plans', 'curve', 'gains', 'settings')
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for variant, options in asked:
        task = _SampledTask(domain, variant, options, effort, seed)
        named = {'action set': variant.name}
        few, most = effort.steps(variant)
        tried = [task.search(setting, few) for setting in settings]
        best = settings[int(np.argmax(tried))]
        *curve, last = [task.judge(best, budget, 0) for budget in effort.budgets(variant)]
        judged = [last, *(task.judge(best, most, number) for number in range(1, plans))]
        found['curve'] += [{**named, **one.record} for one in (*curve, last)]
        found['plans'] += [{**named, **one.record} for one in judged]
        found['settings'].append(
            {
                **named,
                **best.to_dict(),
                'return in the search': max(tried),
                'mean of all tried': float(np.mean(tried)),
            }
        )
        if variant == TO_END:
            found['gains'] += [
                {'carried out as': other.name, 'mean': task.gain(one, other.execution)}
                for other in INTERRUPTING
                for one in judged
            ]
    return found


@dataclass(frozen=True)
class _JudgedPlan:
    """A plan, and the games that it was judged in."""

    number: int
    budget: int
    plan: SampledPlan
    returns: Returns

    @property
    def record(self) -> dict[str, Any]:
        """What is kept of it."""
        return _record(self.budget, self.plan, self.returns, self.returns.outcomes['cleared'])


@dataclass(frozen=True)
class _SampledTask:
    """Planning and playing with one variant."""

    domain: Domain[Any]
    variant: Variant
    options: BatchOptions
    effort: Effort
    seed: int

    def search(self, setting: Setting, budget: int) -> float:
        """Return the mean return of a small plan in a few games."""
        seed = self._seed('search', 0)
        plan = self._plan(setting, budget, seed)
        return float(plan.play(seed, self.effort.search_games).total.mean())

    def judge(self, setting: Setting, budget: int, number: int) -> _JudgedPlan:
        """Make one of the plans that are judged, and play."""
        plan = self._plan(setting, budget, self._seed('plan', number))
        returns = plan.play(self._seed('games', number), self.effort.games, None)
        return _JudgedPlan(number, budget, plan, returns)

    def gain(self, one: _JudgedPlan, execution: Execution) -> float:
        """Return what is gained when the same plan is executed in another way."""
        returns = one.plan.play(self._seed('games', one.number), self.effort.games, execution)
        return float(returns.total.mean() - one.returns.total.mean())

    def _plan(self, setting: Setting, budget: int, seed: int) -> SampledPlan:
        return make_sampled_plan(
            self.domain,
            self.variant.action_set,
            self.options,
            budget,
            seed,
            setting.gamma,
            setting.sampling,
            clock=CLOCK,
            execution=self.variant.execution,
        )

    def _seed(self, purpose: str, number: int) -> int:
        return int(generator(self.seed, 'table 2', purpose, number).integers(2**31))
