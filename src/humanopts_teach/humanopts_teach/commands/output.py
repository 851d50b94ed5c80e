"""What a command writes on standard output and standard error, where those may be full or gone."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
import sys
from typing import Any, TextIO


class _Unfailing:
    """A stream of texts; what cannot be written is lost."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if that is possible."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that is possible."""
        with suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def unfailing_output() -> Iterator[None]:
    """Go on though nobody reads standard output or standard error, or their disk is full."""
    before = sys.stdout, sys.stderr
    unfailing: list[Any] = [_Unfailing(stream) for stream in before]
    sys.stdout, sys.stderr = unfailing
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def open_streams() -> None:
    """Open what a shell has closed, as with ``>&-``: else another file gets its number."""
    for number, name, mode in ((0, 'stdin', 'r'), (1, 'stdout', 'w'), (2, 'stderr', 'w')):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number)
            if null != number:
                os.close(null)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, encoding='utf-8', closefd=False))


def silence(stream: TextIO) -> None:
    """Drop what is left to write on a stream that cannot be written, and all that follows."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
