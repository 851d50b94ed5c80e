"""What is missing from a recording, counted by the sequence numbers in the messages."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

from humanopts_teach.bags.stamps import Stamp

MOST_GAPS = 10_000


@dataclass
class Stream:
    """
    The messages of one publisher on one topic.

    Numbers begin at 1, so what was sent before the first that was received is missing too. What
    was sent after the last cannot be known. The last ``MOST_GAPS`` gaps are kept: a message that
    fills an older one counts as a repetition, so that never too few are said to be missing.
    """

    first: int = 0  # smallest number received; 0: none yet
    last: int = 0  # largest number received
    received: int = 0  # repetitions left out
    duplicates: int = 0
    late: int = 0  # received after a larger number
    _gaps: list[tuple[int, int]] = field(default_factory=list)  # first and last missing, ascending

    def add(self, sequence: int) -> None:
        """Count one message."""
        if sequence > self.last:
            if sequence > self.last + 1:
                self._gaps.append((self.last + 1, sequence - 1))
                if len(self._gaps) > 2 * MOST_GAPS:
                    del self._gaps[:MOST_GAPS]
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
        """Number of messages that were sent and not received."""
        return self.last - self.received

    def _fill(self, sequence: int) -> bool:
        """Take a late message out of its gap; False: it was received before."""
        at = bisect_right(self._gaps, (sequence, self.last)) - 1
        if at < 0 or self._gaps[at][1] < sequence:
            return False
        low, high = self._gaps[at]
        parts = [(low, sequence - 1), (sequence + 1, high)]
        self._gaps[at : at + 1] = [part for part in parts if part[0] <= part[1]]
        return True


class Ledger:
    """Streams by topic and publisher."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, str], Stream] = {}
        self.missing = 0  # over all streams

    def add(self, topic: str, stamp: Stamp) -> None:
        """Count one message."""
        stream = self._streams.setdefault((topic, stamp.publisher_id), Stream())
        before = stream.missing
        stream.add(stamp.sequence)
        self.missing += stream.missing - before

    def __iter__(self) -> Iterator[tuple[str, str, Stream]]:
        """Yield (topic, publisher, stream), sorted."""
        return iter((*key, self._streams[key]) for key in sorted(self._streams))
