"""Start states by what was learned, as the lesson node draws them."""

from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.failures import find_failures
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_teach.lesson import seeded_starts
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
import pytest

OPTION = 'go to passenger and pickup'


@pytest.fixture(scope='module')
def shown(taxi_lesson: list[Demonstration]) -> list[Demonstration]:
    """A few demonstrations: not enough to learn the option."""
    return [demo for demo in taxi_lesson if demo.option_name == OPTION][:6]


@pytest.fixture(scope='module')
def option(taxi: Domain[Any], shown: list[Demonstration]) -> LearnedOption:
    """What is learned from them."""
    return learn_option(shown, taxi, 0)


def starts(
    taxi: Domain[Any], strategy: str = 'failures', until: bool = True, seed: int = 0
) -> SeededStarts:
    return SeededStarts(taxi, LessonRules(strategy, seed=seed, until_no_failures=until))


@pytest.fixture
def history(taxi: Domain[Any], shown: list[Demonstration]) -> OptionHistory:
    """The option with these demonstrations."""
    found = OptionHistory(OPTION, taxi.features)
    for demo in shown:
        found.add(demo)
    return found


def test_failures_asks_for_a_state_where_the_learned_option_fails(
    taxi: Any, shown: list[Demonstration], option: LearnedOption, history: OptionHistory
) -> None:
    failing = find_failures(option, taxi, shown).failing
    assert failing.any()
    for seed in range(5):
        chooser = starts(taxi, seed=seed)
        chooser.learned('p1', OPTION, option_to_json(option, []))
        assert failing[taxi.index(taxi.decode(chooser.draw('p1', history)))]


@pytest.mark.parametrize(
    ('strategy', 'n_shown', 'is_learned'),
    [
        ('random', 6, True),
        ('coverage', 6, True),
        ('failures', 0, True),
        ('failures', 6, False),
        ('failures', 6, True),
    ],
)
def test_a_sample_that_is_drawn_ahead_changes_no_start_state(
    yard: Domain[Any],
    yard_lesson: list[Demonstration],
    strategy: str,
    n_shown: int,
    is_learned: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(seeded_starts, 'AHEAD', 2)
    name = yard_lesson[0].option_name
    shown = [demo for demo in yard_lesson if demo.option_name == name]
    text = option_to_json(learn_option(shown[:2], yard, 0), [])
    history = OptionHistory(name, yard.features)
    for demo in shown[:n_shown]:
        history.add(demo)
    plain, ahead = (starts(yard, strategy) for _ in range(2))
    for chooser in (plain, ahead):
        if is_learned:
            chooser.learned('p1', name, text)
    drawn = plain.draw('p1', history)
    ahead.draw_ahead('p1', history)
    assert ahead.draw('p1', history) == drawn
    assert ahead.draw('p1', history) == drawn  # what was drawn ahead is used once
    history.number += 1  # drawn ahead with the last one
    assert ahead.draw('p1', history) == plain.draw('p1', history) != drawn
    history.number -= 1
    ahead.draw_ahead('p2', history)  # somebody else's
    assert ahead.draw('p1', history) == drawn
    ahead.draw_ahead('p1', history)
    empty = OptionHistory(name, yard.features, history.number)  # all were taken back meanwhile
    assert ahead.draw('p1', empty) == plain.draw('p1', empty)


def test_it_counts_the_demonstrations_that_the_newest_option_was_learned_from(
    taxi: Any, shown: list[Demonstration], option: LearnedOption, history: OptionHistory
) -> None:
    chooser = starts(taxi)
    newer = replace(shown[0], uuid='a newer one')
    assert not chooser.counts(history, shown[0])
    chooser.learned('p1', OPTION, option_to_json(option, []))
    assert all(chooser.counts(history, demo) for demo in shown)
    assert not chooser.counts(history, newer)
    assert not chooser.counts(history, replace(shown[0], participant='p2'))
    assert starts(taxi, 'random').counts(history, newer)


def test_not_here_alone_teaches_it_nothing_to_wait_for(
    taxi: Any, shown: list[Demonstration]
) -> None:
    assert starts(taxi).counts(OptionHistory(OPTION, taxi.features), shown[0])


def test_it_knows_that_one_is_withdrawn_once_the_option_is_learned_without_it(
    taxi: Any, shown: list[Demonstration], option: LearnedOption, history: OptionHistory
) -> None:
    chooser = starts(taxi)
    chooser.learned('p1', OPTION, option_to_json(option, []))
    assert not chooser.counts(history, replace(shown[0], withdrawn=True))
    assert chooser.counts(history, replace(shown[0], uuid='left out', withdrawn=True))


@pytest.mark.parametrize(
    ('strategy', 'until', 'exhausted'),
    [('failures', True, False), ('failures', False, True), ('random', True, True)],
)
def test_only_failures_goes_on_when_the_criteria_hold(
    taxi: Any,
    option: LearnedOption,
    history: OptionHistory,
    strategy: str,
    until: bool,
    exhausted: bool,
) -> None:
    chooser = starts(taxi, strategy, until)
    chooser.learned('p1', OPTION, option_to_json(option, []))
    assert chooser.exhausted('p1', history) is exhausted


@pytest.mark.parametrize('text', ['{}', 'not JSON'])
def test_what_is_no_option_is_refused(taxi: Any, text: str) -> None:
    with pytest.raises(OptionError):
        starts(taxi).learned('p1', OPTION, text)


def test_an_option_of_another_domain_is_refused(taxi: Any, option: LearnedOption) -> None:
    larger = make_domain('taxi', {'rows': 6, 'cols': 6})
    with pytest.raises(OptionError, match='was learned in'):
        starts(larger).learned('p1', OPTION, option_to_json(option, []))
