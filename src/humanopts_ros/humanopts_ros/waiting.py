"""Waiting in the coroutines of a node."""

from collections.abc import Callable, Coroutine, Generator
from typing import Any

from rclpy.client import Client
from rclpy.node import Node

_CHECK_PERIOD = 0.02  # s between checks of the conditions
_DISCOVERY = 1.0  # s, maximum wait for the server of a request


class _Wake:
    """The object that a waiting coroutine yields; ``set`` resumes it."""

    def __init__(self) -> None:
        self._set = False
        self.resume: Callable[[], object] = lambda: None

    def __await__(self) -> Generator['_Wake', None, None]:
        while not self._set:  # executors may resume their tasks at any time
            yield self

    def set(self) -> None:
        """End the wait."""
        self._set = True
        self.resume()


def drive(
    coroutine: Coroutine[Any, Any, Any], use: Callable[[Any], object] = lambda result: None
) -> None:
    """
    Run a coroutine that waits only through ``Waiting``, which resumes it.

    The executors of rclpy would poll it instead. The ``EventsExecutor`` would keep a core busy,
    and does not accept a coroutine as a service callback.

    :param use: callback for the result.
    """

    def resume() -> None:
        try:
            coroutine.send(None).resume = resume
        except StopIteration as end:
            use(end.value)

    resume()


class Waiting:
    """
    Lets a node's coroutines wait for conditions and for service responses.

    Pending conditions are checked periodically; ``check`` checks them immediately.
    """

    def __init__(self, node: Node, monotonic: Callable[[], float]) -> None:
        """
        Start without conditions.

        :param monotonic: clock for deadlines, s.
        """
        self._monotonic = monotonic
        self._open: list[tuple[_Wake, Callable[[], bool], float]] = []
        self._timer = node.create_timer(_CHECK_PERIOD, self.check, autostart=False)

    def check(self) -> None:
        """Resume coroutines with a true condition or an expired deadline."""
        now, pending = self._monotonic(), self._open
        due: list[_Wake] = []
        self._open = []
        for wake, condition, deadline in pending:
            try:
                over = condition() or now > deadline
            except Exception:  # raised again in the coroutine
                over = True
            if over:
                due.append(wake)
            else:
                self._open.append((wake, condition, deadline))
        if not self._open:
            self._timer.cancel()
        for wake in due:
            wake.set()

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition is true; return whether it became true in time."""
        deadline = self._monotonic() + seconds
        while not condition():  # it may be false again when the coroutine resumes
            if self._monotonic() > deadline:
                return False
            wake = _Wake()
            self._open.append((wake, condition, deadline))
            if self._timer.is_canceled():
                self._timer.reset()
            await wake
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
        :return: the response; None if none after ``seconds``, or the server is gone.
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
