"""What a lesson makes of the recorders: whether it is recorded, and why not."""

from typing import Any

from humanopts_teach.lesson.recorders import AGAIN, PATIENCE, Recorders, SILENT
import pytest

STARTING: dict[str, Any] = {'complete': False, 'stopped': False, 'text': ''}
WORKS = STARTING | {'complete': True}
STOPPED = WORKS | {'stopped': True, 'text': 'recording stopped: no space'}


@pytest.fixture
def recorders() -> Recorders:
    return Recorders(expected=True)


def test_a_recorder_that_stopped_is_quoted_with_what_to_do(recorders: Recorders) -> None:
    recorders.update('a', **STOPPED)
    fault = recorders.check(True)
    assert fault.startswith('recording stopped: no space. Everything taught so far is on disk')
    assert recorders.check(False) == fault  # it has ended since


@pytest.mark.parametrize(('expected', 'fault'), [(True, SILENT), (False, '')])
def test_a_lesson_needs_a_recorder_only_where_one_is_expected(expected: bool, fault: str) -> None:
    recorders = Recorders(expected=expected)
    recorders.update('a', **WORKS)
    assert recorders.check(True) == ''
    assert recorders.check(False) == fault


def test_a_recorder_that_says_nothing_any_more_is_taken_to_be_gone(recorders: Recorders) -> None:
    recorders.update('a', **WORKS)
    assert {recorders.check(True) for _ in range(PATIENCE)} == {''}
    assert recorders.check(True) == SILENT
    recorders.update('a', **WORKS)
    assert recorders.check(True) == ''


def test_a_recorder_that_has_not_spoken_yet_is_no_fault(recorders: Recorders) -> None:
    assert recorders.check(True) == ''


@pytest.mark.parametrize('beside', [False, True])
def test_a_new_recorder_ends_the_fault_once_it_has_every_topic(
    recorders: Recorders, beside: bool
) -> None:
    recorders.update('a', **STOPPED)
    fault = recorders.check(True)
    assert recorders.check(beside) == fault
    recorders.update('b', **STARTING)
    assert recorders.check(True) == fault
    recorders.update('b', **WORKS)
    assert recorders.check(True) == ''


def test_a_node_that_the_recorder_has_yet_to_match_is_no_fault(recorders: Recorders) -> None:
    for words in (WORKS, STARTING):
        recorders.update('a', **words)
        assert recorders.check(True) == ''


def test_a_recorder_that_works_is_enough_until_it_leaves(recorders: Recorders) -> None:
    recorders.update('a', **WORKS)
    for _ in range(PATIENCE):
        recorders.update('b', **STOPPED)
        assert recorders.check(True) == ''
    assert recorders.check(True).startswith('recording stopped: no space')


def test_another_recorder_is_a_fault_for_a_look_though_it_has_every_topic(
    recorders: Recorders,
) -> None:
    recorders.update('a', **WORKS)
    assert recorders.check(True) == ''
    recorders.update('b', **WORKS)  # the first was killed just now, and still is on the graph
    assert [recorders.check(True) for _ in range(3)] == [AGAIN, '', '']
    recorders.update('c', **STARTING)
    assert [recorders.check(True) for _ in range(2)] == [AGAIN, '']  # the other two may go on
    recorders.update('c', **WORKS)
    assert recorders.check(True) == ''
