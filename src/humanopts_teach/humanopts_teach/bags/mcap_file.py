"""
Reads MCAP files with the ``mcap`` package, be they whole, cut short or damaged.

A whole file is read by its index. Where that is missing or damaged, the file is gone through once,
and every complete chunk is kept. Damage is said in words and never ends the reading.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from io import BufferedReader, BytesIO, FileIO
from os import SEEK_END
from pathlib import Path
import re
import struct
from typing import NamedTuple
import zlib

from humanopts_teach.bags.errors import BagError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.stream_reader import breakup_chunk, MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC
import zstandard

LARGEST = 1 << 28  # bytes of a chunk; one that claims more is damaged
OffsetCallback = Callable[[int], object]  # takes the offset up to which a file was read
_HEAD = struct.Struct('<BQ')  # opcode of a record, length of its content
_TIMES = struct.Struct('<QQ')  # first and last log time, at the beginning of a chunk's content
_DATA_END = struct.Struct('<BQI')  # a whole DataEnd record: opcode, length, checksum
_MESSAGE_HEAD = 22  # bytes of a message before its data
_PIECE = 1 << 20  # bytes that are read at a time where a file has no structure
_ZSTD = b'\4\0\0\0zstd'  # how a chunk names its compression ...
_ZSTD_AT = 28  # ... at this offset in its content
_OPCODES = {int(opcode) for opcode in Opcode}
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)  # that may also be outside
# What damaged bytes make the ``mcap`` package raise.
DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,  # checksums and text that is not UTF-8, too
    KeyError,
    OSError,
    MemoryError,
    OverflowError,
)


@dataclass(frozen=True, slots=True)
class Block:
    """A chunk, or a run of records outside chunks."""

    offset: int  # of the chunk's content, or of the first record
    length: int  # bytes of a run
    start: int  # earliest log time, ns
    end: int  # latest log time, ns
    channels: frozenset[int]  # ids of the channels that have messages in it
    is_chunk: bool = True


class Attached(NamedTuple):
    """Where an attached file is."""

    offset: int  # of its record
    size: int  # of the attached file, bytes
    media_type: str


@dataclass
class FileIndex:
    """What one MCAP file holds, and where."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel id
    blocks: list[Block] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attached] = field(default_factory=dict)  # by name
    damage: list[str] = field(default_factory=list)  # what is wrong with the file, in words
    library: str = ''  # that wrote the file; empty: not known

    def note(self, damage: str) -> None:
        """Keep what is wrong with the file."""
        self.damage.append(f'{self.path.name}: {damage}')


class McapStream(BufferedReader):
    """A file that reads as many bytes as it is asked for, or raises ``EndOfFile``."""

    def __init__(self, path: Path) -> None:
        super().__init__(FileIO(path))
        self.size = path.stat().st_size
        self.limit = LARGEST  # bytes that are read at once

    def read(self, size: int | None = -1, /) -> bytes:
        """
        Read bytes; a length that damage made huge takes no memory.

        :raises EndOfFile: there are fewer.
        """
        wanted = -1 if size is None else size
        if wanted > min(self.size, self.limit):
            raise EndOfFile(f'a length of {wanted} bytes is damaged')
        data = super().read(wanted)
        if len(data) < wanted:
            raise EndOfFile('it is cut short')
        return data


def read_index(path: Path, on_offset: OffsetCallback = lambda _: None) -> FileIndex:
    """
    Find the messages of a file.

    :param on_offset: is called while a file without an index is gone through.
    :raises BagError: the file cannot be read, is empty, or is not an MCAP file.
    """
    try:
        with McapStream(path) as stream:
            if stream.size == 0:
                raise BagError(f'{path} is empty')
            if stream.peek(MAGIC_SIZE)[:MAGIC_SIZE] != MCAP0_MAGIC:
                raise BagError(f'{path} is not an MCAP file: it was written by another program')
            index = _find_messages(path, stream, on_offset)
            try:
                stream.seek(0)
                index.library = SeekingReader(stream).get_header().library
            except DAMAGE:
                pass
            return index
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


def data_fits(path: Path, on_offset: OffsetCallback = lambda _: None) -> bool:
    """Compare all bytes of a whole file with their checksum; True: they fit, or it has none."""
    with McapStream(path) as stream:
        try:
            left = _read_footer(stream).summary_start - _DATA_END.size
            stream.seek(left)
            opcode, _, checksum = _DATA_END.unpack(stream.read(_DATA_END.size))
        except DAMAGE:
            return True  # what is wrong with the end of the file is said by ``read_index``
        if opcode != Opcode.DATA_END:
            return False
        stream.seek(0)
        found = 0
        while checksum and left > 0:
            found = zlib.crc32(stream.read(min(left, _PIECE)), found)
            left -= _PIECE
            on_offset(stream.tell())
        return bool(found == checksum)


def read_attachment(index: FileIndex, name: str) -> Attachment:
    """
    Return an attached file with its times.

    :raises BagError: there is none of this name, or it is damaged.
    """
    if name not in index.attachments:
        raise BagError(f'{index.path} has no attachment {name!r}')
    with McapStream(index.path) as stream:
        try:
            stream.seek(index.attachments[name].offset)
            _, length = _HEAD.unpack(stream.read(_HEAD.size))
            stream.limit = stream.size
            content = stream.read(length)
            checksum = int.from_bytes(content[-4:], 'little')
            if checksum and zlib.crc32(content[:-4]) != checksum:  # the package does not compare
                raise ValueError('it does not fit its checksum')
            attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
            return attachment
        except DAMAGE as error:
            raise BagError(f'attachment {name} of {index.path} is damaged: {error}') from error


def _find_messages(path: Path, stream: McapStream, on_offset: OffsetCallback) -> FileIndex:
    """Use the index of a file, or do without it."""
    try:
        return _read_summary(path, stream) or _scan(path, stream, on_offset)
    except DAMAGE as error:
        index = _scan(path, stream, on_offset)
        if not index.damage:
            index.note(f'its index is damaged ({error}); everything else that was found is whole')
        return index


def _read_summary(path: Path, stream: McapStream) -> FileIndex | None:
    """
    Read the index at the end of a file; None: it lacks one, or what some programs leave out.

    :raises Exception: one of ``DAMAGE``, where it is damaged or the file has no end.
    """
    footer = _read_footer(stream)
    if footer.summary_start == 0:
        return None
    _check_summary(stream, footer)
    stream.seek(0)
    reader = SeekingReader(stream)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    index = FileIndex(path, summary.schemas, summary.channels)
    index.counts.update(summary.statistics.channel_message_counts)
    described = all(_is_described(index, channel) for channel in index.counts)
    if not index.counts or not summary.chunk_indexes or not described:
        return None
    groups: dict[frozenset[int], frozenset[int]] = {}  # one object for all blocks that have it
    for chunk in summary.chunk_indexes:
        _check_place(stream, chunk)
        channels = frozenset(chunk.message_index_offsets or index.channels)
        index.blocks.append(
            Block(
                chunk.chunk_start_offset + _HEAD.size,
                chunk.chunk_length - _HEAD.size,
                chunk.message_start_time,
                chunk.message_end_time,
                groups.setdefault(channels, channels),
            )
        )
    index.metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    if list(index.metadata) != list(dict.fromkeys(at.name for at in summary.metadata_indexes)):
        raise ValueError('it names other metadata records')
    for at in summary.attachment_indexes:
        index.attachments[at.name] = Attached(at.offset, at.data_size, at.media_type)
    return index


def _read_footer(stream: McapStream) -> Footer:
    """
    Return the last record of a file.

    :raises Exception: one of ``DAMAGE``, where the file has no end.
    """
    stream.seek(-FOOTER_SIZE - MAGIC_SIZE, SEEK_END)
    opcode, _ = _HEAD.unpack(stream.read(_HEAD.size))
    footer: Footer = Footer.read(ReadDataStream(stream))
    if opcode != Opcode.FOOTER or stream.read(MAGIC_SIZE) != MCAP0_MAGIC:
        raise ValueError('the file has no end')
    return footer


def _check_summary(stream: McapStream, footer: Footer) -> None:
    """
    Compare the index with its place and its checksum, which the ``mcap`` package does not.

    :raises Exception: one of ``DAMAGE``, where they do not fit.
    """
    stream.seek(footer.summary_start - _DATA_END.size)
    if stream.read(1)[0] != Opcode.DATA_END:
        raise ValueError('it is not where the end of the file says')
    stream.seek(footer.summary_start)
    stream.limit = stream.size
    content = stream.read(stream.size - MAGIC_SIZE - footer.summary_start)
    stream.limit = LARGEST
    if footer.summary_crc and zlib.crc32(content[:-4]) != footer.summary_crc:
        raise ValueError('it does not fit its checksum')


def _check_place(stream: McapStream, chunk: ChunkIndex) -> None:
    """
    Compare the beginning of a chunk with what the index says of it.

    :raises Exception: one of ``DAMAGE``, where something else is there.
    """
    stream.seek(chunk.chunk_start_offset)
    head = _HEAD.unpack(stream.read(_HEAD.size))
    times = _TIMES.unpack(stream.read(_TIMES.size))
    indexed = (chunk.message_start_time, chunk.message_end_time)
    if head != (Opcode.CHUNK, chunk.chunk_length - _HEAD.size) or times != indexed:
        raise ValueError(f'there is another chunk at byte {chunk.chunk_start_offset}')


def read_block(stream: McapStream, block: Block) -> list[McapRecord]:
    """
    Return the records of a block.

    :raises Exception: one of ``DAMAGE``, where they are damaged.
    """
    stream.seek(block.offset)
    if block.is_chunk:
        return _unpack(Chunk.read(ReadDataStream(stream)))
    return _unpack(_as_chunk(stream.read(block.length)))


def _as_chunk(records: bytes) -> Chunk:
    """Return records outside chunks as a chunk that is not compressed and has no checksum."""
    return Chunk('', records, 0, 0, uncompressed_crc=0, uncompressed_size=len(records))


def _unpack(chunk: Chunk) -> list[McapRecord]:
    """
    Return the records of a chunk.

    :raises Exception: one of ``DAMAGE``, where it is damaged, or claims to be huge.
    """
    sizes = [chunk.uncompressed_size]
    if chunk.compression == 'zstd':
        sizes.append(zstandard.frame_content_size(chunk.data))
    if max(sizes) > LARGEST:
        raise ValueError(f'a chunk claims {max(sizes)} bytes')
    return breakup_chunk(chunk, validate_crc=True)


def _scan(path: Path, stream: McapStream, on_offset: OffsetCallback) -> FileIndex:
    """Go through a file that has no index; what is damaged is noted and left out."""
    index = FileIndex(path)
    closed = False
    run, run_end = 0, 0  # records outside chunks that follow one another
    for opcode, start, end in _whole_records(stream, index):
        on_offset(start)
        if opcode in _IN_CHUNKS and not closed:
            if start != run_end or run_end - run >= _PIECE:
                _add_run(index, stream, run, run_end)
                run = start
            run_end = end
            continue
        closed = closed or opcode == Opcode.DATA_END
        try:
            _add_record(index, stream, opcode, start, end)
        except DAMAGE as error:
            index.note(f'the record at byte {start} is damaged ({error}) and left out')
    _add_run(index, stream, run, run_end)
    if not closed and not index.damage:
        index.note('it was not closed: it ends without an index')
    counts = index.counts.items()
    unknown = sum(count for channel, count in counts if not _is_described(index, channel))
    if unknown:
        index.note(f'{unknown} messages are left out: the record of their topic is damaged')
    return index


def _whole_records(stream: McapStream, index: FileIndex) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and end of every whole record; where there is none, find a chunk."""
    at, closed = MAGIC_SIZE, False
    while at < stream.size:
        opcode, end = _record_at(stream, at)
        if opcode == 0:
            found, end = _next_chunk(stream, at)
            if end == 0:
                if not closed:
                    index.note(f'it is cut short in the record at byte {at} of {stream.size}')
                return
            if found == at:
                index.note(f'the head of the chunk at byte {at} is damaged; it is read')
            else:
                index.note(f'{found - at} bytes from byte {at} on are no whole record')
            opcode, at = int(Opcode.CHUNK), found
        yield opcode, at, end
        if opcode == Opcode.FOOTER:
            return
        closed = closed or opcode == Opcode.DATA_END
        at = end


def _record_at(stream: McapStream, at: int) -> tuple[int, int]:
    """Return opcode and end of the record at an offset; (0, 0): there is no whole one."""
    try:
        stream.seek(at)
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        end = at + _HEAD.size + length
        if opcode not in _OPCODES or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD):
            return 0, 0
        if end == stream.size or opcode == Opcode.FOOTER:
            return opcode, end
        stream.seek(end)
        return (opcode, end) if stream.read(1)[0] in _OPCODES else (0, 0)
    except DAMAGE:
        return 0, 0


def _next_chunk(stream: McapStream, at: int) -> tuple[int, int]:
    """Return offset and end of the first readable zstd chunk from an offset on; end 0: none."""
    for place in range(at, stream.size, _PIECE):
        stream.seek(place)
        window = stream.read(min(_PIECE + len(_ZSTD) - 1, stream.size - place))
        for match in re.finditer(re.escape(_ZSTD), window):
            start = place + match.start() - _ZSTD_AT - _HEAD.size
            if start >= at:
                try:
                    stream.seek(start + _HEAD.size)
                    _unpack(Chunk.read(ReadDataStream(stream)))
                except DAMAGE:
                    continue
                return start, stream.tell()
    return 0, 0


def _add_record(index: FileIndex, stream: McapStream, opcode: int, start: int, end: int) -> None:
    """
    Take in a record that is not in a run.

    :raises Exception: one of ``DAMAGE``, where it is damaged.
    """
    stream.seek(start + _HEAD.size)
    stream.limit = LARGEST if opcode == Opcode.CHUNK else max(LARGEST, end - start)
    data = ReadDataStream(stream)
    if opcode == Opcode.CHUNK:
        block = Block(start + _HEAD.size, end - start - _HEAD.size, 0, 0, frozenset())
        _add_block(index, stream, block)
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(data)
        size = len(attachment.data)
        index.attachments[attachment.name] = Attached(start, size, attachment.media_type)
    elif opcode == Opcode.METADATA:
        record = Metadata.read(data)
        index.metadata[record.name] = record.metadata
    elif opcode == Opcode.SCHEMA:  # of the index: needed only where the first one is damaged
        schema = Schema.read(data)
        index.schemas.setdefault(schema.id, schema)
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(data)
        index.channels.setdefault(channel.id, channel)


def _add_run(index: FileIndex, stream: McapStream, start: int, end: int) -> None:
    """Take in records outside chunks, where there are any."""
    if end > start:
        try:
            _add_block(index, stream, Block(start, end - start, 0, 0, frozenset(), is_chunk=False))
        except DAMAGE as error:
            index.note(f'the records from byte {start} are damaged ({error})')


def _add_block(index: FileIndex, stream: McapStream, block: Block) -> None:
    """
    Keep what a block describes, and the block where it holds messages.

    :raises Exception: one of ``DAMAGE``, where it is damaged; nothing is kept then.
    """
    times, counts = [], Counter[int]()
    for record in read_block(stream, block):
        if isinstance(record, Message):
            times.append(record.log_time)
            counts[record.channel_id] += 1
        elif isinstance(record, Schema):
            index.schemas[record.id] = record
        elif isinstance(record, Channel):
            index.channels[record.id] = record
    if times:
        index.counts.update(counts)
        found = replace(block, start=min(times), end=max(times), channels=frozenset(counts))
        index.blocks.append(found)


def _is_described(index: FileIndex, channel_id: int) -> bool:
    """Tell whether topic and type of a channel's messages are known."""
    channel = index.channels.get(channel_id)
    return channel is not None and channel.schema_id in {0, *index.schemas}
