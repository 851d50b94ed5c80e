"""The options block: one function for live and offline numbers."""

from dataclasses import replace
import json
import math
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, group_by_option
from humanopts_learner.options.criteria import judge, Judgement, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.evaluation.summary import differences, option_block, OptionBlock
import pytest

KEYS = {
    'name',
    'features',
    'n_demonstrations',
    'policy_accuracy',
    'mean_return_demonstrations',
    'mean_return_policy',
    'cv_error_initiation',
    'cv_error_termination',
    'classification_accuracy_initiation',
    'classification_accuracy_termination',
    'criteria_met',
}
Taught = tuple[LearnedOption, Judgement]


def learn(domain: Domain[Any], demos: list[Demonstration], count: int = 100) -> Taught:
    """Learn and judge the first option from its first demonstrations."""
    shown = next(iter(group_by_option(demos).values()))[:count]
    return learn_option(shown, domain, 3), judge(shown, domain, Thresholds(), 3)


def as_message(judgement: Judgement) -> SimpleNamespace:
    """Return what OptionStatus carries: plain numbers, NaN where there is none."""
    criteria = [
        SimpleNamespace(
            name=c.name,
            value=math.nan if c.value is None else c.value,
            threshold=c.threshold,
            measurable=c.measurable,
            met=c.met,
        )
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
    assert set(offline.to_dict()) == KEYS


def test_what_cannot_be_measured_is_null_and_never_nan(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    option, judgement = learn(taxi, taxi_lesson, 1)
    block = option_block(option, as_message(judgement), taxi)
    values = json.loads(json.dumps(block.to_dict(), allow_nan=False))
    unknown = {name for name, value in values.items() if value is None}
    assert unknown == {name for name in KEYS if name.startswith(('cv_', 'policy_', 'classif'))}


def test_accuracies_are_measured_where_states_cannot_be_listed(
    pacman_lesson: list[Demonstration],
) -> None:
    pacman = make_domain('pacman')
    option, judgement = learn(pacman, pacman_lesson)
    block = option_block(option, judgement, pacman, reference_options(pacman)[option.name])
    assert block.policy_accuracy == 1.0
    assert block.classification_accuracy_initiation == pytest.approx(1.0, abs=0.01)
    assert block.classification_accuracy_termination == 1.0


def test_a_block_is_the_same_after_a_round_through_json(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    block = option_block(*learn(taxi, taxi_lesson), taxi)
    assert OptionBlock.from_dict(json.loads(json.dumps(block.to_dict()))) == block


def test_differences_name_the_option_the_measure_and_both_values(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    block = option_block(*learn(taxi, taxi_lesson), taxi)
    other = replace(block, mean_return_policy=-1.25)
    (text,) = differences([block], [other])
    assert block.name in text
    assert 'mean_return_policy' in text
    assert repr(block.mean_return_policy) in text
    assert '-1.25' in text
    assert differences([block], [block]) == []


def test_an_option_on_one_side_only_is_a_difference(
    taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    block = option_block(*learn(taxi, taxi_lesson), taxi)
    assert 'not in the bag' in differences([block], [])[0]
    assert 'not learned live' in differences([], [block])[0]
    assert len(differences([block, block], [block])) == 1
