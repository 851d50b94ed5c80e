"""
How many demonstrations an option takes, by the way in which it is learned.

Past the paper, which learns every part of an option by trees. A trial is one simulated person who
teaches every reference option of a domain in one way, from start states of one strategy. A lesson
goes on until the criteria hold and the policy is right, and then for ``LONGER`` demonstrations, to
see whether it stays right; or for ``BUDGET`` start states. Right means: in every state of the
reference option's initiation set the action is one of the best. In domains without chance, it is
then as good as what was shown from every start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, GOAL, METHODS, TREES
from humanopts_learner.intervals import all_hold, Interval
from humanopts_learner.options.accuracy import policy_accuracy
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import pandas as pd

from experiments import report
from experiments.paper import Statement
from experiments.people import CAREFUL, Participant, participants, Study
from experiments.trials import Trial

NAME = 'demonstrations'
TITLE = 'Demonstrations that an option takes'
STRATEGIES = ('random', 'failures')
SLIPS = 'slips'  # careful people with a share of wrong steps
ERROR_RATE = 0.02
BUDGET = 60  # start states of one lesson
LONGER = 3  # demonstrations after it is right and the criteria hold
TARGETS = {GOAL: 5, TREES: 25}  # demonstrations until the criteria hold, for the options of Taxi
KEYS = ['domain', 'option', 'method', 'strategy', 'people']
UNTIL = ['until the criteria hold', 'until right for good']
COSTS = {'taxi': 10.0, 'rooms': 30.0}  # of a trial, about processor seconds, by domain


def trials(study: Study) -> list[Trial]:
    """Return one trial for each simulated person, domain, method and strategy; with bags, none."""
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
        for method in METHODS
        for strategy in STRATEGIES
        for person in (*careful, *slipping)
    ]


def count_demonstrations(parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each reference option: the demonstrations that it took; None: too few."""
    rows = []
    for name in reference_options(make_domain(parameters['domain'])):
        past = _lesson(parameters, name)
        count, accuracy = next((at[:2] for at in past if at[2]), (None, None))
        right = past
        while wrong := [number for number, at in enumerate(right) if at[1] < 1.0]:
            right = right[wrong[-1] + 1 :]
        rows.append(
            {
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

    :return: demonstrations, accuracy of the policy, and whether the criteria hold, after each
        demonstration and "not here" answer.
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


def count_table(done: report.Done) -> pd.DataFrame:
    """Return a row for each option that a person taught: ``KEYS``, code, counts, accuracy."""
    return pd.DataFrame(
        {
            **{key: p[key] for key in ('domain', 'method', 'strategy')},
            'people': p['person']['group'],
            'code': p['person']['code'],
            **row,
        }
        for p, result in done
        for row in result
    )


def summary_table(counts: pd.DataFrame) -> pd.DataFrame:
    """
    Return a row for each option, method, strategy and group of people: medians and the most.

    :return: ``KEYS``, count (of people), for both of ``UNTIL`` the median, the most and how many
        people did not get there within the budget, and the most by which criteria came later.
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


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    counts = count_table(done)
    by_option = summary_table(counts)
    tables = [
        report.Table('demonstrations-summary', 'Demonstrations by option', by_option),
        report.Table('demonstrations-each', 'Each lesson', counts, shown=False),
    ]
    facts = {'budget': BUDGET, 'error_rate': ERROR_RATE}
    said, pictures = _comparisons(counts), _pictures(counts)
    return report.Section(NAME, TITLE, said, pictures, tables, facts)


def _comparisons(counts: pd.DataFrame) -> list[report.Comparison]:
    """Compare the mean demonstrations of each option of Taxi with the goal of its method."""
    found = []
    taxi = counts[(counts['domain'] == 'taxi') & (counts['strategy'] == 'failures')]
    for (method, people), rows in report.grouped(taxi, ['method', 'people']):
        # Where a lesson did not get there, it took more demonstrations than it had.
        means = {
            option: Interval.of(mine[UNTIL[0]].fillna(BUDGET))
            for (option,), mine in report.grouped(rows, ['option'])
        }
        most = TARGETS[method]
        said = (
            f'With {method} (people: {people}), the criteria of each Taxi option hold after '
            f'{most} demonstrations or fewer, the mean over people.'
        )
        text = report.listed(f'{rows["code"].nunique()} people', means, '.1f')
        met = all_hold(mean.at_most(most) for mean in means.values())
        found.append(report.compared(Statement(said, report.OURS), text, met))
    return found


def _pictures(counts: pd.DataFrame) -> list[report.Picture]:
    return [
        report.Picture(
            f'demonstrations-{domain}',
            f'Demonstrations until the criteria hold for each option of {domain}',
            (7.6, 5.2),
            partial(_draw, rows),
            f'{domain}: until the criteria hold, with the strategy failures; the dots are people, '
            'careful or with slips, the bars medians. Lessons that did not get there are missing.',
        )
        for (domain,), rows in report.grouped(counts[counts['strategy'] == 'failures'], ['domain'])
    ]


def _draw(rows: pd.DataFrame, work: Drawing) -> None:
    axes, options = work.axes, list(dict.fromkeys(rows['option']))
    for number, method in enumerate(METHODS):
        mine = rows[rows['method'] == method]
        for place, option in enumerate(options):
            values = mine[mine['option'] == option][UNTIL[0]].dropna()
            height = place + 0.15 * (2 * number - 1)
            axes.plot(values, [height] * len(values), 'o', ms=4, alpha=0.4, color=f'C{number}')
            (bar,) = axes.plot(values.median(), height, '|', color=f'C{number}', ms=14, mew=2)
        bar.set_label(method)
    axes.set_yticks(range(len(options)), options)
    axes.invert_yaxis()
    axes.set(xlabel='demonstrations', xlim=(0, None))
    axes.grid(axis='x')
    axes.legend()
