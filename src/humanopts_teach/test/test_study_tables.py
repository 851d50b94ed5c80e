"""The tables of a study, its report, and the mixed model over them."""

from collections.abc import Callable
from pathlib import Path
import re
import shutil
import subprocess
import time

from humanopts_env.domains.base import Domain
from humanopts_learner.intervals import Interval
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.study_report import write_report
from humanopts_teach.evaluation.tables import accuracies
from humanopts_teach.lesson.in_process import Taught
from humanopts_teach.study.accuracy import accuracy_table
from humanopts_teach.study.export import write_study
from humanopts_teach.study.figures import accuracy_figure
from humanopts_teach.study.log import StudyLog
from humanopts_teach.study.model import effects, ModelError
from humanopts_teach.study.plan import read_plan, StudyPlan
from humanopts_teach.study.record import StudyFolder
from humanopts_teach.study.report import paper_section, Results
from humanopts_teach.study.tables import read_study, tables
import numpy as np
import pandas as pd
import pyreadstat
import pytest
from scipy.stats import ttest_ind
from teach_support.taught_study import Clock, lesson, take_part

HOUR = 3600.0
PLAN = """
study: two
consent: consent.md
order: balanced
return_within: 2
attention: {most_failed: 0}
all: {domain: taxi, learn: goal, buttons: 2, questions: asked.yaml}
conditions:
  - {name: plain}
  - {name: derived}
"""
ASKED = """
points: 5
items:
  - {name: hard, text: How hard was it?, low: very easy, high: very hard}
  - {name: why, text: Why?, kind: choices, options: [The game, The keys, Other]}
  - {name: check, text: Choose No., kind: choice, options: ['Yes', 'No'], expect: 2}
  - {name: said, text: Anything else?, kind: text}
"""


@pytest.fixture(scope='module')
def plan(tmp_path_factory: pytest.TempPathFactory) -> StudyPlan:
    folder = tmp_path_factory.mktemp('plan')
    for name, text in (('consent.md', '# Taking part'), ('asked.yaml', ASKED), ('p.yaml', PLAN)):
        (folder / name).write_text(text)
    return read_plan(folder / 'p.yaml')


@pytest.fixture(scope='module')
def taught(plan: StudyPlan) -> dict[str, Taught]:
    found = lesson(plan.conditions[0], seed=1, error_rate=0.0)
    return {each.name: found for each in plan.conditions}


@pytest.fixture(scope='module')
def study(
    plan: StudyPlan, taught: dict[str, Taught], tmp_path_factory: pytest.TempPathFactory
) -> StudyFolder:
    """Return a study with participants in every state."""
    folder = StudyFolder(tmp_path_factory.mktemp('study'))
    clock, keys = Clock(), [part.key for part in plan.parts_of(0, 0)]
    take_part(folder, plan, 'whole', taught, clock)
    take_part(folder, plan, 'early', taught, clock, most=1)
    asked = keys.index('plain/questions')
    record = take_part(folder, plan, 'careless', taught, clock, most=asked)
    questions = plan.parts_of(record.place, record.number)[asked]
    record.note('part began', questions)
    record.note('answer', questions, item='hard', value=4, points=5, seconds=2.5)
    record.note('answer', questions, item='why', value=(1, 3), seconds=3.0)
    record.note('answer', questions, item='check', value=1)
    record.note('answer', questions, item='said', value='=1+1 is hard')
    record.note('part ended', questions, why=record.check_attention(questions))
    take_part(folder, plan, 'nothing', {}, clock)
    log = StudyLog(folder.path)
    for _ in range(2):
        log.note('declined')
    log.note('withdrawn', number=9, place=1, files=3)
    return folder


@pytest.fixture(scope='module')
def results(study: StudyFolder) -> Results:
    found, problems = read_study(study, time.time() + 3 * HOUR)
    assert problems == []
    return Results(found)


def test_drop_outs_and_those_who_taught_nothing_have_a_row_for_each_condition(
    results: Results, taught: dict[str, Taught]
) -> None:
    rows = results.tables['conditions'].set_index(['participant', 'condition'])
    assert len(rows) == 2 * 4
    shown = taught['plain'].summaries[0].n_demonstrations
    assert rows.loc[('whole', 'plain'), 'demonstrations'] == shown > 0
    assert rows.loc[('whole', 'plain'), 'options_learned'] == 1
    assert rows.loc[('nothing', 'plain'), ['reached', 'demonstrations']].tolist() == ['yes', 0]
    assert rows.loc[('early', 'derived'), ['reached', 'demonstrations']].tolist() == ['no', 0]
    assert rows['state'].groupby('participant').first().to_dict() == {
        'careless': 'excluded',
        'early': 'dropped out',
        'nothing': 'finished',
        'whole': 'finished',
    }
    given = results.tables['demonstrations']
    plain = given[(given['participant'] == 'whole') & (given['condition'] == 'plain')]
    assert (plain['kind'] == 'demonstration').sum() == shown
    assert plain['trial'].tolist() == list(range(1, len(plain) + 1))
    assert set(plain[plain['kind'] == 'exam']['right']) == {'yes'}


def test_an_answer_has_the_wording_the_page_and_the_time(results: Results) -> None:
    answers = results.tables['answers']
    own = answers[answers['participant'] == 'careless'].set_index('item')
    shown = ['page', 'wording', 'value', 'text', 'reaction_seconds', 'passed']
    assert own.loc['hard', shown].tolist() == [1, 'How hard was it?', 4, '', 2.5, '']
    assert own.loc['why', ['chosen', 'text']].tolist() == ['1 3', 'The game | Other']
    assert own.loc['check', ['value', 'text', 'expected', 'passed']].tolist() == [
        1, 'Yes', '2', 'no',
    ]  # fmt: skip
    assert own.loc['said', ['page', 'text']].tolist() == [4, '=1+1 is hard']
    events = results.tables['events']
    assert events[events['participant'] == 'early']['event'].tolist() == [
        'began',
        'part began',
        'part ended',
    ]


def test_everyone_who_came_is_counted_once_in_the_flow(results: Results) -> None:
    flow = results.flow
    assert (flow.assessed, flow.declined, flow.began) == (7, 2, 5)
    assert (flow.finished, flow.excluded, flow.dropped_out, flow.withdrawn) == (2, 1, 1, 1)
    plain = next(each for each in flow.conditions if each.name == 'plain')
    assert (plain.assigned, plain.taught, plain.finished) == (4, 3, 3)


def test_tables_for_spss_have_labels(results: Results, tmp_path: Path) -> None:
    names = {path.name for path in write_study(results.data, tmp_path)}
    assert {'conditions.csv', 'codebook.csv', 'analysis.R', 'conditions.sav'} <= names
    rows, labels = pyreadstat.read_sav(str(tmp_path / 'conditions.sav'), apply_value_formats=True)
    assert rows['reached'].astype(str).tolist().count('no') == 3  # after leaving
    assert labels.column_names_to_labels['teach_seconds'] == 'of that, teaching (s)'
    assert labels.variable_measure['teach_seconds'] == 'scale'


@pytest.mark.skipif(shutil.which('Rscript') is None, reason='R is not installed')
def test_the_analysis_runs_in_r(results: Results, tmp_path: Path) -> None:
    write_study(results.data, tmp_path)
    command = ['Rscript', '--vanilla', 'analysis.R']
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert 'options_learned' in done.stdout


def test_the_report_is_one_page_without_a_network(study: StudyFolder, tmp_path: Path) -> None:
    assert write_report(study, tmp_path / 'report.html') == []
    page = (tmp_path / 'report.html').read_text('utf-8')
    for section in ('flow', 'curves', 'effect', 'buttons', 'times', 'questions'):
        assert f'<h2 id="{section}">' in page
    assert 'The model cannot be fitted' in page  # two participants are too few
    assert not re.search(r'(src|href)="(?!#)', page)


def test_a_study_without_participants_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match='no one has taken part yet'):
        write_report(StudyFolder(tmp_path), tmp_path / 'report.html')


def test_a_study_without_its_plan_and_with_a_damaged_record_has_tables_and_a_report(
    study: StudyFolder, tmp_path: Path
) -> None:
    damaged = shutil.copytree(study.path, tmp_path / 'study')
    wrong = shutil.copytree(study.path, tmp_path / 'wrong')
    for path in wrong.glob('0*.jsonl'):
        path.write_text(path.read_text().replace('"value":[1,3]', '"value":[1,9]'))
    (damaged / 'protocol.jsonl').unlink()
    record = damaged / '001-early.jsonl'
    record.write_text(record.read_text().replace('"event":"began"', '"event":"begun"'))
    (damaged / 'log.jsonl').write_text('{"event": "declined"}\n')
    problems = write_report(StudyFolder(damaged), tmp_path / 'report.html')
    answers = tables(read_study(StudyFolder(wrong), time.time())[0])['answers']
    own = answers[(answers['participant'] == 'careless') & (answers['item'] == 'why')]
    assert own['chosen'].isna().tolist() == [True]
    assert [problem.split(' is left out')[0] for problem in problems] == [
        f'line 1 of {record}',
        f'line 1 of {damaged / "log.jsonl"}',
    ]
    assert '<dd>unknown</dd>' in (tmp_path / 'report.html').read_text('utf-8')


def paired(people: int) -> pd.DataFrame:
    """Return an outcome y of people who differ, in two conditions."""
    rng = np.random.default_rng(1)
    rows = [
        (f'p{person}', condition, 1, base + rng.normal() + 3 * (condition == 'b'))
        for person, base in enumerate(rng.normal(10, 5, people))
        for condition in 'ab'
    ]
    return pd.DataFrame(rows, columns=['participant', 'condition', 'position', 'y'])


def test_in_a_complete_design_the_effect_is_that_of_a_paired_t_test() -> None:
    rows = paired(12)
    (found,) = effects(rows, 'y', ['a', 'b']).rows
    a, b = (rows[rows['condition'] == name]['y'] for name in 'ab')
    expected = Interval.of_difference(b, a)
    assert found.difference.mean == pytest.approx(expected.mean)
    assert found.difference.low == pytest.approx(expected.low, rel=1e-3)
    assert found.difference.high == pytest.approx(expected.high, rel=1e-3)


def test_with_one_condition_for_each_person_it_is_that_of_a_t_test() -> None:
    rows = paired(24)
    rows = rows[(rows['participant'].str[1:].astype(int) % 2 == 0) == (rows['condition'] == 'a')]
    model = effects(rows, 'y', ['a', 'b'])
    a, b = (rows[rows['condition'] == name]['y'] for name in 'ab')
    expected = ttest_ind(b, a).confidence_interval()
    limits = model.rows[0].difference.low, model.rows[0].difference.high
    assert limits == pytest.approx((expected.low, expected.high))
    assert 'no random intercept' in model.remark


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        (lambda rows: rows[rows['condition'] == 'a'], 'only one condition has data'),
        (lambda rows: rows.head(4), '4 observations of 2 participants are too few'),
        (lambda rows: rows.assign(y=2.0), 'all values are 2'),
    ],
)
def test_a_model_that_cannot_be_fitted_says_why_in_a_sentence(
    change: Callable[[pd.DataFrame], pd.DataFrame], reason: str
) -> None:
    with pytest.raises(ModelError, match=reason):
        effects(change(paired(12)), 'y', ['a', 'b'])


def test_a_fixed_order_takes_the_position_out_of_the_model() -> None:
    rows = paired(12)
    rows['position'] = np.where(rows['condition'] == 'a', 1, 2)
    model = effects(rows, 'y', ['a', 'b'])
    assert 'cannot be separated' in model.remark
    assert model.rows[0].difference.holds(3.0)


def test_merged_wordings_are_one_button_of_most_people(
    study: StudyFolder, results: Results, tmp_path: Path
) -> None:
    first = next(each.text for each in results.data.records[0].of('button'))
    file, page = tmp_path / 'wordings.yaml', tmp_path / 'report.html'
    file.write_text(f'fetch: ["{first}", go to destination, go to destination and dropoff]\n')
    assert write_report(study, page, file) == []
    assert re.search(r'more than half of the people named (?:[^<]*, )?fetch', page.read_text())
    file.write_text('fetch: get\n')
    with pytest.raises(CommandError, match=r'wordings\.yaml: .*list of wordings'):
        write_report(study, page, file)


def test_options_are_as_accurate_as_when_they_were_taught(
    results: Results, taught: dict[str, Taught], taxi: Domain
) -> None:
    points = accuracy_table(results.data, {'whole'})
    for name, own in points.groupby('condition'):
        lesson = taught[str(name)]
        assert own['demonstrations'].tolist() == [
            *range(1, lesson.summaries[0].n_demonstrations + 1)
        ]
        expected = accuracies(lesson.options[0], taxi)
        assert own['policy'].iloc[-1] == expected['policy_accuracy'] > own['policy'].iloc[0] / 2
        assert own['return'].iloc[-1] <= own['best_return'].iloc[-1]
    assert set(points['condition']) == {'plain', 'derived'}
    assert accuracy_table(results.data, ()).empty
    section = paper_section(results)
    assert section is not None
    assert 'taxi' in section.notes[0]


def test_an_option_taught_in_two_conditions_has_two_curves() -> None:
    rows = [
        {'option': 'fetch', 'participant': 'p', 'condition': c, 'demonstrations': n, 'policy': 0.5}
        for c in 'ab'
        for n in (1, 2)
    ]
    assert 'mean of 2' in accuracy_figure(pd.DataFrame(rows), 'policy', 'taxi', 40)
