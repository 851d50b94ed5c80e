"""A node as a process: signals, launcher exit, and exit status."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros import workarounds
from humanopts_ros.guarded_node import start_ros, StartError
from humanopts_ros.limits import accept_any_text, one_line
from humanopts_ros.middleware import LAUNCHER_PID, MiddlewareError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.publisher import PublishError
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.utilities import try_shutdown

_PAUSED = (
    'the process was stopped for {:.0f} s; other nodes may have lost it, so it exits: '
    'start it again'
)


class _Stop:
    """
    A stop condition: true after SIGINT, SIGTERM or SIGHUP, after the launcher has exited, or after
    the process was suspended by SIGSTOP or SIGTSTP for too long.

    :ivar paused: duration of a too long suspension, s; 0 if none.
    """

    def __init__(self) -> None:
        self.requested, self.paused = False, 0.0
        self._checked = time.monotonic()
        signal.signal(signal.SIGCONT, self._on_continue)
        self._launcher = int(os.environ.get(LAUNCHER_PID, '0'))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._request)

    def _request(self, signum: int, frame: FrameType | None) -> None:
        self.requested = True

    def _on_continue(self, signum: int, frame: FrameType | None) -> None:
        pause = time.monotonic() - self._checked
        if pause > workarounds.MAX_PAUSE:
            self.paused = pause

    def __call__(self) -> bool:
        self._checked = time.monotonic()
        orphaned = self._launcher != 0 and os.getppid() != self._launcher
        return self.requested or self.paused > 0.0 or orphaned


@contextmanager
def woken_by_signals(wake: Callable[[], object]) -> Iterator[None]:
    """
    Call ``wake`` from another thread at each signal.

    Python runs signal handlers only while the main thread is outside the middleware, so a waiting
    executor has to be woken.
    """
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    former = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

    def watch() -> None:
        while reader.recv(64):
            with suppress(InvalidHandle, AttributeError):  # it may just have been shut down
                wake()

    thread = threading.Thread(target=watch, name='signals', daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(former)
        writer.close()
        thread.join()
        reader.close()


def run_node(
    factory: Callable[[], NodeBase],
    args: list[str] | None = None,
    *,
    by_events: bool = False,
) -> int:
    """
    Run a node until SIGINT, SIGTERM or SIGHUP, or until it was suspended for too long.

    The node is always closed. An unexpected error propagates, so that the traceback is shown and
    the exit status is 1.

    :param by_events: whether to use the ``EventsExecutor``, which responds about three times as
        fast; it is experimental.
    :return: exit status of the process: 0 after a clean shutdown, 2 if it cannot start, 1 if it
        cannot continue.
    """
    accept_any_text()
    stop, give_back, served = _Stop(), workarounds.MemoryReturn(), threading.Event()

    def ended() -> bool:
        give_back()
        return stop()

    try:
        start_ros(args)
    except MiddlewareError as error:
        print(f'humanopts: {one_line(str(error))}', file=sys.stderr)
        return 2
    by_events &= not workarounds.events_crash()
    executor: Executor = EventsExecutor() if by_events else SingleThreadedExecutor()
    node: NodeBase | None = None
    try:
        node = factory()
        executor.add_node(node)
        if by_events:
            workarounds.restart_postponed_timers(node, served)
        try:
            with woken_by_signals(partial(executor.create_task, lambda: None)):
                node.serve(executor, ended)
        finally:  # also after an error, so that the node completes its files
            served.set()
            node.close()
        node.set_status(NodeStatus.STATE_STOPPING)
        node.drain()
        if stop.paused:
            print(f'humanopts: {_PAUSED.format(stop.paused)}', file=sys.stderr)
            node.failed = True
        workarounds.limit_leaving(0 if node.failed else None)
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
        workarounds.limit_leaving(0)
    return int(node is not None and node.failed)
