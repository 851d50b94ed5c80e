"""An action goal: acceptance and result as futures."""

from collections.abc import Callable
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.task import Future


class Goal:
    """
    A goal sent to an action server.

    :ivar accepted: future: whether the server accepts the goal.
    :ivar result: future: the ``result`` field of the action's result; never done if the goal is
        rejected or the server has ended.
    """

    def __init__(
        self, client: ActionClient, goal: Any, on_feedback: Callable[[Any], object]
    ) -> None:
        """Send the goal; the server must be matched, or the goal is lost."""
        self.accepted, self.result = Future(), Future()
        self._handle: Any = None
        sent = client.send_goal_async(
            goal, feedback_callback=lambda message: on_feedback(message.feedback)
        )
        sent.add_done_callback(self._on_answer)

    def cancel(self) -> Future:
        """Cancel the accepted goal and return the future of the response."""
        asked: Future = self._handle.cancel_goal_async()
        return asked

    def _on_answer(self, done: Future) -> None:
        self._handle = done.result()
        if self._handle.accepted:
            self._handle.get_result_async().add_done_callback(
                lambda ended: self.result.set_result(ended.result().result.result)
            )
        self.accepted.set_result(self._handle.accepted)
