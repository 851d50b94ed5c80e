"""
Figure 2: accuracy of learned options against the number of demonstrations (section 7.1).

A policy has two measures. *Average return* is the paper's: that of runs from states in the
option's initiation set. *Policy accuracy* is the share of these states in which the learned policy
takes one of the best actions. *Classification accuracy* of I and beta is the share of states that
are classified as the reference option does.

Pac-Man is taught with both lists of its features: directions hand the policy over, and positions
are what the paper names. From random start states other classifiers learn from the same
demonstrations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
import json
import math
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import domain_from_json, reference_options
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.intervals import all_hold, any_holds, Interval
from humanopts_learner.options.accuracy import average_returns, LONGEST
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.start_states import STRATEGIES
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.measures import accuracies, finite
from humanopts_teach.lesson.in_process import SECONDS, teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import matplotlib
from matplotlib.ticker import MaxNLocator, PercentFormatter
import pandas as pd

from experiments import paper
from experiments.learners import cloned_accuracies, FOREST, NEIGHBOUR
from experiments.people import (
    BagLesson,
    CAREFUL,
    Participant,
    participants,
    Study,
    taught_in,
    VARIED,
)
from experiments.report import (
    compared,
    Comparison,
    Done,
    draw_curves,
    goal,
    grouped,
    listed,
    Mark,
    mean_intervals,
    Picture,
    Section,
    Table,
    written,
)
from experiments.trials import Trial

NAME = 'fig2'
TITLE = 'Figure 2: accuracy against demonstrations'
EVERY = 10  # demonstrations, after each of which other classifiers learn
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
    strategies: tuple[str, ...]  # of start states
    note: str = ''  # on the features, for captions


DIRECTIONS, POSITIONS = 'directions', 'positions (features=paper)'  # names of lists of features
GAMES = (
    TaughtGame('taxi', 'all', '{}', 60, (CAREFUL, VARIED), STRATEGIES),
    TaughtGame(
        'pacman',
        DIRECTIONS,
        '{}',
        40,
        (VARIED,),
        STRATEGIES,
        'These features are first moves of shortest paths: they hand the policy over.',
    ),
    TaughtGame(
        'pacman',
        POSITIONS,
        '{"features": "paper"}',
        60,
        (VARIED,),
        ('random',),
        'These features are positions only, as in the list of the paper.',
    ),
)
COSTS = {  # of a trial, about processor seconds, by domain and strategy
    ('taxi', 'random'): 2.0,
    ('taxi', 'coverage'): 3.0,
    ('taxi', 'failures'): 1.5,
    ('pacman', 'random'): 6.0,
    ('pacman', 'coverage'): 18.0,
    ('pacman', 'failures'): 7.0,
}
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
NEAR = 10  # demonstrations by which "about 40" may be missed
STYLES = {'random': ('C1', '--'), 'coverage': ('C3', '-.'), 'failures': ('C0', '-')}
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
            COSTS[game.domain, strategy],
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
        others (rows of demonstrations and the policy accuracy of each other classifier; where
        start states are random), the person's seconds, and why the lesson was cut short (empty:
        it was not).
    """
    person = Participant(**parameters['person'])
    domain = domain_from_json(parameters['domain'], parameters['domain_parameters'])
    name, wanted = parameters['option'], parameters['demonstrations']
    reference, others = reference_options(domain)[name], []
    learned: dict[int, LearnedOption] = {}  # by demonstrations: later "not here" answers count in

    def measure(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        learned[option.n_demonstrations] = option
        if parameters['strategy'] == 'random' and shown[-1].kind is Kind.TRAJECTORY:
            others.extend(_others(option, shown, domain, reference, person.seed))
        return bool(option.n_demonstrations >= wanted)

    rules = LessonRules(
        parameters['strategy'], ASKED * wanted, person.seed, until_no_failures=False
    )
    taught = teach(domain, person.teaching(name), rules, measure)
    measured = _measured(list(learned.values()), domain, reference)
    told = {'seconds': taught.seconds, 'cut_short': taught.cut_short}
    return {**measured, 'others': others, **told}


def learn_again(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Learn an option again from the demonstrations in a bag; see ``learn_from_simulated``."""
    lesson = BagLesson(**parameters)
    bag = open_bag(Path(lesson.bag))
    domain = read_domain(bag)
    demos = taught_in(bag, domain)[lesson.participant, lesson.option]
    reference, others = reference_options(domain).get(lesson.option), []
    learned: dict[int, LearnedOption] = {}
    for count in range(1, len(demos) + 1):
        if any(demo.kind is Kind.TRAJECTORY for demo in demos[:count]):
            option = learn_option(demos[:count], domain, lesson.seed)
            learned[option.n_demonstrations] = option
            if reference and demos[count - 1].kind is Kind.TRAJECTORY:
                others += _others(option, demos[:count], domain, reference, lesson.seed)
    measured = _measured(list(learned.values()), domain, reference)
    told = {'seconds': sum(demo.seconds for demo in demos), 'cut_short': ''}
    return {**measured, 'others': others, **told}


def _measured(
    options: Sequence[LearnedOption], domain: Domain[Any], reference: ReferenceOption | None
) -> dict[str, Any]:
    """Return the point of each option, and the best return; without a reference, None for it."""
    returns: list[float | None] = [None] * (len(options) + 1)
    if reference:
        returns = [finite(each) for each in average_returns([*options, None], domain, reference)]
    points = [
        [option.n_demonstrations, option.n_not_here, its, *accuracies(option, domain, reference)]
        for option, its in zip(options, returns)
    ]
    return {'points': points, 'best_return': returns[-1]}


def _others(
    option: LearnedOption,
    shown: Sequence[Demonstration],
    domain: Domain[Any],
    reference: ReferenceOption,
    seed: int,
) -> list[dict[str, float]]:
    """Return a row of other classifiers' policy accuracies after every tenth demonstration."""
    if option.n_demonstrations % EVERY:
        return []
    found = cloned_accuracies(shown, domain, reference, seed)
    return [{'demonstrations': option.n_demonstrations, **found}]


def accuracy_table(done: Done) -> pd.DataFrame:
    """
    Return a row for each person and number of demonstrations.

    Options that have no reference to compare with are left out.

    :return: ``CASE``, person, demonstrations, not here (answers so far), ``MEASURES``, and of the
        whole lesson: best return (of the reference option), minutes, cut short (why; empty: it was
        not).
    """
    counts = ['demonstrations', 'not here']
    columns = [*CASE, 'person', *counts, *MEASURES, 'best return', 'minutes', 'cut short']
    rows = [
        [
            *_case(parameters),
            _code(parameters),
            *point,
            result['best_return'],
            result['seconds'] / 60,
            result['cut_short'],
        ]
        for parameters, result in done
        for point in result['points']
        if any(known[3] is not None for known in result['points'])
    ]
    numbers = dict.fromkeys([*MEASURES, 'best return'], float)
    points = pd.DataFrame(rows, columns=columns).astype(numbers)
    # a "not here" answer changes the point of the demonstrations so far
    return points.drop_duplicates([*CASE, 'person', 'demonstrations'], keep='last')


def _case(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the values of ``CASE`` of a trial."""
    group = parameters['person']['group'] if 'person' in parameters else PEOPLE
    domain, features = parameters['domain'], _features(parameters)
    return domain, features, parameters['option'], group, parameters['strategy']


def _code(parameters: Mapping[str, Any]) -> str:
    """Return the code of the person of a trial."""
    person = parameters.get('person', {'code': parameters.get('participant')})
    return str(person['code'])


def _features(parameters: Mapping[str, Any]) -> str:
    """Return the name of the list of features that a trial has."""
    named = json.loads(parameters['domain_parameters']).get('features')
    known = {(g.domain, json.loads(g.parameters).get('features')): g.features for g in GAMES}
    return known.get((parameters['domain'], named), 'all')


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return the numbers that are drawn: means and their intervals over people.

    :return: ``CASE``, measure, demonstrations, count, mean, low, high, best (of the measure).
    """
    best = points.groupby(CASE, sort=False)['best return'].mean().rename('best').reset_index()
    parts = []
    for measure in MEASURES:
        is_return = measure == RETURN
        limits = () if is_return else (0.0, 1.0)
        by = [*CASE, 'measure', 'demonstrations']
        found = mean_intervals(points.assign(measure=measure), by, measure, *limits)
        found = found.merge(best, on=CASE, how='left')
        parts.append(found if is_return else found.assign(best=1.0))
    return _case_by_case(pd.concat(parts, ignore_index=True))


def person_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return a row for each person.

    :return: ``CASE``, person, for each of ``LEVELS`` the demonstrations and start states ("not
        here" answers included) until it was first reached, and until it was reached for good: it
        held after every later demonstration; the last measures, best return, shown (all
        demonstrations), minutes, cut short.
    """
    keys = [*CASE, 'person']
    people = points.groupby(keys, sort=False).tail(1).set_index(keys)
    accuracies = {name: f'last accuracy of {name}' for name in MEASURES}
    people = people.rename(columns={**accuracies, RETURN: 'last return'})
    people['shown'] = people.pop('demonstrations')
    people = people.drop(columns='not here')
    reached = {}
    for level in LEVELS:
        reaches = points['policy'] >= level - 1e-12
        later = reaches[::-1].astype(int).groupby([points[key] for key in keys]).cummin()
        holds = later[::-1] == 1
        for crossing, there in ((REACHED, reaches), (HELD, holds)):
            first = points[there].groupby(keys, sort=False).first()
            asked = first['demonstrations'] + first['not here']
            for name, values in (
                ('demonstrations', first['demonstrations']),
                ('start states', asked),
            ):
                column = f'{name} for {level:.0%}, {crossing}'
                reached[column] = values.reindex(people.index).astype('Int64')
    return _case_by_case(pd.concat([pd.DataFrame(reached), people], axis=1).reset_index())


def _case_by_case(frame: pd.DataFrame) -> pd.DataFrame:
    """Return all rows of the first case, then those of the next."""
    order = frame.groupby(CASE, sort=False).ngroup()
    return frame.iloc[order.argsort(kind='stable')].reset_index(drop=True)


def needed_table(people: pd.DataFrame) -> pd.DataFrame:
    """
    Return the demonstrations that people needed for ``LEVELS`` of policy accuracy.

    A level that was reached can be lost again by a demonstration that misleads, so that there are
    two numbers: until it was reached first, and for good. Where somebody did not, the mean is at
    least that with all demonstrations that were shown.
    """
    rows = []
    for key, members in grouped(people, CASE):
        row = {**dict(zip(CASE, key)), 'count': len(members)}
        for case in CROSSINGS:
            demonstrations = members[f'demonstrations for {case}']
            asked = members[f'start states for {case}']
            reached, longest = int(demonstrations.notna().sum()), members['shown'].max()
            mean = float(demonstrations.fillna(longest).mean())
            text = f'{mean:.1f}'
            if reached < len(members):
                text = f'over {text} ({reached} of {len(members)} people)'
            row[f'demonstrations for {case}'] = text if reached else f'not within {longest}'
            complete = reached == len(members)
            row[f'start states for {case}'] = round(asked.mean(), 1) if complete else None
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


def learner_table(done: Done, points: pd.DataFrame) -> pd.DataFrame:
    """
    Return the policy accuracies of the tree and of other classifiers, means over people.

    :return: ``CASE``, demonstrations, count (of people), tree, each other classifier, and the
        forest's less the tree's, with its interval, paired by person.
    """
    keys = [*CASE, 'person', 'demonstrations']
    rows = [
        dict(zip(keys, [*_case(parameters), _code(parameters)])) | row
        for parameters, result in done
        for row in result['others']
    ]
    if not rows:
        return pd.DataFrame(columns=[*CASE, 'demonstrations'])
    each = pd.DataFrame(rows).merge(points[[*keys, 'policy']], on=keys)
    each['more'] = each[FOREST] - each['policy']
    by = [*CASE, 'demonstrations']
    found = each.groupby(by, sort=False)[['policy', NEIGHBOUR, FOREST]].mean()
    found.insert(0, 'count', each.groupby(by, sort=False)['person'].nunique())
    gain = mean_intervals(each, by, 'more').set_index(by)[['mean', 'low', 'high']]
    gain.columns = ['forest less tree', 'low', 'high']
    return found.rename(columns={'policy': 'tree'}).join(gain).round(3).reset_index()


def present(done: Done) -> Section:
    """Return the section of the report."""
    points = accuracy_table(done)
    curves, people = curve_table(points), person_table(points)
    needed = needed_table(people)
    hidden = ['shown', *(f'start states for {case}' for case in CROSSINGS)]
    return Section(
        NAME,
        TITLE,
        [*_compare_cases(points, people, needed), *_compare_minutes(people)],
        _pictures(curves),
        [
            Table('fig2-needed', 'Demonstrations needed for a policy accuracy', needed),
            Table('fig2-last', 'After the last demonstration', last_table(curves)),
            Table(
                'fig2-learners',
                'Best actions of other classifiers from the same demonstrations',
                learner_table(done, points),
            ),
            Table('fig2-curves', 'The curves', curves, shown=False),
            Table('fig2-people', 'Each person', people.drop(columns=hidden), shown=False),
        ],
        {
            'shown': {f'{game.domain}, {game.features}': game.shown for game in GAMES},
            'pace': PACE,
            'longest': LONGEST,
        },
    )


def _compare_cases(
    points: pd.DataFrame, people: pd.DataFrame, needed: pd.DataFrame
) -> list[Comparison]:
    found = []
    for key, members in grouped(people, CASE):
        domain, features, option, group, strategy = key
        row = needed[(needed[CASE] == list(key)).all(axis=1)].iloc[0]
        case = f'{_game(domain, features)}, “{option}”, start states by {strategy}'
        if _as_in_paper(group, strategy) and paper.FIGURE_2_OPTIONS.get(domain) == option:
            mine = points[(points[CASE] == list(key)).all(axis=1)]
            found += _compare_accuracies(case, mine, row)
        if group == CAREFUL and domain == 'taxi':
            found += _compare_needed(case, strategy, members, row)
    return found


def _compare_accuracies(case: str, points: pd.DataFrame, row: pd.Series) -> list[Comparison]:
    """Compare how return and best actions rise, within each person, and what I and beta are."""
    last = min(paper.DEMONSTRATIONS, int(points['demonstrations'].max()))
    gains, found = {}, {}
    for measure, style in ((RETURN, '.2f'), ('policy', '.1%')):
        values = points.pivot(index='person', columns='demonstrations', values=measure)
        # a person who began with "not here" answers alone, or showed fewer, has no pair
        pairs = values.reindex(columns=[1, last]).dropna().to_numpy()
        first, then = pairs[:, 0], pairs[:, -1]
        gains[measure] = Interval.of_difference(then, first)
        found[measure] = (
            f'{first.mean():{style}} after 1, {then.mean():{style}} after {last}, '
            f'gain within a person {written(gains[measure], style)}'
        )
    ends = points.groupby('person', sort=False).last()
    errors = {part: Interval.of(1 - ends[part].dropna()) for part in ('initiation', 'termination')}
    shown = points['demonstrations'].max()
    accuracies = {
        name: f'{1 - errors[part].mean:.1%} (error {written(errors[part], ".1%")})'
        for name, part in (('I', 'initiation'), ('β', 'termination'))
    }
    return [
        compared(
            paper.FIGURE_2['rises'],
            f'{case}: average return {found[RETURN]} (reference option '
            f'{points["best return"].mean():.2f}); best actions: {found["policy"]}; '
            f'95% after: {_needed(row, LEVELS[0])}',
            all_hold(gain.above() for gain in gains.values()),
        ),
        compared(
            paper.FIGURE_2['imperfect'],
            f'{case}: after {shown}: {listed(accuracies)}',
            any_holds(error.above(ROUNDING) for error in errors.values()),
        ),
    ]


def _compare_needed(
    case: str, strategy: str, members: pd.DataFrame, row: pd.Series
) -> list[Comparison]:
    """
    Compare the demonstrations that careful people needed with the paper's and our goals.

    Those count after which the level held for good. Who did not reach it counts with all that
    were shown, so that their number can only be too low then: it may refute that few are needed,
    and never shows it.
    """
    found = []
    for level in LEVELS:
        demonstrations = members[f'demonstrations for {level:.0%}, {HELD}']
        complete = bool(demonstrations.notna().all())
        needed = Interval.of(demonstrations.fillna(members['shown']).astype(float))
        text = f'{case}, people without errors: {_needed(row, level)}'
        if complete and not math.isnan(needed.low):
            text += f' ({needed.low:.1f} to {needed.high:.1f})'
        most = GOALS.get((strategy, level))
        if most is not None:
            said = f'{level:.0%} policy accuracy takes at most {most} demonstrations.'
            found.append(goal(said, text, _within(needed, complete, 0.0, most)))
        elif strategy == 'random' and level == LEVELS[0]:
            limits = paper.DEMONSTRATIONS - NEAR, paper.DEMONSTRATIONS + NEAR
            near = _within(needed, complete, *limits)
            found.append(compared(paper.FIGURE_2['forty'], text, near))
    return found


def _within(needed: Interval, complete: bool, least: float, most: float) -> bool | None:
    """Return whether a number lies within limits; not complete: it is one that it exceeds."""
    if not complete:
        return False if needed.at_most(most) is False else None
    return all_hold([needed.at_least(least), needed.at_most(most)])


def _needed(row: pd.Series, level: float) -> str:
    reached, held = (row[f'demonstrations for {level:.0%}, {name}'] for name in (REACHED, HELD))
    return str(reached) if reached == held else f'{reached} first, {held} for good'


def _game(domain: str, features: str) -> str:
    """Return the name of a game, with its list of features where it has several."""
    return domain if features == 'all' else f'{domain} with {features}'


def _compare_minutes(people: pd.DataFrame) -> list[Comparison]:
    """Compare the time that people took for all that they showed."""
    found = []
    like = [_as_in_paper(*key) for key in people[CASE[3:]].itertuples(index=False)]
    mine = people[pd.Series(like, index=people.index, dtype=bool)]
    for (domain, features), members in grouped(mine, CASE[:2]):
        if domain in paper.MINUTES:
            lessons = members.groupby(['person', 'start states by'])['minutes'].sum()
            taken = Interval.of(lessons.groupby('person').mean())
            real = bool((members['people'] == PEOPLE).all())
            text = f'{_game(domain, features)}: {written(taken, ".1f")} min, ' + (
                'by the clock' if real else 'at an assumed pace'
            )
            said = paper.FIGURE_2[f'minutes in {domain}']
            found.append(
                compared(said, text, taken.at_most(paper.MINUTES[domain]))
                if real
                else Comparison(said.text, said.where, text, Mark.NOT_COMPARABLE)
            )
    return found


def _as_in_paper(group: str, strategy: str) -> bool:
    """Return whether real people taught, or varied simulated ones from random start states."""
    return group == PEOPLE or (group, strategy) == (VARIED, 'random')


def _pictures(curves: pd.DataFrame) -> list[Picture]:
    """Return one figure for each option and group, with a line for each strategy."""
    notes = {(game.domain, game.features): game.note for game in GAMES}
    return [
        Picture(
            re.sub(r'[^a-z0-9]+', '-', f'fig2-{domain}-{known}{option}-{group}'.lower()),
            f'Accuracy of {option} in {_game(domain, features)} by demonstrations, {group} people',
            (13.0, 2.9),
            partial(_draw, shown),
            f'{_game(domain, features)}: “{option}”, {GROUP_NAMES[group]}'
            + (' (figure 2)' if paper.FIGURE_2_OPTIONS.get(domain) == option else '')
            + f'. {notes.get((domain, features), "")}'.rstrip(),
        )
        for (domain, features, option, group), shown in grouped(curves, CASE[:4])
        for known in ['positions-' if features == POSITIONS else '']
    ]


def _draw(shown: pd.DataFrame, work: Drawing) -> None:
    plots = work.figure.subplots(1, len(MEASURES))
    muted = matplotlib.rcParams['axes.edgecolor']
    for axes, (measure, title) in zip(plots, MEASURES.items()):
        mine = shown[shown['measure'] == measure]
        draw_curves(axes, mine, 'start states by', 'demonstrations', STYLES, lw=1.5)
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
