"""Sends the messages of a game to one reader: as fast as it takes them, or at a steady rate."""

from pathlib import Path
import sys
import time
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import STREAM
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import serialize_message

from benchmarks.measure import add_record

KINDS = {'game_state': GameState, 'action': ActionCommand, 'current_state': GameState}
_PATIENCE = 60.0  # s
_PERIOD = 0.002  # s between looks at what is due
_AT_ONCE = 500  # messages, as fast as it can; takes longer than the period


class BenchSender(NodeBase):
    """
    Tells when it begins, and how long it took.

    As fast as it can, it sends on one topic what was serialized before, so that the reader is what
    limits the rate, and the time ends when the reader's middleware has everything. At a steady
    rate it sends on three, as a game does whose states are also displayed.
    """

    def __init__(self) -> None:
        super().__init__('bench_sender')
        self._path = Path(self.setting('results', '', 'file to write'))
        self._count = int(self.setting('count', 1000, 'messages to send'))
        self._rate = int(self.setting('rate', 0, 'messages a second; 0: as fast as it can'))
        self._reader = str(self.setting('reader', 'recorder', 'node that takes them'))
        topics = list(KINDS) if self._rate else list(KINDS)[:1]
        self._to = [self.create_publisher(KINDS[topic], topic, STREAM) for topic in topics]
        self._prepared: list[bytes] = []  # what is sent as fast as it can be
        self._sent = self._bytes = 0
        self._begun = 0.0

    def waits_for(self) -> str | None:
        """Wait for the reader."""
        matched = (self._is_read(p.topic_name) and p.get_subscription_count() for p in self._to)
        return None if all(matched) else self._reader

    def _is_read(self, topic: str) -> bool:
        readers = self.get_subscriptions_info_by_topic(topic)
        return any(reader.node_name == self._reader for reader in readers)

    def on_ready(self) -> None:
        """Begin."""
        if not self._rate:
            self._prepared = [self._message(number) for number in range(self._count)]
        add_record(self._path, begun=True)
        self._begun = time.monotonic()
        self._timer = self.create_timer(_PERIOD, self._send_due)

    def _send_due(self) -> None:
        elapsed = time.monotonic() - self._begun
        due = int(elapsed * self._rate) if self._rate else self._sent + _AT_ONCE
        for number in range(self._sent, min(due, self._count)):
            self._send(self._message(number) if self._rate else self._prepared[number])
        if self._sent == self._count:
            self._timer.cancel()
            self._finish()

    def _finish(self) -> None:
        """
        Wait until everything has arrived, and write how long it took.

        At a steady rate that wait does not count: the middleware asks for the last answer only
        every few seconds.

        :raises PublishError: it does not arrive.
        """
        sent = time.monotonic() - self._begun
        for publisher in self._to:
            if not publisher.wait_for_all_acked(Duration(seconds=_PATIENCE)):
                raise PublishError(f'{self._reader} has not taken all after {_PATIENCE:g} s')
        seconds = sent if self._rate else time.monotonic() - self._begun
        add_record(self._path, seconds=seconds, bytes=self._bytes)

    def _send(self, message: bytes) -> None:
        """
        Publish; where the reader holds the writer back, that waits for 0.1 s and refuses.

        :raises PublishError: it goes on refusing.
        """
        deadline = time.monotonic() + _PATIENCE
        publisher = self._to[self._sent % len(self._to)]
        while True:
            try:
                publisher.publish(message)
                break
            except rclpy_implementation.RCLError:
                if time.monotonic() > deadline:
                    raise PublishError(f'{self._reader} takes nothing any more') from None
        self._sent += 1
        self._bytes += len(message)

    def _message(self, number: int) -> bytes:
        """Return a message for the topic whose turn it is, numbered among those of the topic."""
        turn, place = divmod(number, len(self._to))
        kind = KINDS[list(KINDS)[place]]
        message = kind(publisher_id=self.publisher_id, sequence=turn + 1, episode=1, step=turn)
        message.header.stamp = self.get_clock().now().to_msg()
        _fill(message)
        return bytes(serialize_message(message))


def _fill(message: Any) -> None:
    """Fill in what a game of Taxi would send."""
    if isinstance(message, ActionCommand):
        message.source = ActionCommand.SOURCE_MACHINE
        message.action, message.option_name = 'north', 'go to passenger and pickup'
        return
    message.state, message.features = 'taxi 2,3 passenger R destination B', [0] * 10
    message.previous_action, message.action_source = 'north', GameState.SOURCE_MACHINE
    message.action_publisher_id, message.action_sequence = message.publisher_id, message.sequence
    message.reward = -1.0


if __name__ == '__main__':
    sys.exit(run_node(BenchSender))
