"""Log output of the server's libraries on standard error: escaped and rate-limited."""

from collections.abc import Iterator
from contextlib import contextmanager
import logging
import sys
import time

from humanopts_ros.limits import printable

_BURST = 10  # maximum number of messages in a burst
_SECONDS = 10.0  # time per additional message
_MAX_CHARACTERS = 2000  # maximum length, cut at the start; a traceback ends with its cause
_SOURCES = ('asyncio', 'engineio.server', 'nicegui', 'socketio.server', 'uvicorn.error')


class _TerminalHandler(logging.Handler):
    """A log handler that escapes messages, since clients control parts of them."""

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
    """Apply escaping and rate limiting to all library logs within the block."""
    handler = _TerminalHandler()
    for name in _SOURCES:
        source = logging.getLogger(name)
        source.handlers, source.propagate = [], True
    logging.root.addHandler(handler)
    try:
        yield
    finally:
        logging.root.removeHandler(handler)
