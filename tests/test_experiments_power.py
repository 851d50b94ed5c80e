"""The power of studies: its effects and errors, and the model of the report of a study."""

from humanopts_teach.study.model import effects
import numpy as np
import pandas as pd
import pytest

from experiments import power


@pytest.fixture
def lessons() -> pd.DataFrame:
    """Lessons of people who differ."""
    rng = np.random.default_rng(1)
    person = np.repeat(np.arange(20), 3)
    values = 40 + rng.normal(scale=8, size=20)[person] + rng.normal(scale=4, size=60)
    run = np.tile(np.arange(3), 20)
    return pd.DataFrame(
        {'person': person, 'run': run, 'demonstrations': values, 'minutes': values / 4}
    )


def test_power_grows_with_people_and_effect_and_false_findings_are_rare(
    lessons: pd.DataFrame,
) -> None:
    powers = power.power_table(lessons)
    wide = powers.pivot_table(
        index=['outcome', 'design', 'people'], columns='effect', values='power'
    )
    assert wide[0.0].between(0.03, 0.07).all()
    assert (wide[0.5] >= wide[0.2] - 0.02).all()
    assert (wide.diff(axis=1).iloc[:, 1:] > -0.02).all(axis=None)
    within = wide.xs('within', level='design')[0.2]
    assert (within >= wide.xs('between', level='design')[0.2]).all()
    needed = power.needed_table(powers).set_index(['outcome', 'design'])
    assert needed.loc[('demonstrations', 'within'), '50% less'] == '4'


@pytest.mark.parametrize('design', power.DESIGNS)
def test_an_effect_is_found_if_the_interval_of_the_report_excludes_zero(
    design: str, monkeypatch: pytest.MonkeyPatch, lessons: pd.DataFrame
) -> None:
    monkeypatch.setattr(power, 'STUDIES', 1)
    values = lessons.pivot(index='person', columns='run', values='demonstrations').to_numpy()
    people, effect, found = 8, 0.15, []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        who = rng.integers(20, size=(1, people))[0]
        first = rng.integers(3, size=(1, people))[0]
        other = (first + rng.integers(1, 3, size=(1, people))[0]) % 3
        plain, changed = values[who, first], (1 - effect) * values[who, other]
        rows = []
        for number in range(people):
            second = number >= people // 2
            if design == 'within' or not second:
                rows.append((number, 'plain', 2 if second else 1, plain[number]))
            if design == 'within' or second:
                rows.append((number, 'changed', 1 if second else 2, changed[number]))
        table = pd.DataFrame(rows, columns=['participant', 'condition', 'position', 'outcome'])
        if design == 'between':
            table['position'] = 1
        model = effects(table, 'outcome', ['plain', 'changed'])
        if design == 'within' and not model.between:
            continue
        share = power.power(values, effect, people, design, np.random.default_rng(seed))
        zero_excluded = model.rows[0].difference.above() is not None
        assert share == zero_excluded
        found.append(zero_excluded)
    assert len(found) > 6
    assert len(set(found)) == 2


def test_a_simulated_person_teaches_again_from_other_starts() -> None:
    (trial,) = power.trials(power.Study(participants=1))
    rows = power.give_lessons(trial.parameters)
    assert len({row['minutes'] for row in rows}) == power.RUNS
    section = power.present(pd.DataFrame([*rows, *({**row, 'person': 'other'} for row in rows)]))
    assert [table.name for table in section.tables] == [
        'power-needed',
        'power-spread',
        'power-all',
    ]
