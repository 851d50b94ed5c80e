"""
The plans of table 2: action sets and executions, in every game (sections 7.3 and 8).

One trial has one owner of options: a person, an extraction, or nobody. The options are made once,
in the usual game, and every variant of that kind of owner plans with them. Plans with exact models
are played from every start state; those with sampled models in new games.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.registry import make_domain
from humanopts_env.games import TableGames
from humanopts_env.seeding import generator
from humanopts_learner.execution import play
from humanopts_learner.options.learned_option import LearnedOption, TabularOption, tabulate
from humanopts_learner.planning.action_set import ActionSet
from humanopts_learner.planning.evaluate import AnyAvailable, play_plan, Returns
from humanopts_learner.planning.exact_plan import make_exact_plan, option_table
from humanopts_learner.planning.interruption import as_executed
from humanopts_learner.planning.plan import AnyPlan
from humanopts_learner.planning.request import (
    Arbitration,
    AUTOMATIC,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    MAX_SWEEPS,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan, play_games
from humanopts_learner.planning.sampled_policies import UniformPolicy
from humanopts_teach.evaluation.games import carried_over
from humanopts_teach.evaluation.tables import finite, SECONDS
import numpy as np
from numpy.typing import NDArray

from experiments import paper, people

NAME = 'table2'
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man
# Options of a person: those that the paper's participants taught, those that it names too, and one
# more that it does not name.
SECTION_7, NAMED, ALSO_FRUIT = 'of section 7', 'named in the paper', 'the fruit too'
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

STOPPED, INTERRUPTED = Arbitration.INTERRUPTED, 'human, interrupted'
BY_CHANCE = 'random choice among human options'
VARIANTS = (
    Variant('primitive', people.NOBODY, PRIMITIVE, 'C0-o'),
    Variant('human', people.PERSON, HUMAN, 'C1-s'),
    Variant(AS_IN_PAPER, people.PERSON, HUMAN, 'C1:x', options=SECTION_7),
    Variant('automatic', people.MACHINE, AUTOMATIC, 'C2-^'),
    Variant('human + primitive', people.PERSON, HUMAN_AND_PRIMITIVE, 'C1--D'),
    Variant(INTERRUPTED, people.PERSON, HUMAN, 'C3-P', STOPPED),
    Variant('human, 5 options, interrupted', people.PERSON, HUMAN, 'C4-h', STOPPED, ALSO_FRUIT),
    Variant(BY_CHANCE, people.PERSON, HUMAN, 'C5:*', by_chance=True),
)


@dataclass(frozen=True)
class Effort:
    """How much is sampled and played; with primitive actions alone more, as steps cost less."""

    largest: int = 200_000  # game steps of the last point of the curve, and of plans of the table
    primitive_largest: int = 3_200_000
    first: int = 25_000  # of the first point of the curve; then doubled
    games: int = 150  # in which every plan is judged

    def budgets(self, variant: Variant) -> list[int]:
        """Return the game steps of the points of the curve."""
        largest = self.primitive_largest if variant.action_set == PRIMITIVE else self.largest
        return [self.first * 2**n for n in range(int(math.log2(largest / self.first)) + 1)]


EFFORT = Effort()


def plan_all_games(parameters: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """
    Plan with every variant that some options belong to, in every game of their domain.

    :return: rows of tables: ``plans`` and ``curve`` (plans of smaller budgets), and ``costs`` of
        the options.
    """
    effort, plans = Effort(**parameters['effort']), parameters['plans']
    owned = _options_by_variant(parameters)
    costs = ('demonstrations', 'minutes', 'seconds', 'game_steps')
    found: dict[str, list[dict[str, Any]]] = {'plans': [], 'curve': []}
    found['costs'] = [
        {
            'action set': variant.name,
            'options': len(owner.options),
            **{name: getattr(owner, name) for name in costs},
        }
        for variant, owner in owned
    ]
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
                of = {'game': game.name, 'action set': variant.name}
                found[name] += [{**of, **row} for row in rows]
    return found


def _options_by_variant(
    parameters: Mapping[str, Any],
) -> list[tuple[Variant, people.OwnedOptions]]:
    """Return the variants of a trial, each with its options, without those that have no more."""
    domain = make_domain(parameters['domain'])
    owned = {NAMED: people.options_of(parameters, domain)}
    if domain.name in paper.ALSO_NAMED and 'person' in parameters.get('teacher', {}):
        owned[SECTION_7] = owned[NAMED]
        owned[NAMED] += people.options_of(parameters, domain, paper.ALSO_NAMED[domain.name])
        fruit = people.options_of(parameters, domain, paper.NOT_NAMED[domain.name])
        owned[ALSO_FRUIT] = owned[NAMED] + fruit
    return [
        (variant, owned[variant.options])
        for variant in VARIANTS
        if variant.whose == parameters['whose'] and variant.options in owned
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
    :return: rows of plans, and of the curve (one for each number of sweeps, doubled until
        converged).
    """

    def judge(max_sweeps: int = MAX_SWEEPS) -> tuple[bool, dict[str, Any]]:
        """Judge the plan of the median seconds of several, since one takes hardly any."""
        request, made = PlanRequest(variant.action_set, max_sweeps=max_sweeps), []
        for _ in range(REPEATS):
            plan = make_exact_plan(domain, options, request, clock=people.CLOCK)
            began = people.CLOCK()
            executed = as_executed(plan, variant.execution)
            seconds = plan.model_seconds + people.CLOCK() - began
            made.append((replace(plan, model_seconds=seconds), executed))
        made.sort(key=lambda pair: sum(getattr(pair[0], name) for name in SECONDS))
        plan, executed = made[REPEATS // 2]
        returns = play_plan(executed, domain.start_states())
        return plan.solution.converged, _record(max_sweeps, plan, returns, returns.successes)

    curve, converged, sweeps = [], False, 1
    while not converged and sweeps <= MAX_SWEEPS:
        converged, record = judge(sweeps)
        curve.append(record)
        sweeps *= 2
    return {'curve': curve, 'plans': [judge()[1] for _ in range(plans)]}


def plan_from_samples(
    domain: Domain[Any],
    variant: Variant,
    options: Sequence[LearnedOption],
    plans: int,
    effort: Effort,
    seed: int,
) -> dict[str, list[dict[str, Any]]]:
    """
    Plan from samples, and judge each plan in new games.

    :param plans: how many are made of the largest budget, each by random draws of its own.
    :param seed: of plans and games.
    :return: rows of plans, and of the curve (one for each budget).
    """
    budgets, rows = effort.budgets(variant), []
    numbers = [0] * len(budgets) + list(range(1, plans))
    for budget, number in zip([*budgets, *[budgets[-1]] * (plans - 1)], numbers):
        request = PlanRequest(
            variant.action_set,
            game_steps=budget,
            seed=_seed_for(seed, 'plan', number),
            execution=variant.execution,
        )
        plan = make_sampled_plan(domain, options, request, clock=people.CLOCK)
        returns = plan.play(_seed_for(seed, 'games', number), effort.games)
        rows.append(_record(budget, plan, returns, returns.outcomes['cleared']))
    return {'curve': rows[: len(budgets)], 'plans': rows[-plans:]}
