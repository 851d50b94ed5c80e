"""
The yardstick for the graph: a node that answers immediately, with rclpy alone.

It receives the same messages as game and option_server, on separate topics below ``bare``, and
answers with messages of the same size. It has no rules and no counters, and records nothing.
"""

import sys

from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ActionCommand, GameState, OptionResult
from humanopts_interfaces.srv import RunOption
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT, STREAM
from rclpy.action.server import ServerGoalHandle


class BenchPeer(NodeBase):
    """Echo commands as states, and end every run before its first step."""

    def __init__(self) -> None:
        super().__init__('bench_peer')
        self._state: GameState | None = None
        self._sample = self.create_subscription(GameState, 'current_state', self._keep, CURRENT)
        self._result = OptionResult(
            option_name='go to passenger and pickup',
            status=OptionResult.STATUS_REACHED,
            detail='its termination condition holds',
        )
        self._states = self.create_publisher(GameState, 'bare/game_state', STREAM)
        self.create_subscription(ActionCommand, 'bare/action', self._on_command, STREAM)
        self.create_service(RunOption, 'bare/run_option', self._on_run)
        self._server = self.recorded_action(ExecuteOption, 'bare/execute_option', self._execute)

    def waits_for(self) -> str | None:
        """Wait for a state of the game, so that answers have the same size."""
        return None if self._state is not None else 'current_state'

    def on_ready(self) -> None:
        """Unsubscribe from the game."""
        self.destroy_subscription(self._sample)

    def close(self) -> None:
        """Destroy the action server, since the node does not do so itself."""
        self._server.destroy()

    def _keep(self, message: GameState) -> None:
        self._state = message

    def _on_command(self, command: ActionCommand) -> None:
        state = self._state
        if state is not None:
            state.episode, state.step = command.episode, command.step + 1
            self._states.publish(state)

    def _on_run(
        self, request: RunOption.Request, response: RunOption.Response
    ) -> RunOption.Response:
        response.result = self._result
        return response

    async def _execute(self, handle: ServerGoalHandle) -> ExecuteOption.Result:
        handle.succeed()
        return ExecuteOption.Result(result=self._result)


def main() -> int:
    """Run the node."""
    return run_node(BenchPeer)


if __name__ == '__main__':
    sys.exit(main())
