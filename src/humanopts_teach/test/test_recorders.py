"""What a lesson makes of the recorders: whether it is recorded, and why not."""

from humanopts_teach.dialogue.recorders import GONE, Recorders, RecorderWord
import pytest

STARTING = RecorderWord(complete=False, stopped=False, text='')
WORKS = RecorderWord(complete=True, stopped=False, text='')
STOPPED = RecorderWord(complete=True, stopped=True, text='recording stopped: no space')


@pytest.fixture
def recorders() -> Recorders:
    return Recorders(expected=True)


def test_a_recorder_that_stopped_is_quoted_with_what_to_do(recorders: Recorders) -> None:
    recorders.heard('a', STOPPED)
    fault = recorders.fault(1)
    assert fault.startswith('recording stopped: no space. Everything taught is on disk')
    assert recorders.fault(0) == fault  # it has ended since


@pytest.mark.parametrize(('expected', 'fault'), [(True, GONE), (False, '')])
def test_a_lesson_needs_a_recorder_only_where_one_is_expected(expected: bool, fault: str) -> None:
    recorders = Recorders(expected=expected)
    recorders.heard('a', WORKS)
    assert recorders.fault(1) == ''
    assert recorders.fault(0) == fault


def test_a_recorder_that_has_not_spoken_yet_is_no_fault(recorders: Recorders) -> None:
    assert recorders.fault(1) == ''


@pytest.mark.parametrize('there', [1, 2], ids=['in its place', 'beside it'])
def test_a_new_recorder_ends_the_fault_once_it_has_every_topic(
    recorders: Recorders, there: int
) -> None:
    recorders.heard('a', STOPPED)
    fault = recorders.fault(1)
    recorders.heard('b', STARTING)
    assert recorders.fault(there) == fault
    recorders.heard('b', WORKS)
    assert recorders.fault(there) == ''
    if there == 2:
        recorders.heard('a', STOPPED)
        assert recorders.fault(there) == ''


def test_a_node_that_the_recorder_has_yet_to_match_is_no_fault(recorders: Recorders) -> None:
    recorders.heard('a', WORKS)
    recorders.heard('a', STARTING)
    assert recorders.fault(1) == ''


def test_a_recorder_that_left_no_longer_counts(recorders: Recorders) -> None:
    recorders.heard('a', WORKS)
    recorders.heard('b', STOPPED)
    assert recorders.fault(2) == ''
    assert recorders.fault(1).startswith('recording stopped: no space')
