"""Goes through a damaged MCAP file record by record, keeping all that is whole."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
import struct
from typing import BinaryIO

from humanopts_teach.bags.blocks import (
    attached,
    Block,
    block_data,
    DAMAGE,
    describe,
    FileIndex,
    HEAD,
    split,
)
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Schema
from mcap.stream_reader import MAGIC_SIZE

ProgressCallback = Callable[[int], object]  # how far the file is read
_HEADS = 1 << 16  # bytes that hold the names of an attached file
_LOOSE_BYTES = 1 << 20  # records outside chunks are read in runs of about this size
_LOOSE = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX}
_OPCODES = {int(opcode) for opcode in Opcode}
_WINDOW = 1 << 20  # bytes searched at a time for where records go on
_ZSTD = b'\4\0\0\0zstd'  # how a chunk's head names its compression
_ZSTD_AT = HEAD + 28  # where, from the beginning of the chunk
_DATA_AT = _ZSTD_AT + len(_ZSTD) + 8
_MESSAGE = struct.Struct('<HIQ')  # how a message begins: channel, sequence, log time


def scan(path: Path, stream: BinaryIO, on_byte: ProgressCallback) -> FileIndex:
    """Index a file that has no index of its own; what is damaged is noted and left out."""
    index = FileIndex(path)
    run = Run(index, stream)
    closed = False
    for opcode, offset, length in _walk(stream, index):
        on_byte(offset)
        if opcode in _LOOSE and not closed:
            run.extend(offset, length)
            continue
        run.finish()
        closed = closed or opcode == Opcode.DATA_END
        try:
            _take(index, stream, opcode, offset, length)
        except DAMAGE as error:
            index.note(f'the record at byte {offset} is damaged ({error}) and left out')
    run.finish()
    if not closed and not index.damage:
        index.note('it was not closed: it ends without an index')
    _note_unknown(index)
    return index


class Run:
    """Records outside chunks that follow one another."""

    def __init__(self, index: FileIndex, stream: BinaryIO) -> None:
        self._index, self._stream = index, stream
        self._start = self._end = 0

    def extend(self, offset: int, length: int) -> None:
        """Take in the next record."""
        if self._end - self._start >= _LOOSE_BYTES or offset != self._end:
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
                block = Block(start, end - start, 0, 0, frozenset(), loose=True)
                _add_block(self._index, self._stream, block)
            except DAMAGE as error:
                self._index.note(f'the records from byte {start} are damaged ({error})')


def _walk(stream: BinaryIO, index: FileIndex) -> Iterator[tuple[int, int, int]]:
    """
    Yield (opcode, offset, length with head) of every whole record after the magic.

    Where there is none, go on at the next chunk; where chunks are over, that is the end.
    """
    size = index.path.stat().st_size
    offset = MAGIC_SIZE
    closed = False
    while offset < size:
        opcode, length = _record(stream, offset, size)
        if length:
            yield opcode, offset, length
            closed = closed or opcode == Opcode.DATA_END
            if opcode == Opcode.FOOTER:
                return
        else:
            found, length = _next_chunk(stream, offset, size)
            if found == size and closed:
                return
            if found == size:
                index.note(f'it is cut short in the record at byte {offset} of {size}')
                _save_leading(index, stream, offset, size)
                return
            if found == offset:
                index.note(f'the head of the chunk at byte {offset} is damaged; it is read')
            else:
                index.note(f'{found - offset} bytes from byte {offset} on are no whole record')
            offset = found
            yield Opcode.CHUNK, offset, length
        offset += length


def _record(stream: BinaryIO, offset: int, size: int) -> tuple[int, int]:
    """Return opcode and length of the record at an offset; length 0: there is no whole one."""
    stream.seek(offset)
    head = stream.read(HEAD)
    if len(head) < HEAD or head[0] not in _OPCODES:
        return 0, 0
    end: int = offset + HEAD + struct.unpack('<Q', head[1:])[0]
    if end > size:
        return 0, 0
    stream.seek(end)
    after = stream.read(1)
    fits = head[0] == Opcode.FOOTER or not after or after[0] in _OPCODES
    return head[0], end - offset if fits else 0


def _next_chunk(stream: BinaryIO, offset: int, size: int) -> tuple[int, int]:
    """Return offset and length of the first whole zstd chunk from an offset on; size: none."""
    place = offset
    while place < size:
        stream.seek(place)
        window = stream.read(_WINDOW + len(_ZSTD) - 1)
        at = window.find(_ZSTD)
        while at >= 0:
            start = place + at - _ZSTD_AT
            length = _chunk_length(stream, start, size) if start >= offset else 0
            if length:
                return start, length
            at = window.find(_ZSTD, at + 1)
        place += _WINDOW
    return size, 0


def _chunk_length(stream: BinaryIO, start: int, size: int) -> int:
    """Return the length of a zstd chunk, told by its inner length; 0: there is no whole one."""
    stream.seek(start)
    head = stream.read(_DATA_AT)
    if len(head) < _DATA_AT:
        return 0
    (outer,), (inner,) = struct.unpack('<Q', head[1:HEAD]), struct.unpack('<Q', head[-8:])
    likely = head[0] == Opcode.CHUNK or outer + HEAD == _DATA_AT + inner
    return _DATA_AT + inner if likely and start + _DATA_AT + inner <= size else 0


def _save_leading(index: FileIndex, stream: BinaryIO, offset: int, size: int) -> None:
    """Keep the messages at the beginning of a chunk that was cut short, where there are any."""
    stream.seek(offset)
    if stream.read(1) == bytes([Opcode.CHUNK]):
        try:
            kept = _add_block(
                index, stream, Block(offset, size - offset, 0, 0, frozenset(), cut=True)
            )
        except DAMAGE:
            return
        if kept:
            index.note(f'{kept} messages of the chunk that was cut short are kept')


def _take(index: FileIndex, stream: BinaryIO, opcode: int, offset: int, length: int) -> None:
    """Index one record that is not loose, or is in the summary at the end."""
    if opcode == Opcode.CHUNK:
        _add_block(index, stream, Block(offset, length, 0, 0, frozenset()))
    elif opcode == Opcode.ATTACHMENT:
        stream.seek(offset + HEAD)
        name, place = attached(offset, stream.read(min(length - HEAD, _HEADS)))
        if place.size > length:
            raise ValueError('it is larger than its record')
        index.attachments[name] = place
    elif opcode in (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL):
        stream.seek(offset + HEAD)
        _add_if_new(index, describe(opcode, stream.read(length - HEAD)))


def _add_if_new(index: FileIndex, record: McapRecord | None) -> None:
    """Take what the summary repeats only where the chunk that told it first is damaged."""
    known = (isinstance(record, Schema) and record.id in index.schemas) or (
        isinstance(record, Channel) and record.id in index.channels
    )
    if record is not None and not known:
        index.add(record)


def _add_block(index: FileIndex, stream: BinaryIO, block: Block) -> int:
    """Read a block for what it describes, keep it if it holds messages; return how many."""
    data = block_data(stream, block)
    described, times, counts = [], [], Counter[int]()
    for opcode, start, end in split(data):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time = _MESSAGE.unpack_from(data, start)
            times.append(log_time)
            counts[channel] += 1
        elif (record := describe(opcode, data[start:end])) is not None:
            described.append(record)
    for record in described:
        index.add(record)
    if times:
        index.counts.update(counts)
        channels = index.group(frozenset(counts))
        index.blocks.append(replace(block, start=min(times), end=max(times), channels=channels))
    return len(times)


def _note_unknown(index: FileIndex) -> None:
    """Say which messages cannot be read, since what described them is damaged."""
    unknown = sum(
        count
        for channel, count in index.counts.items()
        if channel not in index.channels or index.channels[channel].schema_id not in index.schemas
    )
    if unknown:
        index.note(f'{unknown} messages are left out: the record of their topic is damaged')
