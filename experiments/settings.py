"""
Settings: the same search for the settings of sampled plans, with every action set.

It is made in mazes that are drawn by seed, and that nothing else uses. One trial is one maze, with
random and with chasing ghosts by turns. One person taught five options in the usual maze;
automatic options belong to a maze, and are extracted in each. Every action set tries the same
settings, with common random numbers: a grid, and those that were found by hand in the usual maze.
Mazes are the independent units, so differences are paired by maze.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import PlanSettings
from humanopts_env.domains.pacman.random_mazes import random_maze
from humanopts_env.domains.pacman.rules import GHOST_RULES
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.intervals import Interval
from humanopts_learner.planning.request import (
    AUTOMATIC,
    Execution,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    OF_MACHINES,
    PlanRequest,
    PRIMITIVE,
    Sampling,
)
from humanopts_learner.planning.sampled.plan import make_sampled_plan
from humanopts_teach.evaluation.games import baselines_of, carried_over
import pandas as pd

from experiments.people import options_of, owners, PERSON, Study
from experiments.report import Done, mean_intervals, Section, Table
from experiments.table2_plans import EFFORT
from experiments.transfer import taught_in_usual_maze
from experiments.trials import Trial

NAME, DOMAIN = 'settings', 'pacman'
TITLE = 'Settings: the same search with every action set'
GAMES = 100  # that each plan is judged in
COST = 110.0
GRID = {'gamma': (0.95, 0.97, 0.985), 'penalty': (0.0, 30.0), 'shrinkage': (0.0, 1000.0)}
USUAL = 'usual'
BY_HAND = {  # with what settings were found, by their name in ``Baselines``
    'primitive': 'by hand: primitive',
    'interrupted': 'by hand: human, interrupted',
    'interrupted_mixture': 'by hand: human + primitive, interrupted',
}
ACTION_SETS = {  # action set, execution, and the settings that were found by hand with them
    'primitive': (PRIMITIVE, Execution.RUN_TO_END, BY_HAND['primitive']),
    'human': (HUMAN, Execution.RUN_TO_END, ''),
    'human, interrupted': (HUMAN, Execution.INTERRUPTED, BY_HAND['interrupted']),
    'human + primitive, interrupted': (
        HUMAN_AND_PRIMITIVE,
        Execution.INTERRUPTED,
        BY_HAND['interrupted_mixture'],
    ),
    'automatic': (AUTOMATIC, Execution.RUN_TO_END, ''),
}
ALL = 'all of them, by one setting'
KEYS = ['action set', 'setting']


def trials(study: Study) -> list[Trial]:
    """Return one trial for each maze, as many as the seeds of the study."""
    people = owners(study, DOMAIN)[PERSON]
    return [
        Trial(
            NAME,
            {
                'maze': random_maze(generator(study.seed, NAME, 'maze', number)).text,
                'ghosts': GHOST_RULES[number % len(GHOST_RULES)],
                'number': number,
                'steps': EFFORT.search_steps,
                'primitive_steps': EFFORT.primitive_search_steps,
                'games': GAMES,
                'seed': study.seed,
                **people[0],
            },
            search_in_maze,
            COST,
        )
        for number in range(1, study.seeds + 1)
        if people
    ]


def settings_to_try(domain: Domain[Any]) -> dict[str, PlanSettings]:
    """Return the settings by name, the same for every action set."""
    found = {}
    for gamma, penalty, shrinkage in product(*GRID.values()):
        name = f'gamma {gamma:g}, penalty {penalty:g}, shrinkage {shrinkage:g}'
        one = PlanSettings(gamma, {'penalty': penalty, 'shrinkage': shrinkage})
        is_usual = gamma == domain.gamma and Sampling(**one.sampling) == Sampling()
        found[USUAL if is_usual else name] = one
    usual = baselines_of(domain)
    return found | {name: getattr(usual, found_with) for found_with, name in BY_HAND.items()}


def search_in_maze(parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each action set and setting: the mean score of its games."""
    domain = make_domain(DOMAIN, {'maze': parameters['maze'], 'ghosts': parameters['ghosts']})
    seed = int(generator(parameters['seed'], NAME, parameters['number']).integers(2**31))
    taught = taught_in_usual_maze(parameters['teacher']).options
    carried = [carried_over(option, domain) for option in taught]
    found = options_of({'extraction': seed}, domain).options
    rows = []
    for name, (action_set, execution, _) in ACTION_SETS.items():
        options = found if action_set in OF_MACHINES else carried
        steps = parameters['primitive_steps' if action_set == PRIMITIVE else 'steps']
        for setting, how in settings_to_try(domain).items():
            request = PlanRequest(
                action_set,
                gamma=how.gamma,
                game_steps=steps,
                seed=seed,
                sampling=Sampling(**how.sampling),
                execution=execution,
            )
            plan = make_sampled_plan(domain, options, request)
            score = float(plan.play(seed, parameters['games']).total.mean())
            rows.append({'action set': name, 'setting': setting, 'score': score})
    return rows


def score_table(done: Done) -> pd.DataFrame:
    """Return a row for each maze, action set and setting: the mean score of its games."""
    return pd.DataFrame(
        {'maze': p['number'], 'ghosts': p['ghosts'], **row} for p, result in done for row in result
    )


def choice_table(scores: pd.DataFrame) -> pd.DataFrame:
    """
    Return what the search finds for each action set, and for all of them by one setting.

    The score of the search in a maze is that of the setting with the best mean in all *other*
    mazes. Differences are paired by maze.

    :return: action set; best setting of all mazes; score of the search; score of the usual
        setting, and how much more the search has (with low and high); of the setting that was
        found by hand for this action set the same, NaN where there is none.
    """
    rows: list[dict[str, Any]] = []
    for name in (*ACTION_SETS, ALL):
        mine = scores if name == ALL else scores[scores['action set'] == name]
        table = mine.pivot_table('score', 'maze', 'setting', sort=False)
        searched = pd.Series(
            {maze: table[table.drop(index=maze).mean().idxmax()][maze] for maze in table.index}
        )
        row = {'action set': name, 'best setting': table.mean().idxmax(), 'score': searched.mean()}
        by_hand = '' if name == ALL else ACTION_SETS[name][-1]
        for title, other in (('usual', USUAL), ('by hand', by_hand)):
            if other:
                more = Interval.of_difference(searched, table[other])
                limits = {'more': more.mean, 'low': more.low, 'high': more.high}
                row[title] = table[other].mean()
                row |= {f'{title}: {limit}': value for limit, value in limits.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def present(done: Done) -> Section:
    """Return the section of the report."""
    scores = score_table(done)
    means = scores.pivot_table('score', 'setting', 'action set', sort=False)
    means = means.rename_axis(columns=None).reset_index()
    limits = mean_intervals(scores, KEYS, 'score')
    limits = limits.rename(columns={'count': 'mazes', 'mean': 'score'})
    tables = [
        Table('settings-means', 'Mean scores over the mazes', means),
        Table('settings-summary', 'Mean scores, with limits', limits, shown=False),
        Table('settings-scores', 'Scores by maze', scores, shown=False),
    ]
    if scores['maze'].nunique() > 1:
        chosen = choice_table(scores)
        tables.insert(0, Table('settings-choices', 'What the search finds', chosen))
    facts = {'steps': EFFORT.search_steps, 'primitive_steps': EFFORT.primitive_search_steps}
    return Section(NAME, TITLE, [], [], tables, {**facts, 'games': GAMES})
