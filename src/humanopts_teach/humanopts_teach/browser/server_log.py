"""What the libraries of the server log, on standard error: escaped, in few lines."""

from collections.abc import Iterator
from contextlib import contextmanager
import logging
import sys
import time

from humanopts_ros.limits import printable

_BURST = 10  # messages that may come at once
_SECONDS = 10.0  # until there may be one more
_MAX_CHARACTERS = 2000  # of a message; a traceback has its cause at its end
_SOURCES = ('asyncio', 'engineio.server', 'nicegui', 'socketio.server', 'uvicorn.error')


class _TerminalHandler(logging.Handler):
    """Writes messages so that what a stranger sends cannot pass for something else."""

    def __init__(self) -> None:
        super().__init__()
        self._left, self._since, self._hidden = float(_BURST), time.monotonic(), 0

    def emit(self, record: logging.LogRecord) -> None:
        now = time.monotonic()
        self._left = min(_BURST, self._left + (now - self._since) / _SECONDS)
        self._since = now
        if self._left < 1.0:
            self._hidden += 1
            return
        self._left -= 1.0
        text = printable(self.format(record))[-_MAX_CHARACTERS:]
        if self._hidden:
            text += f'\n({self._hidden} messages before it were left out)'
            self._hidden = 0
        print(f'{record.name}: ' + text.replace('\n', '\n    '), file=sys.stderr, flush=True)


@contextmanager
def limited_log() -> Iterator[None]:
    """Have all libraries log in this way meanwhile."""
    handler = _TerminalHandler()
    for name in _SOURCES:
        source = logging.getLogger(name)
        source.handlers, source.propagate = [], True
    logging.root.addHandler(handler)
    try:
        yield
    finally:
        logging.root.removeHandler(handler)
