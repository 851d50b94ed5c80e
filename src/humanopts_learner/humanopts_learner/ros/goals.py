"""Goals of actions: how far long work is, stopping it, and how it ended."""

from collections.abc import Callable
import time
from typing import Any

from humanopts_learner.planning.errors import PlanCanceled
from rclpy.action.server import ServerGoalHandle

_PERIOD = 0.1  # s


class Feedback:
    """Publishes feedback when a stage begins and now and then while it goes on."""

    def __init__(
        self,
        handle: ServerGoalHandle,
        stopping: Callable[[], bool],
        message: Callable[..., Any],
    ) -> None:
        """
        Begin.

        :param stopping: tells whether the node ends.
        :param message: makes the feedback from what is told.
        """
        self._handle, self._stopping, self._message = handle, stopping, message
        self._stage, self._next = '', 0.0

    def __call__(self, stage: str, *numbers: Any) -> None:
        """
        Take in how far the work is.

        :raises PlanCanceled: the client wants no more, or the node ends.
        """
        if self._handle.is_cancel_requested or self._stopping():
            raise PlanCanceled
        now = time.monotonic()
        if stage != self._stage or now >= self._next:
            self._stage, self._next = stage, now + _PERIOD
            self._handle.publish_feedback(self._message(stage, *numbers))


def end_goal(handle: ServerGoalHandle, good: bool, canceled: bool) -> None:
    """Set how a goal ended: as wanted, canceled by its client, or neither."""
    if good:
        handle.succeed()
    elif canceled:
        handle.canceled()
    else:
        handle.abort()
