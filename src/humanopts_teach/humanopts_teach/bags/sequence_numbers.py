"""Message loss, measured by the publisher id and sequence number of humanopts messages."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
import struct
from typing import NamedTuple

from humanopts_teach.bags.schemas import field_lines

_FIELDS = [
    ('std_msgs/Header', 'header'),
    ('string', 'publisher_id'),
    ('uint64', 'sequence'),
    ('uint32', 'episode'),
    ('uint32', 'step'),
]
_ORIGIN = 4  # CDR alignment starts after the encapsulation header
_FRAME_ID = _ORIGIN + 8  # after header.stamp


class Stamp(NamedTuple):
    """The publisher of a message and its sequence number on the topic."""

    publisher_id: str
    sequence: int  # 1, 2, 3, ...
    episode: int = 0  # 0: no episode, or not read
    step: int = 0  # step of the episode


def is_stamped(schema: str) -> bool:
    """Return whether messages of a schema begin with header, publisher_id and sequence."""
    return field_lines(schema)[:3] == _FIELDS[:3]


def has_step(schema: str) -> bool:
    """Return whether episode and step follow the stamp."""
    return field_lines(schema)[:5] == _FIELDS


def read_stamp(data: bytes, *, with_step: bool = False) -> Stamp | None:
    """
    Return the stamp of a CDR message of a stamped type; None if damaged.

    :param with_step: also read episode and step, if ``has_step`` is True for the type.
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
MAX_STREAMS = 10_000  # limits memory, since publisher ids may be forged
_COUNTS = ('topic', 'publisher', 'sent', 'recorded', 'missing', 'replaced', 'repeated', 'late')


@dataclass
class Stream:
    """
    The messages of one publisher on one topic.

    Numbers start at 1; messages before the first recorded one count as missing, except in other
    graphs, which may have started earlier. Messages after the last recorded one are unknown. Only
    the last ``MAX_GAPS`` gaps are kept. A message that fills an older gap counts as repeated, so
    the number of missing messages is never underestimated.
    """

    topic: str = ''
    publisher: str = ''
    latched: bool = False  # the topic is latched: newer values can replace unsent ones
    own: bool = True  # whether it is in the recorded graph
    first: int = 0  # smallest recorded number; 0: none yet
    sent: int = 0  # largest recorded number
    recorded: int = 0  # excluding repetitions
    repeated: int = 0
    late: int = 0  # recorded after a larger number
    _gaps: list[tuple[int, int]] = field(default_factory=list)  # first and last number, ascending

    def add(self, sequence: int) -> None:
        """Count one message."""
        if sequence > self.sent:
            if sequence > self.sent + 1:
                self._gaps.append((self.sent + 1, sequence - 1))
                if len(self._gaps) > 2 * MAX_GAPS:
                    del self._gaps[:MAX_GAPS]
            self.sent = sequence
        else:
            at = bisect_right(self._gaps, (sequence, self.sent)) - 1
            if at < 0 or self._gaps[at][1] < sequence:
                self.repeated += 1
                return
            self.late += 1
            low, high = self._gaps[at]
            parts = [(low, sequence - 1), (sequence + 1, high)]
            self._gaps[at : at + 1] = [part for part in parts if part[0] <= part[1]]
        self.recorded += 1
        self.first = min(self.first or sequence, sequence)

    @property
    def missing(self) -> int:
        """The number of lost messages."""
        before = 0 if self.own else max(0, self.first - 1)
        return 0 if self.latched else self.sent - before - self.recorded

    @property
    def replaced(self) -> int:
        """The number of current values replaced by newer ones before reception."""
        return self.sent - self.recorded if self.latched else 0

    def to_dict(self) -> dict[str, str | int]:
        """Return the counts as JSON data."""
        return {name: getattr(self, name) for name in _COUNTS}


class LossCounter:
    """Streams by topic and publisher, up to ``MAX_STREAMS``; further publishers are ignored."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, str], Stream] = {}

    def add(self, topic: str, stamp: Stamp, *, latched: bool = False, own: bool = True) -> None:
        """
        Count one message.

        :param latched: whether the topic is latched. As for ``own``, only the value given with the
            first message is used.
        :param own: whether the topic belongs to the recorded graph.
        """
        key = topic, stamp.publisher_id
        if key not in self._streams and len(self._streams) < MAX_STREAMS:
            self._streams[key] = Stream(*key, latched, own)
        if key in self._streams:
            self._streams[key].add(stamp.sequence)

    @property
    def missing(self) -> int:
        """The total number of lost messages."""
        return sum(stream.missing for stream in self._streams.values())

    def __iter__(self) -> Iterator[Stream]:
        """Yield the streams, sorted by topic and publisher."""
        return (self._streams[key] for key in sorted(self._streams))
