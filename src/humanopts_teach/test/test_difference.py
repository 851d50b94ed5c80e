"""What differs between two lessons."""

from dataclasses import replace
import json
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, evaluate
from humanopts_teach.evaluation.difference import compare, Difference, difference_text
from humanopts_teach.evaluation.measures import Settings
import pytest


def lesson(domain: Domain[Any], demos: list[Demonstration], seed: int = 5) -> BagEvaluation:
    return evaluate(demos, domain, Settings(seed))


@pytest.fixture(scope='module')
def short(taxi_lesson: list[Demonstration]) -> list[Demonstration]:
    """At most four demonstrations of each option."""
    shown = [demo for demo in taxi_lesson if demo.kind is Kind.TRAJECTORY]
    names = dict.fromkeys(demo.option_name for demo in shown)
    return [d for name in names for d in [d for d in shown if d.option_name == name][:4]]


@pytest.fixture(scope='module')
def whole(taxi: Domain[Any], short: list[Demonstration]) -> BagEvaluation:
    return lesson(taxi, short)


def kinds(found: list[Difference]) -> set[str]:
    return {difference.what for difference in found}


def test_a_lesson_does_not_differ_from_itself(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    found = compare(whole, lesson(taxi, short))
    assert found == []
    assert difference_text(found) == 'the lessons are the same'


def test_settings_are_compared_by_name(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    assert Difference('setting', 'seed', 5, 6) in compare(whole, lesson(taxi, short, seed=6))


def test_a_demonstration_that_is_missing_is_named_and_changes_what_is_learned(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    found = compare(whole, lesson(taxi, short[1:]))
    (missing,) = (d for d in found if d.what == 'demonstration')
    assert (missing.of, missing.b) == (short[0].uuid, None)
    assert missing.a['option'] == short[0].option_name
    assert all(short[0].option_name in d.of for d in found if d.what in ('tree', 'criteria'))
    assert 'tree' in kinds(found)
    assert f'of {short[0].option_name} by p1' in difference_text(found)
    json.dumps([d.a for d in found])


def test_a_demonstration_that_was_taken_back_is_told_to_be_so(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    withdrawn = replace(short[0], withdrawn=True)
    undone = lesson(taxi, [withdrawn, *short[1:]])
    found = compare(whole, undone)
    told = [d for d in found if d.what == 'demonstration']
    which = f'withdrawn of {withdrawn.uuid} (of {withdrawn.option_name} by p1)'
    assert told == [Difference('demonstration', which, False, True)]
    assert which in difference_text(found)
    lone = difference_text(compare(undone, lesson(taxi, short[1:])))
    assert f'of {short[0].option_name} by p1, taken back  1 that are only here' in lone


def test_every_criterion_and_what_was_not_here_are_compared(
    taxi: Domain[Any], taxi_lesson: list[Demonstration], whole: BagEvaluation
) -> None:
    found = compare(whole, lesson(taxi, taxi_lesson))
    told = {d.of.split(' of ')[0] for d in found if d.what == 'criteria'}
    criteria = {f'criterion {name}' for name in ('return', 'initiation', 'termination')}
    assert told >= {'n_demonstrations', 'n_not_here', *criteria}


def test_a_demonstration_that_was_changed_is_told_by_field(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    slower = [replace(short[0], seconds=99.0), *short[1:]]
    (found,) = compare(whole, lesson(taxi, slower))
    which = f'seconds of {short[0].uuid} (of {short[0].option_name} by p1)'
    assert found == Difference('demonstration', which, short[0].seconds, 99.0)


def test_times_of_demonstrations_are_one_line_of_the_text(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    slower = [replace(demo, seconds=demo.seconds + 2) for demo in short[:3]]
    found = compare(whole, lesson(taxi, [*slower, *short[3:]]))
    (line,) = difference_text(found).splitlines()[1:]
    before = sum(demo.seconds for demo in short[:3])
    assert line.split() == (
        f'demonstration seconds of 3, added up {before:g} {before + 6:g}'.split()
    )


def test_participants_options_features_and_plans_are_compared(
    taxi: Domain[Any], short: list[Demonstration], whole: BagEvaluation
) -> None:
    found = compare(whole, lesson(taxi, [replace(d, participant='p2') for d in short]))
    assert Difference('participant', 'p1', True, None) in found
    assert kinds(found) >= {'participant', 'option', 'demonstration'}
    fewer = [replace(d, chosen_features=d.chosen_features[1:]) for d in short[:4]]
    found = compare(whole, lesson(taxi, [*fewer, *short[4:]]))
    chosen = next(d for d in found if d.what == 'features chosen')
    assert (chosen.a[1:], 'taxi_row' in chosen.b) == (chosen.b, False)
    assert Difference('option', f'{short[4].option_name} by p1', True, None) in compare(
        whole, lesson(taxi, short[:4])
    )
