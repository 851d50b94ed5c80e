"""Waiting inside coroutine callbacks, always with a deadline."""

from collections.abc import Callable
import time

from rclpy.node import Node
from rclpy.task import Future


class Waiting:
    """
    Conditions that coroutines of one node wait for.

    The coroutines must be in a reentrant callback group. ``look`` must be called when something
    may have come about, and regularly, so that deadlines are kept.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._open: list[tuple[Future, Callable[[], bool], float]] = []

    def look(self) -> None:
        """Wake those whose condition holds or whose time is over."""
        now = time.monotonic()
        still = []
        for entry in self._open:
            future, condition, deadline = entry
            if condition() or now > deadline:
                future.set_result(None)
            else:
                still.append(entry)
        self._open = still

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition holds; False: it did not in time."""
        if not condition():
            future = Future(executor=self._node.executor)
            self._open.append((future, condition, time.monotonic() + seconds))
            await future
        return condition()
