"""
Figure 2: accuracy of learned options against the number of demonstrations (section 7.1).

*Policy accuracy* is here the share of states in the option's initiation set in which the learned
policy takes one of the best actions; the paper compares returns. *Classification accuracy* of I
and beta is the share of states that are classified as the reference option does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
import math
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.intervals import all_hold, any_holds, Interval
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.start_states import STRATEGIES
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.measures import accuracies
from humanopts_teach.lesson.in_process import SECONDS, teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import matplotlib
from matplotlib.ticker import MaxNLocator, PercentFormatter
import pandas as pd

from experiments import paper
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
from experiments.trials import code_version, Trial

NAME = 'fig2'
TITLE = 'Figure 2: accuracy against demonstrations'
SHOWN = {'taxi': 60, 'pacman': 40}  # demonstrations of an option by one person
ASKED = 6  # most start states for each of those demonstrations, "not here" answers included
GROUPS = {'taxi': (CAREFUL, VARIED), 'pacman': (VARIED,)}
PEOPLE = 'people'  # the group of those in bags
COSTS = {  # of a trial by domain and strategy; others: 1
    ('pacman', 'random'): 4.0,
    ('pacman', 'coverage'): 20.0,
    ('pacman', 'failures'): 12.0,
}
CASE = ['domain', 'option', 'people', 'start states by']  # columns that tell curves apart
MEASURES = {  # of accuracy, with the titles of their plots
    'policy': 'policy',
    'initiation': 'I (may it start?)',
    'termination': 'β (does it end?)',
}
LEVELS = (0.95, 1.0)  # of policy accuracy; the report says how many demonstrations they take
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
                'domain': domain,
                'option': option,
                'strategy': strategy,
                'demonstrations': SHOWN[domain],
                'person': asdict(person),
            },
            learn_from_simulated,
            COSTS.get((domain, strategy), 1.0),
        )
        for domain, options in paper.TAUGHT.items()
        for group in GROUPS[domain]
        for person in participants(group, study.participants, study.seed)
        for option in options
        for strategy in STRATEGIES
    ]


def learn_from_simulated(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Have a simulated participant teach an option, and measure it after every demonstration.

    :return: points [demonstrations, "not here" answers, policy accuracy, that of I, that of beta],
        the person's seconds, and why the lesson was cut short (empty: it was not).
    """
    person = Participant(**parameters['person'])
    domain = make_domain(parameters['domain'])
    name, wanted = parameters['option'], parameters['demonstrations']
    reference, points = reference_options(domain)[name], []

    def measure(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        points.append(_point(option, accuracies(option, domain, reference)))
        return bool(option.n_demonstrations >= wanted)

    rules = LessonRules(
        parameters['strategy'], ASKED * wanted, person.seed, until_no_failures=False
    )
    taught = teach(domain, person.teaching(name), rules, measure)
    return {'points': points, 'seconds': taught.seconds, 'cut_short': taught.cut_short}


def learn_again(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Learn an option again from the demonstrations in a bag; see ``learn_from_simulated``."""
    lesson = BagLesson(**parameters)
    bag = open_bag(Path(lesson.bag))
    domain = read_domain(bag)
    demos = taught_in(bag, domain)[lesson.participant, lesson.option]
    reference, points = reference_options(domain).get(lesson.option), []
    for count in range(1, len(demos) + 1):
        if any(demo.kind is Kind.TRAJECTORY for demo in demos[:count]):
            option = learn_option(demos[:count], domain, lesson.seed)
            points.append(_point(option, accuracies(option, domain, reference)))
    seconds = sum(demo.seconds for demo in demos)
    return {'points': points, 'seconds': seconds, 'cut_short': ''}


def _point(option: LearnedOption, measured: Sequence[float | None]) -> list[float | None]:
    return [option.n_demonstrations, option.n_not_here, *measured]


def accuracy_table(done: Done) -> pd.DataFrame:
    """
    Return a row for each person and number of demonstrations.

    Options that have no reference to compare with are left out.

    :return: ``CASE``, person, demonstrations, not here (answers so far), accuracies by
        ``MEASURES``, and of the whole lesson: minutes, cut short (why; empty: it was not).
    """
    counts = ['demonstrations', 'not here']
    columns = [*CASE, 'person', *counts, *MEASURES, 'minutes', 'cut short']
    rows = [
        [
            *(parameters[name] for name in ('domain', 'option')),
            parameters['person']['group'] if 'person' in parameters else PEOPLE,
            parameters['strategy'],
            parameters['person']['code'] if 'person' in parameters else parameters['participant'],
            *point,
            result['seconds'] / 60,
            result['cut_short'],
        ]
        for parameters, result in done
        for point in result['points']
        if any(known[2] is not None for known in result['points'])
    ]
    points = pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(MEASURES, float))
    # a "not here" answer changes the point of the demonstrations so far
    return points.drop_duplicates([*CASE, 'person', 'demonstrations'], keep='last')


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """Return mean accuracies and their intervals over people: the numbers that are drawn."""
    long = points.melt([*CASE, 'person', 'demonstrations'], list(MEASURES), 'measure', 'accuracy')
    by = [*CASE, 'measure', 'demonstrations']
    curves = mean_intervals(long, by, 'accuracy', 0.0, 1.0)
    return _case_by_case(curves)


def person_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return a row for each person.

    :return: ``CASE``, person, for each of ``LEVELS`` the demonstrations and start states ("not
        here" answers included) until it was first reached, the last accuracies, shown (all
        demonstrations), minutes, cut short.
    """
    keys = [*CASE, 'person']
    people = points.groupby(keys, sort=False).tail(1).set_index(keys)
    people = people.rename(columns={name: f'last accuracy of {name}' for name in MEASURES})
    people['shown'] = people.pop('demonstrations')
    people = people.drop(columns='not here')
    reached = {}
    for level in LEVELS:
        first = points[points['policy'] >= level - 1e-12].groupby(keys, sort=False).first()
        asked = first['demonstrations'] + first['not here']
        for name, values in (('demonstrations', first['demonstrations']), ('start states', asked)):
            reached[f'{name} for {level:.0%}'] = values.reindex(people.index).astype('Int64')
    return _case_by_case(pd.concat([pd.DataFrame(reached), people], axis=1).reset_index())


def _case_by_case(frame: pd.DataFrame) -> pd.DataFrame:
    """Return all rows of the first case, then those of the next."""
    order = frame.groupby(CASE, sort=False).ngroup()
    return frame.iloc[order.argsort(kind='stable')].reset_index(drop=True)


def needed_table(people: pd.DataFrame) -> pd.DataFrame:
    """
    Return the demonstrations that people needed for ``LEVELS`` of policy accuracy.

    Where somebody did not, the mean is at least that with all demonstrations that were shown.
    """
    rows = []
    for key, members in grouped(people, CASE):
        row = {**dict(zip(CASE, key)), 'count': len(members)}
        for level in LEVELS:
            demonstrations = members[f'demonstrations for {level:.0%}']
            asked = members[f'start states for {level:.0%}']
            reached, longest = int(demonstrations.notna().sum()), members['shown'].max()
            mean = float(demonstrations.fillna(longest).mean())
            text = f'{mean:.1f}'
            if reached < len(members):
                text = f'over {text} ({reached} of {len(members)} people)'
            row[f'demonstrations for {level:.0%}'] = text if reached else f'not within {longest}'
            row[f'people who reached {level:.0%}'] = reached
            complete = reached == len(members)
            row[f'start states for {level:.0%}'] = round(asked.mean(), 1) if complete else None
        rows.append({**row, 'minutes': round(members['minutes'].mean(), 2)})
    return pd.DataFrame(rows)


def present(done: Done) -> Section:
    """Return the section of the report."""
    points = accuracy_table(done)
    curves, people = curve_table(points), person_table(points)
    needed = needed_table(people)
    hidden = ['shown', *(f'start states for {level:.0%}' for level in LEVELS)]
    return Section(
        NAME,
        TITLE,
        [*_compare_cases(points, people, needed), *_compare_minutes(people)],
        _pictures(curves),
        [
            Table('fig2-needed', 'Demonstrations needed for a policy accuracy', needed),
            Table('fig2-curves', 'The curves', curves, shown=False),
            Table('fig2-people', 'Each person', people.drop(columns=hidden), shown=False),
        ],
        {'code': code_version(), 'shown': SHOWN, 'pace': PACE},
    )


def _compare_cases(
    points: pd.DataFrame, people: pd.DataFrame, needed: pd.DataFrame
) -> list[Comparison]:
    found = []
    for key, members in grouped(people, CASE):
        domain, option, group, strategy = key
        row = needed[(needed[CASE] == list(key)).all(axis=1)].iloc[0]
        case = f'{domain}, “{option}”, start states by {strategy}'
        if _as_in_paper(group, strategy) and paper.FIGURE_2_OPTIONS.get(domain) == option:
            mine = points[(points[CASE] == list(key)).all(axis=1)]
            found += _compare_accuracies(case, mine, row)
        if group == CAREFUL and domain == 'taxi':
            found += _compare_needed(case, strategy, members, row)
    return found


def _compare_accuracies(case: str, points: pd.DataFrame, row: pd.Series) -> list[Comparison]:
    """Compare how accuracy rises, within each person, and where it comes to in the end."""
    policy = points.pivot(index='person', columns='demonstrations', values='policy')
    last = min(paper.DEMONSTRATIONS, int(policy.columns.max()))
    # a person who began with "not here" answers alone, or showed fewer, has no pair
    pairs = policy.reindex(columns=[1, last]).dropna().to_numpy()
    first, then = pairs[:, 0], pairs[:, -1]
    gain = Interval.of_difference(then, first)
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
            f'{case}: policy accuracy {first.mean():.1%} after 1, {then.mean():.1%} '
            f'after {last}; gain within a person {written(gain, ".1%")}; '
            f'95% after: {row["demonstrations for 95%"]}',
            gain.above(),
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

    Who did not reach the level counts with all that were shown, so that their number can only
    be too low then: it may refute that few are needed, and never shows it.
    """
    found = []
    for level in LEVELS:
        demonstrations = members[f'demonstrations for {level:.0%}']
        complete = bool(demonstrations.notna().all())
        needed = Interval.of(demonstrations.fillna(members['shown']).astype(float))
        text = f'{case}, people without errors: {row[f"demonstrations for {level:.0%}"]}'
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


def _compare_minutes(people: pd.DataFrame) -> list[Comparison]:
    """Compare the time that people took for all that they showed."""
    found = []
    for domain, most in paper.MINUTES.items():
        mine = people[people['domain'] == domain]
        mine = mine[[_as_in_paper(*key) for key in mine[CASE[2:]].itertuples(index=False)]]
        if len(mine):
            lessons = mine.groupby(['person', 'start states by'])['minutes'].sum()
            taken = Interval.of(lessons.groupby('person').mean())
            real = bool((mine['people'] == PEOPLE).all())
            text = f'{domain}: {written(taken, ".1f")} min, ' + (
                'by the clock' if real else 'at an assumed pace'
            )
            said = paper.FIGURE_2[f'minutes in {domain}']
            found.append(
                compared(said, text, taken.at_most(most))
                if real
                else Comparison(said.text, said.where, text, Mark.NOT_COMPARABLE)
            )
    return found


def _as_in_paper(group: str, strategy: str) -> bool:
    """Return whether real people taught, or varied simulated ones from random start states."""
    return group == PEOPLE or (group, strategy) == (VARIED, 'random')


def _pictures(curves: pd.DataFrame) -> list[Picture]:
    """Return one figure for each option and group, with a line for each strategy."""
    return [
        Picture(
            re.sub(r'[^a-z0-9]+', '-', f'fig2-{domain}-{option}-{group}'.lower()),
            f'Accuracy of {option} in {domain} by demonstrations, {group} people',
            (10.0, 2.9),
            partial(_draw, shown),
            f'{domain}: “{option}”, {GROUP_NAMES[group]}'
            + (' (figure 2)' if paper.FIGURE_2_OPTIONS.get(domain) == option else ''),
        )
        for (domain, option, group), shown in grouped(curves, CASE[:3])
    ]


def _draw(shown: pd.DataFrame, work: Drawing) -> None:
    plots = work.figure.subplots(1, 3, sharey=True)
    for axes, (measure, title) in zip(plots, MEASURES.items()):
        mine = shown[shown['measure'] == measure]
        draw_curves(axes, mine, 'start states by', 'demonstrations', STYLES, lw=1.5)
        muted = matplotlib.rcParams['axes.edgecolor']
        axes.axvline(paper.DEMONSTRATIONS, color=muted, ls=':', lw=1)
        axes.set(title=title, xlabel='demonstrations', ylim=(None, 1.02))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    plots[0].set_ylabel('share of states')
    plots[0].legend(loc='lower right')
