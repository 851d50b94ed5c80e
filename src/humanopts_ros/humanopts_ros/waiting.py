"""Waiting in the coroutines of a node."""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

_CHECK_PERIOD = 0.02  # s between checks of the conditions
_DISCOVERY = 1.0  # s, maximum wait for the server of a request


class Waiting:
    """
    Lets a node's coroutines wait for conditions and for responses of services.

    The coroutines must be in a reentrant callback group. Pending conditions are checked
    periodically; ``check`` checks them immediately.
    """

    def __init__(self, node: Node, monotonic: Callable[[], float]) -> None:
        """
        Start without conditions.

        :param monotonic: clock for deadlines, s.
        """
        self._node, self._monotonic = node, monotonic
        self._open: list[tuple[Future, Callable[[], bool], float]] = []
        self._timer = node.create_timer(
            _CHECK_PERIOD, self.check, callback_group=ReentrantCallbackGroup(), autostart=False
        )

    def check(self) -> None:
        """Wake coroutines with a true condition or an expired deadline."""
        now = self._monotonic()
        still = []
        for entry in self._open:
            future, condition, deadline = entry
            try:
                if condition() or now > deadline:
                    future.set_result(None)
                else:
                    still.append(entry)
            except Exception as error:  # raised in the waiting coroutine
                future.set_exception(error)
        self._open = still
        if not still:
            self._timer.cancel()

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition is true; return whether it became true in time."""
        deadline = self._monotonic() + seconds
        while not condition():  # may be false again when the coroutine resumes
            if self._monotonic() > deadline:
                return False
            future = Future(executor=self._node.executor)
            self._open.append((future, condition, deadline))
            if self._timer.is_canceled():
                self._timer.reset()
            await future
        return True

    async def answer(
        self,
        client: Client,
        request: Any,
        seconds: float,
        lost: Callable[[], bool] = lambda: False,
    ) -> Any:
        """
        Call a service.

        A request sent before the server is discovered is lost, so this waits for the server.

        :param lost: function that returns whether the server has restarted and lost the request.
        :return: the response; None: there is none after ``seconds``, or the server is gone.
        """
        ready = client.service_is_ready
        if not await self.until(ready, min(seconds, _DISCOVERY)):
            return None
        future = client.call_async(request)
        future.add_done_callback(lambda _: self.check())
        await self.until(lambda: future.done() or lost() or not ready(), seconds)
        if future.done():
            return future.result()
        client.remove_pending_request(future)
        return None
