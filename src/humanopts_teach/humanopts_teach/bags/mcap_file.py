"""
One MCAP file: its topics, chunks, attachments and metadata, as read by the ``mcap`` package.

A file is read through its index. A file without an index, as left by a killed recorder, is scanned
up to the first record that the package cannot read. Chunks with wrong checksums are skipped.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from os import SEEK_END
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from humanopts_teach.bags import BagError
from humanopts_teach.bags.rosbag2 import COMPRESSED, convert, decompress
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    Metadata,
    Schema,
)
from mcap.stream_reader import breakup_chunk, MAGIC_SIZE, StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
import zstandard

ReadCallback = Callable[[int, int], object]  # takes the amount read and the total
_SQLITE, _ROS_1 = b'SQLite format 3\0', b'#ROSBAG V'
_HEAD = 9  # bytes of a record's header: opcode and length
ALWAYS = (0, 2**64)  # first and last log time
# Exceptions that the ``mcap`` package raises for damaged bytes.
DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,  # including wrong checksums and invalid UTF-8
    KeyError,
    OSError,
    MemoryError,
    OverflowError,
)


@dataclass
class McapFile:
    """
    The contents of one MCAP file.

    :ivar growing: whether the file is being written, so that a missing end is not damage.
    :ivar summary: schemas, channels, and locations of chunks and attachments.
    :ivar counts: number of messages by channel id.
    :ivar loose: messages outside chunks, as some programs write them.
    :ivar damage: descriptions of damage.
    """

    path: Path
    growing: bool = False
    summary: Summary = field(default_factory=Summary)
    counts: Counter[int] = field(default_factory=Counter)
    loose: list[Message] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)

    def note(self, damage: str) -> None:
        """Record a description of damage."""
        self.damage.append(f'{self.path.name}: {damage}')

    def describes(self, channel_id: int) -> bool:
        """Return whether the topic and type of a channel are known."""
        channel = self.summary.channels.get(channel_id)
        return channel is not None and channel.schema_id in {0, *self.summary.schemas}

    def chunks(self, channels: Container[int], between: tuple[int, int]) -> Iterator[ChunkIndex]:
        """
        Yield the chunks that may contain messages of some channels.

        :param channels: channel ids.
        :param between: first and last log time, ns.
        """
        for chunk in self.summary.chunk_indexes:
            there = chunk.message_index_offsets or self.summary.channels
            early, late = chunk.message_start_time, chunk.message_end_time
            if early <= between[1] and late >= between[0] and any(c in channels for c in there):
                yield chunk

    def read(self, index: ChunkIndex) -> list[Message]:
        """Return the messages of a chunk; raise one of ``DAMAGE`` if the chunk is damaged."""
        with self.path.open('rb') as stream:
            stream.seek(index.chunk_start_offset)
            limit = index.chunk_length
            reader = StreamReader(
                stream, skip_magic=True, emit_chunks=True, record_size_limit=limit
            )
            chunk = next(reader.records)
        if (
            not isinstance(chunk, Chunk)
            or chunk.message_start_time != index.message_start_time
            or chunk.message_end_time != index.message_end_time
        ):
            raise ValueError('there is another record than the index says')
        inside = breakup_chunk(chunk, validate_crc=True)
        return [each for each in inside if isinstance(each, Message)]


def ignore_progress(*_: object) -> None:
    """Do nothing."""


def open_file(
    path: Path, on_read: ReadCallback = ignore_progress, *, growing: bool = False
) -> McapFile:
    """
    Open a file and read its index, or scan it.

    :param on_read: progress callback for scanning a file without an index.
    :param growing: whether the file is being written.
    :raises BagError: the file cannot be read, is empty, or is not an MCAP file.
    """
    try:
        with path.open('rb') as stream:
            head = stream.read(len(_SQLITE))
            if not head.startswith(MCAP0_MAGIC):
                raise BagError(f'{path} is {_format_of(path, head)}')
            file, problem = McapFile(path, growing), ''
            try:
                indexed = not growing and _read_summary(file, stream)
            except DAMAGE as error:
                indexed, problem = False, f'its index is damaged: {error}'
            if not indexed:
                file = McapFile(path, growing)
                if _scan(file, stream, on_read) and problem:
                    file.note(problem)
            return file
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


def _format_of(path: Path, head: bytes) -> str:
    """Describe the format of a file from its first bytes, and the way to convert it to MCAP."""
    if not head:
        return 'empty'
    for suffix, (_, magic) in COMPRESSED.items():
        if head.startswith(magic):
            return f'not an MCAP file: {decompress(path, suffix)}'
    if head.startswith(_SQLITE):
        return f'a bag in sqlite3 format; {convert(path.parent)}'
    if head.startswith(_ROS_1):
        return f'a bag of ROS 1; {convert(path)}'
    return 'not an MCAP file: it was written by another program'


def _read_summary(file: McapFile, stream: BinaryIO) -> bool:
    """
    Read the index at the end of a file, and verify its checksum, unlike the ``mcap`` package.

    :return: whether the index is complete.
    """
    stream.seek(_HEAD - FOOTER_SIZE - MAGIC_SIZE, SEEK_END)
    footer = Footer.read(ReadDataStream(stream))
    if footer.summary_start:
        stream.seek(footer.summary_start)
        content = stream.read()[: -4 - MAGIC_SIZE]
        if footer.summary_crc and zlib.crc32(content) != footer.summary_crc:
            raise ValueError('it does not match its checksum')
    stream.seek(0)
    reader = SeekingReader(stream)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return False
    file.summary = summary
    file.counts.update(summary.statistics.channel_message_counts)
    file.metadata.update((each.name, each.metadata) for each in reader.iter_metadata())
    return bool(summary.chunk_indexes and file.counts) and all(map(file.describes, file.counts))


def _scan(file: McapFile, stream: BinaryIO, on_read: ReadCallback) -> bool:
    """Scan a file without an index to its end or to damage; return whether it has an end."""
    size, at, closed = stream.seek(0, SEEK_END), MAGIC_SIZE, False
    stream.seek(0)
    reader = StreamReader(stream, emit_chunks=True, record_size_limit=size)
    try:
        for record in reader.records:
            if isinstance(record, DataEnd):  # only the damaged index follows
                closed = True
                break
            _add(file, record, at, stream.tell())
            at = stream.tell()
            on_read(at, size)
    except (EndOfFile, RecordLengthLimitExceeded, struct.error):  # truncated record
        if not file.growing:
            cut = f'is cut short in the record at byte {at} of {size}'
            file.note(f'it {cut if at < size else "was not closed: it ends without an index"}')
    except DAMAGE as error:
        file.note(f'it cannot be read from byte {at} of {size} on: {error}')
    unknown = sum(count for each, count in file.counts.items() if not file.describes(each))
    if unknown:
        file.note(f'{unknown} messages are left out: the record of their topic is damaged')
    return closed


def _add(file: McapFile, record: object, start: int, end: int) -> None:
    """Add the contents of a record located between two offsets."""
    summary = file.summary
    if isinstance(record, Schema):
        summary.schemas.setdefault(record.id, record)
    elif isinstance(record, Channel):
        summary.channels.setdefault(record.id, record)
    elif isinstance(record, Message):
        file.counts[record.channel_id] += 1
        file.loose.append(record)
    elif isinstance(record, Metadata):
        file.metadata[record.name] = record.metadata
    elif isinstance(record, Attachment):
        place = start, end - start, record.log_time, record.create_time, len(record.data)
        summary.attachment_indexes.append(AttachmentIndex(*place, record.name, record.media_type))
    elif isinstance(record, Chunk):
        try:
            inside = breakup_chunk(record, validate_crc=True)
        except DAMAGE as error:
            file.note(f'the chunk at byte {start} is damaged and left out: {error}')
            return
        for each in inside:
            if isinstance(each, Message):
                file.counts[each.channel_id] += 1
            else:
                _add(file, each, start, end)
        summary.chunk_indexes.append(
            ChunkIndex(
                chunk_length=end - start,
                chunk_start_offset=start,
                compression=record.compression,
                compressed_size=len(record.data),
                message_end_time=record.message_end_time,
                message_index_length=0,
                message_index_offsets={},  # unknown: may contain any channel
                message_start_time=record.message_start_time,
                uncompressed_size=record.uncompressed_size,
            )
        )


def check_bytes(path: Path, on_read: ReadCallback = ignore_progress) -> str:
    """Verify the checksums of a closed file; return a description of damage, or empty."""
    size = path.stat().st_size
    with path.open('rb') as stream:
        try:
            for _ in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
                on_read(stream.tell(), size)
        except DAMAGE as error:
            return str(error)
    return ''


def read_attachment(path: Path, index: AttachmentIndex) -> Attachment:
    """
    Return an attached file with its times.

    :raises BagError: the attachment is damaged.
    """
    with path.open('rb') as stream:
        try:
            stream.seek(index.offset + _HEAD)
            content = stream.read(index.length - _HEAD)
            if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], 'little'):
                raise ValueError('it does not match its checksum')  # not verified by mcap
            found: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
            return found
        except DAMAGE as error:
            raise BagError(f'attachment {index.name} of {path} is damaged: {error}') from error
