"""Waiting inside coroutine callbacks, always with a deadline."""

from collections.abc import Callable

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

_PERIOD = 0.02  # s between checks of the conditions


class Waiting:
    """
    Conditions that coroutines of one node wait for.

    The coroutines must be in a reentrant callback group. Conditions are checked regularly while
    there are any; ``look`` checks them at once.
    """

    def __init__(self, node: Node, monotonic: Callable[[], float]) -> None:
        """
        Begin with no condition.

        :param monotonic: the clock of the deadlines, s.
        """
        self._node, self._monotonic = node, monotonic
        self._open: list[tuple[Future, Callable[[], bool], float]] = []
        self._timer = node.create_timer(
            _PERIOD, self.look, callback_group=ReentrantCallbackGroup(), autostart=False
        )

    def look(self) -> None:
        """Wake the coroutines whose condition holds or whose time is over."""
        now = self._monotonic()
        still = []
        for entry in self._open:
            future, condition, deadline = entry
            if condition() or now > deadline:
                future.set_result(None)
            else:
                still.append(entry)
        self._open = still
        if not still:
            self._timer.cancel()

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition holds; False: it did not in time."""
        if not condition():
            future = Future(executor=self._node.executor)
            self._open.append((future, condition, self._monotonic() + seconds))
            if self._timer.is_canceled():
                self._timer.reset()
            await future
        return condition()
