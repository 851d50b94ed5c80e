"""
The plans of table 2: action sets and executions, in every game (sections 7.3 and 8).

One trial has one owner of options: a person, an extraction, or none. The options are learned or
extracted once, in the default game, and every variant for that kind of owner plans with them.
Plans with exact models are played from every start state, plans with sampled models in new games.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.registry import make_domain
from humanopts_env.games import new_games, TableGames
from humanopts_env.seeding import generator
from humanopts_learner.execution import play
from humanopts_learner.options.learned_option import LearnedOption, TabularOption, tabulate
from humanopts_learner.planning.action_set import ActionSet, AnyOption
from humanopts_learner.planning.exact_plan import make_exact_plan, option_table, play_plan, Returns
from humanopts_learner.planning.interruption import as_executed
from humanopts_learner.planning.plan import AnyPlan, summarise_plan
from humanopts_learner.planning.request import (
    Arbitration,
    AUTOMATIC,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    MAX_SWEEPS,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from humanopts_learner.summary import PlanSummary
from humanopts_teach.evaluation.games import carried_over
from humanopts_teach.evaluation.tables import finite
import numpy as np

from experiments import paper, people
from experiments.trials import Rows

NAME = 'table2'
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man
# A person's options: those taught by the paper's participants; these and the others named in the
# paper; and all of these with one that the paper does not name.
SECTION_7, NAMED, ALSO_FRUIT = 'of section 7', 'named in the paper', 'the fruit too'
REPEATS = 7  # repetitions of each exact plan, for timing
PLAN, CURVE, COST = 'plan', 'curve', 'cost'  # kinds of row
SECONDS, RETURN = 'total, s', 'mean return'
COLUMNS = {  # column names of a plan by field of its summary
    'table_seconds': 'tables, s',
    'model_seconds': 'models, s',
    'sweep_seconds': 'sweeps, s',
    'sweeps': 'sweeps',
    'n_states': 'states',
    'game_steps': 'game steps',
}
PARTS = [*COLUMNS.values()][:3]  # parts of the total seconds


@dataclass(frozen=True)
class ComparedGame:
    """One game in which all variants are compared."""

    name: str
    domain: str
    exact: bool  # whether models are exact, not sampled
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Variant:
    """A row of the table: options and actions of a plan, and the execution of its policy."""

    name: str
    owner: str  # kind of owner of the options
    action_set: str
    line: str  # matplotlib format: colour, line, marker
    execution: Arbitration = Arbitration.RUN_TO_END
    options: str = NAMED  # set of a person's options, in Pac-Man
    by_chance: bool = False  # no plan: uniform random choice among the options that can start


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
    """Amount of sampling and play; primitive actions alone get more, as their steps cost less."""

    largest: int = 200_000  # game steps of the last point of the curve, and of plans in the table
    primitive_largest: int = 3_200_000
    first: int = 25_000  # game steps of the first point of the curve, then doubled
    games: int = 150  # games for evaluating each plan

    def budgets(self, variant: Variant) -> list[int]:
        """Return the game steps of the points of the curve."""
        largest = self.primitive_largest if variant.action_set == PRIMITIVE else self.largest
        return [self.first * 2**n for n in range(int(math.log2(largest / self.first)) + 1)]


EFFORT = Effort()


def plan_all_games(parameters: Mapping[str, Any]) -> Rows:
    """
    Plan with every variant for the options of one owner, in every game of their domain.

    :return: rows of three kinds: the cost of the options, plans, and the curve (plans with
        smaller budgets).
    """
    effort, plans, name = Effort(**parameters['effort']), parameters['plans'], parameters['domain']
    owned = _options_by_variant(parameters)
    rows: Rows = [
        {
            'kind': COST,
            'domain': name,
            'action set': variant.name,
            'options': len(owner.options),
            'demonstrations': owner.demonstrations,
            'teaching minutes': owner.minutes,
            'extraction seconds': owner.seconds,
            'extraction game steps': owner.game_steps,
        }
        for variant, owner in owned
    ]
    for game in GAMES:
        if game.domain != name:
            continue
        domain = make_domain(game.domain, game.parameters)
        seed = people.owner_seed(parameters, NAME, game.name)
        for variant, owner in owned:
            options = [  # adapt to parameters that differ from the lesson's
                carried_over(option, domain) if isinstance(option, LearnedOption) else option
                for option in owner.options
            ]
            if variant.by_chance:
                draws = (generator(seed, 'table 2', 'chance', number) for number in range(plans))
                played = (play_by_chance(domain, options, effort.games, rng) for rng in draws)
                found: Iterable[Any] = (_row(PLAN, 0, returns) for returns in played)
            elif is_enumerable(domain):
                found = plan_exactly(domain, variant, options)
            else:
                found = plan_from_samples(domain, variant, options, plans, effort, seed)
            rows += [{'game': game.name, 'action set': variant.name, **row} for row in found]
    return rows


def _options_by_variant(
    parameters: Mapping[str, Any],
) -> list[tuple[Variant, people.OwnedOptions]]:
    """Return the variants for the owner of a trial, each with its options."""
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
        if variant.owner == parameters['owner'] and variant.options in owned
    ]


def _row(kind: str, budget: int, returns: Returns, plan: AnyPlan | None = None) -> dict[str, Any]:
    """
    Return seconds, sizes and means of a plan and its evaluation games, as JSON data.

    :param budget: maximum number of sweeps, or game steps.
    :param plan: plan; None: random choice.
    """
    known = PlanSummary('') if plan is None else summarise_plan(plan)
    row = {title: getattr(known, name) for name, title in COLUMNS.items()}
    return {
        'kind': kind,
        'budget': budget,
        **row,
        SECONDS: sum(row[part] for part in PARTS),
        RETURN: float(returns.total.mean()),
        'discounted': finite(returns.discounted.mean()),
        'done': float(returns.outcomes.get('cleared', returns.successes).mean()),
        'fallbacks in a game': float(returns.fallbacks.mean()),
    }


def play_by_chance(
    domain: Domain,
    options: Sequence[Any],
    games: int,
    rng: np.random.Generator,
) -> Returns:
    """
    Play by random choice among the options, as a baseline for plans.

    Whenever a choice is due, one of the options that can start is drawn uniformly and run to its
    end. If none can start, a primitive action is taken.

    :param options: learned options or, if states can be listed, tables.
    :param games: number of games if models are sampled; otherwise one game is played from every
        start.
    """
    action_set = HUMAN if options else PRIMITIVE
    if is_enumerable(domain):
        table: Any = option_table(domain, action_set, [tabulate(each, domain) for each in options])
        begun: Any = TableGames(domain, domain.start_states().astype(np.intp))
    else:
        table, begun = ActionSet(domain, action_set, options), new_games(domain, games, rng)
    played = play(begun, table, AnyOption(rng), rng, domain.max_steps, gamma=domain.gamma)
    return Returns.of(played, domain.gamma, len(options))


def _seed_for(seed: int, purpose: str, number: int = 0) -> int:
    return int(generator(seed, 'table 2', purpose, number).integers(2**31))


def plan_exactly(
    domain: EnumerableDomain,
    variant: Variant,
    options: Sequence[LearnedOption | TabularOption],
) -> Iterator[dict[str, Any]]:
    """
    Plan with exact models and play once from every start state.

    Planning is very fast, so each plan is made several times, and the one with the median time
    counts.

    :return: the curve, one row per number of sweeps, doubled until convergence; and the plan.
    """
    sweeps, last = 1, False
    while not last:
        request, made = PlanRequest(variant.action_set, max_sweeps=sweeps), []
        for _ in range(REPEATS):
            plan = make_exact_plan(domain, options, request, clock=people.CLOCK)
            began = people.CLOCK()
            executed = as_executed(plan, variant.execution)
            seconds = plan.model_seconds + people.CLOCK() - began
            made.append((replace(plan, model_seconds=seconds), executed))
        made.sort(key=lambda pair: pair[0].seconds)
        plan, executed = made[REPEATS // 2]
        returns = play_plan(executed, domain.start_states())
        last = plan.solution.converged or 2 * sweeps > MAX_SWEEPS
        kinds = [CURVE] + [PLAN] * last
        yield from (_row(kind, sweeps, returns, plan) for kind in kinds)
        sweeps *= 2


def plan_from_samples(
    domain: Domain,
    variant: Variant,
    options: Sequence[LearnedOption],
    plans: int,
    effort: Effort,
    seed: int,
) -> Iterator[dict[str, Any]]:
    """
    Plan from samples and evaluate each plan in new games.

    :param plans: number of plans with the largest budget, each with its own random draws.
    :param seed: seed of plans and games.
    :return: the curve, one row per budget; and the plans.
    """
    *smaller, largest = effort.budgets(variant)
    for budget, number in [
        *((each, 0) for each in smaller),
        *((largest, n) for n in range(plans)),
    ]:
        request = PlanRequest(
            variant.action_set,
            game_steps=budget,
            seed=_seed_for(seed, 'plan', number),
            execution=variant.execution,
        )
        plan = make_sampled_plan(domain, options, request, clock=people.CLOCK)
        returns = plan.play(_seed_for(seed, 'games', number), effort.games)
        kinds = [CURVE] * (number == 0) + [PLAN] * (budget == largest)
        yield from (_row(kind, budget, returns, plan) for kind in kinds)
