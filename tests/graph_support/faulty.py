"""A node whose callbacks raise unexpected errors."""

from typing import Any

from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import GameState
from humanopts_interfaces.srv import ListOptions, RunOption
from humanopts_ros.node_base import NodeBase


class Faulty(NodeBase):
    """Fails in a timer, a subscription, two services and an action."""

    def __init__(self, **options: Any) -> None:
        super().__init__('faulty', **options)
        self.ticks = 0
        self.create_timer(0.01, self.on_tick)
        self.create_subscription(GameState, 'game_state', self.on_state, 10)
        self.recorded_service(ListOptions, 'list_options', self.on_list)
        self.recorded_service(RunOption, 'run_option', self.on_run)
        self.recorded_action(ExecuteOption, 'execute_option', self.execute)

    def on_tick(self) -> None:
        """Fail, each time."""
        self.ticks += 1
        raise ZeroDivisionError('of the timer')

    def on_state(self, state: GameState) -> None:
        """Fail."""
        raise KeyError(state.state)

    def on_list(self, request: Any, response: Any) -> Any:
        """Fail."""
        raise RuntimeError('of the service\x1b[2J' + 'x' * 10_000)

    async def on_run(self, request: Any, response: Any) -> Any:
        """Fail after a wait."""
        await self.waiting.until(lambda: False, 0.01)
        raise RuntimeError('of the coroutine')

    async def execute(self, handle: Any) -> Any:
        """Fail after a wait."""
        await self.waiting.until(lambda: False, 0.01)
        raise RuntimeError('of the action')
