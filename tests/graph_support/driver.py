"""A process that drives a robot: announced, alive, and with a key or a command for each state."""

from functools import partial
import sys
from typing import Any, ClassVar

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT


class Driver(NodeBase):
    """Answers each state with the same action."""

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        super().__init__('driver', **options)
        self._source = self.setting('source', 2, 'a SOURCE_ of ActionCommand')
        self._action = self.setting('action', 'forward', 'name of the action')
        self._commands = self.stamped_publisher(ActionCommand, 'action')
        self.create_subscription(GameState, 'current_state', self._on_state, CURRENT)
        self.create_timer(0.4, self.publish_status_again)  # as a terminal does that holds control

    def _on_state(self, state: GameState) -> None:
        place = {'episode': state.episode, 'step': state.step}
        self._commands.publish(ActionCommand(source=self._source, action=self._action, **place))


main = partial(run_node, Driver)

if __name__ == '__main__':
    sys.exit(main())
