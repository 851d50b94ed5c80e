"""
Messages per second accepted by the recorder, with cost and losses.

This process sends the same messages to the recorder and to a reader that writes nothing.
"""

from contextlib import closing, ExitStack
from dataclasses import dataclass, replace
import json
from pathlib import Path
import time
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.qos import STREAM
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.usage import usage_of
import pytest
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import serialize_message

from benchmarks.bench_reader import KINDS
from benchmarks.processes import Client, launched, NAMESPACE, own_place, own_spec, stop

_PATIENCE = 10.0  # s for a reader to receive all messages
_PERIOD = 0.002  # s between checks of the clock
_AT_ONCE = 500  # messages between checks of the clock, at maximum speed


@dataclass(frozen=True)
class Load:
    """The messages to send to a reader."""

    messages: int
    rate: int  # messages per second; 0: as fast as the reader takes them
    rounds: int
    longest: float = 15.0  # s of sending at most; a slow reader then gets fewer messages


# A reader's middleware queues up to 5,000 messages per topic, so a load at maximum speed has many
# times more.
LOADS = {
    'as fast as they are taken': Load(60_000, 0, 5),
    '3,000 a second': Load(180_000, 3_000, 1, longest=66.0),
}


@pytest.mark.parametrize('load', LOADS)
@pytest.mark.parametrize('reader', ['recorder', 'bench_reader'])
def bench_recording(benchmark: Any, load: str, reader: str, quick: bool) -> None:
    """Send messages to a reader until its middleware has them all; no loss is allowed."""
    benchmark.group = f'messages, {load}'
    benchmark.name = 'the recorder' if reader == 'recorder' else 'taken alike, not written'
    wanted = replace(LOADS[load], messages=2_000) if quick else LOADS[load]
    rounds: list[tuple[Path, Sender]] = []
    with own_place() as place, ExitStack() as stack:

        def start() -> Any:
            stack.close()
            folder = place / str(len(rounds))
            spec = own_spec(reader, results=str(folder / 'taken.json'))
            if reader == 'recorder':
                bag = str(folder / 'bag')
                spec = ProcessSpec(reader, 'humanopts_teach.ros.recorder', {'path': bag})
            launcher = stack.enter_context(launched([spec], folder))
            sender = stack.enter_context(closing(Sender(launcher, reader)))
            rounds.append((folder, sender))
            return (sender, wanted), {}

        benchmark.pedantic(Sender.send, setup=start, rounds=wanted.rounds)
        stack.close()
        counts = [_received(folder) for folder, _ in rounds]
    senders = [sender for _, sender in rounds]
    sent = sum(sender.sent for sender in senders)
    benchmark.extra_info |= {
        'messages sent': sent,
        'lost': sent - sum(taken for taken, _ in counts),
        'longest wait in s': round(max(waited for _, waited in counts), 3),
        'share of a core': round(max(sender.processor for sender in senders), 2),
        'bytes of memory': max(sender.memory for sender in senders),
    }
    assert not benchmark.extra_info['lost']


def _received(folder: Path) -> tuple[int, float]:
    """Return the number of messages received by a reader, and their longest waiting time, s."""
    if not (folder / 'bag').exists():
        found = json.loads((folder / 'taken.json').read_text('utf-8'))
        return found['taken'], found['waited']
    bag, topics = open_bag(folder / 'bag'), [f'{NAMESPACE}/{name}' for name in KINDS]
    statuses = bag.messages([f'{NAMESPACE}/recorder_status'])
    waited = max(recorded.message.lag for recorded in statuses)
    return sum(s.recorded for s in summarise(bag).streams if s.topic in topics), waited


class Sender(Client):
    """
    Send the messages of a game to one reader.

    At maximum speed, it sends pre-serialized messages on one topic, so that the reader limits the
    rate. At a steady rate, it sends on three topics, like a game with a display.

    :ivar sent: number of messages.
    :ivar processor: share of one core used by the reader while receiving.
    :ivar memory: peak memory of the reader, bytes.
    """

    def __init__(self, launcher: Launcher, reader: str) -> None:
        super().__init__(launcher, 'bench_sender')
        self.sent, self.processor, self.memory = 0, 0.0, 0
        self._launcher, self._pid = launcher, launcher.pid(reader)
        self._to = [self.node.create_publisher(kind, name, STREAM) for name, kind in KINDS.items()]
        self.until(lambda: all(to.get_subscription_count() for to in self._to), reader)

    def send(self, load: Load) -> None:
        """Send all messages, or as many as the reader accepts in time; wait until they arrive."""
        to = self._to if load.rate else self._to[:1]
        wanted = range(load.messages)
        ready = [] if load.rate else [self._message(number, 1) for number in wanted]
        before, began = usage_of(self._pid), time.monotonic()
        while self.sent < load.messages and time.monotonic() < began + load.longest:
            elapsed = time.monotonic() - began
            due = int(elapsed * load.rate) if load.rate else self.sent + _AT_ONCE
            for number in wanted[self.sent : due]:
                message = ready[number] if ready else self._message(number, len(to))
                try:
                    to[number % len(to)].publish(message)
                except rclpy_implementation.RCLError:
                    break  # the reader has blocked the sender for 0.1 s
                self.sent += 1
            if load.rate:
                time.sleep(_PERIOD)
        self._await_received(_PATIENCE)
        after = usage_of(self._pid)
        self.processor = (after.cpu - before.cpu) / (after.time - before.time)
        self.memory = after.peak

    def close(self) -> None:
        """Leave the graph; a reader with pending messages ends first, and takes them meanwhile."""
        if not self._await_received(0.0):
            stop(self._launcher)
        super().close()

    def _await_received(self, seconds: float) -> bool:
        """Wait on each topic; return whether the reader's middleware has received everything."""
        return all(to.wait_for_all_acked(Duration(seconds=seconds)) for to in self._to)

    def _message(self, number: int, topics: int) -> bytes:
        """Return a message for the next topic, with its sequence number on that topic."""
        turn, place = divmod(number, topics)
        sender = f'{NAMESPACE}/bench_sender#00000000'
        message: Any = [*KINDS.values()][place](
            publisher_id=sender, sequence=turn + 1, episode=1, step=turn
        )
        message.header.stamp = self.node.get_clock().now().to_msg()
        if isinstance(message, ActionCommand):
            message.source = ActionCommand.SOURCE_MACHINE
            message.action, message.option_name = 'north', 'go to passenger and pickup'
        else:
            message.state, message.features = 'taxi 2,3 passenger R destination B', [0.0] * 10
            message.previous_action, message.action_source = 'north', GameState.SOURCE_MACHINE
            message.action_publisher_id, message.action_sequence = sender, turn + 1
            message.reward = -1.0
        return bytes(serialize_message(message))
