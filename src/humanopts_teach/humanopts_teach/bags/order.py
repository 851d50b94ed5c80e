"""Reads the messages of several files in order of time, in bounded memory."""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from humanopts_teach.bags.blocks import Block, DAMAGE, FileIndex, read_messages, Stored

MOST_WAITING = 64 << 20  # bytes of messages that are put in order of time at once
ALWAYS = (0, 2**64)  # log times
_EACH = 300  # bytes that a message takes in memory apart from its data
OnRead = Callable[[int, int], object]  # bytes that a pass over a bag is through, of how many


def silent(done: int, total: int) -> None:
    """Tell nobody."""


class Passage:
    """How far a pass over several files is."""

    def __init__(self, files: Sequence[Path]) -> None:
        sizes = [file.stat().st_size if file.exists() else 0 for file in files]
        self._before = [sum(sizes[:number]) for number in range(len(sizes))]
        self._total = sum(sizes)

    def tell(self, on_read: OnRead, number: int, offset: int) -> None:
        """Say that a file is read up to an offset."""
        on_read(self._before[number] + offset, self._total)


@dataclass(frozen=True)
class Pass:
    """
    One pass over some messages of some files.

    :ivar wanted: ids of the channels that are read, of each file.
    :ivar between: first and last log time, ns.
    :ivar on_block: told the number of the file and the offset of each block that is read.
    :ivar note: told what is damaged.
    """

    files: Sequence[FileIndex]
    wanted: Sequence[frozenset[int]]
    between: tuple[int, int]
    on_block: Callable[[int, int], object]
    note: Callable[[str], object]

    def messages(self) -> Iterator[Stored]:
        """Yield messages by time; where blocks overlap in time, those of several are held."""
        blocks = self._blocks()
        waiting: list[Stored] = []
        with ExitStack() as stack:
            streams = [stack.enter_context(file.path.open('rb')) for file in self.files]
            for (_, number, offset, block), after in zip(blocks, [*blocks[1:], None]):
                self.on_block(number, offset)
                waiting += self._read(streams[number], number, block)
                waiting.sort()
                due = len(waiting) if after is None else bisect_left(waiting, after[:3])
                if _size(waiting[due:]) > MOST_WAITING:
                    self.note('its messages are so far out of order that they come as they are')
                    due = len(waiting)
                yield from waiting[:due]
                del waiting[:due]

    def _blocks(self) -> list[tuple[int, int, int, Block]]:
        """Return time, file, offset and block of what is read, sorted."""
        first, last = self.between
        found = (
            (block.start, number, block.offset, block)
            for number, file in enumerate(self.files)
            for block in file.blocks
            if block.start <= last
            and block.end >= first
            and not block.channels.isdisjoint(self.wanted[number])
        )
        return sorted(found, key=lambda each: each[:3])

    def _read(self, stream: BinaryIO, number: int, block: Block) -> list[Stored]:
        """Return the messages that are asked for in a block; none where it is damaged."""
        try:
            found = read_messages(stream, block, self.wanted[number], number)
        except DAMAGE as error:
            name = self.files[number].path.name
            self.note(f'{name}: the chunk at byte {block.offset} is damaged and left out: {error}')
            return []
        if self.between is ALWAYS:
            return found
        first, last = self.between
        return [message for message in found if first <= message.log_time <= last]


def _size(messages: Sequence[Stored]) -> int:
    """Return how many bytes messages take, about."""
    return sum(len(message.data) + _EACH for message in messages)
