"""Goes through a damaged MCAP file record by record, keeping all that is whole."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO

from humanopts_teach.bags.blocks import Block, DAMAGE, FileIndex, HEAD, read_block
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Message, Metadata
from mcap.stream_reader import MAGIC_SIZE

_LOOSE_BYTES = 1 << 20  # records outside chunks are read in runs of about this size
_LOOSE = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX}


def scan(path: Path, stream: BinaryIO) -> FileIndex:
    """Index a file that has no index of its own; what is damaged is noted and left out."""
    index = FileIndex(path)
    run = Run(index, stream)
    for opcode, offset, length in _walk(stream, index):
        if opcode in _LOOSE:
            run.extend(offset, length)
            continue
        run.finish()
        if opcode == Opcode.DATA_END:
            return index
        try:
            _take(index, stream, opcode, offset, length)
        except DAMAGE as error:
            index.note(f'the record at byte {offset} is damaged ({error}) and left out')
    run.finish()
    if not index.damage:
        index.note('it was not closed: it ends without an index')
    return index


class Run:
    """Records outside chunks that follow one another."""

    def __init__(self, index: FileIndex, stream: BinaryIO) -> None:
        self._index, self._stream = index, stream
        self._start = self._end = 0

    def extend(self, offset: int, length: int) -> None:
        """Take in the next record."""
        if self._end - self._start >= _LOOSE_BYTES:
            self.finish()
        if self._start == self._end:
            self._start = offset
        self._end = offset + length

    def finish(self) -> None:
        """Make a block of the run."""
        start, end = self._start, self._end
        self._start = self._end
        if end > start:
            try:
                _add_block(self._index, self._stream, start, end - start, loose=True)
            except DAMAGE as error:
                self._index.note(f'the records from byte {start} are damaged ({error})')


def _walk(stream: BinaryIO, index: FileIndex) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, offset, length with head) of every whole record after the magic."""
    size = index.path.stat().st_size
    offset = MAGIC_SIZE
    while offset < size:
        stream.seek(offset)
        head = stream.read(HEAD)
        length = HEAD + (struct.unpack('<Q', head[1:])[0] if len(head) == HEAD else 0)
        if len(head) < HEAD or offset + length > size:
            index.note(f'it is cut short in the record at byte {offset} of {size}')
            return
        yield head[0], offset, length
        offset += length


def _take(index: FileIndex, stream: BinaryIO, opcode: int, offset: int, length: int) -> None:
    """Index one record that is not loose."""
    if opcode == Opcode.CHUNK:
        _add_block(index, stream, offset, length, loose=False)
    elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
        stream.seek(offset + HEAD)
        content = ReadDataStream(BytesIO(stream.read(length - HEAD)))
        if opcode == Opcode.METADATA:
            index.add(Metadata.read(content))
        else:
            index.attachments[Attachment.read(content).name] = offset


def _add_block(
    index: FileIndex, stream: BinaryIO, offset: int, length: int, *, loose: bool
) -> None:
    """Read a block for what it describes, and keep where it is if it holds messages."""
    records = read_block(stream, Block(offset, length, 0, frozenset(), loose))
    for record in records:
        index.add(record)
    messages = [record for record in records if isinstance(record, Message)]
    if messages:
        index.counts.update(message.channel_id for message in messages)
        start = min(message.log_time for message in messages)
        channels = frozenset(message.channel_id for message in messages)
        index.blocks.append(Block(offset, length, start, channels, loose))
