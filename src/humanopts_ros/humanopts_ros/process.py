"""A node as a process: signals, the launcher's end, and the exit status."""

from collections.abc import Callable
from contextlib import suppress
import ctypes
import os
import signal
import sys
import threading
import time
from types import FrameType

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.environment import LAUNCHER_PID
from humanopts_ros.limits import accept_any_text, one_line
from humanopts_ros.middleware import MiddlewareError
from humanopts_ros.node_base import NodeBase, start_ros, StartError
from humanopts_ros.publisher import PublishError
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

# s to leave the graph after a clean end. Where all participants leave at once, Fast DDS hangs now
# and then; the node is closed and what it sent is taken by then, so SIGALRM may end the process.
_LEAVING = 5
# s that a process may be stopped. After 20 s without a sign of it others forget it, and it forgets
# them, but not at the same moment: then Fast DDS may never connect them again.
LONGEST_PAUSE = 15.0
_GIVING_BACK = 5.0  # s between two givings back of memory, which take 0.3 ms each
_M_MMAP_THRESHOLD, _LARGE = -3, 128 * 1024  # of malloc.h; bytes, with which glibc begins
_LOOK_PERIOD = 0.5  # s between looks at timers
_PAUSED = (
    'the process was stopped for {:.0f} s; other nodes may not hear it any more, so it ends: '
    'start it again'
)


class _Stop:
    """
    Set by SIGINT, SIGTERM or SIGHUP, when the launcher that started the process is gone, or when
    the process goes on after SIGSTOP or SIGTSTP has stopped it for too long.

    :ivar paused: how long that was, s; 0: it was not.
    """

    def __init__(self) -> None:
        self.requested, self.paused = False, 0.0
        self._looked = time.monotonic()
        signal.signal(signal.SIGCONT, self._go_on)
        self._launcher = int(os.environ.get(LAUNCHER_PID, '0'))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._request)

    def _request(self, signum: int, frame: FrameType | None) -> None:
        self.requested = True

    def _go_on(self, signum: int, frame: FrameType | None) -> None:
        pause = time.monotonic() - self._looked
        if pause > LONGEST_PAUSE:
            self.paused = pause

    def __call__(self) -> bool:
        self._looked = time.monotonic()
        orphaned = self._launcher != 0 and os.getppid() != self._launcher
        return self.requested or self.paused > 0.0 or orphaned


class MemoryReturn:
    """
    Gives memory that is free back to the operating system, now and then.

    The C library would keep it, and a reader of the middleware may have used much for a while: it
    keeps what comes after a message that did not arrive, until that comes or its sender leaves.

    Large blocks go back as soon as they are free. By itself glibc soon puts them on its heap, too,
    which grows with messages that grow, such as everybody's options.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic, self._due = monotonic, 0.0
        library = ctypes.CDLL(None)
        self._trim = getattr(library, 'malloc_trim', None)  # of glibc
        if self._trim is not None:
            library.mallopt(_M_MMAP_THRESHOLD, _LARGE)

    def __call__(self) -> None:
        """Give memory back if it is time to; to be called often."""
        if self._trim is not None and (now := self._monotonic()) >= self._due:
            self._due = now + _GIVING_BACK
            self._trim(0)


def reset_postponed(node: Node) -> None:
    """
    Reset the timers of a node whose next call is further away than their period.

    While a callback blocks, as one that publishes to a reader which has stopped, the
    ``EventsExecutor`` of rclpy 7.1.5 gathers many calls of one timer; each puts the next one off
    by a period, so that the node does without its timers for minutes.
    """
    for timer in list(node.timers):
        with suppress(InvalidHandle):  # it was destroyed just now
            left = timer.time_until_next_call()  # ns; None: it is cancelled
            if left is not None and left > timer.timer_period_ns:
                timer.reset()


def _look_after_timers(node: Node, ended: threading.Event) -> None:
    while not ended.wait(_LOOK_PERIOD):
        reset_postponed(node)


def run_node(
    factory: Callable[[], NodeBase],
    args: list[str] | None = None,
    *,
    by_events: bool = False,
) -> int:
    """
    Run a node until SIGINT, SIGTERM or SIGHUP, or until it was stopped for too long.

    The node is closed however it ends. An unexpected error is raised to the caller, so
    that the traceback is shown and the exit status is 1.

    :param by_events: run on the ``EventsExecutor``, which answers about three times as fast; it is
        experimental, and for nodes whose services are no coroutines.
    :return: the process's exit status: 0 after a clean end, 2 when it cannot start, 1 when it
        cannot go on.
    """
    accept_any_text()
    stop, give_back, served = _Stop(), MemoryReturn(), threading.Event()

    def ended() -> bool:
        give_back()
        return stop()

    try:
        start_ros(args)
    except MiddlewareError as error:
        print(f'humanopts: {one_line(str(error))}', file=sys.stderr)
        return 2
    executor: Executor = EventsExecutor() if by_events else SingleThreadedExecutor()
    node: NodeBase | None = None
    try:
        node = factory()
        executor.add_node(node)
        if by_events:
            threading.Thread(target=_look_after_timers, args=(node, served), daemon=True).start()
        try:
            node.serve(executor, ended)
        finally:  # after any error too, so that its files are complete
            served.set()
            node.close()
        node.set_status(NodeStatus.STATE_STOPPING)
        node.drain()
        if stop.paused:
            print(f'humanopts: {_PAUSED.format(stop.paused)}', file=sys.stderr)
            node.failed = True
        signal.alarm(0 if node.failed else _LEAVING)
    except (StartError, MiddlewareError) as error:
        print(f'humanopts: {one_line(str(error))}', file=sys.stderr)
        return 2
    except PublishError as error:
        print(f'humanopts: {one_line(str(error))}', file=sys.stderr)
        return 1
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        try_shutdown()
        signal.alarm(0)
    return int(node is not None and node.failed)
