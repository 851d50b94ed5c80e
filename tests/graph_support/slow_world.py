"""A robot with one action that takes time; a test says when it ends, and what it senses."""

from typing import Any, ClassVar

from humanopts_env.domains.base import Action, Feature, FeatureKind
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionProgress,
    ActionRefusal,
    ControlState,
    DomainInfo,
    GameState,
)
from humanopts_interfaces.srv import ResetGame
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_ros.senders import Role

SECONDS = 30.0  # longest duration of an action
X = Feature('x', 'how far it is', FeatureKind.CONTINUOUS, unit='m', high=100.0)
DOMAIN = DescribedDomain(
    'slow', {}, [X], [Action('drive', 'up', '', SECONDS), Action('beep', 'b', '')], 0.95, 0
)


class SlowWorld(NodeBase):
    """
    Drives until the test ends the action, a stop comes or it is locked.

    :ivar acting: command under way; None: none.
    :ivar stops: number of stops received.
    :ivar obeys: whether a stop ends the action.
    """

    role: ClassVar[Role] = 'game'

    def __init__(self, **options: Any) -> None:
        super().__init__('slow', **options)
        self.now = GameState(features=[0.0])
        self.acting: ActionCommand | None = None
        self.stops, self.obeys = 0, True
        self._info = self.stamped_publisher(DomainInfo, 'domain_info', LATCHED)
        self._states = self.stamped_publisher(GameState, 'game_state')
        self._current = self.stamped_publisher(GameState, 'current_state', LATCHED)
        self._control = self.stamped_publisher(ControlState, 'control', LATCHED)
        self._progress = self.stamped_publisher(ActionProgress, 'action_progress', LATCHED)
        self._refusals = self.stamped_publisher(ActionRefusal, 'action_refused')
        self.create_service(ResetGame, 'reset_game', self._on_reset)
        self.create_subscription(ActionCommand, 'action', self._on_action, STREAM)

    def on_ready(self) -> None:
        """Publish the domain."""
        self._info.publish(domain_to_info(DOMAIN))
        self.control(ControlState.HOLDER_NOBODY, 'the world started')

    def control(self, holder: int, reason: str) -> None:
        """Publish who has control."""
        self._control.publish(ControlState(holder=holder, reason=reason))

    def progress(self, seconds: float = 0.0, stopped: str = '') -> None:
        """Publish the progress of the action under way, or why the robot does not move."""
        message = ActionProgress(seconds=seconds, stopped=stopped)
        if self.acting is not None:
            message.episode, message.step = self.now.episode, self.now.step
            message.action, message.source = self.acting.action, self.acting.source
        self._progress.publish(message)

    def refresh(self, x: float) -> None:
        """Publish the step again with another feature."""
        self.now.refreshed, self.now.features, self.now.state = True, [x], f'x {x:g}'
        self._show()

    def finish(self, x: float, *, cut_short: bool = False, truncated: bool = False) -> None:
        """End the action under way."""
        command, self.acting = self.acting, None
        assert command is not None
        self.now = GameState(
            episode=self.now.episode,
            step=self.now.step + 1,
            state=f'x {x:g}',
            features=[x],
            previous_action=command.action,
            action_source=command.source,
            action_publisher_id=command.publisher_id,
            action_sequence=command.sequence,
            reward=-1.0,
            cut_short=cut_short,
            truncated=truncated,
        )
        self._show()

    def refuse(self, command: ActionCommand, reason: int, detail: str) -> None:
        """Refuse a command."""
        self._refusals.publish(
            ActionRefusal(
                reason=reason,
                detail=detail,
                command_publisher_id=command.publisher_id,
                command_sequence=command.sequence,
            )
        )

    def _show(self) -> None:
        self._states.publish(self.now)
        self._current.publish(self.now)

    def _on_reset(
        self, request: ResetGame.Request, response: ResetGame.Response
    ) -> ResetGame.Response:
        self.acting = None
        self.now = GameState(episode=self.now.episode + 1, state='x 0', features=[0.0])
        self._show()
        response.status, response.episode = response.STATUS_OK, self.now.episode
        return response

    def _on_action(self, command: ActionCommand) -> None:
        if not command.action:
            self.stops += 1
            if self.acting is not None and self.obeys:
                self.finish(self.now.features[0] + 0.5, cut_short=True)
        elif self.acting is not None:
            self.refuse(command, ActionRefusal.REASON_STALE, 'an action is under way')
        else:
            self.acting = command
            if command.action == 'beep':
                self.finish(self.now.features[0])
