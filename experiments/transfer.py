"""
Transfer: options that were taught in one maze, in mazes that nobody has tuned anything on.

The mazes are drawn by seed, or are a user's own. One trial is one maze: the options of one person,
taught in the usual maze, plan and play there in every variant of the game, beside every baseline
of ``humanopts demo``. The settings of the plans are those that were found in the usual maze. Mazes
are the independent units, so differences are paired by maze.
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
    RANDOM,
    RULE,
)
from humanopts_teach.report.figures import Drawing
from humanopts_teach.report.pages import counted
import pandas as pd

from experiments import paper, report
from experiments.paper import Statement
from experiments.people import options_of, OwnedOptions, owners, PERSON, Study
from experiments.random_mazes import random_maze
from experiments.trials import Trial

NAME, DOMAIN = 'transfer', 'pacman'
TITLE = 'Transfer: options of one maze in others'
MAZES = 2  # for each seed of the study
STEPS, GAMES = 100_000, 150  # game steps of a plan; games that each way to play is judged by
COST = 60.0
KEYS = ['game', 'way to play']


def trials(study: Study) -> list[Trial]:
    """Return one trial for each maze; people take turns."""
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


def play_in_maze(parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each variant of the game and way to play: means over the games."""
    options = taught_in_usual_maze(parameters['teacher']).options
    maze = make_domain(DOMAIN, {'maze': parameters['maze']})
    seed = int(generator(parameters['seed'], NAME, parameters['number']).integers(2**31))
    rows = []
    for name, changed in baselines_of(maze).variants.items():
        domain = make_domain(DOMAIN, {**maze.parameters, **changed})
        for baseline in every_baseline(domain, options, parameters['steps']):
            row = dict(play_baseline(domain, baseline, seed, parameters['games']).row)
            outcomes = {outcome: of['mean'] for outcome, of in row.pop('outcomes').items()}
            rows.append({'game': name, 'way to play': row.pop('name'), **row, **outcomes})
    return rows


def taught_in_usual_maze(teacher: Mapping[str, Any]) -> OwnedOptions:
    """Return all that a person taught in the usual maze."""
    names = (*paper.TAUGHT[DOMAIN], *paper.ALSO_NAMED[DOMAIN], *paper.NOT_NAMED[DOMAIN])
    return options_of({'teacher': teacher}, make_domain(DOMAIN), names)


def score_table(done: report.Done) -> pd.DataFrame:
    """
    Return a row for each maze, variant of the game and way to play.

    :return: maze (its number), game, way to play, kind, score (mean of the games), cleared (share)
        and the other outcomes, fallbacks (of a game), seconds (of planning).
    """
    return pd.DataFrame({'maze': p['number'], **row} for p, result in done for row in result)


def summary_table(scores: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each variant and way to play: means over the mazes, score with limits."""
    found = report.mean_intervals(scores, KEYS, 'score')
    others = scores.columns.intersection(['cleared', 'fallbacks', 'seconds'], sort=False)
    found = found.join(scores.groupby(KEYS, sort=False)[list(others)].mean(), on=KEYS)
    return found.rename(columns={'count': 'mazes', 'mean': 'score'})


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    scores = score_table(done)
    mazes = pd.DataFrame([(p['number'], p['maze']) for p, _ in done], columns=['maze', 'text'])
    summary = summary_table(scores)
    tables = [
        report.Table('transfer-summary', 'Mean scores over the mazes', summary),
        report.Table('transfer-scores', 'Scores by maze', scores, shown=False),
        report.Table('transfer-mazes', 'The mazes', mazes, shown=False),
    ]
    facts, pictures = {'steps': STEPS, 'games': GAMES}, _pictures(scores)
    return report.Section(NAME, TITLE, _comparisons(scores), pictures, tables, facts)


def _by_maze(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Return the scores (mazes,) of each way to play in one game, in the order of the rows."""
    return {
        name: mine.set_index('maze')['score'] for (name,), mine in report.grouped(rows, KEYS[1:])
    }


def _comparisons(scores: pd.DataFrame) -> list[report.Comparison]:
    """
    Compare the plan with all options, interrupted, with chance, the rule and primitive actions.

    The intervals of the differences hold for all of these at once.
    """
    asked = []
    for (game,), rows in report.grouped(scores, ['game']):
        by_way = _by_maze(rows)
        kinds = dict(zip(rows['way to play'], rows['kind']))
        *_, plan = (name for name in by_way if kinds[name] == PLAN and name != PRIMITIVE)
        asked += [
            (game, by_way, plan, other)
            for other in by_way
            if kinds[other] in (RANDOM, RULE) or other == PRIMITIVE
        ]
    found = []
    for game, by_way, plan, other in asked:
        more = Interval.of_difference(by_way[plan], by_way[other], level_of_each(len(asked)))
        values = {name: Interval.of(by_way[name]) for name in (plan, other)}
        case = f'{game}, {counted(len(by_way[plan]), "maze")}'
        text = report.listed(case, {**values, 'more': more}, ',.0f')
        said = f'Options that are planned with and interrupted score more than: {other}.'
        found.append(report.compared(Statement(said, report.OURS), text, more.above()))
    return found


def _pictures(scores: pd.DataFrame) -> list[report.Picture]:
    return [
        report.Picture(
            f'transfer-{game.rpartition("=")[2]}',
            f'Scores by maze of every way to play Pac-Man, {game}',
            (7.6, 3.8),
            partial(_draw, _by_maze(rows), game),
            f'{game}: the dots are mazes, the bars means over the mazes with 95 % intervals.',
        )
        for (game,), rows in report.grouped(scores, ['game'])
    ]


def _draw(by_way: Mapping[str, pd.Series], game: str, work: Drawing) -> None:
    axes = work.axes
    for place, values in enumerate(by_way.values()):
        mean = Interval.of(values)
        axes.plot([mean.low, mean.high], [place, place], color='C1', lw=2)
        axes.plot(mean.mean, place, '|', color='C1', ms=12)
        axes.plot(values, [place] * len(values), 'o', ms=3.5, alpha=0.5, color='C0')
    axes.set_yticks(range(len(by_way)), list(by_way))
    axes.invert_yaxis()
    axes.set(title=game, xlabel='mean score of a maze')
    axes.grid(axis='x')
