"""Standard output and standard error of a command, which may be full or closed."""

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
import os
import sys
from typing import Any, TextIO


class _Unfailing:
    """A text stream that discards text that cannot be written."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text if possible."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush if possible."""
        with suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def tolerant_output() -> Iterator[None]:
    """Ignore errors of standard output and standard error, such as a closed pipe or full disk."""
    out: Any = _Unfailing(sys.stdout)
    err: Any = _Unfailing(sys.stderr)
    with redirect_stdout(out), redirect_stderr(err):
        yield


def open_streams() -> None:
    """Open streams closed by the shell (``>&-``), before other files get their descriptors."""
    for number, name, mode in ((0, 'stdin', 'r'), (1, 'stdout', 'w'), (2, 'stderr', 'w')):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number)
            if null != number:
                os.close(null)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, encoding='utf-8', closefd=False))


def silence(stream: TextIO) -> None:
    """Discard all buffered and later output of a stream that cannot be written."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
