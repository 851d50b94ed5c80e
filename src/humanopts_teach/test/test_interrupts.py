"""A signal that is to end a command is heard, wherever it finds the command."""

from collections.abc import Iterator
import os
import signal

from humanopts_teach.commands import catch_interrupts
import pytest

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def as_in_a_terminal() -> Iterator[None]:
    """Let SIGHUP do what it does in a terminal: under nohup it stays ignored, as it should."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


class Deleted:
    """An object during whose end a signal comes; Python ignores what is raised there."""

    def __init__(self, number: signal.Signals) -> None:
        self.number = number

    def __del__(self) -> None:
        os.kill(os.getpid(), self.number)


@pytest.mark.parametrize('number', ENDING)
def test_a_signal_that_comes_where_errors_are_ignored_is_heard_at_the_next_look(
    number: signal.Signals,
) -> None:
    reached = []

    def work() -> None:
        with catch_interrupts() as interrupts:
            interrupts.check()
            Deleted(number)
            reached.append('what follows')
            interrupts.check()
            raise AssertionError('it was not heard')

    with pytest.raises(KeyboardInterrupt):
        work()
    assert reached == ['what follows']


def test_a_signal_after_the_last_look_is_heard_at_the_end_and_the_handlers_are_restored() -> None:
    before = [signal.getsignal(number) for number in ENDING]
    with pytest.raises(KeyboardInterrupt), catch_interrupts():
        os.kill(os.getpid(), signal.SIGTERM)
    assert [signal.getsignal(number) for number in ENDING] == before


def test_an_error_of_the_work_is_not_replaced_by_a_signal() -> None:
    def work() -> None:
        with catch_interrupts():
            os.kill(os.getpid(), signal.SIGINT)
            raise ValueError('of the work')

    with pytest.raises(ValueError, match='of the work'):
        work()
