"""Bags as they are recorded, evaluated: nothing but their demonstrations and facts is used."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import reference_options
from humanopts_env.ros.convert import domain_to_info
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.criteria import Thresholds
from humanopts_learner.ros.convert import demonstration_to_message, status_to_message
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.evaluation.bag_evaluation import evaluate, evaluate_bag, EvaluationError
from humanopts_teach.evaluation.summary import option_block, Settings
import pytest
from rclpy.serialization import serialize_message

FACTS = {
    'seed': '5',
    'return_delta': '0.75',
    'initiation_error': '0.05',
    'termination_error': '0.1',
    'strategy': 'random',
    'budget': '40',
    'teacher_error_rate': '0.0',
}
SETTINGS = Settings(5, Thresholds(0.75, 0.05, 0.1), 'random', 40, 0.0)


def record(
    path: Path,
    domain: Domain[Any],
    demos: Sequence[Demonstration],
    facts: dict[str, str] | None = None,
) -> Path:
    """Write a bag of a lesson."""
    with BagWriter(path, FACTS if facts is None else facts) as bag:
        bag.add_topic('/domain_info', 'humanopts_interfaces/msg/DomainInfo')
        bag.add_topic('/demonstrations', 'humanopts_interfaces/msg/Demonstration')
        info = domain_to_info(domain)
        info.publisher_id, info.sequence = 'game-1', 1
        bag.write('/domain_info', serialize_message(info), 1)
        for number, demo in enumerate(demos, start=1):
            message = demonstration_to_message(demo)
            message.publisher_id, message.sequence = 'lesson-1', number
            bag.write('/demonstrations', serialize_message(message), 1 + number)
    return path


def test_a_bag_gives_the_numbers_of_its_demonstrations_exactly(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    found = evaluate_bag(record(tmp_path / 'bag', taxi, taxi_lesson))
    live = evaluate(taxi_lesson, taxi, SETTINGS)
    assert found.settings == SETTINGS
    assert found.blocks == live.blocks
    assert [option.curve for option in found.options] == [option.curve for option in live.options]
    assert found.warnings == ()


def test_the_status_message_gives_the_same_block_as_the_bag(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    for option in evaluate_bag(record(tmp_path / 'bag', taxi, taxi_lesson)).options:
        status = status_to_message(option.option, option.judgement)
        reference = reference_options(taxi)[option.block.name]
        assert option_block(option.option, status, taxi, reference) == option.block


def test_a_bag_without_one_demonstration_gives_other_numbers(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    whole = evaluate_bag(record(tmp_path / 'whole', taxi, taxi_lesson))
    fewer = evaluate_bag(record(tmp_path / 'fewer', taxi, taxi_lesson[1:]))
    assert fewer.blocks[0].n_demonstrations == whole.blocks[0].n_demonstrations - 1
    assert fewer.blocks[0] != whole.blocks[0]


def test_a_bag_without_facts_is_evaluated_with_defaults_and_says_so(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    found = evaluate_bag(record(tmp_path / 'bag', taxi, taxi_lesson, facts={}))
    assert found.settings == Settings()
    assert any('seed' in warning for warning in found.warnings)


def test_a_bag_with_no_demonstration_is_refused(tmp_path: Path, taxi: Domain[Any]) -> None:
    with pytest.raises(EvaluationError, match='no demonstration to learn from'):
        evaluate_bag(record(tmp_path / 'bag', taxi, []))


def test_a_path_without_a_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='nothing'):
        evaluate_bag(tmp_path / 'nothing')
