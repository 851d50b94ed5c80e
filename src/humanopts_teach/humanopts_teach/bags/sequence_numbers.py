"""Loss, counted by the publisher and sequence number that begin every humanopts message."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
import struct
from typing import NamedTuple, TYPE_CHECKING

from humanopts_ros.recording import own_name
from humanopts_teach.bags.rosbag2 import Extent
from humanopts_teach.bags.schemas import field_lines
from humanopts_teach.bags.writer import NAMESPACE

if TYPE_CHECKING:  # the recorder does not read
    from humanopts_teach.bags.reader import Bag, Recorded

_FIELDS = [
    ('std_msgs/Header', 'header'),
    ('string', 'publisher_id'),
    ('uint64', 'sequence'),
]
_STEP_FIELDS = [('uint32', 'episode'), ('uint32', 'step')]
_ORIGIN = 4  # CDR aligns from after the encapsulation header
_FRAME_ID = _ORIGIN + 8  # after header.stamp


class Stamp(NamedTuple):
    """The publisher of a message, and its number among the publisher's messages on a topic."""

    publisher_id: str
    sequence: int  # 1, 2, 3, ...
    episode: int = 0  # 0: none, or not read
    step: int = 0  # of the episode


def is_stamped(schema: str) -> bool:
    """Return whether messages of a schema begin with header, publisher_id and sequence."""
    return field_lines(schema)[:3] == _FIELDS


def has_step(schema: str) -> bool:
    """Return whether episode and step follow the stamp."""
    return field_lines(schema)[:5] == [*_FIELDS, *_STEP_FIELDS]


def read_stamp(data: bytes, *, with_step: bool = False) -> Stamp | None:
    """
    Return the stamp of a CDR message whose type ``is_stamped``; None: it is damaged.

    :param with_step: read episode and step too, of a message whose type ``has_step``.
    """
    try:
        order = '<' if data[1] & 1 else '>'
        (length,) = struct.unpack_from(order + 'I', data, _FRAME_ID)
        start = _align(_FRAME_ID + 4 + length, 4)
        (length,) = struct.unpack_from(order + 'I', data, start)
        end = start + 4 + length
        numbers = struct.unpack_from(order + ('QII' if with_step else 'Q'), data, _align(end, 8))
        return Stamp(data[start + 4 : end - 1].decode(), *numbers)
    except (struct.error, IndexError, UnicodeDecodeError):
        return None


def _align(offset: int, size: int) -> int:
    return offset + (_ORIGIN - offset) % size


MAX_GAPS = 10_000
MAX_STREAMS = 10_000  # that are counted separately: publishers may be made up


@dataclass
class Stream:
    """
    The messages of one publisher on one topic.

    Numbers begin at 1, so messages sent before the first that was received count as missing, too;
    not so of another graph, which may have begun before the recording.
    Messages sent after the last cannot be known. The last ``MAX_GAPS`` gaps are kept: a message
    that fills an older gap counts as a repetition, so the number missing is never too low.
    """

    topic: str = ''
    publisher: str = ''
    first: int = 0  # smallest number received; 0: none yet
    last: int = 0  # largest number received
    received: int = 0  # without repetitions
    duplicates: int = 0
    late: int = 0  # received after a larger number
    latched: bool = False  # current values, of which a newer one may replace one that is not sent
    own: bool = True  # of the graph that is recorded
    _gaps: list[tuple[int, int]] = field(default_factory=list)  # first and last number, ascending

    def add(self, sequence: int) -> None:
        """Count one message."""
        if sequence > self.last:
            if sequence > self.last + 1:
                self._gaps.append((self.last + 1, sequence - 1))
                if len(self._gaps) > 2 * MAX_GAPS:
                    del self._gaps[:MAX_GAPS]
            self.last = sequence
        elif self._fill(sequence):
            self.late += 1
        else:
            self.duplicates += 1
            return
        self.received += 1
        self.first = min(self.first or sequence, sequence)

    @property
    def missing(self) -> int:
        """Number of messages that were sent and lost."""
        before = 0 if self.own else max(0, self.first - 1)
        return 0 if self.latched else self.last - before - self.received

    @property
    def replaced(self) -> int:
        """Number of current values that newer ones replaced before they were received."""
        return self.last - self.received if self.latched else 0

    def to_dict(self) -> dict[str, str | int]:
        """Return the counts as JSON data."""
        return {
            'topic': self.topic,
            'publisher': self.publisher,
            'sent': self.last,  # up to the last message that was recorded
            'recorded': self.received,
            'missing': self.missing,
            'replaced': self.replaced,
            'repeated': self.duplicates,
            'late': self.late,
        }

    def _fill(self, sequence: int) -> bool:
        """Remove a late message from its gap; False: it was received before."""
        at = bisect_right(self._gaps, (sequence, self.last)) - 1
        if at < 0 or self._gaps[at][1] < sequence:
            return False
        low, high = self._gaps[at]
        parts = [(low, sequence - 1), (sequence + 1, high)]
        self._gaps[at : at + 1] = [part for part in parts if part[0] <= part[1]]
        return True


class LossCounter:
    """Streams by topic and publisher; publishers beyond the first ``MAX_STREAMS`` have none."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, str], Stream] = {}

    def add(self, topic: str, stamp: Stamp, *, latched: bool = False, own: bool = True) -> None:
        """
        Count one message; the first one of a stream decides what it is.

        :param latched: the topic has current values.
        :param own: it belongs to the graph that is recorded.
        """
        key = (topic, stamp.publisher_id)
        if key not in self._streams:
            if len(self._streams) == MAX_STREAMS:
                return
            self._streams[key] = Stream(*key, latched=latched, own=own)
        self._streams[key].add(stamp.sequence)

    @property
    def missing(self) -> int:
        """Number of messages that were sent and lost."""
        return sum(stream.missing for stream in self._streams.values())

    def __iter__(self) -> Iterator[Stream]:
        """Yield the streams, sorted by topic and publisher."""
        return iter(self._streams[key] for key in sorted(self._streams))


class MessageCounter:
    """Counts the messages of a bag: by topic, by time, and by their publishers' numbers."""

    def __init__(self, bag: 'Bag') -> None:
        self.counts: Counter[str] = Counter()  # by topic
        self.extent = Extent()
        self.losses = LossCounter()
        self.stamped = {t.name for t in bag.topics.values() if is_stamped(t.schema)}
        self._latched = {t.name for t in bag.topics.values() if t.latched}
        namespace = bag.facts.get(NAMESPACE)  # None: it is of another program
        self._own = {t for t in bag.topics if namespace is None or own_name(t, namespace)}
        self._bag = bag

    def loss(self, topic: str) -> tuple[int, ...]:
        """Return a topic's number of publishers and of lost messages; (): they are not known."""
        missing = [stream.missing for stream in self.losses if stream.topic == topic]
        return (len(missing), sum(missing)) if topic in self.stamped else ()

    def add(self, recorded: 'Recorded') -> bool:
        """Count a message; False: it does not decode, which ``Bag.damage`` then says."""
        self.counts[recorded.topic] += 1
        self.extent.add(recorded.log_time)
        if recorded.topic in self.stamped:
            stamp = read_stamp(recorded.data)
            if stamp is None:
                self._bag.note(f'a message on {recorded.topic} does not decode')
                return False
            if not self._bag.is_strange(recorded):  # whose numbers may be made up
                topic, latched = recorded.topic, recorded.topic in self._latched
                self.losses.add(topic, stamp, latched=latched, own=topic in self._own)
        return True
