"""Where demonstrations start: chosen by strategy and seed, from what was learned."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.failures import find_failures
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
import pytest
from teach_support.lesson import (
    OPTION,
    TAXI,
)


@pytest.fixture(scope='module')
def few(taxi_lesson: list[Demonstration]) -> list[Demonstration]:
    """A few demonstrations: not enough to learn the option."""
    return [demo for demo in taxi_lesson if demo.option_name == OPTION][:6]


@pytest.fixture(scope='module')
def option(few: list[Demonstration]) -> LearnedOption:
    return learn_option(few, TAXI, 0)


def history(shown: Sequence[Demonstration], features: Sequence[Any]) -> OptionHistory:
    found = OptionHistory('p1', shown[0].option_name, features)
    for demo in shown:
        found.add(demo)
    return found


def starts(domain: Domain, text: str = '', **rules: Any) -> SeededStarts:
    """Return the start states of a lesson to which the learner has published an option."""
    found = SeededStarts(domain, LessonRules(**rules))
    if text:
        found.learned('p1', OPTION, text)
    return found


def test_failures_asks_for_a_state_where_the_learned_option_fails(
    taxi: Any, few: list[Demonstration], option: LearnedOption
) -> None:
    text, known = option_to_json(option, []), history(few, taxi.features)
    failing = find_failures(option, taxi, few).failing
    assert failing.any()
    for seed in range(5):
        start = starts(taxi, text, seed=seed).draw(known)
        assert failing[taxi.index(taxi.decode(start))]
    assert not starts(taxi, text).exhausted(known)
    assert starts(taxi, text, until_no_failures=False).exhausted(known)
    assert starts(taxi, text, strategy='random').exhausted(known)


def test_it_counts_what_the_newest_option_was_learned_from(
    few: list[Demonstration], option: LearnedOption
) -> None:
    known, newer = history(few, TAXI.features), replace(few[0], uuid='newer')
    assert not starts(TAXI).counts(known, few[0])
    chooser = starts(TAXI, option_to_json(option, []))
    assert all(chooser.counts(known, demo) for demo in few)
    assert not chooser.counts(known, replace(few[0], withdrawn=True))
    assert not chooser.counts(known, newer)
    assert chooser.counts(known, replace(newer, withdrawn=True))
    assert not starts(TAXI, strategy='random').counts(known, newer)  # the exam needs it


@pytest.mark.parametrize('strategy', ['coverage', 'failures'])
def test_a_sample_that_is_drawn_ahead_changes_no_start_state(
    yard: Domain, yard_lesson: list[Demonstration], strategy: str
) -> None:
    shown = [demo for demo in yard_lesson if demo.option_name == yard_lesson[0].option_name][:6]
    text = option_to_json(learn_option(shown[:2], yard, 0), [])
    known, empty = history(shown, yard.features), OptionHistory('p1', OPTION, yard.features)
    plain, ahead = (starts(yard, strategy=strategy) for _ in range(2))
    for chooser in (plain, ahead):
        chooser.learned('p1', known.name, text)
    for each in (known, known, empty):
        drawn = plain.draw(each)
        ahead.draw_ahead(empty)
        ahead.draw_ahead(each)
        assert ahead.draw(each) == drawn
    known.number += 1
    assert ahead.draw(known) == plain.draw(known)


def test_what_is_no_option_of_the_domain_is_refused(option: LearnedOption) -> None:
    larger = make_domain('taxi', {'rows': 6, 'cols': 6})
    for domain, text in ((TAXI, '{}'), (TAXI, 'not JSON'), (larger, option_to_json(option, []))):
        with pytest.raises(OptionError):
            starts(domain, text)
