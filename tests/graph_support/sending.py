"""A process that sends messages as a game does, and keeps a record of all that it sent."""

from collections.abc import Iterator
import os
from pathlib import Path
import random
import struct
import sys
import time
from typing import Any, NamedTuple

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import STREAM
from rclpy.serialization import serialize_message

RATE = 500  # messages a second, over all topics
KINDS = {'/action': ActionCommand, '/game_state': GameState, '/large_state': GameState}
TURN = ('/action', '/game_state') * 5 + ('/large_state',)
SIZES = {'/action': (2, 20), '/game_state': (20, 400), '/large_state': (2_000, 40_000)}
_HEAD = struct.Struct('<BQI')  # index of the topic, ns since the epoch, bytes that follow


class Sent(NamedTuple):
    """A message that was sent."""

    time: int  # just before, ns since the epoch
    topic: str
    data: bytes


def read_sent(path: Path) -> Iterator[Sent]:
    """Yield what was sent, in order; nothing where there is no record yet."""
    record, at = path.read_bytes() if path.exists() else b'', 0
    while at < len(record):
        topic, sent, size = _HEAD.unpack_from(record, at)
        at += _HEAD.size + size
        yield Sent(sent, list(KINDS)[topic], record[at - size : at])


class Sender(NodeBase):
    """Begins when the recorder has matched every publisher."""

    def __init__(self) -> None:
        super().__init__('sender')
        self._record = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        self._to = {topic: self.create_publisher(k, topic, STREAM) for topic, k in KINDS.items()}
        self._sent = dict.fromkeys(KINDS, 0)
        self._begun = 0.0

    def waits_for(self) -> str | None:
        """Wait for the recorder."""
        matched = (p.get_subscription_count() and self.is_recorded(t) for t, p in self._to.items())
        return None if all(matched) else 'the recorder'

    def on_ready(self) -> None:
        """Begin."""
        self._begun = time.monotonic()
        self.create_timer(1 / RATE, self._send_due)

    def _send_due(self) -> None:
        due = int((time.monotonic() - self._begun) * RATE)
        for number in range(sum(self._sent.values()), due):
            self._send(TURN[number % len(TURN)])

    def _send(self, topic: str) -> None:
        self._sent[topic] += 1
        data = bytes(serialize_message(self._message(topic, self._sent[topic])))
        data += bytes(-len(data) % 4)  # as the middleware does
        sent = time.time_ns()
        self._to[topic].publish(data)
        os.write(self._record, _HEAD.pack(list(KINDS).index(topic), sent, len(data)) + data)

    def _message(self, topic: str, number: int) -> Any:
        """Return a message whose size and text follow from its number."""
        chance = random.Random(f'{topic} {number}')
        text = chance.randbytes(chance.randint(*SIZES[topic]) // 2).hex()
        message = KINDS[topic](publisher_id=self.publisher_id, sequence=number)
        message.header.stamp = self.get_clock().now().to_msg()
        if topic == '/action':
            message.action = text
        else:
            message.state = text
        return message


if __name__ == '__main__':
    sys.exit(run_node(Sender, []))
