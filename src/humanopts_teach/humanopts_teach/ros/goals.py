"""One goal of an action: sent, accepted or not, and its result."""

from collections.abc import Callable
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.task import Future


class Goal:
    """
    A goal that was sent.

    :ivar accepted: a future: whether the server takes it.
    :ivar result: a future: the ``result`` of the action's result; never done where it is not
        accepted, or its server has ended.
    """

    def __init__(
        self, client: ActionClient, goal: Any, on_feedback: Callable[[Any], object]
    ) -> None:
        """Send it; the server is matched, or the goal would be lost."""
        self.accepted, self.result = Future(), Future()
        self._handle: Any = None
        sent = client.send_goal_async(
            goal, feedback_callback=lambda message: on_feedback(message.feedback)
        )
        sent.add_done_callback(self._on_answer)

    def cancel(self) -> Future:
        """Ask the server to cancel it, once it is accepted; return the future of the answer."""
        asked: Future = self._handle.cancel_goal_async()
        return asked

    def _on_answer(self, done: Future) -> None:
        self._handle = done.result()
        if self._handle.accepted:
            self._handle.get_result_async().add_done_callback(
                lambda ended: self.result.set_result(ended.result().result.result)
            )
        self.accepted.set_result(self._handle.accepted)
