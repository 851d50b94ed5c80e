"""The rules for restarting nodes that ended."""

from dataclasses import dataclass
import signal

MAX_RESTARTS = 5  # maximum number of consecutive restarts of a node
STEADY = 10.0  # s of operation after which the number of consecutive restarts is reset
_FIRST_PAUSE = 0.1  # s before the first consecutive restart; doubled for each further one
CANNOT_START = 2  # exit status of a node with invalid parameters
_SERVER_GONE = 255  # exit status in multiprocessing of a process that lost its fork server


def describe_exit(status: int) -> str:
    """Return an exit status in words; -N means signal N."""
    if status == _SERVER_GONE:
        return 'its parent process, the fork server, was killed'
    return f'by signal {signal.Signals(-status).name}' if status < 0 else f'exit status {status}'


def last_output(lines: str) -> str:
    """Return the end of a sentence about a node, with the last lines of its log."""
    return f'; its last lines:{lines}' if lines else '; its log is empty'


@dataclass(frozen=True)
class NodeExit:
    """An unexpected exit of a node."""

    node: str
    how: str  # "by signal SIGKILL", "exit status 1"
    last_lines: str  # of its log, each after a line break; empty: it wrote nothing
    restarts: int  # number of consecutive restarts, including the next one
    again: bool  # whether the node is restarted

    @property
    def sentence(self) -> str:
        """A description of the exit, in one line."""
        what = f'the node {self.node} ended ({self.how})'
        if self.again:
            return f'{what}, and is started again'
        after = f' after {self.restarts} restarts in a row' if self.restarts else ''
        return f'{what}{after} while it was needed'

    @property
    def text(self) -> str:
        """A description of the exit, with the last lines of the node's log."""
        return f'{self.sentence}{last_output(self.last_lines)}'


class RestartPolicy:
    """
    Counts consecutive quick exits of a node, and decides when to restart it.

    :ivar restarts: number of consecutive restarts.
    """

    def __init__(self, max_restarts: int = MAX_RESTARTS) -> None:
        """
        Create the policy of a node that has not started yet.

        :param max_restarts: maximum number of consecutive restarts.
        """
        self._max_restarts, self._began = max_restarts, 0.0
        self.restarts = 0

    def begin(self, now: float) -> None:
        """Record the time at which the node starts, s."""
        self._began = now

    def end(self, now: float, status: int) -> float | None:
        """
        Record the exit of the node; return the time of its restart, s; None: no restart.

        :param status: exit status of the node.
        """
        if now - self._began >= STEADY:
            self.restarts = 0
        if status in (CANNOT_START, _SERVER_GONE) or self.restarts == self._max_restarts:
            return None
        self.restarts += 1
        return now + _FIRST_PAUSE * 2.0 ** (self.restarts - 1)
