"""
Figure 2: accuracy of learned options by number of demonstrations (section 7.1).

*Average return* of a policy, as in the paper, is the mean return of runs from states in the
option's initiation set. *Policy accuracy* is the share of these states in which the learned policy
takes an optimal action. *Classification accuracy* of I and beta is the share of states in which
they agree with the reference option.

Pac-Man is taught with both of its feature lists: directions, which give the policy away, and
positions, as in the paper.
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
from humanopts_learner.options.accuracy import average_returns, MAX_RUN_STEPS
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.starts import STRATEGIES
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.tables import accuracies, finite
from humanopts_teach.lesson.in_process import SECONDS, teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
from humanopts_teach.study.accuracy import PAPER_DEMONSTRATIONS, PAPER_MINUTES
import matplotlib
from matplotlib.ticker import MaxNLocator, PercentFormatter
import pandas as pd

from experiments import paper, report
from experiments.people import (
    BagLesson,
    CAREFUL,
    Participant,
    participants,
    Study,
    taught_in,
    VARIED,
)
from experiments.trials import Rows, Trial

NAME = 'fig2'
TITLE = 'Figure 2: accuracy against demonstrations'
ASKED = 6  # maximum number of start states per demonstration, including "not here" answers
PEOPLE = 'people'  # group of the people in bags


@dataclass(frozen=True)
class TaughtGame:
    """A game with one feature list."""

    domain: str
    features: str  # name of the feature list
    feature_list: str | None  # value of this domain parameter; None: no such parameter
    shown: int  # demonstrations per option and person
    groups: tuple[str, ...]  # groups of people
    cost: float  # approximate processor seconds per trial
    strategies: tuple[str, ...] = STRATEGIES  # for start states
    note: str = ''  # note on the features, for captions

    @property
    def parameters(self) -> str:
        """The domain parameters that differ from the defaults, as a JSON object."""
        return json.dumps({'features': self.feature_list} if self.feature_list else {})


DIRECTIONS, POSITIONS = 'directions', 'positions (features=paper)'  # names of feature lists
HANDED_OVER = 'These features are first moves of shortest paths: they give the policy away.'
AS_LISTED = 'These features are positions only, as in the list of the paper.'
GAMES = (
    TaughtGame('taxi', 'all', None, 60, (CAREFUL, VARIED), cost=2.0),
    TaughtGame('pacman', DIRECTIONS, None, 40, (VARIED,), cost=10.0, note=HANDED_OVER),
    TaughtGame('pacman', POSITIONS, 'paper', 60, (VARIED,), 6.0, ('random',), AS_LISTED),
)
CASE = ['domain', 'features', 'option', 'people', 'start states by']  # identifies a curve
PERSON = [*CASE, 'person']
RETURN = 'return'
MEASURES = {  # measure: plot title; all except the return are shares of states
    RETURN: 'policy: average return',
    'policy': 'policy: best actions',
    'initiation': 'I (may it start?)',
    'termination': 'β (does it end?)',
}
LEVELS = (0.95, 1.0)  # of policy accuracy; the report gives the demonstrations needed for each
GOALS = {('failures', 0.95): 15, ('failures', 1.0): 30}  # maximum for careful people in Taxi
ROUNDING = 1e-9  # rounding error of an accuracy
STYLES = {'random': 'C1--', 'coverage': 'C3-.', 'failures': 'C0-'}
ACTS = ('name of an option', 'answer', 'start state', 'step', 'watched step', 'verdict')
PACE = dict(zip(ACTS, SECONDS.values(), strict=True))  # assumed seconds per act
GROUP_NAMES = {
    CAREFUL: 'simulated people without errors',
    VARIED: 'simulated people who differ',
    PEOPLE: 'people',
}


def trials(study: Study) -> list[Trial]:
    """Return one trial per person, option and strategy."""
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


def learn_from_simulated(parameters: Mapping[str, Any]) -> Rows:
    """Have a simulated participant teach an option; measure it after every demonstration."""
    person = Participant(**parameters['person'])
    domain = domain_from_json(parameters['domain'], parameters['domain_parameters'])
    name, wanted, strategy = (parameters[key] for key in ('option', 'demonstrations', 'strategy'))
    lesson: list[LearnedOption] = []

    def enough(_: Sequence[Demonstration], option: LearnedOption) -> bool:
        lesson.append(option)
        return bool(option.n_demonstrations >= wanted)

    rules = LessonRules(strategy, ASKED * wanted, person.seed, until_no_failures=False)
    taught = teach(domain, person.teaching(name), rules, enough)
    who = person.group, strategy, person.code
    return point_rows(lesson, domain, name, who, taught.seconds, taught.cut_short)


def learn_again(parameters: Mapping[str, Any]) -> Rows:
    """Relearn an option from the demonstrations in a bag; measure it after each one."""
    known = BagLesson(**parameters)
    bag = open_bag(Path(known.bag))
    domain = read_domain(bag)
    demos = taught_in(bag, domain)[known.participant, known.option]
    first = next(n for n, demo in enumerate(demos, start=1) if demo.kind is Kind.TRAJECTORY)
    counts = range(first, len(demos) + 1)
    lesson = [learn_option(demos[:count], domain, known.seed) for count in counts]
    who = PEOPLE, known.strategy, known.participant
    return point_rows(lesson, domain, known.option, who, sum(demo.seconds for demo in demos))


def point_rows(
    lesson: Sequence[LearnedOption],
    domain: Domain,
    name: str,
    who: tuple[str, str, str],
    seconds: float,
    cut_short: str = '',
) -> Rows:
    """
    Measure an option after each of its demonstrations.

    :param lesson: version of the option after each answer; the last one for each number of
        demonstrations counts.
    :param who: group, strategy of start states, and code of the person.
    :param seconds: duration of the lesson.
    :param cut_short: reason for an early end of the lesson; empty: no early end.
    :return: ``PERSON``, demonstrations, not here (answers so far), ``MEASURES``, best return (of
        the reference option), minutes, cut short. No rows without a reference option.
    """
    if (reference := reference_options(domain).get(name)) is None:
        return []
    options = [*{option.n_demonstrations: option for option in lesson}.values()]
    *returns, best = map(finite, average_returns([*options, None], domain, reference))
    taught = domain.name, domain.parameters.get('features')
    features = [g.features for g in GAMES if taught == (g.domain, g.feature_list)]
    case = [domain.name, *(features or ['all']), name, *who]
    return [
        {
            **dict(zip(PERSON, case, strict=True)),
            'demonstrations': option.n_demonstrations,
            'not here': option.n_not_here,
            **dict(zip(MEASURES, (its, *accuracies(option, domain).values()), strict=True)),
            'best return': best,
            'minutes': seconds / 60,
            'cut short': cut_short,
        }
        for option, its in zip(options, returns)
    ]


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return the numbers to plot: means and their intervals over people.

    :return: ``CASE``, demonstrations, best return, count, mean, low, high, measure.
    """
    by = [*CASE, 'demonstrations', 'best return']
    share = {measure: () if measure == RETURN else (0.0, 1.0) for measure in MEASURES}
    each = [
        report.mean_intervals(points, by, measure, *limits).assign(measure=measure)
        for measure, limits in share.items()
    ]
    return pd.concat(each, ignore_index=True)


def person_table(points: pd.DataFrame) -> pd.DataFrame:
    """
    Return one row per person.

    :return: ``PERSON``; for each of ``LEVELS`` the number of demonstrations after which the policy
        accuracy stayed there, NaN if it never did; the last measures, best return, minutes, cut
        short, and shown (total number of demonstrations).
    """
    last = {name: f'last accuracy of {name}' for name in MEASURES} | {RETURN: 'last return'}
    rows = []
    for key, mine in report.grouped(points, PERSON):
        row: dict[str, Any] = dict(zip(PERSON, key))
        for level in LEVELS:
            held = (mine['policy'] >= level - ROUNDING)[::-1].cummin()[::-1]
            row[f'{level:.0%}'] = mine['demonstrations'][held].min()
        end = mine.iloc[-1].drop([*PERSON, 'trial', 'not here'], errors='ignore')
        rows.append({**row, **end.rename({**last, 'demonstrations': 'shown'})})
    return pd.DataFrame(rows)


def needed_table(people: pd.DataFrame) -> pd.DataFrame:
    """
    Return the numbers of demonstrations after which the policy accuracy stayed at ``LEVELS``.

    A person without such a number counts with all demonstrations shown, so the mean is too low.
    """
    rows = []
    for key, members in report.grouped(people, CASE):
        row = {**dict(zip(CASE, key)), 'count': len(members)}
        for level in LEVELS:
            needed, longest = members[f'{level:.0%}'], members['shown'].max()
            reached = int(needed.notna().sum())
            text = f'{needed.fillna(longest).mean():.1f}'
            if reached < len(members):
                text = f'over {text} ({reached} of {len(members)} people)'
            row[f'demonstrations for {level:.0%}'] = text if reached else f'not within {longest}'
        rows.append({**row, 'minutes': round(members['minutes'].mean(), 2)})
    return pd.DataFrame(rows)


def last_table(points: pd.DataFrame) -> pd.DataFrame:
    """Return the means after the last demonstration and the return of the reference option."""
    by, shown = [*CASE, 'demonstrations'], points['demonstrations']
    last = points[shown == points.groupby(CASE)['demonstrations'].transform('max')]
    found: pd.DataFrame = last.groupby(by, sort=False)[['best return', *MEASURES]].mean()
    return found.round(3).reset_index()


def present(points: pd.DataFrame) -> report.Section:
    """Return the report section."""
    curves, people = curve_table(points), person_table(points)
    tables = [
        report.Table(
            'fig2-needed', 'Demonstrations needed for a policy accuracy', needed_table(people)
        ),
        report.Table('fig2-last', 'After the last demonstration', last_table(points)),
        report.Table('fig2-curves', 'The curves', curves, shown=False),
        report.Table('fig2-people', 'Each person', people.drop(columns='shown'), shown=False),
    ]
    said = [*_compare_cases(points, people), *_compare_minutes(people)]
    shown = {f'{game.domain}, {game.features}': game.shown for game in GAMES}
    facts = {'shown': shown, 'pace': PACE, 'longest': MAX_RUN_STEPS}
    return report.Section(NAME, TITLE, said, _pictures(curves), tables, facts)


def _compare_cases(points: pd.DataFrame, people: pd.DataFrame) -> Iterator[report.Comparison]:
    for (key, members), (_, mine) in zip(
        report.grouped(people, CASE), report.grouped(points, CASE)
    ):
        domain, features, option, group, strategy = key
        case = f'{_game(domain, features)}, “{option}”, start states by {strategy}'
        if _like_paper(members).all() and paper.FIGURE_2_OPTIONS.get(domain) == option:
            yield from _compare_accuracies(case, mine)
        if group == CAREFUL and domain == 'taxi':
            yield from _compare_needed(f'{case}, without errors', strategy, members)


def _compare_accuracies(case: str, points: pd.DataFrame) -> Iterator[report.Comparison]:
    """Compare the gains within a person in return and policy accuracy, and errors of I and β."""
    most = int(points['demonstrations'].max())
    last, gains = min(PAPER_DEMONSTRATIONS, most), {}
    for measure in (RETURN, 'policy'):
        values = points.pivot(index='person', columns='demonstrations', values=measure)
        # people with only "not here" answers at the start or too few demonstrations have no pair
        pairs = values.reindex(columns=[1, last]).dropna().to_numpy(float)
        gains[MEASURES[measure]] = Interval.of_difference(pairs[:, -1], pairs[:, 0])
    ends = points.groupby('person', sort=False).last()
    parts = ('initiation', 'termination')
    errors = {MEASURES[part]: Interval.of(1 - ends[part].dropna()) for part in parts}
    yield report.compare(
        paper.SAID['rises'],
        all_hold(gain.above() for gain in gains.values()),
        f'{case}, gain within a person from 1 to {last}',
        gains,
    )
    yield report.compare(
        paper.SAID['imperfect'],
        any_holds(error.above(ROUNDING) for error in errors.values()),
        f'{case}, errors after {most}',
        errors,
    )


def _compare_needed(
    case: str, strategy: str, members: pd.DataFrame
) -> Iterator[report.Comparison]:
    """
    Compare the demonstrations needed by careful people with the paper's claim and our goals.

    A person who did not reach a level counts with all demonstrations shown. This number can only
    be too low, so it can refute a goal but not confirm it.
    """
    for level in LEVELS:
        reached = members[f'{level:.0%}']
        needed = Interval.of(reached.fillna(members['shown']).astype(float))
        known = needed if reached.notna().all() else f'over {needed.mean:.1f}'
        values = {f'demonstrations until {level:.0%} holds for good': known}
        if (strategy, level) in GOALS:
            most = GOALS[strategy, level]
            text = f'{level:.0%} policy accuracy takes at most {most} demonstrations.'
            verdict = needed.at_most(most)
            if verdict and reached.isna().any():
                verdict = None
            yield report.compare(text, verdict, case, values, '.1f')
        elif (strategy, level) == ('random', LEVELS[0]):
            said, mark = paper.SAID['forty'], report.Mark.NOT_COMPARABLE
            yield report.compare(said, mark, case, values, '.1f', paper.NO_LEVEL)


def _game(domain: str, features: str) -> str:
    """Return the name of a game, with its feature list if it has several."""
    return domain if features == 'all' else f'{domain} with {features}'


def _compare_minutes(people: pd.DataFrame) -> Iterator[report.Comparison]:
    """Compare the minutes that people took for all their demonstrations with the paper's."""
    for (domain, features), mine in report.grouped(people[_like_paper(people)], CASE[:2]):
        if domain in PAPER_MINUTES:
            lessons = mine.groupby(['person', 'start states by'])['minutes'].sum()
            taken = Interval.of(lessons.groupby('person').mean())
            real = bool((mine['people'] == PEOPLE).all())
            pace = f'minutes {"by the clock" if real else "at an assumed pace"}'
            verdict = taken.at_most(PAPER_MINUTES[domain]) if real else report.Mark.NOT_COMPARABLE
            said, case = paper.SAID[f'minutes_in_{domain}'], _game(domain, features)
            yield report.compare(said, verdict, case, {pace: taken}, '.1f')


def _like_paper(rows: pd.DataFrame) -> 'pd.Series[bool]':
    """Select the rows of real people, and of varied simulated people with random start states."""
    group = rows['people']
    return (group == PEOPLE) | (group == VARIED) & (rows['start states by'] == 'random')


def _pictures(curves: pd.DataFrame) -> list[report.Picture]:
    """Return one figure per option and group, with one line per strategy."""
    notes = {(game.domain, game.features): game.note for game in GAMES}
    return [
        report.Picture(
            re.sub(r'[^a-z0-9]+', '-', f'fig2-{domain}-{known}{option}-{group}'.lower()),
            f'{_game(domain, features)}: “{option}” by demonstrations, {GROUP_NAMES[group]}'
            + (' (figure 2)' if paper.FIGURE_2_OPTIONS.get(domain) == option else '')
            + f'. {notes.get((domain, features), "")}'.rstrip(),
            (13.0, 2.9),
            partial(_draw, shown),
        )
        for (domain, features, option, group), shown in report.grouped(curves, CASE[:4])
        for known in ['positions-' if features == POSITIONS else '']
    ]


def _draw(shown: pd.DataFrame, work: Drawing) -> None:
    plots = work.figure.subplots(1, len(MEASURES))
    muted = matplotlib.rcParams['axes.edgecolor']
    for axes, (measure, title) in zip(plots, MEASURES.items()):
        mine = shown[shown['measure'] == measure].sort_values('demonstrations')
        report.draw_curves(axes, mine, 'start states by', 'demonstrations', STYLES, lw=1.5)
        axes.axvline(PAPER_DEMONSTRATIONS, color=muted, ls=':', lw=1)
        axes.set(title=title, xlabel='demonstrations')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        if measure == RETURN:
            axes.axhline(mine['best return'].mean(), color=muted, lw=1, label='reference')
            continue
        axes.set(ylim=(None, 1.02))
        axes.sharey(plots[1])
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    plots[0].set_ylabel('reward units')
    plots[1].set_ylabel('share of states')
    plots[0].legend(loc='lower right')
