"""A person's terminal as a node: it takes control and drives, or enables the machine and stays."""

from functools import partial
import sys
from typing import Any, ClassVar

from humanopts_interfaces.msg import ActionCommand, ControlState, GameState
from humanopts_interfaces.srv import ResetGame, SetControl
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT

PERIOD = 0.1  # s between a held key's commands
RENEWAL = 0.4  # s between the signs of life of a terminal that holds control


class TerminalNode(NodeBase):
    """Takes control when the world is there."""

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        super().__init__('terminal', **options)
        self._drives = self.setting('drives', '', 'action to repeat; empty: enable the machine')
        self._commands = self.stamped_publisher(ActionCommand, 'action')
        self._state = GameState()
        self._control = self.create_client(SetControl, 'set_control')
        self._reset = self.create_client(ResetGame, 'reset_game')
        self._asked = False
        self.create_subscription(GameState, 'current_state', self._on_state, CURRENT)
        self.create_subscription(ControlState, 'control', self._on_control, CURRENT)
        self.create_timer(PERIOD, self._tick)
        self.create_timer(RENEWAL, self.publish_status_again)

    def _on_state(self, state: GameState) -> None:
        self._state = state

    def _on_control(self, control: ControlState) -> None:
        if control.holder_id == self.publisher_id and not self._drives:
            self._control.call_async(SetControl.Request(hold=False, holder_id=self.publisher_id))
        elif control.holder_id == self.publisher_id:
            source = ResetGame.Request.SOURCE_PERSON
            self._reset.call_async(ResetGame.Request(source=source, seed=1))

    def _tick(self) -> None:
        if not self._asked and self._control.service_is_ready():
            self._asked = True
            self._control.call_async(SetControl.Request(hold=True, holder_id=self.publisher_id))
        if self._drives and self._state.episode:
            place = {'episode': self._state.episode, 'step': self._state.step}
            person = ActionCommand.SOURCE_PERSON
            self._commands.publish(ActionCommand(source=person, action=self._drives, **place))


main = partial(run_node, TerminalNode)

if __name__ == '__main__':
    sys.exit(main())
