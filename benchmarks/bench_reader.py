"""The yardsticks of the recorder: take raw messages, and write nothing."""

from collections.abc import Callable
import json
from pathlib import Path
import sys
import time
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import STREAM
from humanopts_teach.ros.raw_subscriber import RawSubscriber
from rclpy.executors import Executor
from rclpy.subscription import Subscription

KINDS = {'game_state': GameState, 'action': ActionCommand, 'current_state': GameState}
_LOOK_PERIOD = 0.05  # s between looks at the graph
_TAKE_PERIOD = 0.004  # s between takes, as the recorder has it while messages come
_QUIET = 0.1  # s without a message that end it
_LINGER = 5.0  # s at most to wait for that


class BenchReader(NodeBase):
    """Counts messages: taken as the recorder takes them, or one by one by the executor."""

    def __init__(self) -> None:
        super().__init__('bench_reader')
        self._path = Path(self.setting('results', '', 'file to write'))
        self._taken, self._waited = 0, 0
        self._one_by_one: list[tuple[Any, Subscription]] = []  # by the executor
        if self.setting('polled', True, 'take all that is there every few milliseconds'):
            prefix = self.get_namespace().rstrip('/')
            self._topics = {f'{prefix}/{topic}' for topic in KINDS}
            self._intake = RawSubscriber(self, self.selection)
            self.create_timer(_LOOK_PERIOD, self._intake.discover)
            self.create_timer(_TAKE_PERIOD, self._take)
        else:
            for topic, kind in KINDS.items():
                count: Any = self._count  # rclpy's types know no information beside a message
                self._one_by_one.append(
                    (kind, self.create_subscription(kind, topic, count, STREAM, raw=True))
                )

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """
        Take messages until the end, and then those that are still on their way.

        Thousands may be queued then, for which an executor takes longer than a process has to end;
        the clock is stopped, so they are taken from the queues.
        """
        super().serve(executor, stop)
        quiet, end = time.monotonic() + _QUIET, time.monotonic() + _LINGER
        while time.monotonic() < (end if self._is_sent_to() else min(quiet, end)):
            before = self._taken
            self._take_rest()
            if self._taken > before:
                quiet = time.monotonic() + _QUIET
            time.sleep(_TAKE_PERIOD)

    def _is_sent_to(self) -> bool:
        """Return whether a sender, which stays while messages are on their way, is there."""
        return any(subscription.get_publisher_count() for _, subscription in self._one_by_one)

    def close(self) -> None:
        """Write how many messages there were, and the longest time that one waited, s."""
        found = {'taken': self._taken, 'waited': self._waited / 1e9}
        self._path.write_text(json.dumps(found), 'utf-8')

    def _take(self) -> None:
        times = [t.received for t in self._intake.take() if t.topic in self._topics]
        if times:
            self._taken += len(times)
            self._waited = max(self._waited, time.time_ns() - times[0])

    def _take_rest(self) -> None:
        """Take what is queued, without the executor."""
        if not self._one_by_one:
            self._take()
        for kind, subscription in self._one_by_one:
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(kind, True)) is not None:
                    self._count(*taken)

    def _count(self, data: bytes, information: Any) -> None:
        self._taken += 1
        self._waited = max(self._waited, time.time_ns() - information['received_timestamp'])


def main() -> int:
    """Run the node."""
    return run_node(BenchReader)


if __name__ == '__main__':
    sys.exit(main())
