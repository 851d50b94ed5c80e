"""The node ``recorder``: records the graph in a bag."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import islice
import json
import math
from mimetypes import guess_type
import os
from pathlib import Path
import sys
import time
from typing import Any

from humanopts_interfaces.msg import NodeStatus, RecorderStatus, StreamLoss
from humanopts_ros.guarded_node import StartError
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.peers import announced_ids, GameIdentity, node_names
from humanopts_ros.process import run_node
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import LATCHED
from humanopts_ros.recording import MAX_BYTES, own_name, SHARED
from humanopts_ros.text_files import fault_in, FileError, read_bytes
from humanopts_teach.bags import BagWriteError, SchemaError
from humanopts_teach.bags.provenance import attachments, software
from humanopts_teach.bags.sequence_numbers import is_stamped, LossCounter, read_stamp
from humanopts_teach.bags.writer import (
    BagWriter,
    GAME,
    GAME_IDS,
    Limits,
    NAMESPACE,
    next_part,
    parts,
)
from humanopts_teach.launching import OUTLASTING
from humanopts_teach.launching.usage import usage_of
from humanopts_teach.ros.raw_subscriber import RawSubscriber, Taken, TopicSubscription
from pydantic import TypeAdapter, ValidationError
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.executors import Executor
from rclpy.serialization import deserialize_message

_NS = 10**9
_MAX_ATTACHED = 2**31  # maximum size of an attached file, bytes
_PERIOD, _IDLE_PERIOD = 0.02, 0.1  # s between takes under load, and otherwise
_SILENT_PERIOD = 0.25  # s until the next take after one without messages
_MANY = 10  # number of messages in a take that counts as load
_DISCOVERY_PERIOD = 0.05  # s between discoveries until all publishers are matched
_MATCHED_PERIOD = 0.25  # s between discoveries after that
_COUNT_PERIOD = 1.0  # s between counts of the publishers of known topics
_FLUSH_PERIOD = 0.25  # s; maximum loss if the recorder is killed
_STATUS_PERIOD = 1.0  # s between statuses that differ only in their counts
_QUIET = 0.1  # s without a message before a recording ends
_LINGER = 2.0  # s, maximum wait for that
MAX_WAIT = 0.5  # s; the recorder has fallen behind if a message waits longer
_MAX_MISSING = 2**64 - 1  # maximum count in a status
_MAX_LOSSES = 100  # maximum number of streams in a status
_MAX_TEXT = 2000  # maximum number of characters in a status
_HELD = 0.5  # s to hold a log message until its node is discovered
_MAX_SHARED = 10_000  # maximum number of held messages
_RECOVERY = 1.0  # s without delayed messages until the recorder has caught up
_FACTS = TypeAdapter(dict[str, Any])
_BEHIND = (
    f'the recorder does not keep up: messages wait for it longer than {MAX_WAIT} s; '
    'end other programs, or leave topics out'
)


@dataclass
class Lag:
    """The delay of messages before recording; times are in seconds, from a monotonic clock."""

    _longest: float = 0.0  # longest delay since the last report
    _late: float = -math.inf  # time of the last take with an excessive delay
    _taken: float = math.inf  # time of the last take

    def add(self, now: float, waited: float) -> None:
        """
        Register a take of all messages that have arrived.

        A suspended process cannot observe arrivals, so an excessive pause between two takes counts
        as a delay.

        :param waited: time since the first message arrived; 0: no messages.
        """
        pause = now - self._taken
        self._taken = now
        waited = max(waited, pause if pause > MAX_WAIT else 0.0)
        self._longest = max(self._longest, waited)
        if waited > MAX_WAIT:
            self._late = now

    def behind(self, now: float) -> bool:
        """Return whether messages are delayed too long."""
        return now - self._late < _RECOVERY

    def take_longest(self) -> float:
        """Return the longest delay since the last report, and reset it."""
        longest, self._longest = self._longest, 0.0
        return longest


class Recorder(NodeBase):
    """
    Records the graph of its namespace, including service events and actions, and selected topics.

    On topics shared by all nodes (log, parameter events), it records only messages of this graph.

    If the bag can no longer be written, the recorder reports this on ``recorder_status`` and
    continues to take messages, so that publishers are not blocked.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('recorder', **options)
        self._bag = self._begin()
        attach = self.setting('attach', [''], 'files and folders to attach to the bag at its end')
        self._attached = [Path(path) for path in attach if path]
        others = self.setting(
            'outlasts', [''], 'nodes of the namespace that end before the recorder'
        )
        self._outlasts = {self.full_name(name) for name in others if name}
        self._subscriber = RawSubscriber(self, self.selection)
        self._losses = LossCounter()
        self._lag = Lag()
        self._numbered: dict[str, bool] = {}  # recorded topics: whether messages are numbered
        self._latched: set[str] = set()  # recorded topics of current values
        self._shared: deque[tuple[float, Taken]] = deque()  # held messages, with start times, s
        self._game = GameIdentity(self)
        self._games: list[str] = []  # publisher ids of the game, one per start
        self._complete = False  # all publishers were matched at the last two checks
        self._stopped = ''  # reason why the recording has stopped; empty: it has not
        self._text = self.selection.missing_for_evaluation
        if self._text:
            self.get_logger().warning(self._text)
        self._discover_at = self._flush_at = self._count_at = 0.0  # s, due times
        self._topics: list[tuple[str, list[str]]] = []  # at the last count
        self._unflushed = False  # whether a new topic may not be on disk yet
        self._behind = False
        self._published: tuple[object, ...] = ()  # significant part of the last status
        self._published_at = 0.0
        self._publisher = self.stamped_publisher(RecorderStatus, 'recorder_status', LATCHED)
        self._timer = self.create_timer(_PERIOD, self._on_timer)

    def waits_for(self) -> str | None:
        """Wait until all publishers are matched."""
        return self._stopped or (None if self._complete else 'the publishers on the graph')

    def on_ready(self) -> None:
        """Log the path of the bag."""
        self.get_logger().info(f'records to {self._bag.path}')

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Run callbacks until ``stop`` returns True and the nodes to outlast are gone."""
        super().serve(executor, stop)
        end = time.monotonic() + OUTLASTING
        while self._outlasts.intersection(node_names(self)) and time.monotonic() < end:
            self.turn(executor, _DISCOVERY_PERIOD)

    def close(self) -> None:
        """Record the last messages and close the bag; set ``failed`` if this fails."""
        before = self._stopped
        end = time.monotonic() + _LINGER
        quiet = time.monotonic() + _QUIET
        while time.monotonic() < min(quiet, end):
            if batch := self._subscriber.take():
                quiet = time.monotonic() + _QUIET
            self._record(batch)
            time.sleep(_PERIOD)
        self._record([], held=0.0)
        self._attempt(self._attach)
        self._attempt(self._bag.close)
        self.failed = self._stopped != before  # a status would not reach readers any more

    def _begin(self) -> BagWriter:
        """
        Create the bag.

        :raises StartError: the bag cannot be created, or a parameter is invalid.
        """
        path = self.setting('path', '', 'directory of the bag; must not exist')
        resume = self.setting('resume', False, 'if path exists, write to path-2, path-3, ...')
        facts = self.setting('metadata', '{}', 'JSON object of facts to keep in the bag')
        limits = Limits(
            self.setting('max_bytes', 0, 'size of a file; 0: any', (0, MAX_BYTES)),
            self.setting('max_seconds', 0.0, 'time in a file; 0: any', (0.0, 1e9)),
        )
        if not path:
            raise StartError('parameter path: name the directory of the bag')
        try:
            bag, before = Path(path), parts(Path(path)) if resume else []
            selection = self.selection
            known = {
                **_facts(facts),
                **software(),
                NAMESPACE: selection.namespace,
                'record_topics': json.dumps(selection.record),
                'record_exclude': json.dumps(selection.exclude),
            }
            if before:
                bag, known['continues'] = next_part(bag), before[-1].name
            return BagWriter(bag, known, limits=limits)
        except BagWriteError as error:
            raise StartError(str(error)) from error

    def _attach(self) -> None:
        """Attach files to the bag."""
        for name, path in attachments(self._attached):
            try:
                data, changed = read_bytes(path, _MAX_ATTACHED), path.stat().st_mtime_ns
            except (OSError, FileError) as error:
                self.get_logger().warning(f'{path} is not kept in the bag: {error}')
                continue
            kind = guess_type(name)[0] or 'application/octet-stream'
            self._bag.attach(name, data, kind, (changed, self._subscriber.times.now))

    def _on_timer(self) -> None:
        """Record received messages; run discovery and flush the bag when due."""
        batch, now = self._subscriber.take(), time.monotonic()
        waited = (self._subscriber.times.now - batch[0].received) / _NS if batch else 0.0
        self._lag.add(now, waited)
        self._record(batch)
        if now >= self._discover_at:
            self._discover()
            self._discover_at = now + (_MATCHED_PERIOD if self._complete else _DISCOVERY_PERIOD)
        # Flush a new topic with its first messages, so that the bag is readable even if the
        # recorder is killed soon.
        if now >= self._flush_at or (batch and self._unflushed):
            self._flush_at, self._unflushed = now + _FLUSH_PERIOD, False
            self._attempt(self._bag.flush)
        idle = _IDLE_PERIOD if batch else _SILENT_PERIOD
        idle = idle if self._complete else _DISCOVERY_PERIOD
        period = int((_PERIOD if len(batch) > _MANY else idle) * _NS)
        if period != self._timer.timer_period_ns:
            self._timer.timer_period_ns = period

    def _discover(self) -> None:
        """Subscribe to new topics on the graph; count all publishers less often."""
        now, topics = time.monotonic(), self.get_topic_names_and_types()
        if self._complete and topics == self._topics and now < self._count_at:
            self._publish_status()
            return
        self._topics, self._count_at = topics, now + _COUNT_PERIOD
        before = self._subscriber.complete
        added = self._subscriber.discover()
        self._complete = before and self._subscriber.complete  # also matched by the publishers
        self._unflushed |= bool(added)
        for subscription in added:
            self._attempt(partial(self._add_topic, subscription))
        self._find_game()
        self._publish_status()

    def _find_game(self) -> None:
        """Record in the bag which publisher is the game, by the same rule as other nodes."""
        for publisher_id in announced_ids(self, 'game'):
            if publisher_id not in self._games and self._game.accepts(publisher_id):
                self._games.append(publisher_id)
                ids = {GAME_IDS: json.dumps(self._games)}
                self._attempt(partial(self._bag.note, GAME, ids))

    def _add_topic(self, added: TopicSubscription) -> None:
        """Add a topic to the bag if its type is installed."""
        try:
            schema = self._bag.add_topic(added.topic, added.type, added.offers, added.type_hash)
        except SchemaError as error:
            self._text = str(error)
        else:
            self._numbered[added.topic] = is_stamped(schema)
            if added.latched:
                self._latched.add(added.topic)

    def _record(self, batch: list[Taken], held: float = _HELD) -> None:
        """
        Record messages; on topics shared by all nodes, only those from nodes of this graph.

        :param held: time in s to hold messages of shared topics until their nodes are discovered.
        """
        due, now = list[Taken](), time.monotonic()
        for taken in batch:
            if taken.topic not in SHARED or self.selection.adds(taken.topic):
                due.append(taken)
            elif len(self._shared) < _MAX_SHARED:
                self._shared.append((now, taken))
        while self._shared and now - self._shared[0][0] >= held:
            _, taken = self._shared.popleft()
            if _sender(taken) in self._subscriber.own_nodes:
                due.append(taken)
        self._write(due)

    def _write(self, batch: list[Taken]) -> None:
        """Write messages and count missing ones."""
        for taken in batch:
            if taken.topic not in self._numbered:  # its type is not installed
                continue
            stamp = read_stamp(taken.data) if self._numbered[taken.topic] else None
            if stamp is not None:
                own = bool(own_name(taken.topic, self.selection.namespace))
                latched = taken.topic in self._latched
                self._losses.add(taken.topic, stamp, latched=latched, own=own)
            if not self._stopped:
                try:
                    self._bag.write(taken.topic, taken.data, taken.received, taken.sent)
                except BagWriteError as error:
                    self._stop(error)

    def _attempt(self, write: Callable[[], object]) -> None:
        """Write to the bag unless the recording has stopped; stop the recording on failure."""
        if not self._stopped:
            try:
                write()
            except BagWriteError as error:
                self._stop(error)

    def _stop(self, error: BagWriteError) -> None:
        """Stop the recording and report the reason."""
        if not self._stopped:
            self._stopped = f'recording stopped: {error}'
            self.get_logger().error(self._stopped)
            self._publish_status()
            self.set_status(NodeStatus.STATE_PAUSED, self._stopped)

    def _publish_status(self) -> None:
        """Publish the recording's state at every significant change and once per second."""
        now = time.monotonic()
        if (behind := self._lag.behind(now)) != self._behind:
            self._behind = behind
            log = self.get_logger()
            if behind:
                log.warning(_BEHIND)
            else:
                log.info('the recorder keeps up again')
        text = self._stopped or (_BEHIND if self._behind else self._remark())
        state = (self._complete, self._behind, text, self._losses.missing)
        if state == self._published and now - self._published_at < _STATUS_PERIOD:
            return
        self._published, self._published_at = state, now
        try:
            self._publisher.publish(self._status_message(text))
        except PublishError as error:
            self.get_logger().error(str(error))

    def _remark(self) -> str:
        """Describe what is not recorded; empty: everything is recorded."""
        if self._complete and not self._numbered:
            return 'the patterns leave no topic to record'
        unknown = self._subscriber.unknown.items()
        types = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(unknown))
        return self._text or (types and f'types not installed here: {types}')

    def _status_message(self, text: str) -> RecorderStatus:
        used = usage_of(os.getpid())
        return RecorderStatus(
            path=str(self._bag.path),
            files=self._bag.n_files,
            topics=len(self._bag.topics),
            messages=self._bag.extent.messages,
            bytes=self._bag.bytes_written,
            complete=self._complete,
            missing=min(self._losses.missing, _MAX_MISSING),  # senders choose the numbers
            losses=[
                StreamLoss(
                    topic=stream.topic,
                    sender=shown(stream.publisher),
                    sent=stream.sent,
                    missing=stream.missing,
                )
                for stream in islice((s for s in self._losses if s.missing), _MAX_LOSSES)
            ],
            lag=self._lag.take_longest(),
            behind=self._behind,
            cpu_seconds=used.cpu,
            memory=used.peak,
            stopped=bool(self._stopped),
            text=shown(text, _MAX_TEXT),
        )


def _sender(taken: Taken) -> str:
    """Return the full name of the node that sent a log message or parameter event."""
    try:
        if taken.topic == '/rosout':
            return '/' + str(deserialize_message(taken.data, Log).name).replace('.', '/')
        return str(deserialize_message(taken.data, ParameterEvent).node)
    except (RuntimeError, ValueError, MemoryError):  # not a valid message
        return ''


def _facts(text: str) -> dict[str, str]:
    """
    Parse the metadata facts.

    :raises StartError: the text is not a JSON object.
    """
    try:
        values = _FACTS.validate_json(text)
    except ValidationError as error:
        raise StartError(f'parameter metadata is not a JSON object: {fault_in(error)}') from None
    return {k: v if isinstance(v, str) else json.dumps(v) for k, v in values.items()}


main = partial(run_node, Recorder)

if __name__ == '__main__':
    sys.exit(main())
