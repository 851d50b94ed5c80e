"""
Statistical power of a study by number of participants and effect size, with simulated teachers.

In a trial, one simulated person with individual rates of errors and needless answers teaches the
two Taxi options of the paper several times, each time from different start states. The lessons
thus vary between people and within a person, but only as far as these teachers do.

Studies are then drawn from these people: one condition lowers the outcome by a given share. In a
*within* design, each person has both conditions in balanced order, in two different lessons. In a
*between* design, half of the people have each condition. An effect is found if the 95 % interval
of the model of ``study report`` excludes zero. Power is the share of studies that find the effect.
"""

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import TREES
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd
from scipy import stats

from experiments import paper, report
from experiments.people import Participant, participants, Study, VARIED
from experiments.trials import Rows, Trial

NAME = 'power'
TITLE = 'How many participants a study needs'
LESSONS = 24  # simulated people
RUNS = 3  # lessons per person
OUTCOMES = {'demonstrations': 'demonstrations', 'minutes': 'minutes of teaching'}
EFFECTS = (0.0, 0.1, 0.2, 0.3, 0.5)  # share by which a condition lowers the outcome
PEOPLE = (4, 6, 8, 12, 16, 24, 32, 48, 64)
DESIGNS = ('within', 'between')
STUDIES = 4000  # studies drawn for each power
WANTED = 0.8  # conventional power of a study (Cohen 1988)
LEVEL = 0.95


def trials(study: Study) -> list[Trial]:
    """Return one trial per simulated person; none if the study uses bags."""
    people = [] if study.bags else participants(VARIED, study.participants, study.seed)
    return [Trial(NAME, {'person': asdict(person)}, give_lessons, 15.0) for person in people]


def give_lessons(parameters: Mapping[str, Any]) -> Rows:
    """Return one row per lesson: person, run, demonstrations and assumed minutes."""
    person, rows = Participant(**parameters['person']), list[dict[str, Any]]()
    for run in range(RUNS):
        own = Participant(**{**parameters['person'], 'seed': person.seed + 1000 * run})
        rules = LessonRules(seed=own.seed, method=TREES)
        taught = teach(make_domain('taxi'), own.teaching(*paper.TAUGHT['taxi']), rules)
        count = sum(each.n_demonstrations for each in taught.summaries)
        minutes = taught.seconds / 60
        rows.append(
            {'person': person.code, 'run': run, 'demonstrations': count, 'minutes': minutes}
        )
    return rows


def power(
    lessons: Floats, effect: float, people: int, design: str, rng: np.random.Generator
) -> float:
    """
    Return the share of simulated studies that find an effect.

    :param lessons: outcome of each lesson, (people, runs).
    :param effect: share by which the second condition lowers the outcome.
    :param people: number of participants in each study, even.
    :param design: one of ``DESIGNS``.
    """
    who = rng.integers(len(lessons), size=(STUDIES, people))
    first = rng.integers(lessons.shape[1], size=who.shape)
    other = (first + rng.integers(1, lessons.shape[1], size=who.shape)) % lessons.shape[1]
    plain, changed = lessons[who, first], (1 - effect) * lessons[who, other]
    half = people // 2
    if design == 'between':
        samples = plain[:, :half], changed[:, half:]
        scale = np.sqrt(sum(each.var(axis=1, ddof=1) for each in samples) / 2)
        mean, error, free = samples[1].mean(axis=1) - samples[0].mean(axis=1), 0.0, people - 2
        error = scale * np.sqrt(2 / half)
    else:
        # For complete, balanced data, the mixed model with condition and position gives the
        # interval of the mean difference, averaged over the two orders.
        orders = np.split(changed - plain, [half], axis=1)
        mean, free = sum(each.mean(axis=1) for each in orders) / 2, people - 2
        variance = sum(each.var(axis=1, ddof=1) for each in orders) / 2
        error = np.sqrt(variance / people)
    limit = stats.t.ppf((1 + LEVEL) / 2, free) * error
    return float((np.abs(mean) > limit).mean())


def power_table(lessons: pd.DataFrame, seed: int = 1) -> pd.DataFrame:
    """Return the power by outcome, design, effect and number of people, one row each."""
    rows = list[dict[str, Any]]()
    for outcome, words in OUTCOMES.items():
        values = lessons.pivot(index='person', columns='run', values=outcome).to_numpy(float)
        for design in DESIGNS:
            for effect in EFFECTS:
                for people in PEOPLE:
                    rng = generator(seed, NAME, outcome, design, round(100 * effect), people)
                    share = power(values, effect, people, design, rng)
                    rows.append(
                        {
                            'outcome': words,
                            'design': design,
                            'effect': effect,
                            'people': people,
                            'power': share,
                        }
                    )
    return pd.DataFrame(rows)


def needed_table(powers: pd.DataFrame) -> pd.DataFrame:
    """Return the smallest number of people with a power of at least ``WANTED``, by effect."""
    rows = list[dict[str, Any]]()
    for (outcome, design), own in report.grouped(powers, ['outcome', 'design']):
        row: dict[str, Any] = {'outcome': outcome, 'design': design}
        for effect, same in own[own['effect'] > 0].groupby('effect'):
            enough = same[same['power'] >= WANTED]['people']
            row[f'{effect:.0%} less'] = str(enough.min()) if len(enough) else f'> {PEOPLE[-1]}'
        rows.append(row)
    return pd.DataFrame(rows)


def spread_table(lessons: pd.DataFrame) -> pd.DataFrame:
    """Return mean and standard deviations, between and within people, of each outcome."""
    rows = list[dict[str, Any]]()
    for outcome, words in OUTCOMES.items():
        values = lessons.pivot(index='person', columns='run', values=outcome).to_numpy(float)
        within = float(values.var(axis=1, ddof=1).mean())
        between = max(float(values.mean(axis=1).var(ddof=1)) - within / values.shape[1], 0.0)
        rows.append(
            {
                'outcome': words,
                'people': len(values),
                'mean': values.mean(),
                'standard deviation between people': np.sqrt(between),
                'within a person': np.sqrt(within),
            }
        )
    return pd.DataFrame(rows).round(2)


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section."""
    powers = power_table(rows)
    needed = needed_table(powers)
    return report.Section(
        NAME,
        TITLE,
        pictures=[
            report.Picture(
                f'power-{design}',
                f'Power by number of people, {design} people: demonstrations',
                (5.0, 3.2),
                partial(_draw, powers, design),
            )
            for design in DESIGNS
        ],
        tables=[
            report.Table('power-needed', f'People for a power of {WANTED:.0%}', needed),
            report.Table('power-spread', 'How lessons differ', spread_table(rows)),
            report.Table('power-all', 'Power', powers.round(3), shown=False),
        ],
    )


def _draw(powers: pd.DataFrame, design: str, work: Drawing) -> None:
    own = powers[(powers['design'] == design) & (powers['outcome'] == 'demonstrations')]
    for number, (effect, curve) in enumerate(own.groupby('effect')):
        label = f'{effect:.0%} less'
        work.axes.plot(curve['people'], curve['power'], f'C{number}-o', ms=3, label=label)
    work.axes.axhline(WANTED, color='#888', ls=':', lw=1)
    work.axes.set(xlabel='people', ylabel='power', ylim=(0, 1.02), title=f'{design} people')
    work.axes.legend()
