"""Publishes game states as fast as it can to one reader, and measures until all are taken."""

from pathlib import Path
import sys
import time

from humanopts_env.nodes.node_base import NodeBase, PublishError, run_node
from humanopts_env.nodes.qos import STREAM
from humanopts_interfaces.msg import GameState
from humanopts_teach.benchmarks.records import RecordWriter
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import serialize_message

_PATIENCE = 60.0  # s


class BenchFlood(NodeBase):
    """Sends messages that were serialized before, so that the reader is what limits the rate."""

    def __init__(self) -> None:
        super().__init__('bench_flood')
        self._path = Path(self.setting('results', '', 'file to write'))
        self._count = int(self.setting('count', 1000, 'messages to send'))
        self._reader = str(self.setting('reader', 'recorder', 'node that takes them'))
        self._flood = self.create_publisher(GameState, 'flood', STREAM)

    def waits_for(self) -> str | None:
        """Wait for the reader."""
        readers = self.get_subscriptions_info_by_topic(self._flood.topic_name)
        there = any(reader.node_name == self._reader for reader in readers)
        return None if there and self._flood.get_subscription_count() else self._reader

    def on_ready(self) -> None:
        """Send everything; the first before the clock runs, so that both sides have met."""
        first, *messages = [self._message(number) for number in range(1, self._count + 1)]
        self._send([first])
        began = time.perf_counter()
        self._send(messages)
        seconds = (time.perf_counter() - began) / len(messages)
        with RecordWriter(self._path) as records:
            records.write(seconds=seconds, bytes=len(first))

    def _send(self, messages: list[bytes]) -> None:
        """
        Publish messages and wait until they have arrived.

        :raises PublishError: they do not.
        """
        deadline = time.monotonic() + _PATIENCE
        for message in messages:
            while not self._sent(message) and time.monotonic() < deadline:
                pass
        if not self._flood.wait_for_all_acked(Duration(seconds=_PATIENCE)):
            raise PublishError(f'{self._reader} has not taken everything after {_PATIENCE:g} s')

    def _sent(self, message: bytes) -> bool:
        """Publish; False: the reader holds the writer back, which waits for 0.1 s and refuses."""
        try:
            self._flood.publish(message)
        except rclpy_implementation.RCLError:
            return False
        return True

    def _message(self, number: int) -> bytes:
        state = GameState(
            publisher_id=self.publisher_id,
            sequence=number,
            episode=1,
            step=number,
            state='taxi 2,3 passenger R destination B',
            features=[0] * 10,
            previous_action='north',
            action_source=GameState.SOURCE_MACHINE,
            action_publisher_id=self.publisher_id,
            action_sequence=number,
            reward=-1.0,
        )
        state.header.stamp = self.get_clock().now().to_msg()
        return bytes(serialize_message(state))


if __name__ == '__main__':
    sys.exit(run_node(BenchFlood))
