"""
The plans of table 2: every action set and execution, in every game (sections 7.3 and 8).

One trial has one owner of options: a person, an extraction, or nobody. The options are made once,
in the usual game, and every variant of that kind of owner plans with them. Exact models have no
settings to search for, and the plans are played from every start state. Sampled models begin with
a search for settings, equally long for all variants, and are judged with other seeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.capabilities import HasBaselines
from humanopts_env.domains.registry import make_domain
from humanopts_env.games import TableGames
from humanopts_env.seeding import generator
from humanopts_learner.execution import play
from humanopts_learner.options.option import LearnedOption, TabularOption, tabulate
from humanopts_learner.planning.evaluate import AnyAvailable, play_plan, Returns
from humanopts_learner.planning.exact import ExactPlan, make_exact_plan, option_table
from humanopts_learner.planning.interruption import as_executed, policy_values
from humanopts_learner.planning.plan import AnyPlan
from humanopts_learner.planning.request import (
    Arbitration,
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    MAX_SWEEPS,
    PlanRequest,
    PRIMITIVE,
    Sampling,
)
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.plan import (
    make_sampled_plan,
    play_games,
)
from humanopts_learner.planning.sampled.policies import UniformPolicy
from humanopts_teach.evaluation.games import carried_over
from humanopts_teach.evaluation.tables import finite
import numpy as np
from numpy.typing import NDArray

from experiments import paper, people
from experiments.learners import FOREST, LEARNERS, NEIGHBOUR, with_cloned_policies

NAME = 'table2'
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man
# Options of a person: those that the paper's participants taught, those that it names too, and one
# more that it does not name. In Taxi also the first with policies by each of ``LEARNERS``.
SECTION_7, NAMED, ALSO_FRUIT = 'of section 7', 'named in the paper', 'the fruit too'
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')
REPEATS = 7  # makings of one exact plan, for its seconds


@dataclass(frozen=True)
class ComparedGame:
    """One game in which all variants are compared."""

    name: str
    domain: str
    exact: bool  # models; else they are sampled
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Variant:
    """A row of the table: the options and actions of a plan, and the execution of its policy."""

    name: str
    whose: str  # kind of owner of the options
    action_set: str
    line: str  # colour, line and marker, as matplotlib has them
    execution: Arbitration = Arbitration.RUN_TO_END
    options: str = NAMED  # of a person, in Pac-Man
    by_chance: bool = False  # nothing is planned: any option that can start, each alike


TAXI = ComparedGame('Taxi', 'taxi', exact=True)
UNIFORM = ComparedGame('Pac-Man, random ghosts', 'pacman', exact=False)
CHASE = ComparedGame(
    'Pac-Man, chasing ghosts', 'pacman', exact=False, parameters={'ghosts': 'chase'}
)
GAMES = (TAXI, UNIFORM, CHASE)

STOPPED, FIVE = Arbitration.INTERRUPTED, 'human, 5 options'
MASS_NAME = 'human, modular (greatest mass)'  # it may make a state worth less
MASS, STRONGEST = Arbitration.MODULAR_MASS, Arbitration.MODULAR_STRONGEST
TO_END = Variant('human', people.PERSON, HUMAN, 'C1-s')
BY_CHANCE = Variant(
    'random choice among human options', people.PERSON, HUMAN, 'C6:*', by_chance=True
)
VARIANTS = (
    Variant('primitive', people.NOBODY, PRIMITIVE, 'C0-o'),
    TO_END,
    Variant(AS_IN_PAPER, people.PERSON, HUMAN, 'C1:x', options=SECTION_7),
    Variant(FIVE, people.PERSON, HUMAN, 'C7-p', options=ALSO_FRUIT),
    Variant('automatic', people.MACHINE, AUTOMATIC, 'C2-^'),
    Variant('human + primitive', people.PERSON, HUMAN_AND_PRIMITIVE, 'C1--D'),
    Variant('automatic + primitive', people.MACHINE, AUTOMATIC_AND_PRIMITIVE, 'C2--v'),
    Variant('human, interrupted', people.PERSON, HUMAN, 'C3-P', STOPPED),
    Variant(f'{FIVE}, interrupted', people.PERSON, HUMAN, 'C8-h', STOPPED, ALSO_FRUIT),
    Variant(MASS_NAME, people.PERSON, HUMAN, 'C4-.<', MASS),
    Variant('human, modular (strongest)', people.PERSON, HUMAN, 'C5-.>', STRONGEST),
    Variant(f'human, {NEIGHBOUR}', people.PERSON, HUMAN, 'C7:1', options=NEIGHBOUR),  # in Taxi
    Variant(f'human, {FOREST}', people.PERSON, HUMAN, 'C8:2', options=FOREST),
    BY_CHANCE,
)
INTERRUPTING = tuple(  # other executions of the plan ``TO_END``
    v for v in VARIANTS if v.execution is not Arbitration.RUN_TO_END and v.options == NAMED
)


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

    def budgets(self, variant: Variant) -> list[int]:
        """Return the game steps of the points of the curve."""
        doublings = int(math.log2(self.steps(variant)[1] / self.first))
        return [self.first * 2**n for n in range(doublings + 1)]


EFFORT = Effort()


def plan_all_games(parameters: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """
    Plan with every variant that some options belong to, in every game of their domain.

    :return: rows of tables: ``plans`` and ``curve`` (plans of smaller budgets), ``gains`` (what
        another execution of the same plan gains), ``settings`` that were chosen, and ``costs`` of
        the options.
    """
    effort, plans = Effort(**parameters['effort']), parameters['plans']
    owned, costs = _options_by_variant(parameters), ('minutes', 'seconds', 'game_steps')
    names = ('plans', 'curve', 'gains', 'settings', 'costs')
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for variant, owner in owned:
        cost = {name: getattr(owner, name) for name in ('demonstrations', *costs)}
        row = {'action set': variant.name, 'options': len(owner.options), **cost}
        found['costs'].append(row)
    for game in GAMES:
        if game.domain != parameters['domain']:
            continue
        domain = make_domain(game.domain, game.parameters)
        seed = people.owner_seed(parameters, NAME, game.name)
        for variant, owner in owned:
            options = [  # for use with other parameters than they were taught with
                carried_over(option, domain) if isinstance(option, LearnedOption) else option
                for option in owner.options
            ]
            if variant.by_chance:
                tables = {'plans': choose_by_chance(domain, options, plans, effort, seed)}
            elif is_enumerable(domain):
                tables = plan_exactly(domain, variant, options, plans)
            else:
                tables = plan_from_samples(domain, variant, options, plans, effort, seed)
            for name, rows in tables.items():
                named = {} if name == 'gains' else {'action set': variant.name}
                found[name] += [{'game': game.name, **named, **row} for row in rows]
    return found


def _options_by_variant(
    parameters: Mapping[str, Any],
) -> list[tuple[Variant, people.OwnedOptions]]:
    """Return the variants of a trial, each with its options, without those that have no more."""
    domain, whose = make_domain(parameters['domain']), parameters['whose']
    owned = {NAMED: people.options_of(parameters, domain)}
    if domain.name in paper.ALSO_NAMED and 'person' in parameters.get('teacher', {}):
        owned[SECTION_7] = owned[NAMED]
        owned[NAMED] += people.options_of(parameters, domain, paper.ALSO_NAMED[domain.name])
        fruit = people.options_of(parameters, domain, paper.NOT_NAMED[domain.name])
        owned[ALSO_FRUIT] = owned[NAMED] + fruit
    if whose == people.PERSON and is_enumerable(domain):
        seed, by_trees = parameters['seed'], owned[NAMED]
        owned |= {each: with_cloned_policies(each, by_trees, domain, seed) for each in LEARNERS}
    return [
        (variant, owned[variant.options])
        for variant in VARIANTS
        if variant.whose == whose and variant.options in owned
    ]


def _record(
    budget: int, plan: AnyPlan | None, returns: Returns, done: NDArray[Any]
) -> dict[str, Any]:
    """
    Return seconds, sizes and means of a plan and the games that it was judged in, as JSON data.

    :param budget: sweeps at most, or game steps.
    :param plan: None: nothing was planned.
    :param done: (E,) which games did what there is to do.
    """
    return {
        'budget': budget,
        **{name: getattr(plan, name) if plan else 0.0 for name in SECONDS},
        'sweeps': plan.solution.sweeps if plan else 0,
        'states': len(plan.solution.values) if plan else 0,
        'game_steps': plan.game_steps if plan else 0,
        'mean': float(returns.total.mean()),
        'discounted': finite(returns.discounted.mean()),
        'done': float(done.mean()),
        'fallbacks': float(returns.fallbacks.mean()),
        'games': len(returns.total),
    }


def choose_by_chance(
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    plans: int,
    effort: Effort,
    seed: int,
) -> list[dict[str, Any]]:
    """
    Play as plans do, with random choice among the same options: what a plan has to beat.

    Wherever a choice is due, any option that can start is chosen, each with the same probability,
    and runs to its end. Where none can start, a primitive action is taken.

    :param plans: how often, with chance of its own each time.
    :return: rows as those of plans.
    """
    rows = []
    for number in range(plans):
        if is_enumerable(domain):
            rng = generator(seed, 'table 2', 'chance', number)
            returns = play_states_by_chance(domain, options, rng)
            done = returns.successes
        else:
            actions, games = ActionSet(domain, HUMAN, options), _seed_for(seed, 'games', number)
            policy = UniformPolicy(generator(seed, 'table 2', 'chance', number))
            returns = play_games(actions, policy, domain.gamma, games, effort.games)
            done = returns.outcomes['cleared']
        rows.append(_record(0, None, returns, done))
    return rows


def play_states_by_chance(
    domain: EnumerableDomain[Any],
    options: Sequence[LearnedOption | TabularOption],
    rng: np.random.Generator,
) -> Returns:
    """Play an episode from every start state of a domain in which every action has one outcome."""
    action_set = HUMAN if options else PRIMITIVE
    table = option_table(domain, action_set, [tabulate(option, domain) for option in options])
    games = TableGames(domain, domain.start_states().astype(np.intp))
    played = play(games, table, AnyAvailable(rng), rng, domain.max_steps, gamma=domain.gamma)
    return Returns.of(played, domain.gamma, len(options))


def _seed_for(seed: int, purpose: str, number: int = 0) -> int:
    return int(generator(seed, 'table 2', purpose, number).integers(2**31))


def plan_exactly(
    domain: EnumerableDomain[Any],
    variant: Variant,
    options: Sequence[LearnedOption | TabularOption],
    plans: int,
) -> dict[str, list[dict[str, Any]]]:
    """
    Plan with exact models, and play from every start state, once.

    :param plans: how often the same plan is made, for its seconds.
    :return: rows of plans, of the curve (one for each number of sweeps, doubled until converged),
        and of the gains by state.
    """

    def make(max_sweeps: int = MAX_SWEEPS) -> tuple[ExactPlan, ExactPlan]:
        """Return a plan, with all its seconds, and the one that executes it."""
        request = PlanRequest(variant.action_set, max_sweeps=max_sweeps)
        plan = make_exact_plan(domain, options, request, clock=people.CLOCK)
        began = people.CLOCK()
        executed = as_executed(plan, variant.execution)
        return replace(plan, model_seconds=plan.model_seconds + people.CLOCK() - began), executed

    def judge(max_sweeps: int = MAX_SWEEPS) -> tuple[ExactPlan, dict[str, Any]]:
        """Judge the plan of the median seconds of several, since one takes hardly any."""
        made = [make(max_sweeps) for _ in range(REPEATS)]
        made.sort(key=lambda pair: sum(getattr(pair[0], name) for name in SECONDS))
        plan, executed = made[REPEATS // 2]
        returns = play_plan(executed, domain.start_states())
        return plan, _record(max_sweeps, plan, returns, returns.successes)

    curve, converged, sweeps = [], False, 1
    while not converged and sweeps <= MAX_SWEEPS:
        plan, record = judge(sweeps)
        curve.append(record)
        converged, sweeps = plan.solution.converged, 2 * sweeps
    tables = {'curve': curve, 'plans': [judge()[1] for _ in range(plans)]}
    if variant in INTERRUPTING:
        plan, executed = make()
        more = policy_values(executed) - policy_values(plan)
        extremes = {'least': float(more.min()), 'most': float(more.max())}
        gain = {'carried out as': variant.name, **extremes, 'mean': float(np.mean(more))}
        tables['gains'] = [gain]
    return tables


def settings_to_try(variant: Variant, domain: Domain[Any], count: int) -> list[PlanRequest]:
    """
    Return requests without budgets, with the same settings for every variant.

    :param domain: its baselines say which columns primitive actions need.
    :param count: 1 to 5; the first are the usual settings.
    """
    settings: list[tuple[float, dict[str, Any]]] = [
        *((domain.gamma, {}), (0.985, {}), (0.95, {'rounds': 16})),
        *((0.985, {'min_samples': 2}), (0.985, {'interruption_margin': 30.0})),
    ]
    columns: tuple[str, ...] = ()
    if variant.action_set == PRIMITIVE and isinstance(domain, HasBaselines):
        columns = domain.baselines().primitive_columns
    return [
        PlanRequest(
            variant.action_set,
            gamma,
            sampling=Sampling(**how),
            columns=columns,
            execution=variant.execution,
        )
        for gamma, how in settings[:count]
    ]


def plan_from_samples(
    domain: Domain[Any],
    variant: Variant,
    options: Sequence[LearnedOption],
    plans: int,
    effort: Effort,
    seed: int,
) -> dict[str, list[dict[str, Any]]]:
    """
    Search for settings, then plan with the best.

    :param plans: how many are made of the largest budget, each by random draws of its own.
    :param seed: of plans and games; those of the search are others.
    :return: rows of plans, of the curve (one for each budget), of the gains (one for each plan
        that runs options to their end), and of the settings that were chosen.
    """
    few, most = effort.steps(variant)

    settings, search = (
        settings_to_try(variant, domain, effort.tried),
        _seed_for(seed, 'search'),
    )
    asked = [replace(one, game_steps=few, seed=search) for one in settings]
    candidates = [make_sampled_plan(domain, options, one) for one in asked]
    searched = [plan.play(search, effort.search_games) for plan in candidates]
    tried = [float(returns.total.mean()) for returns in searched]
    best = settings[int(np.argmax(tried))]

    budgets = [*effort.budgets(variant), *[most] * (plans - 1)]
    numbers = [0] * (len(budgets) - plans + 1) + list(range(1, plans))
    made = [  # one after another, since their seconds are results
        make_sampled_plan(
            domain,
            options,
            replace(best, game_steps=budget, seed=_seed_for(seed, 'plan', number)),
            clock=people.CLOCK,
        )
        for budget, number in zip(budgets, numbers)
    ]
    games = [_seed_for(seed, 'games', number) for number in numbers]
    played = [plan.play(one, effort.games) for plan, one in zip(made, games)]
    records = [
        _record(budget, plan, returns, returns.outcomes['cleared'])
        for budget, plan, returns in zip(budgets, made, played)
    ]
    again = [
        (other, plan, game, before)
        for other in INTERRUPTING
        if variant == TO_END
        for plan, game, before in zip(made[-plans:], games[-plans:], played[-plans:])
    ]
    stopped = [plan.play(game, effort.games, other.execution) for other, plan, game, _ in again]
    how = best.sampling
    setting = {
        'gamma': best.gamma,
        'rounds': how.rounds,
        'explore': how.explore,
        'min_samples': how.min_samples,
        'margin': how.interruption_margin,
        'return in the search': max(tried),
        'mean of all tried': float(np.mean(tried)),
    }
    return {
        'curve': records[: len(records) - plans + 1],
        'plans': records[-plans:],
        'settings': [setting],
        'gains': [
            {'carried out as': other.name, 'mean': float(now.total.mean() - then.total.mean())}
            for (other, _, _, then), now in zip(again, stopped)
        ],
    }
