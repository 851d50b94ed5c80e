"""The commands and their interruption; their options are in ``humanopts_teach.cli``."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
import sys
from types import FrameType

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class CommandError(Exception):
    """Bad input: the command prints this message and exits with status 2."""


@contextmanager
def refusing(*kinds: type[Exception], what: str = '') -> Iterator[None]:
    """
    Convert errors of some types into bad input.

    :param what: text before the error message; of an OSError, only the cause is shown.
    :raises CommandError: one of these errors occurred.
    """
    try:
        yield
    except kinds as error:
        cause = error.strerror if isinstance(error, OSError) else None
        raise CommandError(f'{what}{cause or error}') from error


def confirmed(question: str) -> bool:
    """Ask a question in this terminal; return whether the answer is yes."""
    print(f'{question} [y/N] ', end='', flush=True)
    return sys.stdin.readline().strip().lower() in ('y', 'yes')


@contextmanager
def interruptible() -> Iterator[None]:
    """
    Raise KeyboardInterrupt for SIGINT, SIGTERM and SIGHUP at any point.

    This includes background commands, which a shell without job control starts with SIGINT
    ignored. SIGHUP stays ignored if it already was, as under ``nohup``.
    """

    def interrupt(signum: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handled(interrupt):
        yield


class Interrupts:
    """Whether SIGINT, SIGTERM or SIGHUP was received."""

    def __init__(self) -> None:
        self.received = False

    def check(self) -> None:
        """
        Raise KeyboardInterrupt if a signal was received.

        :raises KeyboardInterrupt: a signal was received.
        """
        if self.received:
            raise KeyboardInterrupt


@contextmanager
def catch_interrupts() -> Iterator[Interrupts]:
    """
    Record these signals, and raise KeyboardInterrupt only in ``check`` or at the end.

    An exception raised by a signal handler would be lost where Python or a library ignores
    errors: during the deletion of an object, or in a callback from C.
    """
    interrupts = Interrupts()

    def note(signum: int, frame: FrameType | None) -> None:
        interrupts.received = True

    with _handled(note):
        yield interrupts
    interrupts.check()


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    kept = signal.SIGHUP if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else None
    before = {number: signal.signal(number, handler) for number in _ENDING if number is not kept}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
