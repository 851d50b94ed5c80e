"""The numbers of a lesson: one function for live and offline, and summary.json."""

from dataclasses import fields, replace
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, group_by_option
from humanopts_learner.options.criteria import judge, Judgement, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.evaluation.summary import (
    BagFacts,
    differences,
    Execution,
    option_block,
    OptionBlock,
    PlanningRow,
    Settings,
    Summary,
    SummaryError,
    write_json,
)
import pytest

KEYS = {part.name for part in fields(OptionBlock)}  # tests/test_demo.py has their list
Taught = tuple[LearnedOption, Judgement]


def learn(domain: Domain[Any], demos: list[Demonstration], count: int = 100) -> Taught:
    """Learn and judge the first option from its first demonstrations."""
    shown = next(iter(group_by_option(demos).values()))[:count]
    return learn_option(shown, domain, 3), judge(shown, domain, Thresholds(), 3)


def as_message(judgement: Judgement) -> SimpleNamespace:
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
    was = f'mean_return_policy of {block.name!r} was {block.mean_return_policy!r} live'
    assert differences([block], [other]) == [f'{was} and is -1.25 offline']
    assert differences([block], [block]) == []
    assert 'not in the bag' in differences([block], [])[0]
    assert 'not learned live' in differences([], [block])[0]
    assert len(differences([block, block], [block])) == 1


ROW = PlanningRow('human', 0.99, 0.1, 0.2, 0.3, 7, 1e-9, True, -10.5, None)
SUMMARY = Summary(
    domain='taxi',
    settings=Settings(seed=4, thresholds=Thresholds(1.5, 0.05, 0.1), teacher_error_rate=0.02),
    options=(),
    planning=(ROW,),
    execution=Execution(100, 100, 0, -10.5),
    bag=BagFacts('bag', 1234, 30),
    offline=(),
)


def test_the_summary_has_the_agreed_form() -> None:
    assert SUMMARY.to_dict() == {
        'domain': 'taxi',
        'seed': 4,
        'options': [],
        'teaching': {
            'strategy': 'failures',
            'thresholds': {
                'return_delta': 1.5,
                'initiation_error': 0.05,
                'termination_error': 0.1,
            },
            'teacher_error_rate': 0.02,
            'budget': 150,
        },
        'planning': [
            {
                'action_set': 'human',
                'gamma': 0.99,
                'table_seconds': 0.1,
                'model_seconds': 0.2,
                'sweep_seconds': 0.3,
                'sweeps': 7,
                'residual': 1e-9,
                'converged': True,
                'mean_return': -10.5,
                'mean_discounted_return': None,
                'game_steps': 0,
                'episodes': 0,
                'mean_return_low': None,
                'mean_return_high': None,
                'fallbacks': None,
                'outcomes': {},
            }
        ],
        'execution': {'episodes': 100, 'successes': 100, 'fallbacks': 0, 'mean_return': -10.5},
        'bag': {'path': 'bag', 'messages': 1234, 'topics': 30},
        'offline': {'options': [], 'planning': []},
        'games': None,
    }


def test_a_written_summary_reads_back_equal_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / 'summary.json'
    path.write_text('old')
    write_json(path, SUMMARY.to_dict())
    assert json.loads(path.read_text()) == SUMMARY.to_dict()
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / 'summary.json'
    with pytest.raises(SummaryError, match=r'nowhere.*No such file'):
        write_json(tmp_path / 'nowhere/summary.json', {})
    path.write_text('old')
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'value': float('nan')})
    assert path.read_text() == 'old'
