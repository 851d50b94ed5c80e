"""
A client in plain rclpy of the graph of a robot, written from docs/reference/graph.md alone.

It prints a line for each topic, service and action of the page: its QoS, whether it is offered so,
and what is answered to an empty request. Then it gives commands that are refused.
"""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
import sys
import time
from typing import Any

from humanopts_interfaces.msg import ActionCommand, ActionRefusal, GameState, OptionResult
import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

PAGE = Path(__file__).parents[2] / 'docs/reference/graph.md'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STREAM = QoSProfile(depth=0, history=HistoryPolicy.KEEP_ALL)
SECONDS = 20.0  # to wait for an answer


def rows(heading: str) -> Iterator[list[str]]:
    """Yield the cells of the first table below a heading, without its head."""
    section = PAGE.read_text('utf-8').split(f'\n## {heading}\n')[1].split('\n## ')[0]
    lines = [line for line in section.split('\n\n**')[0].splitlines() if line.startswith('|')]
    for line in lines[2:]:
        yield [cell.strip().strip('`') for cell in line.strip('|').split('|')]


def get_interface(name: str) -> Any:
    """Return the class of a type, such as std_msgs/msg/Empty."""
    package, group, kind = name.split('/')
    return getattr(import_module(f'{package}.{group}'), kind)


def constant(kind: Any, prefix: str, value: int) -> str:
    """Return the name of a constant of a message."""
    names = [n for n in dir(kind) if n.startswith(prefix) and getattr(kind, n) == value]
    return names[0].removeprefix(prefix) if names else str(value)


class Client:
    """A node that asks and listens."""

    def __init__(self) -> None:
        self._node = Node('plain_client')
        self._heard: dict[str, list[Any]] = {}

    def until(self, condition: Callable[[], Any], seconds: float = SECONDS) -> bool:
        """Serve the node until a condition holds; return whether it does."""
        deadline = time.monotonic() + seconds
        while not condition() and time.monotonic() < deadline:
            rclpy.spin_once(self._node, timeout_sec=0.05)
        return bool(condition())

    def hear(self, topic: str, kind: Any, qos: QoSProfile) -> list[Any]:
        """Subscribe, and return the list of messages to come."""
        if topic not in self._heard:
            self._heard[topic] = heard = []
            self._node.create_subscription(kind, topic, heard.append, qos)
        return self._heard[topic]

    def topic(self, name: str, kind: str, profile: str) -> str:
        """Describe a topic."""
        qos = LATCHED if profile == 'latched' else STREAM
        self.hear(name, get_interface(kind), qos)
        publishers: list[Any] = []

        def found() -> bool:
            publishers[:] = self._node.get_publishers_info_by_topic(f'/{name}')
            return bool(publishers)

        if not self.until(found, 3.0):
            return f'topic {name}: {profile}, no publisher here'
        same = all(p.qos_profile.durability == qos.durability for p in publishers)
        kinds = {p.topic_type for p in publishers}
        said = 'as documented' if same and kinds == {kind} else f'NOT AS DOCUMENTED: {publishers}'
        return f'topic {name}: {profile}, {said}'

    def call(self, name: str, kind: Any, request: Any) -> Any:
        """Return the response to a request; None: there is none."""
        client = self._node.create_client(kind, name)
        if not self.until(client.service_is_ready):
            return None
        future = client.call_async(request)
        return future.result() if self.until(future.done) else None

    def service(self, name: str, kind: str) -> str:
        """Describe a service by its answer to an empty request."""
        loaded = get_interface(kind)
        response = self.call(name, loaded, loaded.Request())
        if response is None:
            return f'service {name}: NO ANSWER'
        if hasattr(response, 'success'):
            return f'service {name}: success {response.success}, {response.message}'
        result = getattr(response, 'result', response)
        status = constant(result, 'STATUS_', result.status)
        return f'service {name}: {status}' + (f', {result.detail}' if result.detail else '')

    def action(self, name: str, kind: str) -> str:
        """Describe an action by its answer to an empty goal."""
        loaded = get_interface(kind)
        refusals = self.hear('option_results', OptionResult, STREAM)
        client, known = ActionClient(self._node, loaded, name), len(refusals)
        if not self.until(client.server_is_ready):
            return f'action {name}: NO SERVER'
        sent = client.send_goal_async(loaded.Goal())
        if not self.until(sent.done):
            return f'action {name}: NO ANSWER'
        if not sent.result().accepted:
            self.until(lambda: len(refusals) > known, 2.0)
            why = f', {refusals[-1].detail}' if len(refusals) > known else ''
            return f'action {name}: rejected{why}'
        ended = sent.result().get_result_async()
        if not self.until(ended.done):
            return f'action {name}: NO RESULT'
        result = ended.result().result.result
        return f'action {name}: {constant(result, "STATUS_", result.status)}, {result.detail}'

    def commands(self) -> Iterator[str]:
        """Give commands that are refused, and describe the refusals."""
        states = self.hear('current_state', GameState, LATCHED)
        refusals = self.hear('action_refused', ActionRefusal, STREAM)
        out = self._node.create_publisher(ActionCommand, 'action', STREAM)
        self.until(lambda: out.get_subscription_count() and states)
        person, machine = ActionCommand.SOURCE_PERSON, ActionCommand.SOURCE_MACHINE
        tries: dict[str, dict[str, Any]] = {
            'without a source': {},
            'of a machine': {'source': machine},
            'of a person without an id': {'source': person},
            'of a person, unknown': {'source': person, 'publisher_id': '/me#1', 'action': 'fly'},
        }
        for number, (what, fields) in enumerate(tries.items(), 1):
            known, state = len(refusals), states[-1]
            place = {'episode': state.episode, 'step': state.step}
            given = {'action': 'forward', 'publisher_id': '', **place, **fields}
            out.publish(ActionCommand(sequence=number, **given))
            self.until(lambda known=known: len(refusals) > known)
            refusal = refusals[-1]
            reason = constant(refusal, 'REASON_', refusal.reason)
            yield f'command {what}: {reason}, {refusal.detail}'


def main() -> int:
    """Print the list."""
    rclpy.init()
    client = Client()
    for name, kind, profile, *_ in rows('Topics'):
        print(client.topic(name, kind, profile))
    own = list(rows('The world of a robot'))
    for name, kind, what in own:
        if what.startswith('latched topic'):
            print(client.topic(name, kind, 'latched'))
    for line in client.commands():
        print(line)
    for name, kind, *_ in rows('Services'):
        print(client.service(name, kind))
    for name, kind, what in own:
        if what.startswith('service'):
            print(client.service(name, kind))
    for name, kind, *_ in rows('Actions'):
        print(client.action(name, kind))
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
