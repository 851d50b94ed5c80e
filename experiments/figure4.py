"""
Figure 4: steps per episode of Q-learning in Taxi, by action set (section 7.3).

A member is one person's options, or those of one extraction, or none, learned with by several
learners; the members of a trial learn side by side. Every action set has the same budget: as many
rates are tried, in as many runs, and the best of them learn anew with other random draws.
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
import pandas as pd

from experiments import paper, people, report
from experiments.trials import Trial

NAME, DOMAIN = 'fig4', 'taxi'
TITLE = 'Figure 4: steps per episode of Q-learning'
SETS = {  # by name: kind of owner of the options, action set of the learner, colour and line
    'primitive': (people.NOBODY, PRIMITIVE, 'C0-'),
    'human': (people.PERSON, HUMAN, 'C1--'),
    'automatic': (people.MACHINE, AUTOMATIC, 'C2-.'),
    'human + primitive': (people.PERSON, HUMAN_AND_PRIMITIVE, 'C3:'),
    'automatic + primitive': (people.MACHINE, AUTOMATIC_AND_PRIMITIVE, 'C4-'),
}
METHODS = {'smdp': 'SMDP Q-learning', 'intra-option': 'intra-option Q-learning'}
LIMIT = 1000  # steps of an episode at most; the domain's own 200 would hide how long they get
TRIED, TRIALS = 10, 3  # rates that are tried, and learners for each
TOGETHER = 6  # members in one trial, at most
COST = 8.0  # of a member, about processor seconds
KEYS = ['method', 'action set']


def trials(study: people.Study) -> list[Trial]:
    """
    Return a trial for each method, action set, and up to ``TOGETHER`` members.

    Members learn side by side, since that takes a fraction of the time.
    """
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
        for name, (whose, *_) in SETS.items()
        for first in range(0, len(sources[whose]), TOGETHER)
        for members in [sources[whose][first : first + TOGETHER]]
    ]


def learn_curves(parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """
    Learn with one action set.

    :return: for each member: mean steps of the learners by episode, the rates, and the names of
        the options.
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
    judged = learn_in_step(
        domain,
        [Learners(table, [one] * parameters['learners']) for table, one in zip(tables, best)],
        settings,
        judging,
    )
    return [
        {
            'steps': learned.steps.mean(axis=0).tolist(),
            'learning_rate': one.learning_rate,
            'explore': one.explore,
            'options': [option.name for option in each],
        }
        for learned, one, each in zip(judged, best, options)
    ]


def episode_table(done: report.Done) -> pd.DataFrame:
    """
    Return a row for each episode of each member.

    :return: method, action set, member (its number among all), episode, steps, and of the member:
        options (how many), learning rate, exploring (share of decisions).
    """
    members = [(parameters, one) for parameters, found in done for one in found]
    rows = [
        {
            'method': METHODS[parameters['method']],
            'action set': parameters['set'],
            'member': member,
            'episode': range(1, len(one['steps']) + 1),
            'steps': one['steps'],
            'options': len(one['options']),
            'learning rate': one['learning_rate'],
            'exploring': one['explore'],
        }
        for member, (parameters, one) in enumerate(members)
    ]
    frame = pd.DataFrame(rows).explode(['episode', 'steps'], ignore_index=True)
    return frame.astype({'episode': int, 'steps': float})


def summary_table(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each method and action set: steps while learning, and the best rates."""
    rates = ['learning rate', 'exploring']
    members = episodes.groupby([*KEYS, 'member'], sort=False)
    totals = members.agg({'steps': 'sum', **dict.fromkeys(['options', *rates], 'first')})
    found = report.mean_intervals(totals.reset_index(), KEYS, 'steps', least=0.0).set_index(KEYS)
    found = found.rename(columns={'mean': 'steps in all'})
    means = totals.groupby(KEYS, sort=False)[['options', *rates]].mean()
    found.insert(1, 'options', means['options'])
    last = episodes['episode'].max()
    for name, part in (
        ('first 10 episodes', episodes[episodes['episode'] <= 10]),
        ('last 10', episodes[episodes['episode'] > last - 10]),
    ):
        found[name] = part.groupby(KEYS, sort=False)['steps'].mean()
    return found.join(means[rates]).reset_index()


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    episodes = episode_table(done)
    curves = report.mean_intervals(episodes, [*KEYS, 'episode'], 'steps', least=1.0)
    tables = [
        report.Table('fig4-summary', 'Steps while learning', summary_table(episodes)),
        report.Table('fig4-curves', 'The curves', curves, shown=False),
    ]
    facts = {'episodes': paper.EPISODES, 'limit': LIMIT, 'rates tried': TRIED}
    said, pictures = _comparisons(episodes), _pictures(curves)
    return report.Section(NAME, TITLE, said, pictures, tables, facts)


def _comparisons(episodes: pd.DataFrame) -> list[report.Comparison]:
    """
    Compare the steps of all episodes; people and extractions are independent units.

    Fewer steps alone do not say that anything was learned, so the first and the last episodes of
    human options stand beside them.
    """
    found = []
    last = episodes['episode'].max()
    totals = episodes.groupby([*KEYS, 'member'], sort=False)['steps'].sum().reset_index()
    for (method,), rows in report.grouped(totals, ['method']):
        steps = {name: mine['steps'] for (name,), mine in report.grouped(rows, ['action set'])}
        if {'human', 'automatic'} <= set(steps):
            fewer = Interval.of_difference(steps['automatic'], steps['human'], paired=False)
            values = {name: Interval.of(each) for name, each in steps.items()}
            case = f'{method}, steps in all {paper.EPISODES} episodes'
            own = episodes[(episodes['method'] == method) & (episodes['action set'] == 'human')]
            means = {
                'human in the first 10': own[own['episode'] <= 10]['steps'].mean(),
                'in the last 10': own[own['episode'] > last - 10]['steps'].mean(),
            }
            text = report.listed(case, {**values, 'automatic less human': fewer}, ',.0f')
            text += report.listed('; steps of an episode', means, '.1f')
            found.append(report.compared(paper.SAID['learning'], text, fewer.above()))
    return found


def _pictures(curves: pd.DataFrame) -> list[report.Picture]:
    """Return two figures for each method: the paper's action sets on its axis, and all sets."""
    return [
        report.Picture(
            f'fig4-{method}{suffix}',
            f'Steps per episode of {called} in Taxi by action set, {axis}',
            (6.4, 3.8),
            partial(_draw, curves[curves['method'] == called], called, bool(suffix)),
            f'Taxi, {called}, {axis}',
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
        axes.set_ylim(0, paper.MOST_STEPS)
    else:
        axes.set_yscale('log')
        axes.set_ylim(0.8 * curves['mean'].min(), 1.25 * curves['mean'].max())
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    work.figure.legend(loc='outside lower center', ncols=3)
