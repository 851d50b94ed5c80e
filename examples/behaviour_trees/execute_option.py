"""
A leaf of py_trees that runs a taught option.

It needs only rclpy, py_trees and the interfaces of humanopts. It also works in ``py_trees_ros``,
which passes ``node`` to ``setup``.
"""

from typing import Any

from action_msgs.msg import GoalStatus
from humanopts_interfaces.action import ExecuteOption as Action
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from rclpy.action import ActionClient


class ExecuteOption(Behaviour):
    """
    Run an option through the action ``execute_option``.

    The status is RUNNING during the run, then SUCCESS if the goal succeeded, otherwise FAILURE.
    The reason is in ``feedback_message``. If the tree stops the leaf, the run is canceled.
    """

    def __init__(
        self, option_name: str, participant: str = '', name: str = '', *, preempt: bool = True
    ) -> None:
        """
        Describe the run.

        :param participant: participant who taught the option; empty: the only one who did.
        :param preempt: whether to end another run in progress; False: this run fails instead.
        """
        super().__init__(name or option_name)
        self._goal = Action.Goal(option_name=option_name, participant=participant, preempt=preempt)
        self._client: ActionClient | None = None
        self._handle: Any = None  # of the accepted goal; None: no goal
        self._run = 0  # counts goals; answers to earlier ones are ignored
        self._ended: Status | None = None

    def setup(self, **arguments: Any) -> None:
        """
        Create the client of the action.

        :param arguments: ``node``, the rclpy node to use; its executor must be spinning.
        """
        self._client = ActionClient(arguments['node'], Action, 'execute_option')

    def initialise(self) -> None:
        """Reset the leaf for a new run."""
        self._run += 1
        self._handle = self._ended = None
        self._sent = False
        self.feedback_message = 'waits for execute_option'

    def update(self) -> Status:
        """Send the goal when the server is available, and return the status of the run."""
        assert self._client is not None, 'setup was called'
        if not self._sent and self._client.server_is_ready():
            self._sent, run = True, self._run
            self.feedback_message = 'begins'
            future = self._client.send_goal_async(
                self._goal, lambda message: self._on_feedback(run, message.feedback)
            )
            future.add_done_callback(lambda done: self._on_accepted(run, done.result()))
        return self._ended or Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Cancel the run if it is in progress."""
        if new_status is Status.INVALID:
            self._run += 1
            if self._handle is not None:
                self._handle.cancel_goal_async()
                self._handle = None

    def _on_accepted(self, run: int, handle: Any) -> None:
        if run != self._run:  # stopped meanwhile
            if handle.accepted:
                handle.cancel_goal_async()
        elif handle.accepted:
            self._handle = handle
            future = handle.get_result_async()
            future.add_done_callback(lambda done: self._on_result(run, done.result()))
        else:
            self.feedback_message = f'{self._goal.option_name} cannot run here and now'
            self._ended = Status.FAILURE

    def _on_feedback(self, run: int, feedback: Any) -> None:
        if run == self._run:
            self.feedback_message = f'step {feedback.step_count}: {feedback.action}'

    def _on_result(self, run: int, reply: Any) -> None:
        if run == self._run:
            self._handle, self.feedback_message = None, reply.result.result.detail
            well = reply.status == GoalStatus.STATUS_SUCCEEDED
            self._ended = Status.SUCCESS if well else Status.FAILURE
