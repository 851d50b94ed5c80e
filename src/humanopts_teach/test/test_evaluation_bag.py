"""Options learned again from demonstrations and bags, and their numbers live and offline."""

from collections.abc import Iterable
from dataclasses import replace
import json
from pathlib import Path
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.msg import Demonstration as Message
from humanopts_interfaces.msg import GameState, OptionResult
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.option_trainer import OptionTrainer
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.ros.convert import (
    demonstration_to_message,
    summary_from_message,
    summary_to_message,
)
from humanopts_teach.bags import BagError
from humanopts_teach.bags.provenance import UNKNOWN
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.cli import main
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    compare_options,
    evaluate,
    evaluate_bag,
    EvaluationError,
)
from humanopts_teach.evaluation.settings import EvaluationSettings, settings_from_facts
from humanopts_teach.evaluation.summary import (
    differences,
    Live,
    PlayedEpisodes,
    SummaryError,
    write_json,
)
from humanopts_teach.evaluation.tables import LIVE_OPTIONS, option_row, OPTIONS, records, table
from humanopts_teach.evaluation.text import evaluation_text
import pytest
from rclpy.serialization import serialize_message
from teach_support.bags import judged_run

SETTINGS = EvaluationSettings(seed=5)
FACTS = {
    'seed': '5',
    'success': '0.9',
    'return_share': '0.75',
    'initiation_error': '0.05',
    'termination_error': '0.1',
    'exam': '7',
    'strategy': 'random',
    'budget': '40',
    'teacher_error_rate': '0.0',
}
RECORDED = EvaluationSettings(5, 'random', Thresholds(0.9, 0.75, 0.05, 0.1, 7), 0.0, 40)  # these
Lesson = list[Demonstration]


def record(
    path: Path,
    messages: Iterable[Any],
    facts: dict[str, str] | None = None,
    attached: dict[str, Any] | None = None,
) -> Path:
    """Write a bag of messages, each kind on a topic of its own, and of files as JSON."""
    with BagWriter(path, FACTS if facts is None else facts) as bag:
        for time, message in enumerate(messages):
            name = type(message).__name__
            bag.add_topic(f'/{name.lower()}', f'humanopts_interfaces/msg/{name}')
            bag.write(f'/{name.lower()}', serialize_message(message), time)
        for name, data in (attached or {}).items():
            bag.attach(name, json.dumps(data).encode())
    return path


def record_lesson(
    path: Path, domain: Domain, demos: Lesson, facts: dict[str, str] | None = None
) -> Path:
    """Write a bag of a lesson."""
    return record(path, [domain_to_info(domain), *map(demonstration_to_message, demos)], facts)


@pytest.fixture(scope='module')
def progress() -> list[tuple[float, float]]:
    """The progress of the evaluation."""
    return []


@pytest.fixture(scope='module')
def evaluation(
    taxi: Domain, taxi_lesson: Lesson, progress: list[tuple[float, float]]
) -> BagEvaluation:
    """The lesson, evaluated."""
    return evaluate(
        taxi_lesson, taxi, SETTINGS, (), lambda done, total, _: progress.append((done, total))
    )


@pytest.fixture(scope='module')
def first(taxi_lesson: Lesson) -> Lesson:
    """The demonstrations of the first of its two options."""
    return [demo for demo in taxi_lesson if demo.option_name == taxi_lesson[0].option_name]


def numbers(evaluation: BagEvaluation) -> list[dict[str, Any]]:
    """Return the numbers of each option."""
    return records(evaluation.option_table)


@pytest.mark.heavy
def test_order_repetitions_withdrawn_and_foreign_demonstrations_change_no_number(
    taxi: Domain, first: Lesson, evaluation: BagEvaluation
) -> None:
    wrong = replace(first[3], uuid=str(uuid.uuid4()), can_start_at_end=True, number=1000)
    back, stray = (
        replace(wrong, withdrawn=True),
        replace(wrong, domain='chess', uuid=str(uuid.uuid4())),
    )
    shown = [*first[:9], wrong, back, stray, *first[9:], wrong]
    assert numbers(evaluate([*first, wrong], taxi, SETTINGS)) != numbers(evaluation)[:1]
    found = evaluate(shown, taxi, SETTINGS)
    assert found.options[0].learning.equals(evaluation.options[0].learning)
    assert any(stray.uuid in warning and 'chess' in warning for warning in found.warnings)
    assert numbers(evaluate([*reversed(shown), *shown], taxi, SETTINGS)) == numbers(found)


@pytest.mark.heavy
def test_nothing_is_learned_from_judged_runs(
    taxi: Domain, first: Lesson, evaluation: BagEvaluation
) -> None:
    runs = [judged_run(first[n], first[: n + 3], n, right=True) for n in range(1, 4)]
    found = evaluate([*first, *runs], taxi, SETTINGS)
    assert found.options[0].option == evaluation.options[0].option
    counted = ['n_demonstrations', 'n_not_here', 'mean_return_policy', 'seconds']
    assert found.options[0].learning[counted].equals(evaluation.options[0].learning[counted])
    only = [replace(demo, withdrawn=True) for demo in first]
    with pytest.raises(EvaluationError, match='has no demonstration left'):
        evaluate([*only, *runs], taxi, SETTINGS)


@pytest.mark.heavy
def test_a_bag_gives_the_status_of_the_learner_exams_and_answers_included(
    tmp_path: Path, taxi: Domain, first: Lesson
) -> None:
    earlier, newest = first[:-1], first
    failed = [judged_run(first[n], earlier, n, exam=True, right=n < 2) for n in (1, 2)]
    back = judged_run(first[3], newest, 4, exam=True)
    passed = [judged_run(first[n], newest, n, exam=True, right=True) for n in (5, 6)]
    answer = judged_run(first[3], newest, 3, right=True)
    given = [*earlier, *failed, newest[-1], answer, back, replace(back, withdrawn=True), *passed]
    trainer = OptionTrainer(tmp_path / 'options', taxi, RECORDED.thresholds, RECORDED.seed)
    for demo in given:
        assert trainer.take(demo)
    (live,) = trainer.options()
    assert (live.summary.n_questions, live.summary.exams_failed) == (1, 1)
    assert (live.summary.exam_right, live.summary.exam_runs) == (2, 2)
    (file,) = (tmp_path / 'options').glob('*/*.json')
    attached = json.loads(file.read_text('utf-8'))
    assert attached['status'] == live.summary.status
    messages = [domain_to_info(taxi), *map(demonstration_to_message, reversed(given))]
    record(tmp_path / 'bag', messages, FACTS, {'options/p1/fetch.json': attached})
    found = evaluate_bag(tmp_path / 'bag').options[0]
    assert (found.summary, found.reproduced) == (live.summary, True)
    assert {run.uuid for run in found.judged} == {run.uuid for run in (*failed, answer, *passed)}
    before = found.learning.iloc[-2]  # the version that failed
    assert (before.exam_right, before.exam_runs, before.exams_failed) == (1, 2, 0)
    again = OptionTrainer(tmp_path / 'options', taxi, RECORDED.thresholds, RECORDED.seed)
    assert again.options() == [live]


def test_an_evaluation_has_learning_curves_and_plans(
    evaluation: BagEvaluation, progress: list[tuple[float, float]]
) -> None:
    """Primitive actions plan at least as well as options; no number in JSON is NaN."""
    values = json.loads(json.dumps(evaluation.to_dict(), allow_nan=False))
    text = evaluation_text(evaluation)
    for found, option in zip(values['options'], evaluation.options, strict=True):
        counts = option.learning['n_demonstrations'] + option.learning['n_not_here']
        assert list(counts) == list(range(counts.iloc[0], counts.iloc[-1] + 1))
        assert len(found['learning_curve']) == len(counts)
        assert found['learning_curve'][-1].items() <= found.items()
        assert option.option.name in text
    assert 'nan' not in text
    plans = evaluation.plan_table
    assert list(plans['action_set']) == ['human', 'primitive']
    assert plans['converged'].all()
    assert plans['mean_return'].is_monotonic_increasing
    assert progress[-1][0] == progress[-1][1]
    assert [done for done, _ in progress] == sorted(done for done, _ in progress)


@pytest.mark.heavy
def test_people_are_evaluated_apart(taxi: Domain, first: Lesson) -> None:
    other = [
        replace(demo, participant='p2', uuid=str(uuid.uuid5(uuid.NAMESPACE_OID, demo.uuid)))
        for demo in first
    ]
    both = evaluate([*first, *other], taxi, SETTINGS)
    assert both.people == ['p1', 'p2']
    assert [*both.plans] == ['human by p1', 'human by p2', 'primitive']


def test_nothing_to_learn_from_is_an_error_that_says_so(
    taxi: Domain, taxi_lesson: Lesson, tmp_path: Path
) -> None:
    refused = [demo for demo in taxi_lesson if demo.kind is Kind.NOT_HERE]
    with pytest.raises(EvaluationError, match=r'no demonstration to learn from.*not here'):
        evaluate(refused, taxi, SETTINGS)
    record(tmp_path / 'bag', [domain_to_info(taxi), Message()])
    with pytest.raises(EvaluationError, match='no demonstration to learn from'):
        evaluate_bag(tmp_path / 'bag')
    with pytest.raises(BagError, match='nothing'):
        evaluate_bag(tmp_path / 'nothing')


def test_settings_are_read_from_the_facts_in_the_bag() -> None:
    assert settings_from_facts(FACTS) == (RECORDED, [])
    person, _ = settings_from_facts({**FACTS, 'teacher_error_rate': 'None'})
    assert person.teacher_error_rate is None
    few, _ = settings_from_facts({**FACTS, 'game_steps': '4000'})
    assert few == replace(RECORDED, game_steps=4000)


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('seed', '-1'),
        ('budget', 'many'),
        ('game_steps', '-1'),
        ('return_share', 'nan'),
        ('initiation_error', '7'),
        ('teacher_error_rate', '2'),
        ('teacher_error_rate', 'nan'),
    ],
)
def test_a_fact_that_makes_no_sense_is_replaced_and_named(name: str, text: str) -> None:
    settings, assumed = settings_from_facts({name: text})
    assert settings == EvaluationSettings()
    assert any(name in note and text in note for note in assumed)


def files_of(evaluation: BagEvaluation, lesson: Lesson) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the option files of a lesson."""
    shown, files = {demo.uuid: demo for demo in lesson}, {}
    for each in evaluation.options:
        option = each.option
        learned_from = [shown[uuid] for uuid in option.uuids]
        text = option_to_json(option, learned_from, each.summary.status)
        files[option.participant, option.name] = json.loads(text)
    return files


def test_options_learned_again_are_compared_with_their_files(
    taxi_lesson: Lesson, evaluation: BagEvaluation
) -> None:
    files, options = files_of(evaluation, taxi_lesson), evaluation.options
    first, second = files
    assert compare_options(files, options, taxi_lesson) == ({first: True, second: True}, [])
    files[first]['policy']['nodes'][0]['counts'][0] += 1e-9
    equal, notes = compare_options(files, options, taxi_lesson)
    assert equal == {first: False, second: True}
    assert notes == [f'{first[1]!r} by p1 differs from its option file: policy']
    (note,) = compare_options({second: files[second]}, options[:1], taxi_lesson)[1]
    assert 'was not learned again' in note
    files['automatic', 'down'] = {'uuids': []}  # without a teacher
    assert compare_options(files, options, taxi_lesson)[1] == notes
    files[second]['status'] = 'learned: nobody knows why'
    assert (
        f'{second[1]!r} by p1 differs from its option file: status'
        in (compare_options(files, options, taxi_lesson)[1])
    )


def test_a_bag_says_that_its_option_files_are_reproduced(
    tmp_path: Path, taxi: Domain, taxi_lesson: Lesson, evaluation: BagEvaluation
) -> None:
    (file, _) = files_of(evaluation, taxi_lesson).values()
    shown = [demo for demo in taxi_lesson if demo.option_name == file['name']]
    messages = [domain_to_info(taxi), *map(demonstration_to_message, shown)]
    facts = {'seed': '5', 'numpy': '1.0', 'scikit-learn': UNKNOWN}
    attached = {'options/p1/fetch.json': file, 'notes.json': []}
    record(tmp_path / 'bag', messages, facts, attached)
    found = evaluate_bag(tmp_path / 'bag')
    assert [option.reproduced for option in found.options] == [True]
    assert found.to_dict()['options'][0]['equals_option_file'] is True
    assert 'equal to its option file in the bag, to the last digit' in evaluation_text(found)
    (warning,) = (text for text in found.warnings if 'recorded with' in text)
    assert warning.startswith('recorded with numpy 1.0, and this is')


@pytest.mark.parametrize(
    ('asked', 'reason'),
    [
        (['--games', '10'], 'plans in taxi are exact'),
        (['--html', ''], 'it is a folder'),
        (['--html', 'nowhere/report.html'], 'there is no such folder'),
        ([], 'no topic of demonstrations'),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_work(
    tmp_path: Path,
    taxi: Domain,
    capsys: pytest.CaptureFixture[str],
    asked: list[str],
    reason: str,
) -> None:
    record(tmp_path / 'bag', [domain_to_info(taxi)])  # of which nothing can be learned
    if '--html' in asked:
        asked = ['--html', str(tmp_path / asked[1])]
    assert main(['bag', 'eval', str(tmp_path / 'bag'), *asked]) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.heavy
def test_a_state_that_is_none_of_the_domain_is_an_error_of_the_report(
    tmp_path: Path, taxi: Domain, taxi_lesson: Lesson, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = [
        domain_to_info(taxi),
        demonstration_to_message(taxi_lesson[0]),
        GameState(publisher_id='/game#1', sequence=1, episode=1, state='chess e4'),
        GameState(publisher_id='/game#1', sequence=2, episode=1, step=1, terminated=True),
        OptionResult(option_name='fetch', episode=1, step_count=1, terminated=True),
    ]
    record(tmp_path / 'bag', messages)
    assert main(['bag', 'eval', str(tmp_path / 'bag'), '--html', str(tmp_path / 'r.html')]) == 2
    assert "'chess e4' is not a taxi state" in capsys.readouterr().err


@pytest.mark.heavy
def test_a_bag_gives_the_numbers_of_its_demonstrations_exactly(
    tmp_path: Path, taxi: Domain, taxi_lesson: Lesson, first: Lesson
) -> None:
    found = evaluate_bag(record_lesson(tmp_path / 'bag', taxi, taxi_lesson))
    assert found.settings == RECORDED
    assert found.options[0].learning.equals(evaluate(first, taxi, RECORDED).options[0].learning)
    assert found.warnings == ()


def test_a_bag_without_facts_is_evaluated_with_defaults_and_says_so(
    tmp_path: Path, taxi: Domain, first: Lesson
) -> None:
    found = evaluate_bag(record_lesson(tmp_path / 'bag', taxi, first[:6], facts={}))
    assert found.settings == EvaluationSettings()
    assert any('seed' in warning for warning in found.warnings)


DEEP = '[' * 100_000


def test_deep_json_in_a_bag_is_named_and_the_rest_is_evaluated(
    taxi: Domain, taxi_lesson: Lesson, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = taxi_lesson[:12]
    deep = [replace(known[0], uuid=str(uuid.uuid4()), domain_parameters=DEEP)]
    bag = record_lesson(tmp_path / 'bag', taxi, [*known, *deep])
    found = evaluate_bag(bag)
    assert [option.option.name for option in found.options] == [known[0].option_name]
    assert 'nested more than' in ' '.join(found.warnings)
    info = domain_to_info(taxi)
    info.parameters = DEEP
    record(tmp_path / 'deep', [info, *map(demonstration_to_message, known)])
    assert main(['bag', 'eval', str(tmp_path / 'deep')]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert 'nested more than' in line


def test_no_escape_sequence_in_a_name_reaches_the_terminal(
    taxi: Domain, taxi_lesson: Lesson, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    named = [
        replace(d, option_name='go\x1b[2J', participant='p\x1b]0;x\x07') for d in taxi_lesson[:9]
    ]
    messages = [domain_to_info(taxi), *map(demonstration_to_message, named)]
    for message in messages:
        message.publisher_id, message.sequence = '/x\x1b[31m#1', 5
    bag = str(record(tmp_path / 'bag', messages, {'seed': '\x1b[5m', 'budget': '\x9b2J'}))
    for command in ('info', 'check', 'eval'):
        main(['bag', command, bag])
    out = capsys.readouterr()
    assert '\\x1b[31m' in out.out
    assert all(char.isprintable() or char == '\n' for char in out.out + out.err)


@pytest.mark.parametrize('count', [1, 12])
def test_a_message_and_the_summary_it_carried_give_the_same_row(
    taxi: Domain, first: Lesson, count: int
) -> None:
    shown = first[:count]
    option, summary = learn_option(shown, taxi, 3), judge(shown, taxi, Thresholds(), 3)
    sent = summary_from_message(summary_to_message(summary))
    live, offline = (
        table(OPTIONS, [option_row(each, option, taxi)])[[*LIVE_OPTIONS]]
        for each in (sent, summary)
    )
    assert live.equals(offline)
    (row,) = json.loads(json.dumps(records(live), allow_nan=False))
    unknown = {name for name, value in row.items() if value is None}
    held_out = {'return', 'initiation', 'termination'}
    assert unknown == {'agreement'} | (held_out if count == 1 else set())


def test_a_difference_names_what_differs_and_both_values(
    taxi: Domain, taxi_lesson: Lesson
) -> None:
    offline = evaluate(taxi_lesson, taxi, EvaluationSettings(seed=3))
    options, plans = offline.option_table, offline.plan_table
    live = Live(options, plans, PlayedEpisodes(1, 1, 0, 0, -10.0))
    assert differences(live, offline) == []
    slower = plans.assign(model_seconds=plans['model_seconds'] + 1.0)
    assert differences(replace(live, plans=slower), offline) == []

    first, second = options['option_name']
    changed = options.assign(mean_return_policy=[-1.25, options['mean_return_policy'][1]])
    was = float(options['mean_return_policy'][0])
    fewer = replace(live, options=changed[:1], plans=plans[:1].assign(sweeps=0))
    assert differences(fewer, offline) == [
        f"mean_return_policy of the option {first!r} 'p1' was -1.25 live and is {was!r} offline",
        f"the option {second!r} 'p1' is not in the live numbers",
        f"sweeps of the plan 'human' was 0 live and is {plans['sweeps'].iloc[0]} offline",
        "the plan 'primitive' is not in the live numbers",
    ]


def test_a_file_is_written_whole_or_the_old_one_stays(tmp_path: Path) -> None:
    path, values = tmp_path / 'summary.json', {'mean return': -10.5, 'games': None}
    path.write_text('old')
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'value': float('nan')})
    assert path.read_text() == 'old'
    write_json(path, values)
    assert json.loads(path.read_text()) == values
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(SummaryError, match=r'nowhere.*No such file'):
        write_json(tmp_path / 'nowhere/summary.json', {})
