"""A stranger that sends garbage on a graph, and sees what its game really does."""

from collections import defaultdict
from collections.abc import Callable
import random
from typing import Any

from humanopts_interfaces.msg import GameState, NodeStatus
from humanopts_ros.qos import ACTION, CURRENT, DISPLAY, LATCHED, SERVICE, STREAM
from humanopts_ros.senders import signer
from humanopts_teach.ros.raw_subscriber import load_type
import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from graph_support.garbage import Garbage

OURS = 'soak'  # the node that sends garbage
_LATCHED = {
    'domain_info', 'current_state', 'control', 'lesson_state', 'learning_status',
    'learned_options', 'automatic_options', 'execution', 'option_values', 'node_status',
    'recorder_status',
}  # fmt: skip


class Stranger:
    """Sends garbage on the graph, and sees what the game really does."""

    def __init__(self, rng: random.Random) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(OURS, context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._garbage, self._rng = Garbage(rng), rng
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._seen: dict[str, Any] = {}  # the newest real message by topic
        self._taken = 0  # messages
        # Episode and step after each action that the game has taken; it may publish a state again.
        self.applied: defaultdict[tuple[str, int], set[tuple[int, int]]] = defaultdict(set)
        self.said: list[str] = []  # by the conductor, in order
        self.node.create_subscription(GameState, 'game_state', self._on_state, STREAM)
        self.node.create_subscription(NodeStatus, 'node_status', self._on_status, CURRENT)

    def close(self) -> None:
        """Leave; it can be called again."""
        if not self._context.ok():
            return
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def serve(self, seconds: float = 0.0) -> None:
        """Take what has come; the game waits for a reader of its stream that falls behind."""
        self._executor.spin_once(seconds)
        for _ in range(8):
            taken = self._taken
            self._executor.spin_once(0.0)
            if taken == self._taken:
                break

    def topics(self) -> list[tuple[str, str]]:
        """Return the topics of the graph and their types."""
        found = self.node.get_topic_names_and_types()
        return sorted(
            (n, t[0]) for n, t in found if t[0].startswith('humanopts') and '/_' not in n
        )

    def bytes(self) -> bytes:
        """Return bytes that are no message of any type."""
        return self._garbage.raw()

    def services(self) -> list[tuple[str, str]]:
        """Return the services and actions of the graph and their types."""
        found = self.node.get_service_names_and_types()
        calls = [(n, t[0]) for n, t in found if t[0].startswith('humanopts') and '/_' not in n]
        ends = [n.removesuffix('/_action/send_goal') for n, _ in found if n.endswith('send_goal')]
        kinds = {n: t[0] for n, t in found if n.endswith('send_goal')}
        goals = [(n, kinds[f'{n}/_action/send_goal'].removesuffix('_SendGoal')) for n in ends]
        return sorted(calls + goals)

    def send(self, name: str, kind: str, count: int) -> None:
        """Publish garbage on a topic: random messages, and sometimes random bytes."""
        loaded = load_type(kind)
        if name not in self._publishers:
            qos = LATCHED if name.rpartition('/')[2] in _LATCHED else STREAM
            self._publishers[name] = self.node.create_publisher(loaded, name, qos)
            if name.rpartition('/')[2] not in ('game_state',):
                self.node.create_subscription(loaded, name, self._keeper(name), DISPLAY)
            for _ in range(20):
                self.serve(0.02)
        for _ in range(count):
            raw = self._rng.random() < 0.1
            message = self._garbage.message(loaded, self._seen.get(name))
            self._publishers[name].publish(self._garbage.raw() if raw else message)
            self.serve()

    def call(self, name: str, kind: str) -> tuple[Callable[[], bool], Callable[[], Any]]:
        """Call a service or send a goal; return whether it was answered, and what."""
        loaded = load_type(kind)
        action = '/action/' in kind
        if name not in self._clients:
            self._clients[name] = (
                ActionClient(self.node, loaded, name, **ACTION)
                if action
                else self.node.create_client(loaded, name, qos_profile=SERVICE)
            )
            for _ in range(50):  # both ends have to find each other, or the answer is lost
                self.serve(0.02)
        client = self._clients[name]
        if action:
            return self._goal(client, self._garbage.message(loaded.Goal))
        future = client.call_async(self._garbage.message(loaded.Request))
        return future.done, future.result

    def _goal(
        self, client: ActionClient, goal: Any
    ) -> tuple[Callable[[], bool], Callable[[], Any]]:
        replies: list[Any] = []

        def on_accepted(done: Any) -> None:
            handle = done.result()
            handle.cancel_goal_async()
            handle.get_result_async().add_done_callback(lambda f: replies.append(f.result()))

        client.send_goal_async(goal).add_done_callback(on_accepted)
        return lambda: bool(replies), lambda: replies[0].result.result

    def ready(self, name: str) -> bool:
        """Return whether the server of a call is found."""
        client = self._clients.get(name)
        if client is None:
            return True
        return bool(
            getattr(client, 'service_is_ready', getattr(client, 'server_is_ready', bool))()
        )

    def _keeper(self, name: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            self._seen[name] = message
            self._taken += 1

        return keep

    def _on_status(self, status: NodeStatus) -> None:
        if signer(status.publisher_id) == '/conductor':
            self.said.append(status.text)

    def _on_state(self, state: GameState) -> None:
        self._seen['/game_state'] = state
        self._taken += 1
        mine = state.publisher_id.endswith('garbage')
        if state.publisher_id.startswith('/game#') and not mine and state.step:
            key = f'{state.publisher_id} {state.action_publisher_id}', state.action_sequence
            self.applied[key].add((state.episode, state.step))
