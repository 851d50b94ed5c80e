"""
How many messages a second the recorder takes, what that costs, and what is lost.

This process sends the same messages to the recorder, and in turns to readers that write nothing.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
import json
from pathlib import Path
import statistics
import time
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.qos import STREAM
from humanopts_teach.bags import BagError
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.sequence_numbers import count_loss
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.usage import Usage, usage_of
import numpy as np
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import serialize_message

from benchmarks.bench_reader import KINDS
from benchmarks.measure import OnMeasured, part_of, ratios, Row
from benchmarks.processes import (
    bench_spec,
    Client,
    launched,
    NAMESPACE,
    own_place,
    processor_time,
    stop,
)

_PATIENCE = 10.0  # s that a reader has to receive what was sent
_PERIOD = 0.002  # s between looks at the clock
_LOOK_PERIOD = 0.1  # s between looks at the reader
_AT_ONCE = 500  # messages that are sent between looks, as fast as can be
_USUAL_RATE = 20_000  # messages a second, where a reader takes them as fast as it can
_TOPICS = [f'{NAMESPACE}/{name}' for name in KINDS]
_STATUS = f'{NAMESPACE}/recorder_status'
RECORDER = 'the recorder'
YARDSTICK = 'taken in the same way, not written'
CALLBACK = 'a raw subscription with a callback, not written'
READERS = (RECORDER, YARDSTICK, CALLBACK)
COUNTED = ('sent', 'taken', 'lost')  # messages of a turn
OnSent = Callable[[float], object]  # share that is sent


@dataclass(frozen=True)
class Load:
    """The messages that are sent to a reader."""

    messages: int
    rate: int  # messages a second; 0: as fast as the reader takes them
    turns: int  # of every reader
    longest: float = 15.0  # s that is sent for; a reader that holds the sender back gets less

    @property
    def name(self) -> str:
        """The load in words."""
        if not self.rate:
            return 'as fast as they are taken'
        return f'{self.rate:,} a second for {self.messages / self.rate:g} s'

    @property
    def seconds(self) -> float:
        """About how long a turn takes."""
        return self.messages / (self.rate or _USUAL_RATE)


LOADS = (Load(60_000, 0, 5), Load(180_000, 3_000, 1, longest=66.0))
QUICK = ((Load(2_000, 0, 1), Load(1_500, 3_000, 1)),)


@dataclass(frozen=True)
class Run:
    """One turn of a reader."""

    sent: int  # at most those of the load
    taken: int
    lost: int  # by the numbers in the messages where they are read, else by their count
    bytes: int  # of all messages
    seconds: float  # in which they were sent; as fast as can be, until all had arrived
    processor: float  # share of one core that the reader used meanwhile
    memory: int  # the most that it had at once, bytes
    grown: int  # by how much its memory grew in the second half, bytes
    waited: float  # longest time that a message waited for the reader, s
    processor_seconds: float  # of the reader meanwhile


def measure(progress: OnMeasured, loads: Sequence[Load] = LOADS) -> list[Row]:
    """
    Send to the recorder, and in turns to readers that write nothing.

    A reader's middleware holds up to 5,000 messages of a topic that are not taken yet, so a load
    as fast as can be has many times more. A turn ends in bounded time: a reader that is too slow
    for its load gets fewer messages, and what it does not take counts as lost.

    :raises LaunchError: a process died.
    """
    work = [(load, turn, name) for load in loads for turn in range(load.turns) for name in READERS]
    total, done = sum(load.seconds for load, _, _ in work), 0.0
    runs: dict[Load, dict[str, list[Run]]] = {load: defaultdict(list) for load in loads}
    with own_place() as folder:
        for number, (load, _, name) in enumerate(work):
            share, text = load.seconds / total, f'messages {load.name}: {name}'
            on_sent = part_of(progress, text, done / total, share)
            on_sent(0.0)
            take = record if name == RECORDER else partial(read, name=name)
            runs[load][name].append(take(load, folder=folder / str(number), on_sent=on_sent))
            done += load.seconds
    return [row for load in loads for row in recording(load, runs[load])]


def record(load: Load, folder: Path, on_sent: OnSent) -> Run:
    """Send to the recorder; return what came of it."""
    parameters = {'path': str(folder / 'bag')}
    recorder = ProcessSpec('recorder', 'humanopts_teach.ros.recorder', parameters)
    sent = _send(load, recorder, folder, on_sent)
    try:
        bag = open_bag(folder / 'bag')
        streams = [stream for stream in count_loss(bag) if stream.topic in _TOPICS]
        waited = max(recorded.message.lag for recorded in bag.messages([_STATUS]))
    except BagError as error:
        raise LaunchError(f'the recording cannot be read: {error}') from error
    taken = sum(stream.received + stream.duplicates for stream in streams)
    lost = sent['sent'] - sum(stream.received for stream in streams)
    return Run(taken=taken, lost=lost, waited=waited, **sent)


def read(load: Load, name: str, folder: Path, on_sent: OnSent) -> Run:
    """Send to a reader that writes nothing; return what came of it."""
    results = folder / 'taken.json'
    reader = bench_spec('bench_reader', results=str(results), polled=name == YARDSTICK)
    sent = _send(load, reader, folder, on_sent)
    # A reader that is stopped, or was killed because it did not end, leaves no results.
    found = json.loads(results.read_text('utf-8')) if results.exists() else {'taken': 0}
    lost = sent['sent'] - found['taken']
    return Run(**{'waited': 0.0, **found}, lost=lost, **sent)


def _send(load: Load, reader: ProcessSpec, folder: Path, on_sent: OnSent) -> dict[str, Any]:
    """Send to a reader; return the fields of ``Run`` that do not depend on what it took."""
    looks: list[Usage] = []
    with launched([reader], folder) as launcher:
        pid = launcher.pid(reader.name)

        def watch() -> None:
            looks.append(usage_of(pid))
            on_sent(min(1.0, (looks[-1].time - looks[0].time) / load.seconds))
            launcher.check()

        with closing(_Sender(launcher, load, reader.name)) as sender:
            began = processor_time(pid)
            number, size, seconds = sender.send(watch)
            used = processor_time(pid) - began
            if not sender.all_received(0.0):
                stop(launcher)  # it takes what is left while the sender can still send it
    first, middle, last = looks[0], looks[len(looks) // 2], looks[-1]
    return {
        'sent': number,
        'bytes': size,
        'seconds': seconds,
        'processor': (last.cpu - first.cpu) / (last.time - first.time),
        'memory': last.peak,
        'grown': last.memory - middle.memory,
        'processor_seconds': used,
    }


class _Sender(Client):
    """
    Sends the messages of a game to one reader.

    As fast as it can, it sends on one topic what was serialized before, so that the reader is what
    limits the rate, and the time ends when the reader's middleware has everything. At a steady
    rate it sends on three, as a game does whose states are also displayed.
    """

    def __init__(self, launcher: Launcher, load: Load, reader: str) -> None:
        super().__init__(launcher, 'bench_sender')
        self._load, self._reader = load, reader
        topics = list(KINDS) if load.rate else list(KINDS)[:1]
        self._to = [self.node.create_publisher(KINDS[topic], topic, STREAM) for topic in topics]
        self.until(lambda: all(map(self._is_read, self._to)), reader)

    def _is_read(self, publisher: Any) -> bool:
        readers = self.node.get_subscriptions_info_by_topic(publisher.topic_name)
        known = any(reader.node_name == self._reader for reader in readers)
        return known and publisher.get_subscription_count() > 0

    def send(self, watch: Callable[[], object]) -> tuple[int, int, float]:
        """
        Send everything, or what the reader lets through in time, and wait until it has arrived.

        At a steady rate that wait does not count: the middleware asks for the last answer only
        every few seconds.

        :param watch: called at begin and end, and now and then between.
        :return: messages, bytes, and seconds.
        """
        load, sent, size = self._load, 0, 0
        prepared = [] if load.rate else [self._message(number) for number in range(load.messages)]
        watch()
        began = watched = time.monotonic()
        end, over = began + load.longest, False
        while sent < load.messages and not over:
            elapsed = time.monotonic() - began
            due = min(int(elapsed * load.rate) if load.rate else sent + _AT_ONCE, load.messages)
            while sent < due and not over:
                message = prepared[sent] if prepared else self._message(sent)
                if self._publish(sent, message):
                    size += len(message)
                    sent += 1
                over = time.monotonic() > end
            if time.monotonic() - watched > _LOOK_PERIOD:
                watch()
                watched = time.monotonic()
            if load.rate:
                time.sleep(_PERIOD)
        seconds = time.monotonic() - began
        deadline = time.monotonic() + _PATIENCE
        while not self.all_received(_LOOK_PERIOD) and time.monotonic() < deadline:
            watch()
        if not load.rate:
            seconds = time.monotonic() - began
        watch()
        return sent, size, seconds

    def all_received(self, seconds: float) -> bool:
        """Return whether the reader's middleware has everything, after a wait for each topic."""
        wait = Duration(seconds=seconds)
        return all(publisher.wait_for_all_acked(wait) for publisher in self._to)

    def _publish(self, number: int, message: bytes) -> bool:
        """Publish; False: the reader holds the writer back, which has waited for 0.1 s."""
        try:
            self._to[number % len(self._to)].publish(message)
        except rclpy_implementation.RCLError:
            return False
        return True

    def _message(self, number: int) -> bytes:
        """Return a message for the topic whose turn it is, numbered among those of the topic."""
        turn, place = divmod(number, len(self._to))
        kind, sender = list(KINDS.values())[place], f'{NAMESPACE}/bench_sender#00000000'
        message = kind(publisher_id=sender, sequence=turn + 1, episode=1, step=turn)
        message.header.stamp = self.node.get_clock().now().to_msg()
        _fill(message)
        return bytes(serialize_message(message))


def _fill(message: Any) -> None:
    """Fill in the values of a game of Taxi."""
    if isinstance(message, ActionCommand):
        message.source = ActionCommand.SOURCE_MACHINE
        message.action, message.option_name = 'north', 'go to passenger and pickup'
        return
    message.state, message.features = 'taxi 2,3 passenger R destination B', [0] * 10
    message.previous_action, message.action_source = 'north', GameState.SOURCE_MACHINE
    message.action_publisher_id, message.action_sequence = message.publisher_id, message.sequence
    message.reward = -1.0


def recording(load: Load, runs: Mapping[str, Sequence[Run]]) -> list[Row]:
    """Return the results of all readers for one load, beside the yardstick."""
    each = {  # the time of each message of each turn, (T, 2)
        name: np.array([[run.seconds, run.processor_seconds] for run in found])
        / np.array([[max(run.sent, 1)] for run in found])
        for name, found in runs.items()
    }
    usual, usual_processor = np.median(each[YARDSTICK], axis=0).tolist()
    rows = []
    for name, found in runs.items():
        sent, taken, lost = (sum(getattr(run, of) for run in found) for of in COUNTED)
        seconds, processor_seconds = np.median(each[name], axis=0).tolist()
        rows.append(
            {
                'load': load.name,
                'what': name,
                'turns': len(found),
                'sent': sent,  # over all turns, as the next two
                'taken': taken,
                'lost': lost,
                'message_bytes': sum(run.bytes for run in found) / max(sent, 1),
                'seconds': seconds,  # for each message, the median of the turns
                'processor_seconds': processor_seconds,  # of the reader, as ``seconds``
                'yardstick': YARDSTICK,
                'yardstick_seconds': usual,
                'yardstick_processor_seconds': usual_processor,
                'target': load.rate or None,  # a second; None: as many as are taken
                'processor': statistics.median(run.processor for run in found),
                'memory': max(run.memory for run in found),
                'grown': max(run.grown for run in found),
                'waited': max(run.waited for run in found),
                'per_second': 1.0 / seconds,
                'ratio': seconds / usual,
                **ratios(each[name], each[YARDSTICK]),
                'throughput': usual / seconds,  # share of the yardstick's messages a second
                'remark': _remark(load, load.messages * len(found), sent, lost),
            }
        )
    return rows


def _remark(load: Load, wanted: int, sent: int, lost: int) -> str:
    """Return in words what a reader did not get or lost; empty: it took everything."""
    remarks = []
    if sent < wanted:
        text = f'{sent:,} of {wanted:,} messages could be sent to it in {load.longest:g} s a turn'
        remarks.append(f'was too slow: {text}')
    if lost:
        remarks.append(f'lost {lost:,} of the {sent:,} messages that were sent to it')
    return '; '.join(remarks)
