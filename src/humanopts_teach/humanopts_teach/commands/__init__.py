"""What the commands do, and how they end early; their options are in ``humanopts_teach.cli``."""

from collections.abc import Iterator
from contextlib import contextmanager
import signal
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class CommandError(Exception):
    """Bad input: the command ends with status 2 and this one line."""


@contextmanager
def interruptible() -> Iterator[None]:
    """
    Raise KeyboardInterrupt for SIGINT, SIGTERM and SIGHUP.

    A shell without job control starts background commands with SIGINT ignored; they hear it here
    all the same. SIGHUP stays ignored where it was, since ``nohup`` asks for that.
    """

    def interrupt(signum: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    kept = signal.SIGHUP if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else None
    before = {number: signal.signal(number, interrupt) for number in ENDING if number is not kept}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
