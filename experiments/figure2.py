"""
Figure 2: accuracy of learned options against the number of demonstrations (section 7.1).

A policy has two measures. *Average return* is the paper's: that of runs from states in the
option's initiation set. *Policy accuracy* is the share of these states in which the learned policy
takes one of the best actions. *Classification accuracy* of I and beta is the share of states that
are classified as the reference option does.

Pac-Man is taught with both lists of its features: directions hand the policy over, and positions
are what the paper names.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
import json
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import domain_from_json, reference_options
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.intervals import all_hold, any_holds, Interval
from humanopts_learner.options.accuracy import average_returns, LONGEST
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.starts import STRATEGIES
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.tables import accuracies, finite
from humanopts_teach.lesson.in_process import SECONDS, teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import matplotlib
from matplotlib.ticker import MaxNLocator, PercentFormatter
import pandas as pd

from experiments import paper, report
from experiments.paper import Statement
from experiments.people import (
    BagLesson,
    CAREFUL,
    Participant,
    participants,
    Study,
    taught_in,
    VARIED,
)
from experiments.trials import Trial

NAME = 'fig2'
TITLE = 'Figure 2: accuracy against demonstrations'
ASKED = 6  # most start states for each demonstration, "not here" answers included
PEOPLE = 'people'  # the group of those in bags


@dataclass(frozen=True)
class TaughtGame:
    """What is taught of one game, with one list of features."""

    domain: str
    features: str  # name of the list
    parameters: str  # of the domain, JSON object
    shown: int  # demonstrations of an option by one person
    groups: tuple[str, ...]  # of people
    cost: float  # of a trial, about processor seconds
    strategies: tuple[str, ...] = STRATEGIES  # of start states
    note: str = ''  # on the features, for captions


DIRECTIONS, POSITIONS = 'directions', 'positions (features=paper)'  # names of lists of features
HANDED_OVER = 'These features are first moves of shortest paths: they hand the policy over.'
AS_LISTED = 'These features are positions only, as in the list of the paper.'
GAMES = (
    TaughtGame('taxi', 'all', '{}', 60, (CAREFUL, VARIED), cost=2.0),
    TaughtGame('pacman', DIRECTIONS, '{}', 40, (VARIED,), cost=10.0, note=HANDED_OVER),
    TaughtGame(
        *('pacman', POSITIONS, '{"features": "paper"}', 60, (VARIED,)),
        cost=6.0,
        strategies=('random',),
        note=AS_LISTED,
    ),
)
CASE = ['domain', 'features', 'option', 'people', 'start states by']  # what tells curves apart
RETURN = 'return'
MEASURES = {  # with the titles of their plots; all but the return are shares of states
    RETURN: 'policy: average return',
    'policy': 'policy: best actions',
    'initiation': 'I (may it start?)',
    'termination': 'β (does it end?)',
}
LEVELS = (0.95, 1.0)  # of policy accuracy; the report says how many demonstrations they take
REACHED, HELD = 'first', 'for good'  # crossings of a level: the first, and the last
CROSSINGS = tuple(f'{level:.0%}, {crossing}' for level in LEVELS for crossing in (REACHED, HELD))
GOALS = {('failures', 0.95): 15, ('failures', 1.0): 30}  # demonstrations at most, careful, Taxi
ROUNDING = 1e-9  # of an accuracy
STYLES = {'random': 'C1--', 'coverage': 'C3-.', 'failures': 'C0-'}
ACTS = ('name of an option', 'answer', 'start state', 'step', 'end of a demonstration')
PACE = dict(zip(ACTS, SECONDS.values(), strict=True))  # s, assumed
GROUP_NAMES = {
    CAREFUL: 'simulated people without errors',
    VARIED: 'simulated people who differ',
    PEOPLE: 'people',
}


def trials(study: Study) -> list[Trial]:
    """Return one trial for each person, option and strategy."""
    if study.bags:
        return [Trial(NAME, asdict(lesson), learn_again) for lesson in study.bags]
    return [
        Trial(
            NAME,
            {
                'domain': game.domain,
                'domain_parameters': game.parameters,
                'option': option,
                'strategy': strategy,
                'demonstrations': game.shown,
                'person': asdict(person),
            },
            learn_from_simulated,
            game.cost,
        )
        for game in GAMES
        for group in game.groups
        for person in participants(group, study.participants, study.seed)
        for option in paper.TAUGHT[game.domain]
        for strategy in game.strategies
    ]


def learn_from_simulated(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Have a simulated participant teach an option, and measure it after every demonstration.

    :return: points [demonstrations, "not here" answers, average return, policy accuracy, that of
        I, that of beta], the average return of the reference option (best return; None: unknown),
        the person's seconds, and why the lesson was cut short (empty: it was not).
    """
    person = Participant(**parameters['person'])
    domain = domain_from_json(parameters['domain'], parameters['domain_parameters'])
    name, wanted, strategy = (parameters[key] for key in ('option', 'demonstrations', 'strategy'))
    lesson: list[LearnedOption] = []

    def enough(_: Sequence[Demonstration], option: LearnedOption) -> bool:
        lesson.append(option)
        return bool(option.n_demonstrations >= wanted)

    rules = LessonRules(strategy, ASKED * wanted, person.seed, until_no_failures=False)
    taught = teach(domain, person.teaching(name), rules, enough)
    told = {'seconds': taught.seconds, 'cut_short': taught.cut_short}
    return _measured(lesson, domain, name) | told


def learn_again(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Learn an option again from the demonstrations in a bag; see ``learn_from_simulated``."""
    known = BagLesson(**parameters)
    bag = open_bag(Path(known.bag))
    domain = read_domain(bag)
    demos = taught_in(bag, domain)[known.participant, known.option]
    first = next(n for n, demo in enumerate(demos, start=1) if demo.kind is Kind.TRAJECTORY)
    counts = range(first, len(demos) + 1)
    lesson = [learn_option(demos[:count], domain, known.seed) for count in counts]
    told = {'seconds': sum(demo.seconds for demo in demos), 'cut_short': ''}
    return _measured(lesson, domain, known.option) | told


def _measured(lesson: Sequence[LearnedOption], domain: Domain[Any], name: str) -> dict[str, Any]:
    """Return points and best return; without a reference option, None for each."""
    learned = {option.n_demonstrations: option for option in lesson}  # the last of each number
    options, returns = [*learned.values()], list[float | None]([None] * (len(learned) + 1))
    if reference := reference_options(domain).get(name):
        returns = [finite(each) for each in average_returns([*options, None], domain, reference)]
    points = [
        [option.n_demonstrations, option.n_not_here, its, *accuracies(option, domain).values()]
        for option, its in zip(options, returns)
    ]
    return {'points': points, 'best_return': returns[-1]}


def accuracy_table(done: report.Done) -> pd.DataFrame:
    """
    Return a row for each person and number of demonstrations, case by case.

    Options that have no reference to compare with are left out.

    :return: ``CASE``, person, demonstrations, not here (answers so far), ``MEASURES``, and of the
        whole lesson: best return (of the reference option), minutes, cut short (why; empty: it was
        not).
    """
    names = ['demonstrations', 'not here', *MEASURES]
    rows = [
        _who(parameters)
        | dict(zip(names, point))
        | {
            'best return': result['best_return'],
            'minutes': result['seconds'] / 60,
            'cut short': result['cut_short'],
        }
        for parameters, result in done
        for point in result['points']
        if any(known[3] is not None for known in result['points'])
    ]
    columns = [*CASE, 'person', *names, 'best return', 'minutes', 'cut short']
    numbers = dict.fromkeys([*MEASURES, 'best return'], float)
    points = pd.DataFrame(rows, columns=columns).astype(numbers)
    # a "not here" answer changes the point of the demonstrations so far
    last = points.drop_duplicates([*CASE, 'person', 'demonstrations'], keep='last')
    return _case_by_case(last)


def _who(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the case and the person of a trial."""
    person = {'group': PEOPLE, 'code': parameters.get('participant')}
    person = parameters.get('person', person)
    domain, known = parameters['domain'], json.loads(parameters['domain_parameters'])
    lists = {
        game.features
        for game in GAMES
        if (game.domain, json.loads(game.parameters).get('features'))
        == (domain, known.get('features'))
    }
    case = [domain, *(lists or {'all'}), parameters['option'], person['group']]
    return dict(zip([*CASE, 'person'], [*case, parameters['strategy'], person['code']]))


def _case_by_case(frame: pd.DataFrame) -> pd.DataFrame:
    """Return all rows of the first case, then those of the next."""
    order = frame.groupby(CASE, sort=False).ngroup()
    return frame.iloc[order.argsort(kind='stable')].reset_index(drop=True)


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return the numbers that are drawn: means and their intervals over people.

    :return: ``CASE``, measure, demonstrations, count, mean, low, high, best (of the measure).
    """
    kept = [*CASE, 'demonstrations', 'best return']
    each = points.melt(kept, [*MEASURES], 'measure', 'value')
    found = report.mean_intervals(each, [*CASE, 'measure', 'demonstrations'], 'value')
    best = points.groupby(CASE, sort=False)['best return'].first().rename('best').reset_index()
    found = found.merge(best, on=CASE, how='left')
    shares = found['measure'] != RETURN
    found.loc[shares, 'low'] = found['low'].clip(lower=0.0)
    found.loc[shares, 'high'] = found['high'].clip(upper=1.0)
    found.loc[shares, 'best'] = 1.0
    return _case_by_case(found)


def person_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return a row for each person.

    :return: ``CASE``, person, for each of ``LEVELS`` the demonstrations until it was first
        reached, and until it was reached for good: it held after every later demonstration; the
        last measures, best return, minutes, cut short, shown (all demonstrations).
    """
    last = {name: f'last accuracy of {name}' for name in MEASURES} | {RETURN: 'last return'}
    rows = []
    for key, mine in report.grouped(points, [*CASE, 'person']):
        row: dict[str, Any] = dict(zip([*CASE, 'person'], key))
        for level in LEVELS:
            first = mine['policy'] >= level - 1e-12
            held = first[::-1].cummin()[::-1]
            for crossing, there in ((REACHED, first), (HELD, held)):
                at = mine[there]['demonstrations']
                row[f'{level:.0%}, {crossing}'] = next(iter(at), pd.NA)
        end = mine.iloc[-1].drop(list(row), errors='ignore')
        shown = end.pop('demonstrations')
        rows.append({**row, **end.drop('not here').rename(last), 'shown': shown})
    return pd.DataFrame(rows).astype(dict.fromkeys(CROSSINGS, 'Int64'))


def needed_table(people: pd.DataFrame) -> pd.DataFrame:
    """
    Return the demonstrations that people needed for ``LEVELS`` of policy accuracy.

    A level that was reached can be lost again by a demonstration that misleads, so that there are
    two numbers: until it was reached first, and for good. Where a person did not, the mean is at
    least that with all demonstrations that were shown.
    """
    rows = []
    for key, members in report.grouped(people, CASE):
        row = {**dict(zip(CASE, key)), 'count': len(members)}
        for case in CROSSINGS:
            reached, longest = int(members[case].notna().sum()), members['shown'].max()
            text = f'{members[case].fillna(longest).mean():.1f}'
            if reached < len(members):
                text = f'over {text} ({reached} of {len(members)} people)'
            row[f'demonstrations for {case}'] = text if reached else f'not within {longest}'
        rows.append({**row, 'minutes': round(members['minutes'].mean(), 2)})
    return pd.DataFrame(rows)


def last_table(curves: pd.DataFrame) -> pd.DataFrame:
    """Return what each measure came to in the end, with the average return of the reference."""
    last = curves.groupby([*CASE, 'measure'], sort=False).tail(1)
    wide = last.pivot(index=[*CASE, 'demonstrations'], columns='measure', values='mean')
    cases = last[last['measure'] == RETURN].set_index([*CASE, 'demonstrations'])['best']
    wide = wide.reindex(cases.index).assign(**{'best return': cases})
    wide = wide.reindex(columns=[RETURN, 'best return', *list(MEASURES)[1:]]).round(3)
    return _case_by_case(wide.rename_axis(columns=None).reset_index())


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    points = accuracy_table(done)
    curves, people = curve_table(points), person_table(points)
    needed = needed_table(people)
    each = people.drop(columns='shown')
    tables = [
        report.Table('fig2-needed', 'Demonstrations needed for a policy accuracy', needed),
        report.Table('fig2-last', 'After the last demonstration', last_table(curves)),
        report.Table('fig2-curves', 'The curves', curves, shown=False),
        report.Table('fig2-people', 'Each person', each, shown=False),
    ]
    said = [*_compare_cases(points, people, needed), *_compare_minutes(people)]
    shown = {f'{game.domain}, {game.features}': game.shown for game in GAMES}
    facts = {'shown': shown, 'pace': PACE, 'longest': LONGEST}
    return report.Section(NAME, TITLE, said, _pictures(curves), tables, facts)


def _compare_cases(
    points: pd.DataFrame, people: pd.DataFrame, needed: pd.DataFrame
) -> Iterator[report.Comparison]:
    for (key, members), (_, mine), (_, row) in zip(
        report.grouped(people, CASE), report.grouped(points, CASE), needed.iterrows()
    ):
        domain, features, option, group, strategy = key
        case = f'{_game(domain, features)}, “{option}”, start states by {strategy}'
        if _as_in_paper(group, strategy) and paper.FIGURE_2_OPTIONS.get(domain) == option:
            yield from _compare_accuracies(case, mine)
        if group == CAREFUL and domain == 'taxi':
            yield from _compare_needed(case, strategy, members, row)


def _compare_accuracies(case: str, points: pd.DataFrame) -> Iterator[report.Comparison]:
    """Yield how return and best actions rise, within each person, and what I and beta are."""
    most = int(points['demonstrations'].max())
    last, gains = min(paper.DEMONSTRATIONS, most), {}
    for measure in (RETURN, 'policy'):
        values = points.pivot(index='person', columns='demonstrations', values=measure)
        # a person who began with "not here" answers alone, or showed fewer, has no pair
        pairs = values.reindex(columns=[1, last]).dropna().to_numpy()
        gains[MEASURES[measure]] = Interval.of_difference(pairs[:, -1], pairs[:, 0])
    ends = points.groupby('person', sort=False).last()
    parts = ('initiation', 'termination')
    errors = {MEASURES[part]: Interval.of(1 - ends[part].dropna()) for part in parts}
    rises = report.listed(f'{case}, gain within a person from 1 to {last}', gains)
    wrong = report.listed(f'{case}, errors after {most}', errors)
    yield report.compared(paper.SAID['rises'], rises, all_hold(g.above() for g in gains.values()))
    verdict = any_holds(error.above(ROUNDING) for error in errors.values())
    yield report.compared(paper.SAID['imperfect'], wrong, verdict)


def _compare_needed(
    case: str, strategy: str, members: pd.DataFrame, row: pd.Series
) -> Iterator[report.Comparison]:
    """
    Yield the demonstrations that careful people needed beside the paper's and our goals.

    Those count after which the level held for good. Who did not reach it counts with all that
    were shown, so that their number can only be too low then: it may refute that few are needed,
    and never shows it. The paper names no level, so that nothing can be compared with its number.
    """
    for level in LEVELS:
        said = {name: row[f'demonstrations for {level:.0%}, {name}'] for name in (REACHED, HELD)}
        demonstrations = members[f'{level:.0%}, {HELD}']
        needed = Interval.of(demonstrations.fillna(members['shown']).astype(float))
        if demonstrations.notna().all():
            said[HELD] = needed
        if (strategy, level) in GOALS:
            most = GOALS[strategy, level]
            text = f'{level:.0%} policy accuracy takes at most {most} demonstrations.'
            verdict = False if needed.at_most(most) is False else None
            if demonstrations.notna().all():
                verdict = needed.at_most(most)
            found = report.listed(f'{case}, without errors', said, '.1f')
            yield report.compared(Statement(text, report.OURS), found, verdict)
        elif (strategy, level) == ('random', LEVELS[0]):
            shown = f'{case}, without errors; {paper.NO_LEVEL}; here for {level:.0%}'
            found = report.listed(shown, said, '.1f')
            yield report.compared(paper.SAID['forty'], found, report.Mark.NOT_COMPARABLE)


def _game(domain: str, features: str) -> str:
    """Return the name of a game, with its list of features where it has several."""
    return domain if features == 'all' else f'{domain} with {features}'


def _compare_minutes(people: pd.DataFrame) -> Iterator[report.Comparison]:
    """Yield the time that people took for all that they showed."""
    for (domain, features), members in report.grouped(people, CASE[:2]):
        like = [_as_in_paper(*key) for key in members[CASE[3:]].itertuples(index=False)]
        mine = members[like]
        if domain in paper.MINUTES and len(mine):
            lessons = mine.groupby(['person', 'start states by'])['minutes'].sum()
            taken = Interval.of(lessons.groupby('person').mean())
            real = bool((mine['people'] == PEOPLE).all())
            pace = 'minutes by the clock' if real else 'minutes at an assumed pace'
            verdict = taken.at_most(paper.MINUTES[domain]) if real else report.Mark.NOT_COMPARABLE
            text = report.listed(_game(domain, features), {pace: taken}, '.1f')
            yield report.compared(paper.SAID[f'minutes_in_{domain}'], text, verdict)


def _as_in_paper(group: str, strategy: str) -> bool:
    """Return whether real people taught, or varied simulated ones from random start states."""
    return group == PEOPLE or (group, strategy) == (VARIED, 'random')


def _pictures(curves: pd.DataFrame) -> list[report.Picture]:
    """Return one figure for each option and group, with a line for each strategy."""
    notes = {(game.domain, game.features): game.note for game in GAMES}
    return [
        report.Picture(
            re.sub(r'[^a-z0-9]+', '-', f'fig2-{domain}-{known}{option}-{group}'.lower()),
            f'Accuracy of {option} in {_game(domain, features)} by demonstrations, {group} people',
            (13.0, 2.9),
            partial(_draw, shown),
            f'{_game(domain, features)}: “{option}”, {GROUP_NAMES[group]}'
            + (' (figure 2)' if paper.FIGURE_2_OPTIONS.get(domain) == option else '')
            + f'. {notes.get((domain, features), "")}'.rstrip(),
        )
        for (domain, features, option, group), shown in report.grouped(curves, CASE[:4])
        for known in ['positions-' if features == POSITIONS else '']
    ]


def _draw(shown: pd.DataFrame, work: Drawing) -> None:
    plots = work.figure.subplots(1, len(MEASURES))
    muted = matplotlib.rcParams['axes.edgecolor']
    for axes, (measure, title) in zip(plots, MEASURES.items()):
        mine = shown[shown['measure'] == measure]
        report.draw_curves(axes, mine, 'start states by', 'demonstrations', STYLES, lw=1.5)
        axes.axvline(paper.DEMONSTRATIONS, color=muted, ls=':', lw=1)
        axes.set(title=title, xlabel='demonstrations')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        if measure == RETURN:
            axes.axhline(mine['best'].mean(), color=muted, lw=1, label='reference')
            continue
        axes.set(ylim=(None, 1.02))
        axes.sharey(plots[1])
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    plots[0].set_ylabel('reward units')
    plots[1].set_ylabel('share of states')
    plots[0].legend(loc='lower right')
