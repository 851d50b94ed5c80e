"""The node ``recorder``: writes everything on the graph to a bag."""

import json
from mimetypes import guess_type
from pathlib import Path
import sys
import time

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.process import run_node
from humanopts_ros.recording import MOST_BYTES, Selection
from humanopts_teach.bags.errors import BagWriteError, SchemaError
from humanopts_teach.bags.pace import Pace
from humanopts_teach.bags.provenance import attachments, software
from humanopts_teach.bags.sequence_numbers import is_stamped, Ledger, read_stamp
from humanopts_teach.bags.writer import BagWriter, Limits
from humanopts_teach.ros.raw_subscriber import RawSubscriber, Taken, TopicSubscription
from humanopts_teach.ros.recording_status import RecordingStatus
from rcl_interfaces.msg import FloatingPointRange, IntegerRange

_NS = 10**9
_BUSY_PERIOD = 4 * 10**6  # ns between takes while messages come
_IDLE_PERIOD = 20 * 10**6  # ns between takes while none come
_LOOK_PERIOD = 0.05  # s between looks at the graph while it is not all matched
_CALM_LOOKS = 4  # looks that are left out while it is
_FLUSH_PERIOD = 0.25  # s; what a killed recorder loses at most
_QUIET = 0.1  # s without a message that end a recording
_LINGER = 2.0  # s at most to wait for that


class Recorder(NodeBase):
    """
    Records the topics of its namespace, service events and actions included, or some of them.

    Where the bag cannot be written any more it says so on ``recorder_status`` and goes on taking
    messages, so that no publisher is held back.
    """

    def __init__(self) -> None:
        super().__init__('recorder')
        self._bag = self._begin()
        attach = self.setting('attach', [''], 'files and folders to keep in the bag at its end')
        self._attached = [Path(path) for path in attach if path]
        self._intake = RawSubscriber(self, self.selection)
        self._ledger = Ledger()
        self._pace = Pace()
        self._counted: dict[str, bool] = {}  # recorded topics: whether messages are numbered
        self._matched = False  # at the last look
        self._complete = False  # at the last two
        self._stopped = ''
        self._text = self.selection.unevaluable
        if self._text:
            self.get_logger().warning(self._text)
        self._calm = 0
        self._new = False  # whether a topic came of which nothing may be on disk yet
        self._standing = RecordingStatus(self, self._bag, self._ledger, self._pace)
        self._take_timer = self.create_timer(_BUSY_PERIOD / _NS, self._take)
        self.create_timer(_LOOK_PERIOD, self._look)
        self.create_timer(_FLUSH_PERIOD, self._flush)

    def waits_for(self) -> str | None:
        """Wait until every publisher is matched."""
        return self._stopped or (None if self._complete else 'the publishers on the graph')

    def close(self) -> None:
        """Take what is still on its way, and close the bag; fail where that stops it only now."""
        told = self._stopped
        end = time.monotonic() + _LINGER
        quiet = time.monotonic() + _QUIET
        while time.monotonic() < min(quiet, end):
            if self._record(self._intake.take()):
                quiet = time.monotonic() + _QUIET
            time.sleep(_BUSY_PERIOD / _NS)
        for finish in (self._attach, self._bag.close):
            try:
                finish()
            except BagWriteError as error:
                self._stop(error)
        self.failed = self._stopped != told  # nobody who heard of it is left

    def _begin(self) -> BagWriter:
        """
        Begin the bag.

        :raises StartError: it cannot be begun there, or a parameter cannot be used.
        """
        path = str(self.setting('path', '', 'directory of the bag; must not exist'))
        facts = str(self.setting('metadata', '{}', 'JSON object of facts to keep in the bag'))
        most = IntegerRange(from_value=0, to_value=MOST_BYTES, step=1)
        longest = FloatingPointRange(from_value=0.0, to_value=1e9)
        limits = Limits(
            self.setting('max_bytes', 0, 'size of a file; 0: any', integer_range=[most]),
            self.setting(
                'max_seconds', 0.0, 'time in a file; 0: any', floating_point_range=[longest]
            ),
        )
        if not path:
            raise StartError('parameter path: name the directory of the bag')
        try:
            told = {**_facts(facts), **software(), **_selected(self.selection)}
            return BagWriter(Path(path), told, limits=limits)
        except BagWriteError as error:
            raise StartError(str(error)) from error

    def _attach(self) -> None:
        """
        Keep files in the bag as they now are.

        :raises BagWriteError: the disk is full.
        """
        for name, path in attachments(self._attached):
            try:
                data, changed = path.read_bytes(), path.stat().st_mtime_ns
            except OSError as error:
                self.get_logger().warning(f'{path} is not kept in the bag: {error.strerror}')
                continue
            kind = guess_type(name)[0] or 'application/octet-stream'
            self._bag.attach(name, data, kind, (changed, time.time_ns()))

    def _look(self) -> None:
        """Follow the graph; less often while nothing changes."""
        self._calm = (self._calm + 1) % _CALM_LOOKS if self._complete else 0
        if self._calm == 0:
            found = self._intake.discover()
            self._complete = found.complete and self._matched  # the other side has matched, too
            self._matched = found.complete
            self._new = self._new or bool(found.added)
            for tap in found.added:
                self._announce(tap)
        self._say()

    def _announce(self, tap: TopicSubscription) -> None:
        """Add a topic to the bag."""
        if self._stopped:
            return
        try:
            schema = self._bag.add_topic(tap.topic, tap.type, tap.offers, tap.type_hash)
        except SchemaError as error:
            self._text = str(error)
        except BagWriteError as error:
            self._stop(error)
        else:
            self._counted[tap.topic] = is_stamped(schema)

    def _take(self) -> None:
        """Record what has arrived, and come again sooner where there was something."""
        batch = self._intake.take()
        waited = (time.time_ns() - batch[0].received) / _NS if batch else 0.0
        self._pace.took(time.monotonic(), waited)
        busy = self._record(batch)
        if busy and self._new:  # so that a bag opens, however soon the end comes
            self._new = False
            self._flush()
        period = _BUSY_PERIOD if busy else _IDLE_PERIOD
        if self._take_timer.timer_period_ns != period:
            self._take_timer.timer_period_ns = period

    def _record(self, batch: list[Taken]) -> int:
        """Write messages; return how many there were."""
        for taken in batch:
            counted = self._counted.get(taken.topic)
            if counted:
                stamp = read_stamp(taken.data)
                if stamp is not None:
                    self._ledger.add(taken.topic, stamp)
            if counted is not None and not self._stopped:
                try:
                    self._bag.write(taken.topic, taken.data, taken.received, taken.sent)
                except BagWriteError as error:
                    self._stop(error)
        return len(batch)

    def _flush(self) -> None:
        if not self._stopped:
            try:
                self._bag.flush()
            except BagWriteError as error:
                self._stop(error)

    def _stop(self, error: BagWriteError) -> None:
        """Write no more, and say why."""
        if not self._stopped:
            self._stopped = f'recording stopped: {error}'
            self.get_logger().error(self._stopped)
            self._say()
            self.set_status(NodeStatus.STATE_PAUSED, self._stopped)

    def _say(self) -> None:
        """Tell how the recording stands."""
        unknown = ', '.join(f'{t} ({kind})' for t, kind in sorted(self._intake.unknown.items()))
        text = self._text or (unknown and f'types not installed here: {unknown}')
        if self._complete and not self._counted:
            text = 'the patterns leave no topic to record'
        self._standing.say(complete=self._complete, stopped=self._stopped, text=text)


def _facts(text: str) -> dict[str, str]:
    """
    Read the facts that the recorder is told.

    :raises StartError: they are not a JSON object.
    """
    try:
        values = json.loads(text)
    except json.JSONDecodeError as error:
        raise StartError(f'parameter metadata is not JSON: {error}') from None
    if not isinstance(values, dict):
        raise StartError(f'parameter metadata is not a JSON object: {text}')
    return {str(k): v if isinstance(v, str) else json.dumps(v) for k, v in values.items()}


def _selected(selection: Selection) -> dict[str, str]:
    """Return which topics are recorded, as facts."""
    return {
        'record_include': json.dumps(selection.include or ['*']),
        'record_exclude': json.dumps(selection.exclude),
    }


def main() -> int:
    """Run the recorder."""
    return run_node(Recorder)


if __name__ == '__main__':
    sys.exit(main())
