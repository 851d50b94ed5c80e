"""
Figure 4: steps per episode of Q-learning in Taxi, by action set (section 7.3).

A member is a set of options (from one person, from one extraction, or empty) with several
learners. The members of a trial learn in parallel, which saves time. Every action set has the same
budget: the same number of rates, each tried in the same number of runs. The best rates are then
used with new random draws.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import tabulate
from humanopts_learner.planning.exact_plan import option_table
from humanopts_learner.planning.request import (
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PRIMITIVE,
)
from humanopts_learner.qlearning import (
    best_rates_of_each,
    drawn_rates,
    learn_in_step,
    Learners,
    Method,
    Settings,
)
from humanopts_teach.report.figures import Drawing
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
import numpy as np
import pandas as pd

from experiments import paper, people, report
from experiments.trials import Rows, Trial

NAME, DOMAIN = 'fig4', 'taxi'
TITLE = 'Figure 4: steps per episode of Q-learning'
SETS = {  # by name: kind of owner of the options, action set of the learner, colour and line style
    'primitive': (people.NOBODY, PRIMITIVE, 'C0-'),
    'human': (people.PERSON, HUMAN, 'C1--'),
    'automatic': (people.MACHINE, AUTOMATIC, 'C2-.'),
    'human + primitive': (people.PERSON, HUMAN_AND_PRIMITIVE, 'C3:'),
    'automatic + primitive': (people.MACHINE, AUTOMATIC_AND_PRIMITIVE, 'C4-'),
}
METHODS = {'smdp': 'SMDP Q-learning', 'intra-option': 'intra-option Q-learning'}
LIMIT = 1000  # maximum steps per episode; the domain's limit of 200 would hide long episodes
TRIED, TRIALS = 10, 3  # number of rates to try, and of learners for each
TOGETHER = 6  # maximum number of members per trial
COST = 8.0  # approximate processor seconds per member
KEYS = ['method', 'action set']
FIRST, LAST, ALL = 'first 10 episodes', 'last 10', 'steps in all'


def trials(study: people.Study) -> list[Trial]:
    """Return one trial per method, action set, and up to ``TOGETHER`` members."""
    sources = people.owners(study, DOMAIN)
    return [
        Trial(
            NAME,
            {
                'set': name,
                'method': method,
                'learners': study.seeds,
                'episodes': paper.EPISODES,
                'seed': study.seed,
                'members': members,
            },
            learn_curves,
            COST * len(members),
        )
        for method in METHODS
        for name, (owner, *_) in SETS.items()
        for first in range(0, len(sources[owner]), TOGETHER)
        for members in [sources[owner][first : first + TOGETHER]]
    ]


def learn_curves(parameters: Mapping[str, Any]) -> Rows:
    """
    Learn with one action set.

    :return: one row per member: method, action set, options (number), rates, and steps (by
        episode, mean over the learners).
    """
    domain, chosen = Taxi(), SETS[parameters['set']][1]
    members = [{**parameters, **member} for member in parameters['members']]
    options = [
        [tabulate(option, domain) for option in people.options_of(member, domain).options]
        for member in members
    ]
    tables = [option_table(domain, chosen, each) for each in options]
    search, judging = (
        people.owner_seed(members[0], 'figure 4', purpose) for purpose in ('search', 'judging')
    )
    rates = drawn_rates(parameters['seed'], TRIED)
    settings = Settings(parameters['episodes'], Method(parameters['method']), max_steps=LIMIT)
    best = best_rates_of_each(domain, tables, rates, TRIALS, settings, search)
    learners = [
        Learners(table, [one] * parameters['learners']) for table, one in zip(tables, best)
    ]
    return [
        {
            'method': METHODS[parameters['method']],
            'action set': parameters['set'],
            'options': len(each),
            'learning rate': one.learning_rate,
            'exploring': one.explore,
            'steps': learned.steps.mean(axis=0).tolist(),
        }
        for each, one, learned in zip(
            options, best, learn_in_step(domain, learners, settings, judging)
        )
    ]


def present(members: pd.DataFrame) -> report.Section:
    """Return the report section; each row of ``members`` has the steps of all episodes."""
    steps = np.array(members['steps'].tolist())  # (members, episodes)
    parts = {ALL: steps.sum(1), FIRST: steps[:, :10].mean(1), LAST: steps[:, -10:].mean(1)}
    totals = members.assign(**parts)
    summary = report.mean_intervals(totals, KEYS, ALL, least=0.0)
    means = totals.groupby(KEYS, sort=False)[
        ['options', FIRST, LAST, 'learning rate', 'exploring']
    ].mean()
    episodes = members.explode('steps').astype({'steps': float})
    episodes['episode'] = episodes.groupby(level=0).cumcount() + 1
    curves = report.mean_intervals(episodes, [*KEYS, 'episode'], 'steps', least=1.0)
    tables = [
        report.Table(
            'fig4-summary',
            'Steps while learning',
            summary.rename(columns={'mean': ALL}).join(means, on=KEYS),
        ),
        report.Table('fig4-curves', 'The curves', curves, shown=False),
    ]
    facts = {'episodes': paper.EPISODES, 'limit': LIMIT, 'rates tried': TRIED}
    return report.Section(NAME, TITLE, _comparisons(totals), _pictures(curves), tables, facts)


def _comparisons(totals: pd.DataFrame) -> list[report.Comparison]:
    """
    Compare the total steps; people and extractions are the independent units.

    Fewer steps alone do not prove learning, so the result also gives the steps in the first and
    the last episodes with human options.
    """
    found = []
    for (method,), rows in report.grouped(totals, ['method']):
        by_set = {name: mine for (name,), mine in report.grouped(rows, ['action set'])}
        if {'human', 'automatic'} <= set(by_set):
            human, automatic = by_set['human'], by_set['automatic']
            fewer = Interval.of_difference(automatic[ALL], human[ALL], paired=False)
            values = {name: Interval.of(mine[ALL]) for name, mine in by_set.items()}
            values['automatic less human'] = fewer
            why = (
                f'steps of an episode: human in the first 10 {human[FIRST].mean():.1f}; '
                f'in the last 10 {human[LAST].mean():.1f}'
            )
            case = f'{method}, steps in all {paper.EPISODES} episodes'
            said = paper.SAID['learning']
            found.append(report.compare(said, fewer.above(), case, values, ',.0f', why))
    return found


def _pictures(curves: pd.DataFrame) -> list[report.Picture]:
    """Return two figures per method: the paper's action sets on the paper's axis, and all sets."""
    return [
        report.Picture(
            f'fig4-{method}{suffix}',
            f'Taxi, steps per episode of {called}, {axis}',
            (6.4, 3.8),
            partial(_draw, curves[curves['method'] == called], called, bool(suffix)),
        )
        for method, called in METHODS.items()
        if called in set(curves['method'])
        for suffix, axis in (('-paper', "on the paper's axis"), ('', 'all action sets'))
    ]


def _draw(curves: pd.DataFrame, title: str, as_in_paper: bool, work: Drawing) -> None:
    axes, lines = work.axes, {name: line for name, (*_, line) in SETS.items()}
    shown = curves[curves['action set'].isin(paper.CURVES)] if as_in_paper else curves
    report.draw_curves(axes, shown, 'action set', 'episode', lines, lw=1.4)
    axes.set(title=title, xlabel='episode', ylabel='steps per episode')
    if as_in_paper:
        axes.set_ylim(0, paper.MAX_STEPS)
    else:
        axes.set_yscale('log')
        axes.set_ylim(0.8 * curves['mean'].min(), 1.25 * curves['mean'].max())
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    work.figure.legend(loc='outside lower center', ncols=3)
