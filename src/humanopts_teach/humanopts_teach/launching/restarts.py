"""When a node that ended is started again, and when no more."""

from dataclasses import dataclass
import signal

MOST = 5  # times in a row that a node is started again
STEADY = 10.0  # s that a node must have run, so that its end is the first in a row again
_FIRST_PAUSE = 0.1  # s before it is started again; each further time in a row twice as long
CANNOT_START = 2  # exit status of a node whose parameters cannot be used
_SERVER_GONE = 255  # of one that multiprocessing has lost with the fork server


def how(status: int) -> str:
    """Return an exit status in words; -N: by signal N."""
    if status == _SERVER_GONE:
        return 'the process that it was forked from was killed'
    return f'by signal {signal.Signals(-status).name}' if status < 0 else f'exit status {status}'


def said_last(lines: str) -> str:
    """Return how a sentence about a node goes on with the last lines of its log."""
    return f'; its last lines:{lines}' if lines else '; its log is empty'


@dataclass(frozen=True)
class NodeExit:
    """An unexpected exit of a node."""

    node: str
    how: str  # "by signal SIGKILL", "exit status 1"
    last_lines: str  # of its log, each line after a line break; empty: it wrote nothing
    restarts: int  # in a row before or because of this
    again: bool  # it is started again

    @property
    def sentence(self) -> str:
        """What happened, in one line."""
        what = f'the node {self.node} ended ({self.how})'
        if self.again:
            return f'{what}, and is started again'
        after = f' after {self.restarts} restarts in a row' if self.restarts else ''
        return f'{what}{after} while it was needed'

    @property
    def text(self) -> str:
        """What happened, and what the node said last."""
        return f'{self.sentence}{said_last(self.last_lines)}'


class RestartPolicy:
    """
    Counts how often in a row a node ended soon, and says when it is started again.

    :ivar restarts: in a row.
    """

    def __init__(self, most: int = MOST) -> None:
        """
        Begin with a node that has not run.

        :param most: times in a row that it is started again.
        """
        self._most, self._began = most, 0.0
        self.restarts = 0

    def begin(self, now: float) -> None:
        """Note that the node is started, s."""
        self._began = now

    def end(self, now: float, status: int) -> float | None:
        """
        Note that the node ended; return when it is to be started again, s; None: no more.

        :param status: its exit status.
        """
        if now - self._began >= STEADY:
            self.restarts = 0
        if status in (CANNOT_START, _SERVER_GONE) or self.restarts == self._most:
            return None
        self.restarts += 1
        return now + _FIRST_PAUSE * 2.0 ** (self.restarts - 1)
