"""
Transfer of options from one maze to other mazes, on which nothing was tuned.

The mazes are drawn with a seed or provided by the user. One trial is one maze: plans with the
options of one person, taught in the default maze, and every baseline of ``humanopts demo`` play
every variant of the game there. The planning settings were chosen in the default maze. Mazes are
the independent units, so differences are paired by maze.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.intervals import Interval, level_of_each
from humanopts_learner.planning.request import PRIMITIVE
from humanopts_teach.evaluation.games import (
    baselines_of,
    every_baseline,
    PLAN,
    play_baseline,
)
from humanopts_teach.report.figures import Drawing
from humanopts_teach.report.pages import counted
import pandas as pd

from experiments import paper, report
from experiments.people import options_of, owners, PERSON, Study
from experiments.random_mazes import random_maze
from experiments.trials import Rows, Trial

NAME, DOMAIN = 'transfer', 'pacman'
TITLE = 'Transfer: options of one maze in others'
MAZES = 2  # per seed of the study
STEPS, GAMES = 100_000, 150  # game steps per plan; games per policy
COST = 60.0
KEYS = ['game', 'way to play']


def trials(study: Study) -> list[Trial]:
    """Return one trial per maze; the people take turns as teachers."""
    people = owners(study, DOMAIN)[PERSON]
    if not people:
        return []
    mazes = study.mazes or [
        random_maze(generator(study.seed, NAME, 'maze', number)).text
        for number in range(1, MAZES * study.seeds + 1)
    ]
    return [
        Trial(
            NAME,
            {
                'maze': maze,
                'number': number,
                'steps': STEPS,
                'games': GAMES,
                'seed': study.seed,
                **people[number % len(people)],
            },
            play_in_maze,
            COST,
        )
        for number, maze in enumerate(mazes, start=1)
    ]


def play_in_maze(parameters: Mapping[str, Any]) -> Rows:
    """
    Play in one maze with every policy.

    :return: one row per variant of the game and policy: maze (its number), text (of the maze),
        game, way to play (the policy), kind, score (mean over games), cleared (share) and the
        other outcomes, fallbacks (per game), seconds (of planning).
    """
    names = (*paper.TAUGHT[DOMAIN], *paper.ALSO_NAMED[DOMAIN], *paper.NOT_NAMED[DOMAIN])
    options = options_of(parameters, make_domain(DOMAIN), names).options
    number, text = parameters['number'], parameters['maze']
    maze = make_domain(DOMAIN, {'maze': text})
    seed = int(generator(parameters['seed'], NAME, number).integers(2**31))
    rows = []
    for game, changed in baselines_of(maze).variants.items():
        domain = make_domain(DOMAIN, {**maze.parameters, **changed})
        for baseline in every_baseline(domain, options, parameters['steps']):
            row = play_baseline(domain, baseline, seed, parameters['games'])
            del row['scores']
            means = {outcome: of['mean'] for outcome, of in row.pop('outcomes').items()}
            known = {'maze': number, 'text': text, 'game': game, 'way to play': row.pop('name')}
            rows.append({**known, **row, **means})
    return rows


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per policy and variant of a maze."""
    mazes = rows[['maze', 'text']].drop_duplicates('maze')
    scores = rows.drop(columns=['text', 'trial'], errors='ignore')
    means = [name for name in ('cleared', 'fallbacks', 'seconds') if name in scores]
    summary = report.mean_intervals(scores, KEYS, 'score').join(
        scores.groupby(KEYS)[means].mean(), on=KEYS
    )
    summary = summary.rename(columns={'count': 'mazes', 'mean': 'score'})
    tables = [
        report.Table('transfer-summary', 'Mean scores over the mazes', summary),
        report.Table('transfer-scores', 'Scores by maze', scores, shown=False),
        report.Table('transfer-mazes', 'The mazes', mazes, shown=False),
    ]
    pictures = [
        report.Picture(
            f'transfer-{game.rpartition("=")[2]}',
            f'Pac-Man, {game}: the dots are mazes, the bars means over them with 95 % intervals.',
            (7.6, 3.8),
            partial(_draw, mine),
        )
        for (game,), mine in report.grouped(scores, KEYS[:1])
    ]
    facts = {'steps': STEPS, 'games': GAMES}
    return report.Section(NAME, TITLE, _comparisons(scores), pictures, tables, facts)


def _comparisons(scores: pd.DataFrame) -> list[report.Comparison]:
    """
    Compare the interrupted plan of all options with chance, the rule and primitive actions.

    The intervals of the differences are simultaneous.
    """
    asked = []
    for (game,), rows in report.grouped(scores, ['game']):
        by_way = rows.pivot(index='maze', columns='way to play', values='score')
        plans = rows['kind'] == PLAN
        primitive = rows['way to play'] == PRIMITIVE
        plan = rows['way to play'][plans & ~primitive].iloc[-1]
        others = rows['way to play'][~plans | primitive].unique()
        asked += [(game, by_way[plan], by_way[other]) for other in others]
    found = []
    for game, plan, other in asked:
        more = Interval.of_difference(plan, other, level_of_each(len(asked)))
        values = {each.name: Interval.of(each) for each in (plan, other)}
        case = f'{game}, {counted(len(plan), "maze")}'
        said = f'Options that are planned with and interrupted score more than: {other.name}.'
        found.append(report.compare(said, more.above(), case, {**values, 'more': more}, ',.0f'))
    return found


def _draw(rows: pd.DataFrame, work: Drawing) -> None:
    style = {'ms': 3.5, 'alpha': 0.5}
    report.draw_samples(work.axes, rows, 'way to play', 'score', 'game', Interval.of, **style)
    work.axes.set(title=rows['game'].iloc[0], xlabel='mean score of a maze')
