"""
Number of demonstrations needed for an option, by learning method.

This goes beyond the paper, which learns every part of an option with trees. In a trial, one
simulated person teaches every reference option of a domain with one learning method and one
strategy for start states. A lesson continues until the criteria are met and the policy is right,
and then for ``LONGER`` more demonstrations, to check that the policy stays right. It ends after
``BUDGET`` start states at the latest. A policy is right if it takes an optimal action in every
state of the reference option's initiation set. In a deterministic domain, a right policy is as
good as the demonstrations from every start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
import math
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, GOAL, TREES
from humanopts_learner.intervals import all_hold, Interval
from humanopts_learner.options.accuracy import policy_accuracy
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import pandas as pd

from experiments import report
from experiments.people import CAREFUL, Participant, participants, Study
from experiments.trials import Rows, Trial

NAME = 'demonstrations'
TITLE = 'Demonstrations that an option takes'
STRATEGIES = ('random', 'failures')
SLIPS = 'slips'  # group of otherwise careful people who take some wrong steps
ERROR_RATE = 0.02
BUDGET = 60  # start states per lesson
LONGER = 3  # extra demonstrations once the policy is right and the criteria are met
TARGETS = {GOAL: 5, TREES: 25}  # maximum demonstrations until the criteria are met, in Taxi
KEYS = ['domain', 'option', 'method', 'strategy', 'people']
UNTIL = ['until the criteria hold', 'until right for good']
COSTS = {'taxi': 10.0, 'rooms': 30.0}  # approximate processor seconds per trial, by domain


def trials(study: Study) -> list[Trial]:
    """Return one trial per simulated person, domain, method and strategy; none for bags."""
    careful = [] if study.bags else participants(CAREFUL, study.participants, study.seed)
    slipping = [
        replace(one, group=SLIPS, code=one.code.replace(CAREFUL, SLIPS), error_rate=ERROR_RATE)
        for one in careful
    ]
    return [
        Trial(
            NAME,
            {'domain': domain, 'method': method, 'strategy': strategy, 'person': asdict(person)},
            count_demonstrations,
            cost,
        )
        for domain, cost in COSTS.items()
        for method in TARGETS
        for strategy in STRATEGIES
        for person in (*careful, *slipping)
    ]


def count_demonstrations(parameters: Mapping[str, Any]) -> Rows:
    """Return one row per reference option: the demonstrations needed, None if not reached."""
    rows = []
    person = parameters['person']
    case = {key: parameters[key] for key in ('domain', 'method', 'strategy')}
    for name in reference_options(make_domain(parameters['domain'])):
        past = _lesson(parameters, name)
        count, accuracy = next((at[:2] for at in past if at[2]), (None, None))
        right = past
        while wrong := [number for number, at in enumerate(right) if at[1] < 1.0]:
            right = right[wrong[-1] + 1 :]
        rows.append(
            {
                **case,
                'people': person['group'],
                'code': person['code'],
                'option': name,
                UNTIL[0]: count,
                UNTIL[1]: right[0][0] if right else None,
                'accuracy when the criteria hold': accuracy,
            }
        )
    return rows


def _lesson(parameters: Mapping[str, Any], name: str) -> list[tuple[int, float, bool]]:
    """
    Teach one option.

    :return: number of demonstrations, policy accuracy, and whether the criteria are met, after
        each demonstration and each "not here" answer.
    """
    domain, person = make_domain(parameters['domain']), Participant(**parameters['person'])
    reference = reference_options(domain)[name]
    past: list[tuple[int, float, bool]] = []

    def enough(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        judgement = judge(shown, domain, Thresholds(), person.seed, option)
        accuracy, count = policy_accuracy(option, domain, reference), option.n_demonstrations
        past.append((count, accuracy, judgement.settled))
        stays = all(right == 1.0 for at, right, _ in past if at > count - LONGER)
        return stays and any(met and count >= at + LONGER for at, _, met in past)

    strategy, method = parameters['strategy'], parameters['method']
    rules = LessonRules(strategy, BUDGET, person.seed, until_no_failures=False, method=method)
    teach(domain, person.teaching(name), rules, enough)
    return past


def summary_table(counts: pd.DataFrame) -> pd.DataFrame:
    """
    Return one row per option, method, strategy and group of people: medians and maxima.

    :return: ``KEYS``, count (of people), for both of ``UNTIL`` the median, the maximum and the
        number of people who never reached it, and the largest excess of the first over the second.
    """
    groups = counts.assign(excess=counts[UNTIL[0]] - counts[UNTIL[1]]).groupby(KEYS, sort=False)
    found = {'count': groups.size()}
    for what in UNTIL:
        found |= {
            f'{what}: median': groups[what].median(),
            f'{what}: most': groups[what].max(),
            f'{what}: never': groups.size() - groups[what].count(),
        }
    return pd.DataFrame({**found, 'most in excess': groups['excess'].max()}).reset_index()


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per person and option taught."""
    counts = rows.drop(columns='trial', errors='ignore').astype(dict.fromkeys(UNTIL, float))
    tables = [
        report.Table('demonstrations-summary', 'Demonstrations by option', summary_table(counts)),
        report.Table('demonstrations-each', 'Each lesson', counts, shown=False),
    ]
    failures = counts[counts['strategy'] == 'failures']
    pictures = [
        report.Picture(
            f'demonstrations-{domain}',
            f'{domain}: demonstrations until the criteria hold, starts by failures; the dots '
            'are people, careful or with slips, the bars medians. Lessons in which the criteria '
            'never held are missing.',
            (7.6, 5.2),
            partial(_draw, mine),
        )
        for (domain,), mine in report.grouped(failures, ['domain'])
    ]
    facts = {'budget': BUDGET, 'error_rate': ERROR_RATE}
    taxi = failures[failures['domain'] == 'taxi']
    return report.Section(NAME, TITLE, _comparisons(taxi), pictures, tables, facts)


def _comparisons(taxi: pd.DataFrame) -> list[report.Comparison]:
    """Compare the mean demonstrations for each Taxi option with the goal of the method."""
    found = []
    for (method, people), rows in report.grouped(taxi, ['method', 'people']):
        # A lesson that never met the criteria counts with its whole budget, which is too low.
        means = {
            option: Interval.of(mine[UNTIL[0]].fillna(BUDGET))
            for (option,), mine in report.grouped(rows, ['option'])
        }
        most = TARGETS[method]
        said = (
            f'With {method} (people: {people}), the criteria of each Taxi option hold after '
            f'{most} demonstrations or fewer, the mean over people.'
        )
        met = all_hold(mean.at_most(most) for mean in means.values())
        case = f'{rows["code"].nunique()} people'
        found.append(report.compare(said, met, case, means, '.1f'))
    return found


def _median(counts: 'pd.Series[float]') -> Interval:
    return Interval(counts.median(), math.nan, math.nan)


def _draw(rows: pd.DataFrame, work: Drawing) -> None:
    style = {'ms': 4, 'alpha': 0.4}
    report.draw_samples(work.axes, rows, 'option', UNTIL[0], 'method', _median, **style)
    work.axes.set(xlabel='demonstrations', xlim=(0, None))
    work.axes.legend()
