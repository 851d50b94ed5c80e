"""
Table 2: what planning with each action set takes and achieves (sections 7.3 and 8).

One trial has one owner of options: a person, an extraction, or nobody. The options are made once,
in the usual game, and every variant of that kind of owner plans with them. Exact models have no
settings to search for, and the plans are played from every start state. Sampled models begin with
a search for settings, equally long for all variants, and are judged with other seeds.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
import math
import re
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.pacman.baselines import INTERRUPTED
from humanopts_env.domains.pacman.baselines import PRIMITIVE as PRIMITIVE_SETTINGS
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.intervals import all_hold, any_holds, Interval, LEVEL, level_of_each
from humanopts_learner.options.option import LearnedOption, TabularOption, tabulate
from humanopts_learner.options.rollout import tabular_rollouts
from humanopts_learner.planning.evaluate import play, Returns
from humanopts_learner.planning.exact import ExactPlan, make_exact_plan
from humanopts_learner.planning.interruption import as_executed, policy_values
from humanopts_learner.planning.plan import AnyPlan
from humanopts_learner.planning.request import (
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    Execution,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    MAX_SWEEPS,
    PlanRequest,
    PRIMITIVE,
    Sampling,
)
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.games import play_games
from humanopts_learner.planning.sampled.plan import (
    make_sampled_plan,
    make_sampled_plans,
    play_in_step,
)
from humanopts_learner.planning.sampled.policies import UniformPolicy
from humanopts_teach.evaluation.games import carried_over
from humanopts_teach.evaluation.measures import finite
from humanopts_teach.report.figures import Drawing
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
from numpy.typing import NDArray
import pandas as pd

from experiments import paper, people, report
from experiments.learners import FOREST, LEARNERS, NEIGHBOUR, with_cloned_policies
from experiments.paper import Statement
from experiments.trials import Trial

NAME = 'table2'
TITLE = 'Table 2: planning time and return'
KEYS = ['game', 'action set']
EXECUTIONS = ['game', 'carried out as']
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man
# Options of a person: those that the paper's participants taught, those that it names too, and one
# more that it does not name. In Taxi also the first with policies by each of ``LEARNERS``.
SECTION_7, NAMED, ALSO_FRUIT = 'of section 7', 'named in the paper', 'the fruit too'
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')
REPEATS = 7  # makings of one exact plan, for its seconds
COSTS = {'pacman': 170.0, 'taxi': 5.0}  # of a trial, about processor seconds
ROUNDING = 1e-9  # reward units
WANTED_UNIFORM, WANTED_MORE, TENTH = 1900.0, 300.0, 10.0  # points; times as long


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
    execution: Execution = Execution.RUN_TO_END
    options: str = NAMED  # of a person, in Pac-Man
    by_chance: bool = False  # nothing is planned: any option that can start, each alike


TAXI = ComparedGame('Taxi', 'taxi', exact=True)
UNIFORM = ComparedGame('Pac-Man, random ghosts', 'pacman', exact=False)
CHASE = ComparedGame(
    'Pac-Man, chasing ghosts', 'pacman', exact=False, parameters={'ghosts': 'chase'}
)
GAMES = (TAXI, UNIFORM, CHASE)

STOPPED, FIVE = Execution.INTERRUPTED, 'human, 5 options'
MASS_NAME = 'human, modular (greatest mass)'  # it may make a state worth less
MASS, STRONGEST = Execution.MODULAR_MASS, Execution.MODULAR_STRONGEST
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
    v for v in VARIANTS if v.execution is not Execution.RUN_TO_END and v.options == NAMED
)
GOALS = {
    TAXI.name: 'Exact models: interrupted, or with the strongest module, no state is worth less '
    'than run to the end.',
    UNIFORM.name: 'Random ghosts: interrupted or as modules, human options come to '
    f'{WANTED_UNIFORM:,.0f} points and to no less than primitive actions, in a tenth of the '
    'planning time.',
    CHASE.name: 'Chasing ghosts: interrupted or as modules, human options come to '
    f'{WANTED_MORE:.0f} points more than run to their end, and to no less than primitive '
    'actions.',
}
ORDER = ['taxi', 'pacman', *(one.name for one in (*GAMES, *VARIANTS))]  # of rows


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


def trials(study: people.Study) -> list[Trial]:
    """Return one trial for each domain that is taught, and person, extraction, repetition."""
    found = []
    for domain in dict.fromkeys(game.domain for game in GAMES):
        sources = people.owners(study, domain)
        if not (count := len(sources[people.PERSON])):
            continue
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
                found.append(Trial(NAME, parameters, plan_all_games, COSTS[domain]))
    return found


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
            policy = UniformPolicy(actions)
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
    everywhere = np.ones(domain.n_states, dtype=np.bool_)
    tables = [tabulate(option, domain) for option in options]
    tables += [
        TabularOption(action.name, 1, np.full(domain.n_states, index), everywhere, everywhere)
        for index, action in enumerate(domain.actions)
    ]
    can = np.array([table.initiation for table in tables])  # (O + A, S)
    can[len(options) :] = ~can[: len(options)].any(axis=0)
    longest = np.array([table.max_steps for table in tables])
    at = domain.start_states().astype(np.intp)
    returns, going = Returns.of_none(np.zeros(len(at), dtype=np.bool_)), np.arange(len(at))
    while going.size:
        draws = np.where(can[:, at[going]], rng.random((len(tables), len(going))), -1.0)
        which = draws.argmax(axis=0)
        limits = np.minimum(longest[which], domain.max_steps - returns.steps[going])
        runs = tabular_rollouts(domain, tables, which, at[going], limits)
        returns.total[going] += runs.total_reward
        returns.steps[going] += runs.steps
        returns.decisions[going] += 1
        returns.fallbacks[going] += which >= len(options)
        returns.successes[going] = runs.over
        at[going] = runs.final
        going = going[~runs.over & (returns.steps[going] < domain.max_steps)]
    returns.discounted[:] = np.nan  # what a run earned is known, not when
    return returns


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
        returns = play(executed, domain.start_states())
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


def settings_to_try(variant: Variant, gamma: float, count: int) -> list[PlanRequest]:
    """
    Return requests without budgets, with the same settings for every variant.

    The first are the usual ones. The second were found by hand with primitive actions, the third
    and fourth with the reference options, in either kind of ghosts; the last look farther ahead.

    :param gamma: the domain's own.
    :param count: 1 to 5.
    """
    by_hand = (PRIMITIVE_SETTINGS, *INTERRUPTED.values())
    settings = [(gamma, {}), *((one.gamma, one.sampling) for one in by_hand), (0.985, {})]
    return [
        PlanRequest(
            variant.action_set, gamma, sampling=Sampling(**how), execution=variant.execution
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
        settings_to_try(variant, domain.gamma, effort.tried),
        _seed_for(seed, 'search'),
    )
    asked = [replace(one, game_steps=few, seed=search) for one in settings]
    candidates = make_sampled_plans(domain, options, asked)
    searched = play_in_step([(plan, search, None) for plan in candidates], effort.search_games)
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
    played = play_in_step([(plan, one, None) for plan, one in zip(made, games)], effort.games)
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
    stopped = [(plan, game, other.execution) for other, plan, game, _ in again]
    how = best.sampling
    setting = {
        'gamma': best.gamma,
        'rounds': how.rounds,
        'explore': how.explore,
        'min_samples': how.min_samples,
        'penalty': how.penalty,
        'pooling': how.shrinkage,
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
            for (other, _, _, then), now in zip(again, play_in_step(stopped, effort.games))
        ],
    }


# The section of the report.


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    members, points, gains = member_table(done), point_table(done), gain_of_members(done)
    summary, curves = summary_table(members), curve_table(points)
    found, pictures, tables = [], [], []
    for game in GAMES:
        if game.name not in summary.index:
            continue
        results = Results(game, members, points, curves)
        found += [*_claims(results), *_numbers(results), *_goals(results), *_gains(game, gains)]
        name = f'table2-{re.sub(r"[^a-z]+", "-", game.name.lower())}'
        tables.append(report.Table(name, game.name, summary.loc[game.name].reset_index()))
        label = f'Mean return in {game.name} by planning seconds and action set'
        unit = 'sweeps' if game.exact else 'game steps'
        caption = (
            f'{game.name}: mean return against planning time, {unit} doubled from point to '
            'point. Shaded: 95 % interval.'
        )
        draw = partial(_draw, game, curves[curves['game'] == game.name])
        pictures.append(report.Picture(name, label, (8.2, 4.2), draw, caption))
    costs, stopped, settings = cost_table(done), gain_table(gains), setting_table(done)
    gained = 'What the same plan gains over running each option to its end'
    drawn = 'The curves; budgets are sweeps in Taxi, game steps in Pac-Man'
    tables += [
        report.Table('table2-acquisition', 'What it cost to get the options, mean of each', costs),
        report.Table('table2-executions', gained, stopped),
        report.Table('table2-paper', "The paper's table, and ours", paper_table(summary)),
        report.Table('table2-curves', drawn, curves, shown=False),
        report.Table('table2-settings', 'Settings that were chosen', settings, shown=False),
    ]
    return report.Section(NAME, TITLE, found, pictures, tables, {'effort': asdict(EFFORT)})


def rows_of(done: report.Done, name: str, by: Sequence[str]) -> pd.DataFrame:
    """
    Return the rows of one table of all trials, with the number of the trial as ``member``.

    :param by: columns to order the rows by, as in ``ORDER``.
    """
    rows = [
        {'domain': parameters['domain'], 'member': member, **row}
        for member, (parameters, result) in enumerate(done)
        for row in result[name]
    ]
    frame = pd.DataFrame(rows, columns=None if rows else ['domain', 'member', *by])
    return frame.sort_values(
        list(by), key=lambda names: names.map(ORDER.index), kind='stable', ignore_index=True
    )


def member_table(done: report.Done) -> pd.DataFrame:
    """Return the means of each member's plans, indexed by game, variant and member."""
    plans = rows_of(done, 'plans', KEYS)
    plans['seconds'] = plans[list(SECONDS)].sum(axis=1)
    return plans.groupby([*KEYS, 'member'], sort=False).mean(numeric_only=True)


def summary_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each game and variant, indexed by both; each member counts once."""
    means = members.groupby(KEYS, sort=False).mean()
    returns = report.mean_intervals(members.reset_index(), KEYS, 'mean').set_index(KEYS)
    exact = means.index.get_level_values('game') == TAXI.name
    parts = {
        'count': returns['count'],
        'tables, s': means['table_seconds'].round(6),
        'models, s': means['model_seconds'].round(6),
        'sweeps, s': means['sweep_seconds'].round(6),
        'total, s': means['seconds'].round(6),
        'sweeps': means['sweeps'].round(1),
        'states': means['states'].round().astype(int),
        'game steps': means['game_steps'].round().astype(int),
        'mean return': returns['mean'],
        'low': returns['low'],
        'high': returns['high'],
        'discounted': means['discounted'].where(exact),  # elsewhere gamma is searched for
        'done': means['done'],
        'fallbacks in a game': means['fallbacks'],
    }
    return pd.DataFrame(parts)


def point_table(done: report.Done) -> pd.DataFrame:
    """Return each member's curve by budget; one that has ended keeps its last point."""
    points = rows_of(done, 'curve', KEYS)
    found: list[pd.DataFrame] = []
    points['seconds'] = points[list(SECONDS)].sum(axis=1)
    for key, mine in report.grouped(points, KEYS):
        wide = mine.set_index(['budget', 'member'])[['seconds', 'mean']].unstack('member').ffill()
        every = wide.stack('member', future_stack=True).reset_index()
        found.append(every.assign(**dict(zip(KEYS, key))))
    return pd.concat(found, ignore_index=True)


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """Return mean return by budget, over members."""
    by = [*KEYS, 'budget']
    curves = report.mean_intervals(points, by, 'mean')
    curves['seconds'] = points.groupby(by, sort=False)['seconds'].mean().to_numpy()
    columns = [*by, 'seconds', 'mean', 'low', 'high']
    return curves[columns].rename(columns={'mean': 'mean return'})


def cost_table(done: report.Done) -> pd.DataFrame:
    """Return what it cost to get the options, mean of their owners."""
    names = {
        'options': 'options',
        'demonstrations': 'demonstrations',
        'minutes': 'teaching minutes',
        'seconds': 'extraction seconds',
        'game_steps': 'extraction game steps',
    }
    keys = ['domain', 'action set']
    owned = rows_of(done, 'costs', keys)
    owned = owned[owned['options'] > 0].astype(dict.fromkeys(names, float))
    groups = owned.groupby(keys, sort=False)
    found: pd.DataFrame = groups[list(names)].mean().rename(columns=names)
    found.insert(0, 'count', groups.size())
    return found.reset_index()


def gain_of_members(done: report.Done) -> pd.DataFrame:
    """Return each member's gain by each execution of a plan over running options to their end."""
    means = {'least': 'min', 'mean': 'mean', 'most': 'max'}
    gains = rows_of(done, 'gains', EXECUTIONS).reindex(columns=[*EXECUTIONS, 'member', *means])
    groups = gains.groupby([*EXECUTIONS, 'member'], sort=False)
    return groups.agg(means).astype(float).reset_index()


def gain_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return the gain of each execution, over members."""
    found = report.mean_intervals(members, EXECUTIONS, 'mean')
    extremes = members.groupby(EXECUTIONS, sort=False)
    found['least of all states'] = extremes['least'].min().to_numpy()
    found['most of all states'] = extremes['most'].max().to_numpy()
    exact = found['game'] == TAXI.name
    found[['low', 'high']] = found[['low', 'high']].mask(exact)
    found.insert(3, 'of', np.where(exact, 'value of a state', 'return of games'))
    return found


def paper_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Set the paper's numbers beside ours; in Pac-Man, beside the game with random ghosts."""
    rows, ours = [], ['total, s', 'mean return', 'low', 'high']
    for game in (TAXI, UNIFORM):
        known = paper.TABLE_2[game.domain]
        for name, row in {**known, AS_IN_PAPER: known['human']}.items():
            if (game.name, name) in summary.index:
                rows.append([game.name, name, *row, *summary.loc[(game.name, name), ours]])
    columns = [*KEYS, "paper's seconds", "paper's average reward", 'seconds', 'mean return']
    return pd.DataFrame(rows, columns=[*columns, 'low', 'high'])


def setting_table(done: report.Done) -> pd.DataFrame:
    """Return the settings that were chosen, for each game, variant and member."""
    settings = rows_of(done, 'settings', KEYS)
    number = settings.groupby(KEYS, sort=False).cumcount() + 1
    settings.insert(4, 'number', number)
    return settings.drop(columns=['domain', 'member'])


Value = tuple[str, Interval]  # what it is of, and its interval


class Results:
    """What there is of one game, by variant: means of each member, and the curves."""

    def __init__(self, game: ComparedGame, *tables: pd.DataFrame) -> None:
        """Take the members, points and curves of all games."""
        self.game = game
        self.members, self._points, self._curves = (
            {name: rows for (name,), rows in report.grouped(of[of['game'] == game.name], KEYS[1:])}
            for of in (table.reset_index() for table in tables)
        )

    def has(self, *names: str) -> bool:
        """Return whether there are results of all these variants."""
        return set(names) <= set(self.members)

    def value(self, name: str, level: float = LEVEL) -> Value:
        """Return what a variant returns."""
        return f'return, {name}', Interval.of(self.members[name]['mean'], level)

    def more(self, first: str, second: str, level: float = LEVEL) -> Value:
        """Return how much more the first variant returns; with the same owners, within each."""
        one, other = (self.members[name].set_index('member')['mean'] for name in (first, second))
        paired = one.index.equals(other.index)
        more = Interval.of_difference(one, other, level, paired=paired)
        return f'return, {first} less {second}', more

    def time(self, first: str, second: str, level: float = LEVEL) -> Value:
        """Return the time of the plans of one variant as a part of another's."""
        one, other = (self.members[name]['seconds'] for name in (first, second))
        return f'time, {first} / {second}', Interval.of_ratio(one, other, level, paired=False)

    def race(self, first: str, second: str) -> Value:
        """
        Return the time of one variant as a part of another's until both come to the same.

        Plans with exact models end by themselves. Sampled ones take as long as they are let, so
        they are compared by the time of the first plans whose whole interval lies at or above a
        return: the highest that both come to so. Of one member there is none, and all is NaN.
        """
        if self.game.exact:
            return self.time(first, second)
        curves = [self._curves[name] for name in (first, second)]
        level = min(float(curve['low'].max()) for curve in curves)
        if math.isnan(level):
            return f'time, {first} / {second}', Interval(math.nan, math.nan, math.nan)
        budgets = [curve.loc[curve['low'] >= level, 'budget'].iloc[0] for curve in curves]
        points = [self._points[name] for name in (first, second)]
        times = [of.loc[of['budget'] == budget, 'seconds'] for of, budget in zip(points, budgets)]
        named = f'time until {level:,.0f} points, {first} / {second}'
        return named, Interval.of_ratio(*times, paired=False)

    def says(
        self, claim: Statement, verdict: bool | report.Mark | None, *values: Value, why: str = ''
    ) -> report.Comparison:
        """Return a claim beside the values that decide it, or why nothing does."""
        found = report.listed(self.game.name, dict(values)) if values else ''
        return report.compared(claim, '; '.join(filter(None, (found, why))), verdict)


def _claims(results: Results) -> Iterator[report.Comparison]:
    """Yield what the paper says of times and returns, and what planning shall gain over chance."""
    said, options = paper.SAID, [*filter(results.has, ('human', 'automatic'))]
    if results.has('primitive') and options:
        for each in options:
            time = results.race(each, 'primitive')
            yield results.says(said[f'{each}_faster'], time[1].below(1.0), time)
        losses = [results.more('primitive', each) for each in options]
        worse = all_hold(loss.above(ROUNDING) for _, loss in losses)
        yield results.says(said['never_as_good'], worse, *losses)
    if len(options) > 1:
        first, second = options
        time, more = results.race(first, second), results.more(first, second)
        verdict = all_hold([time[1].below(1.0), more[1].above(ROUNDING)])
        yield results.says(said['efficient'], verdict, time, more)
    if results.has(TO_END.name, BY_CHANCE.name):
        gain = results.more(TO_END.name, BY_CHANCE.name)
        planned, by_chance = (results.value(one.name)[1].mean for one in (TO_END, BY_CHANCE))
        share = f'random choice has {by_chance / planned:.0%}' if planned > 0 else ''
        claim = 'Planning with human options returns more than random choice among them.'
        yield results.says(Statement(claim, report.OURS), gain[1].above(ROUNDING), gain, why=share)


def _numbers(results: Results) -> Iterator[report.Comparison]:
    """
    Yield the numbers of table 2 beside ours.

    Seconds are compared as parts of those of primitive actions: they agree where the interval
    holds the paper's part.
    """
    known, title = paper.TABLE_2[results.game.domain], results.game.name.partition(',')[0]
    human = AS_IN_PAPER if results.has(AS_IN_PAPER) else 'human'
    ours = {'primitive': 'primitive', 'human': human, 'automatic': 'automatic'}
    ours = {name: own for name, own in ours.items() if results.has(own)}
    if 'primitive' not in ours or results.game == CHASE:
        return
    for name, own in ours.items():
        said, part = f'{title}, {name}: {known[name][0]:g} s', known[name][0]
        if name == 'primitive':
            taken = 'seconds', Interval.of(results.members[own]['seconds'])
            claim, why = Statement(f'{said}.', 'table 2'), paper.WHY_NO_SECONDS
            yield results.says(claim, report.Mark.NOT_COMPARABLE, taken, why=why)
        else:
            part, time = part / known['primitive'][0], results.race(own, 'primitive')
            said += f', {part:.3g} of the time of primitive actions.'
            yield results.says(Statement(said, 'table 2'), time[1].holds(part), time)
    why = paper.WHY_NO_RETURN[results.game.domain]
    for name, own in ours.items():
        claim = Statement(f'{title}, {name}: average reward {known[name][1]:,g}.', 'table 2')
        yield results.says(claim, report.Mark.NOT_COMPARABLE, results.value(own), why=why)
    if not results.game.exact:
        best = paper.SAID['incomplete']
        yield results.says(best, report.Mark.NO_COUNTERPART, why=paper.NO_BEST_KNOWN)


def _goals(results: Results) -> Iterator[report.Comparison]:
    """
    Yield the best way to interrupt human options beside the goals of this project.

    Since it is the best of several, its intervals are those that hold for all of them at once.
    """
    mine = [variant.name for variant in INTERRUPTING if results.has(variant.name)]
    if results.game == TAXI or not mine or not results.has('primitive', 'human'):
        return
    best = max(mine, key=lambda name: results.value(name)[1].mean)
    level = level_of_each(len(mine))
    reached, less = results.value(best, level), results.more(best, 'primitive', level)
    if results.game == UNIFORM:
        slower = results.time('primitive', best, level)
        values = [reached, less, slower]
        parts = [reached[1].at_least(WANTED_UNIFORM), slower[1].at_least(TENTH)]
    else:
        more = results.more(best, 'human', level)
        values, parts = [reached, less, more], [more[1].at_least(WANTED_MORE)]
    verdict = all_hold([*parts, less[1].at_least(-ROUNDING)])
    yield results.says(Statement(GOALS[results.game.name], report.OURS), verdict, *values)


def _gains(game: ComparedGame, gains: pd.DataFrame) -> Iterator[report.Comparison]:
    """Yield what the same plan gains where its options are stopped: by state, or in games."""
    mine = report.grouped(gains[gains['game'] == game.name], EXECUTIONS[1:])
    by_way = {name: rows for (name,), rows in mine}
    if game.exact:
        least = {name: rows['least'].min() for name, rows in by_way.items()}
        least = {name: value for name, value in least.items() if name != MASS_NAME}
        text = report.listed('least of all states and people', least)
        claim, verdict = (
            Statement(GOALS[game.name], report.OURS),
            min(least.values(), default=0) >= -ROUNDING,
        )
    else:
        level = level_of_each(max(len(by_way), 1))
        more = {name: Interval.of(rows['mean'], level) for name, rows in by_way.items()}
        text = report.listed(f'{game.name}, points more than run to the end', more)
        verdict = any_holds(gain.above() for gain in more.values())
        claim = paper.SAID['interrupted']
    if by_way:
        yield report.compared(claim, text, verdict)


def _draw(game: ComparedGame, curves: pd.DataFrame, work: Drawing) -> None:
    axes, (unit, scale) = work.axes, ('ms', 1e3) if game.exact else ('s', 1.0)
    drawn = curves.assign(mean=curves['mean return'], seconds=scale * curves['seconds'])
    lines = {variant.name: variant.line for variant in VARIANTS}
    report.draw_curves(axes, drawn, 'action set', 'seconds', lines, ms=4, lw=1.3)
    axes.set(title=game.name, xlabel=f'planning time of a processor, {unit}', ylabel='mean return')
    axes.set_xscale('log')
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5))
