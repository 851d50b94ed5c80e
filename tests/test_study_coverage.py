"""Intervals of a mixed model over exported tables, in simulated studies with a known effect."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
import re
import time
from typing import Any

from humanopts_env.seeding import generator
from humanopts_learner.spreadsheet import csv_of
from humanopts_teach.study.model import effects
from humanopts_teach.study.plan import read_plan, StudyPlan
from humanopts_teach.study.record import StudyFolder
from humanopts_teach.study.tables import read_study, tables
import pytest
from teach_support.taught_study import Clock, Pool, pool_of, take_part

ROOT = Path(__file__).parents[1]
TEACHERS, PEOPLE, STUDIES = 16, 24, 100
LEAVE = 1 / 8  # share of participants who leave after their first condition
NEEDED = 90
Kept = Mapping[tuple[int, int, bool], str]  # codes, by teacher, place and whether they leave


def ten_lines() -> str:
    """Return the model in the documentation."""
    page = (ROOT / 'docs/how-to/run-a-study.md').read_text('utf-8')
    return next(b for b in re.findall(r'```python\n(.*?)```', page, re.DOTALL) if 'mixedlm' in b)


def records_of(folder: StudyFolder, plan: StudyPlan, pool: Pool) -> Kept:
    """Write a record of each teacher in each order, complete and without the second condition."""
    kept, clock = {}, Clock()
    for teacher in range(TEACHERS):
        taught = {name: lessons[teacher] for name, lessons in pool.items()}
        for leaves in (False, True):
            for place in range(2):
                parts = plan.parts_of(place, 0)
                second = plan.order_of(place)[1].name
                most = [part.condition for part in parts].index(second) if leaves else None
                code = f't{teacher}-{place}-{leaves:d}'
                record = take_part(folder, plan, code, taught, clock, most=most)
                assert record.place % 2 == place
                kept[teacher, place, leaves] = code
    return kept


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_interval_covers_the_true_difference_in_90_of_100_simulated_studies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = read_plan(ROOT / 'examples/study/plan.yaml')
    plan = plan.model_copy(update={'participants': 0})
    pool = pool_of(plan, TEACHERS)
    shown = {
        name: [sum(each.n_demonstrations for each in taught.summaries) for taught in lessons]
        for name, lessons in pool.items()
    }
    truth = (sum(shown['trees']) - sum(shown['goal'])) / TEACHERS
    folder = StudyFolder(tmp_path / 'study')
    kept = records_of(folder, plan, pool)
    everything, problems = read_study(folder, time.time())
    assert problems == []
    by_code = {record.code: record for record in everything.records}
    monkeypatch.chdir(tmp_path)
    model, covered = compile(ten_lines(), 'run-a-study.md', 'exec'), {'model': 0, 'report': 0}
    for study in range(STUDIES):
        rng = generator(1, 'simulated study', study)
        records, lessons = [], {}
        for number in range(PEOPLE):
            drawn = kept[int(rng.integers(TEACHERS)), number % 2, bool(rng.random() < LEAVE)]
            for condition in plan.conditions:
                key = f'p{number}', condition.name
                lessons[key] = everything.lessons[drawn, condition.name]
            records.append(replace(by_code[drawn], code=f'p{number}'))
        data = replace(everything, records=records, lessons=lessons)
        rows = tables(data)['conditions']
        (tmp_path / 'conditions.csv').write_text(csv_of(rows), 'utf-8')
        found: dict[str, Any] = {}
        exec(model, found)
        low, high = found['fitted'].conf_int().loc['C(condition)[T.trees]']
        covered['model'] += low <= truth <= high
        effect = effects(rows[rows['reached'] == 'yes'], 'demonstrations', ['goal', 'trees'])
        covered['report'] += effect.rows[0].difference.holds(truth) is True
    print(f'true difference {truth}; covered in {covered}')
    assert min(covered.values()) >= NEEDED
