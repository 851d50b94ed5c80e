"""Options learned again from demonstrations and bags, and their numbers live and offline."""

from collections.abc import Iterable
from dataclasses import asdict, fields, replace
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import reference_options
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.msg import GameState, OptionResult
from humanopts_learner.demonstrations import Demonstration, group_by_option, Kind
from humanopts_learner.options.criteria import judge, Thresholds
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_learner.summary import OptionSummary
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
from humanopts_teach.evaluation.measures import (
    option_block,
    OptionBlock,
    Settings,
    settings_from_facts,
)
from humanopts_teach.evaluation.summary import (
    differences,
    Execution,
    Live,
    SummaryError,
    write_json,
)
from humanopts_teach.evaluation.text import evaluation_text
import pytest
from rclpy.serialization import serialize_message

SETTINGS = Settings(seed=5)
FACTS = {
    'seed': '5',
    'return_delta': '0.75',
    'initiation_error': '0.05',
    'termination_error': '0.1',
    'strategy': 'random',
    'budget': '40',
    'teacher_error_rate': '0.0',
}
RECORDED = Settings(5, 'random', Thresholds(0.75, 0.05, 0.1), 0.0, 40)  # these
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
    path: Path, domain: Domain[Any], demos: Lesson, facts: dict[str, str] | None = None
) -> Path:
    """Write a bag of a lesson."""
    return record(path, [domain_to_info(domain), *map(demonstration_to_message, demos)], facts)


@pytest.fixture(scope='module')
def told() -> list[tuple[float, float]]:
    """How far the evaluation was said to be."""
    return []


@pytest.fixture(scope='module')
def evaluation(
    taxi: Domain[Any], taxi_lesson: Lesson, told: list[tuple[float, float]]
) -> BagEvaluation:
    """The lesson, evaluated."""
    return evaluate(
        taxi_lesson, taxi, SETTINGS, (), lambda done, total, _: told.append((done, total))
    )


@pytest.fixture(scope='module')
def first(taxi_lesson: Lesson) -> Lesson:
    """What was shown of the first of its two options."""
    return [demo for demo in taxi_lesson if demo.option_name == taxi_lesson[0].option_name]


@pytest.mark.heavy
def test_order_and_repetitions_change_no_number(
    taxi: Domain[Any], first: Lesson, evaluation: BagEvaluation
) -> None:
    mixed = [*reversed(first), *first]
    assert evaluate(mixed, taxi, SETTINGS).blocks == evaluation.blocks[:1]


def test_one_demonstration_less_changes_the_numbers(
    taxi: Domain[Any], taxi_lesson: Lesson, evaluation: BagEvaluation
) -> None:
    gone = next(i for i, d in enumerate(taxi_lesson) if d.kind is Kind.TRAJECTORY)
    fewer = evaluate(taxi_lesson[:gone] + taxi_lesson[gone + 1 :], taxi, SETTINGS)
    assert fewer.blocks[0] != evaluation.blocks[0]
    assert fewer.blocks[1] == evaluation.blocks[1]


@pytest.mark.heavy
def test_what_was_taken_back_is_as_if_it_had_never_been_shown(
    taxi: Domain[Any], first: Lesson, evaluation: BagEvaluation
) -> None:
    wrong = replace(first[3], uuid=str(uuid.uuid4()), can_start_at_end=True, number=1000)
    told = [*first[:9], wrong, replace(wrong, withdrawn=True), *first[9:], wrong]
    assert evaluate([*first, wrong], taxi, SETTINGS).blocks != evaluation.blocks[:1]
    found = evaluate(told, taxi, SETTINGS)
    assert found.blocks == evaluation.blocks[:1]
    assert found.options[0].curve == evaluation.options[0].curve


def test_the_learning_curve_ends_at_the_options_block(evaluation: BagEvaluation) -> None:
    for option in evaluation.options:
        point, block = option.to_dict()['learning_curve'][-1], asdict(option.last.block)
        assert {name: point[name] for name in block if name in point}.items() <= block.items()
        for name in ('initiation', 'termination'):
            assert point['criteria'][name]['value'] == block[f'cv_error_{name}']
        counts = [p.option.n_demonstrations + p.option.n_not_here for p in option.curve]
        assert counts == list(range(counts[0], counts[-1] + 1))


def test_primitive_actions_plan_at_least_as_well_as_options(evaluation: BagEvaluation) -> None:
    human, primitive = evaluation.planning
    assert (human.action_set, primitive.action_set) == ('human', 'primitive')
    assert human.converged
    assert primitive.mean_return is not None
    assert human.mean_return is not None
    assert human.mean_return <= primitive.mean_return


@pytest.mark.heavy
def test_people_are_evaluated_apart(taxi: Domain[Any], first: Lesson) -> None:
    other = [
        replace(demo, participant='p2', uuid=str(uuid.uuid5(uuid.NAMESPACE_OID, demo.uuid)))
        for demo in first
    ]
    both = evaluate([*first, *other], taxi, SETTINGS)
    assert [option.participant for option in both.options] == ['p1', 'p2']
    assert tuple(both.named_plans) == ('human by p1', 'human by p2', 'primitive')


def test_progress_ends_at_its_total(
    evaluation: BagEvaluation, told: list[tuple[float, float]]
) -> None:
    assert evaluation.options
    assert told[-1][0] == told[-1][1]
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_json_holds_no_nan_and_the_text_names_every_option(evaluation: BagEvaluation) -> None:
    values = json.loads(json.dumps(evaluation.to_dict(), allow_nan=False))
    assert len(values['options'][0]['learning_curve']) == len(evaluation.options[0].curve)
    text = evaluation_text(evaluation)
    assert all(block.name in text for block in evaluation.blocks)
    assert 'nan' not in text


def test_a_demonstration_of_another_game_is_left_out_and_named(
    taxi: Domain[Any], first: Lesson, evaluation: BagEvaluation
) -> None:
    stray = replace(first[0], domain='chess', uuid='00000000-0000-4000-8000-000000000000')
    found = evaluate([*first, stray], taxi, SETTINGS)
    assert found.blocks == evaluation.blocks[:1]
    assert any(stray.uuid in warning and 'chess' in warning for warning in found.warnings)


def test_nothing_to_learn_from_is_an_error_that_says_so(
    taxi: Domain[Any], taxi_lesson: Lesson
) -> None:
    with pytest.raises(EvaluationError, match='no demonstration to learn from'):
        evaluate([], taxi, SETTINGS)
    refused = [demo for demo in taxi_lesson if demo.kind is Kind.NOT_HERE]
    assert refused
    with pytest.raises(EvaluationError, match='not here'):
        evaluate(refused, taxi, SETTINGS)


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
        ('return_delta', 'nan'),
        ('initiation_error', '7'),
        ('teacher_error_rate', '2'),
        ('teacher_error_rate', 'nan'),
    ],
)
def test_a_fact_that_makes_no_sense_is_replaced_and_named(name: str, text: str) -> None:
    settings, assumed = settings_from_facts({name: text})
    assert settings == Settings()
    assert any(name in note and text in note for note in assumed)


def files_of(evaluation: BagEvaluation, lesson: Lesson) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the option files of a lesson."""
    options = [each.last.option for each in evaluation.options]
    shown = {demo.uuid: demo for demo in lesson}
    return {
        (o.participant, o.name): json.loads(option_to_json(o, [shown[u] for u in o.uuids]))
        for o in options
    }


def test_options_learned_again_are_compared_with_their_files(
    taxi_lesson: Lesson, evaluation: BagEvaluation
) -> None:
    files, options = files_of(evaluation, taxi_lesson), [e.last.option for e in evaluation.options]
    first, second = files
    assert compare_options(files, options, taxi_lesson) == ({first: True, second: True}, [])
    files[first]['policy']['nodes'][0]['counts'][0] += 1e-9
    equal, notes = compare_options(files, options, taxi_lesson)
    assert equal == {first: False, second: True}
    assert notes == [f'{first[1]!r} by p1 differs from its option file: policy']
    (note,) = compare_options({second: files[second]}, options[:1], taxi_lesson)[1]
    assert 'was not learned again' in note
    files['automatic', 'down'] = {'uuids': []}  # nobody taught it
    assert compare_options(files, options, taxi_lesson)[1] == notes


def test_a_bag_whose_option_files_come_out_again_says_so(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: Lesson, evaluation: BagEvaluation
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
    taxi: Domain[Any],
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
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: Lesson, capsys: pytest.CaptureFixture[str]
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


@pytest.fixture(scope='module')
def of_bag(
    tmp_path_factory: pytest.TempPathFactory, taxi: Domain[Any], taxi_lesson: Lesson
) -> BagEvaluation:
    """The bag of the lesson, evaluated."""
    bag = tmp_path_factory.mktemp('lesson') / 'bag'
    return evaluate_bag(record_lesson(bag, taxi, taxi_lesson))


@pytest.mark.heavy
def test_a_bag_gives_the_numbers_of_its_demonstrations_exactly(
    taxi: Domain[Any], first: Lesson, of_bag: BagEvaluation
) -> None:
    live = evaluate(first, taxi, RECORDED)
    assert of_bag.settings == RECORDED
    assert of_bag.blocks[:1] == live.blocks
    assert of_bag.options[0].curve == live.options[0].curve
    assert of_bag.warnings == ()


def test_a_bag_without_facts_is_evaluated_with_defaults_and_says_so(
    tmp_path: Path, taxi: Domain[Any], first: Lesson
) -> None:
    found = evaluate_bag(record_lesson(tmp_path / 'bag', taxi, first[:6], facts={}))
    assert found.settings == Settings()
    assert any('seed' in warning for warning in found.warnings)


def test_a_bag_that_is_none_or_has_no_demonstration_is_refused(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    with BagWriter(tmp_path / 'bag') as bag:
        for kind in ('DomainInfo', 'Demonstration'):
            bag.add_topic(f'/{kind.lower()}', f'humanopts_interfaces/msg/{kind}')
        bag.write('/domaininfo', serialize_message(domain_to_info(taxi)), 1)
    with pytest.raises(EvaluationError, match='no demonstration to learn from'):
        evaluate_bag(tmp_path / 'bag')
    with pytest.raises(BagError, match='nothing'):
        evaluate_bag(tmp_path / 'nothing')


DEEP = '[' * 100_000


def test_deep_json_in_a_bag_is_named_and_the_rest_is_evaluated(
    taxi: Domain[Any], taxi_lesson: Lesson, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = taxi_lesson[:12]
    deep = [replace(known[0], uuid=str(uuid.uuid4()), domain_parameters=DEEP)]
    bag = record_lesson(tmp_path / 'bag', taxi, [*known, *deep])
    found = evaluate_bag(bag)
    assert [block.name for block in found.blocks] == [known[0].option_name]
    assert 'nested more than' in ' '.join(found.warnings)
    info = domain_to_info(taxi)
    info.parameters = DEEP
    record(tmp_path / 'deep', [info, *map(demonstration_to_message, known)])
    assert main(['bag', 'eval', str(tmp_path / 'deep')]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert 'nested more than' in line


def test_no_escape_sequence_in_a_name_reaches_the_terminal(
    taxi: Domain[Any], taxi_lesson: Lesson, tmp_path: Path, capsys: pytest.CaptureFixture[str]
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


KEYS = {part.name for part in fields(OptionBlock)}  # tests/test_demo.py has their list
Taught = tuple[LearnedOption, OptionSummary]


def learn(domain: Domain[Any], demos: list[Demonstration], count: int = 100) -> Taught:
    """Learn and judge the first option from its first demonstrations."""
    shown = next(iter(group_by_option(demos).values()))[:count]
    return learn_option(shown, domain, 3), judge(shown, domain, Thresholds(), 3)


def as_message(judgement: OptionSummary) -> SimpleNamespace:
    """Return what OptionStatus carries: plain numbers, NaN where there is none."""
    criteria = [
        SimpleNamespace(name=c.name, value=math.nan if c.value is None else c.value)
        for c in judgement.criteria
    ]
    return SimpleNamespace(
        criteria=criteria,
        criteria_met=judgement.criteria_met,
        mean_return_demonstrations=judgement.mean_return_demonstrations,
        mean_return_policy=judgement.mean_return_policy,
    )


@pytest.mark.parametrize('count', [1, 12])
def test_a_message_and_the_judgement_it_carried_give_the_same_block(
    taxi: Domain[Any], taxi_lesson: list[Demonstration], count: int
) -> None:
    option, judgement = learn(taxi, taxi_lesson, count)
    reference = reference_options(taxi)[option.name]
    offline = option_block(option, judgement, taxi, reference)
    assert option_block(option, as_message(judgement), taxi, reference) == offline


def test_what_cannot_be_measured_is_null_and_never_nan(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    option, judgement = learn(taxi, taxi_lesson, 1)
    block = option_block(option, as_message(judgement), taxi)
    values = json.loads(json.dumps(asdict(block), allow_nan=False))
    unknown = {name for name, value in values.items() if value is None}
    assert unknown == {name for name in KEYS if name.startswith(('cv_', 'policy_', 'classif'))}


def test_a_difference_names_what_differs_and_both_values(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    offline = evaluate(taxi_lesson, taxi, Settings(seed=3))
    block, other = offline.blocks
    human, primitive = offline.planning
    live = Live(offline.blocks, offline.planning, Execution(1, 1, 0, -10.0))
    assert differences(live, offline) == []

    changed = replace(block, mean_return_policy=-1.25)
    was = f'mean_return_policy of {block.name!r} was -1.25 live'
    found = differences(replace(live, options=(changed, other)), offline)
    assert found == [f'{was} and is {block.mean_return_policy!r} offline']
    for shown, why in (
        ((block,), f'{other.name!r} is in the bag but was not learned live'),
        ((block, other, replace(other, name='x')), "'x' was learned live but is not in the bag"),
        ((block, other, other), f"'{other.name} (2)' was learned live but is not in the bag"),
    ):
        assert differences(replace(live, options=shown), offline) == [why]

    slower = replace(human, model_seconds=human.model_seconds + 1.0)
    assert differences(replace(live, planning=(slower, primitive)), offline) == []
    more = replace(human, sweeps=human.sweeps + 1)
    (plan,) = differences(replace(live, planning=(more, primitive)), offline)
    assert plan.startswith('sweeps of the human plan was')
    (gone,) = differences(live, replace(offline, plans=offline.plans[:1]))
    assert gone == 'the plan with primitive actions cannot be made from the bag'


def test_a_written_file_reads_back_equal_and_leaves_nothing_else(tmp_path: Path) -> None:
    path, values = tmp_path / 'summary.json', {'mean return': -10.5, 'games': None}
    path.write_text('old')
    write_json(path, values)
    assert json.loads(path.read_text()) == values
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / 'summary.json'
    with pytest.raises(SummaryError, match=r'nowhere.*No such file'):
        write_json(tmp_path / 'nowhere/summary.json', {})
    path.write_text('old')
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'value': float('nan')})
    assert path.read_text() == 'old'
