"""Before the first plan in a replayed world, the person is asked what the choice depends on."""

from dataclasses import replace
from pathlib import Path

from humanopts_teach.lesson.requests import PlanOptions
import pytest
from teach_support.desk import Desk
from teach_support.orchard import Orchard

QUESTION = 'What does the choice between your options depend on?'


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    """A person who has taught two options and wants to watch a plan with them."""
    desk = Desk(Orchard(), tmp_path).press('enter')
    desk.app.known_options = 'fill', 'unload'
    return desk.press('3', '1')


def planned(desk: Desk) -> tuple[str, ...]:
    """Return the columns of the newest plan."""
    return next(each.columns for each in reversed(desk.asked) if isinstance(each, PlanOptions))


def title(desk: Desk) -> str:
    found: str = getattr(desk.app.screen, 'title', '')
    return found


def test_it_is_asked_once_and_the_answer_is_kept(desk: Desk) -> None:
    assert title(desk) == QUESTION
    desk.press('2', '3', 'enter')
    assert planned(desk) == ('basket',)
    desk.run_ends('Planned.')
    desk.run_ends('Played.')
    desk.press('escape', '4', '1')
    assert title(desk) != QUESTION
    desk.asked.clear()
    assert planned(desk.press('enter')) == ('basket',)


def test_the_answer_that_the_data_suggest_comes_first(desk: Desk) -> None:
    desk.press('escape')
    desk.world.lesson = replace(desk.world.lesson, suggested_column='basket:1')
    desk.press('1')
    assert title(desk) == QUESTION
    assert planned(desk.press('enter', 'enter')) == ('basket:1',)


def test_the_choice_may_depend_on_nothing_else(desk: Desk) -> None:
    assert planned(desk.press('1', 'enter')) == ()


def test_single_steps_depend_on_no_option(desk: Desk) -> None:
    desk.press('escape', '2')
    assert title(desk) != QUESTION
