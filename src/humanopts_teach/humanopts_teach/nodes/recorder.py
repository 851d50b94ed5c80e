"""The node ``recorder``: writes everything on the graph to a bag."""

import json
from pathlib import Path
import sys
import time

from humanopts_env.nodes.node_base import NodeBase, PublishError, run_node, StartError
from humanopts_env.nodes.qos import LATCHED
from humanopts_interfaces.msg import NodeStatus, RecorderStatus
from humanopts_teach.bags.errors import BagWriteError, SchemaError
from humanopts_teach.bags.loss import Ledger
from humanopts_teach.bags.stamps import is_stamped, read_stamp
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.nodes.intake import Intake, Taken

_NS = 10**9
_BUSY_PERIOD = 4 * 10**6  # ns between takes while messages come
_IDLE_PERIOD = 20 * 10**6  # ns between takes while none come
_LOOK_PERIOD = 0.05  # s between looks at the graph while it is not all matched
_CALM_LOOKS = 4  # looks that are left out while it is
_FLUSH_PERIOD = 0.25  # s; what a killed recorder loses at most
_COUNT_PERIOD = 1.0  # s between statuses that differ only in their counts
_QUIET = 0.1  # s without a message that end a recording
_LINGER = 2.0  # s at most to wait for that


class Recorder(NodeBase):
    """
    Records every topic of its namespace, service events and actions included.

    Where the bag cannot be written any more it says so on ``recorder_status`` and goes on taking
    messages, so that no publisher is held back.
    """

    def __init__(self) -> None:
        super().__init__('recorder')
        path = str(self.setting('path', '', 'directory of the bag; must not exist'))
        facts = self.setting('metadata', '{}', 'JSON object of facts to keep in the bag')
        self._bag = _begin(path, str(facts))
        self._intake = Intake(self)
        self._ledger = Ledger()
        self._counted: dict[str, bool] = {}  # recorded topics: whether messages are numbered
        self._matched = False  # at the last look
        self._complete = False  # at the last two
        self._stopped = self._text = ''
        self._calm = 0
        self._new = False  # whether a topic came of which nothing may be on disk yet
        self._said: tuple[object, ...] = ()
        self._said_at = 0.0
        self._recorder_status = self.stamped_publisher(RecorderStatus, 'recorder_status', LATCHED)
        self._take_timer = self.create_timer(_BUSY_PERIOD / _NS, self._take)
        self.create_timer(_LOOK_PERIOD, self._look)
        self.create_timer(_FLUSH_PERIOD, self._flush)

    def waits_for(self) -> str | None:
        """Wait until every publisher is matched."""
        return None if self._complete else 'the publishers on the graph'

    def close(self) -> None:
        """Take what is still on its way, and close the bag."""
        end = time.monotonic() + _LINGER
        quiet = time.monotonic() + _QUIET
        while time.monotonic() < min(quiet, end):
            if self._record(self._intake.take()):
                quiet = time.monotonic() + _QUIET
            time.sleep(_BUSY_PERIOD / _NS)
        try:
            self._bag.close()
        except BagWriteError as error:
            self._stop(error)

    def _look(self) -> None:
        """Follow the graph; less often while nothing changes."""
        self._calm = (self._calm + 1) % _CALM_LOOKS if self._complete else 0
        if self._calm == 0:
            found = self._intake.discover()
            self._complete = found.complete and self._matched  # the other side has matched, too
            self._matched = found.complete
            self._new = self._new or bool(found.added)
            for tap in found.added:
                try:
                    schema = self._bag.add_topic(tap.topic, tap.type, tap.offers, tap.type_hash)
                except SchemaError as error:
                    self._text = str(error)
                    continue
                self._counted[tap.topic] = is_stamped(schema)
        self._say()

    def _take(self) -> None:
        """Record what has arrived, and come again sooner where there was something."""
        busy = self._record(self._intake.take())
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
        """Publish how the recording stands, where that has changed."""
        unknown = ', '.join(f'{t} ({kind})' for t, kind in sorted(self._intake.unknown.items()))
        text = self._stopped or self._text or (unknown and f'types not installed here: {unknown}')
        now = time.monotonic()
        state = (self._complete, self._stopped, text, self._ledger.missing)
        if state == self._said and now - self._said_at < _COUNT_PERIOD:
            return
        self._said, self._said_at = state, now
        status = RecorderStatus(
            path=str(self._bag.path),
            topics=len(self._bag.topics),
            messages=self._bag.extent.messages,
            bytes=self._bag.bytes_written,
            complete=self._complete,
            missing=self._ledger.missing,
            stopped=bool(self._stopped),
            text=text,
        )
        try:
            self._recorder_status.publish(status)
        except PublishError as error:
            self.get_logger().error(str(error))


def _begin(path: str, facts: str) -> BagWriter:
    """
    Begin the bag.

    :raises StartError: it cannot be begun there, or the facts are not a JSON object.
    """
    if not path:
        raise StartError('parameter path: name the directory of the bag')
    try:
        values = json.loads(facts)
    except json.JSONDecodeError as error:
        raise StartError(f'parameter metadata is not JSON: {error}') from None
    if not isinstance(values, dict):
        raise StartError(f'parameter metadata is not a JSON object: {facts}')
    texts = {str(k): v if isinstance(v, str) else json.dumps(v) for k, v in values.items()}
    try:
        return BagWriter(Path(path), texts)
    except BagWriteError as error:
        raise StartError(str(error)) from error


def main() -> int:
    """Run the recorder."""
    return run_node(Recorder)


if __name__ == '__main__':
    sys.exit(main())
