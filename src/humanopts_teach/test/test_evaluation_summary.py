"""The numbers of a lesson: one function for live and offline, and how they differ."""

from dataclasses import asdict, fields, replace
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import reference_options
from humanopts_learner.demonstrations import Demonstration, group_by_option
from humanopts_learner.options.criteria import judge, Judgement, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.evaluation.bag_evaluation import evaluate
from humanopts_teach.evaluation.measures import option_block, OptionBlock, Settings
from humanopts_teach.evaluation.summary import (
    differences,
    Execution,
    Live,
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
