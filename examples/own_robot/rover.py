"""
A robot that is taught like a game: one rclpy node, which shares only messages with humanopts.

The node simulates a rover in a corridor of 10 m, with a charger at the west end. It only executes
actions: no other node knows its rules, and no state can be set. At a reset, a person carries the
rover to another place.
"""

import json
import random
import uuid

from humanopts_interfaces.msg import (
    ActionCommand,
    ActionInfo,
    ActionRefusal,
    DomainInfo,
    FeatureInfo,
    GameState,
)
from humanopts_interfaces.srv import ResetGame
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from std_msgs.msg import Empty

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STREAM = QoSProfile(history=HistoryPolicy.KEEP_ALL)
LENGTH, CHARGER = 10.0, 1.0  # m; the charger is reached within 1 m of the west end
FEATURES = [
    FeatureInfo(
        name='x',
        question='how far from the west end it is',
        kind=FeatureInfo.KIND_CONTINUOUS,
        unit='m',
        low=0.0,
        high=LENGTH,
    ),
    FeatureInfo(
        name='lamp',
        question='whether its lamp is on',
        kind=FeatureInfo.KIND_NOMINAL,
        value_names=['off', 'on'],
    ),
]
ACTIONS = {
    'forward': ActionInfo(name='forward', key='right', description='drive east'),
    'back': ActionInfo(name='back', key='left', description='drive west'),
    'switch': ActionInfo(name='switch', key='l', description='switch the lamp on or off'),
}


class Robot(Node):
    """Publish features and states, and execute actions."""

    def __init__(self, info: DomainInfo) -> None:
        super().__init__(info.domain)
        self._id = f'{self.get_fully_qualified_name()}#{uuid.uuid4().hex[:8]}'
        self._sequences: dict[str, int] = {}
        self._now, self._actions = GameState(), {action.name for action in info.actions}
        # Announce the id on the graph, so that no other node can publish in its place.
        name, part = self.get_name(), self._id.partition('#')[2]
        self._mark = self.create_publisher(Empty, f'_game/{name}/_{part}', 1)
        self._out = {
            topic: self.create_publisher(kind, topic, qos)
            for topic, kind, qos in (
                ('domain_info', DomainInfo, LATCHED),
                ('game_state', GameState, STREAM),
                ('current_state', GameState, LATCHED),
                ('action_refused', ActionRefusal, STREAM),
            )
        }
        self.create_service(ResetGame, 'reset_game', self._reset)
        self.create_subscription(ActionCommand, 'action', self._act, STREAM)
        self._publish('domain_info', info)

    def carry(self, seed: int) -> None:
        """Carry the robot to another place."""
        raise NotImplementedError

    def execute(self, action: str, step: int) -> dict[str, float | bool]:
        """Execute an action; return its reward, and how the episode ends if it does."""
        raise NotImplementedError

    def sense(self) -> list[float]:
        """Return the values of the features."""
        raise NotImplementedError

    def _publish(self, topic: str, message) -> None:
        self._sequences[topic] = self._sequences.get(topic, 0) + 1
        message.header.stamp = self.get_clock().now().to_msg()
        message.publisher_id, message.sequence = self._id, self._sequences[topic]
        self._out[topic].publish(message)

    def _show(self, **step) -> None:
        """Publish the state and the step that led to it."""
        features = self.sense()
        state = json.dumps(features)  # any text; only this node reads it
        self._now = GameState(state=state, features=features, **step)
        for topic in ('game_state', 'current_state'):
            self._publish(topic, self._now)

    def _reset(self, request: ResetGame.Request, reply: ResetGame.Response) -> ResetGame.Response:
        if request.start_state:
            reply.status, reply.detail = reply.STATUS_BAD_STATE, 'a rover starts where it stands'
            return reply
        self.carry(request.seed)
        self._show(episode=self._now.episode + 1)
        reply.status, reply.episode, reply.state = (
            reply.STATUS_OK,
            self._now.episode,
            self._now.state,
        )
        return reply

    def _act(self, command: ActionCommand) -> None:
        now, by_person = self._now, command.source == ActionCommand.SOURCE_PERSON
        current = (command.episode, command.step) == (now.episode, now.step)
        over = not now.episode or now.truncated or now.terminated
        if over or command.action not in self._actions or not (by_person or current):
            self._refuse(command, 'no such action, or not for this step')
            return
        outcome = self.execute(command.action, now.step + 1)
        self._show(
            episode=now.episode,
            step=now.step + 1,
            previous_action=command.action,
            action_source=command.source,
            action_publisher_id=command.publisher_id,
            action_sequence=command.sequence,
            **outcome,
        )

    def _refuse(self, command: ActionCommand, why: str) -> None:
        refusal = ActionRefusal(reason=ActionRefusal.REASON_STALE, detail=why)
        refusal.episode, refusal.step = self._now.episode, self._now.step
        for name in ('publisher_id', 'sequence', 'episode', 'step', 'action'):
            setattr(refusal, f'command_{name}', getattr(command, name))
        self._publish('action_refused', refusal)


class Rover(Robot):
    """A rover in a corridor."""

    def __init__(self) -> None:
        info = DomainInfo(domain='rover', parameters='{}', gamma=0.95, max_steps=100)
        info.features, info.actions = FEATURES, list(ACTIONS.values())
        super().__init__(info)

    def carry(self, seed: int) -> None:
        self._chance = random.Random(seed)
        self._x, self._on = self._chance.uniform(2.0, LENGTH), False

    def execute(self, action: str, step: int) -> dict[str, float | bool]:
        if action == 'switch':
            self._on = not self._on
        else:
            way = 1.0 if action == 'forward' else -1.0
            self._x = min(max(self._x + way * self._chance.uniform(0.4, 0.6), 0.0), LENGTH)
        return {'reward': -1.0, 'truncated': step == 100}

    def sense(self) -> list[float]:
        return [self._x, float(self._on)]


def main(robot: type[Robot]) -> None:
    """Run a robot until it is shut down."""
    rclpy.init()
    try:
        rclpy.spin(robot())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main(Rover)
