"""A simulated teacher teaches in one process, by the public names alone."""

from typing import Any

from humanopts_teach import LessonRules, teach, TeacherSettings
from humanopts_teach.lesson.simulated_teacher import TeacherError
import pytest

OPTION = 'go to passenger and pickup'


@pytest.mark.heavy
def test_it_teaches_until_the_criteria_hold_and_nothing_fails(taxi: Any) -> None:
    taught = teach(taxi, TeacherSettings((OPTION,), error_rate=0.02))
    assert [option.name for option in taught.options] == [OPTION]
    assert taught.options[0].uuids == tuple(d.uuid for d in taught.demonstrations)
    assert 10 <= len(taught.demonstrations) < LessonRules().budget
    assert (taught.cut_short, taught.seconds > 60) == ('', True)


def test_it_ends_where_the_caller_has_enough_or_the_budget_is_spent(taxi: Any) -> None:
    rules = LessonRules('random', 7, until_no_failures=False)
    enough = teach(taxi, TeacherSettings((OPTION,)), rules, lambda shown, option: len(shown) > 4)
    spent = teach(taxi, TeacherSettings((OPTION,)), rules, lambda shown, option: False)
    assert (len(enough.demonstrations), len(spent.demonstrations)) == (5, 7)
    assert enough.demonstrations == spent.demonstrations[:5]  # by the same seeds


def test_a_teacher_that_cannot_show_the_option_cuts_the_lesson_short(taxi: Any) -> None:
    with pytest.raises(TeacherError, match="no reference option 'fly'"):
        teach(taxi, TeacherSettings(('fly',)))
    taught = teach(taxi, TeacherSettings((OPTION,), step_limit=1))
    assert 'did not come to the end' in taught.cut_short
