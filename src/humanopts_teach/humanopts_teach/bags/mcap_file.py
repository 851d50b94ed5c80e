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
import zlib

from humanopts_teach.bags import BagError
from humanopts_teach.bags.rosbag2 import convert, unpack
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
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
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_PACKED_MAGIC = {
    '.zst': ZSTD_MAGIC,
    '.gz': b'\x1f\x8b',
    '.bz2': b'BZh',
    '.xz': b'\xfd7zXZ\0',
    '.lz4': b'\x04\x22\x4d\x18',
}
_SQLITE, _ROS_1 = b'SQLite format 3\0', b'#ROSBAG V'
_LONGEST_MAGIC = len(_SQLITE)
_HEAD = struct.Struct('<BQ')  # opcode of a record, length of its content
_TIMES = struct.Struct('<QQ')  # first and last log time, at the beginning of a chunk's content
_DATA_END = struct.Struct('<BQI')  # a whole DataEnd record: opcode, length, checksum
_MESSAGE_HEAD = 22  # bytes of a message before its data
_PIECE = 1 << 20  # bytes that are read at a time where a file has no structure
_ZSTD = b'\4\0\0\0zstd'  # how a chunk names its compression ...
_ZSTD_AT = 28  # ... at this offset in its content, before the length of its records
_OPCODES = {int(opcode) for opcode in Opcode}
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)  # that may also be outside
# What damaged bytes make the ``mcap`` package raise, and the functions below that parse them.
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
    length: int  # bytes
    start: int = 0  # earliest log time, ns
    end: int = 0  # latest log time, ns
    channels: frozenset[int] = frozenset()  # ids of the channels that have messages in it
    is_chunk: bool = True


@dataclass
class FileIndex:
    """What one MCAP file holds, and where."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel id
    blocks: list[Block] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, AttachmentIndex] = field(default_factory=dict)  # by name
    damage: list[str] = field(default_factory=list)  # what is wrong with the file, in words
    closed: bool = False  # whether its data has an end
    growing: bool = False  # it is being written, so an end is not yet expected

    def note(self, damage: str) -> None:
        """Keep what is wrong with the file."""
        self.damage.append(f'{self.path.name}: {damage}')

    def describes(self, channel_id: int) -> bool:
        """Return whether topic and type of a channel's messages are known."""
        channel = self.channels.get(channel_id)
        return channel is not None and channel.schema_id in {0, *self.schemas}


class McapStream(BufferedReader):
    """A file that reads as many bytes as it is asked for, or raises ``EndOfFile``."""

    def __init__(self, path: Path) -> None:
        super().__init__(FileIO(path))
        self.size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """
        Read bytes; a length that damage made huge takes no memory.

        :raises EndOfFile: there are fewer.
        """
        wanted = -1 if size is None else size
        data = b'' if wanted > self.size else super().read(wanted)
        if len(data) < wanted:
            raise EndOfFile('it is cut short')
        return data

    def record(self, offset: int) -> tuple[int, bytes]:
        """
        Return opcode and content of a record.

        :raises EndOfFile: it is cut short.
        """
        self.seek(offset)
        opcode, length = _HEAD.unpack(self.read(_HEAD.size))
        return opcode, self.read(length)


def read_index(
    path: Path, on_offset: OffsetCallback = lambda _: None, *, growing: bool = False
) -> FileIndex:
    """
    Find the messages of a file.

    :param on_offset: is called while a file without an index is gone through.
    :param growing: the file is being written; that its end is missing is no damage.
    :raises BagError: the file cannot be read, is empty, or is not an MCAP file.
    """
    try:
        with McapStream(path) as stream:
            if stream.size == 0:
                raise BagError(f'{path} is empty')
            head = stream.peek(_LONGEST_MAGIC)[:_LONGEST_MAGIC]
            if not head.startswith(MCAP0_MAGIC):
                raise BagError(f'{path} is not an MCAP file: {_what(path, head)}')
            damage, index = '', FileIndex(path, growing=growing)
            try:
                found = not growing and _read_summary(index, stream)
            except DAMAGE as error:
                damage = f'its index is damaged ({error}); everything else that was found is whole'
                found = False
            if not found:
                index = FileIndex(path, growing=growing)
                _scan(index, stream, on_offset)
                if damage and not index.damage:
                    index.note(damage)
            return index
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


def _what(path: Path, head: bytes) -> str:
    """Say what a file is, by its first bytes, and how to make an MCAP file of it."""
    for suffix, magic in _PACKED_MAGIC.items():
        if head.startswith(magic):
            return unpack(path, suffix)
    if head.startswith(_SQLITE):
        return f'it was written by another program, as sqlite3; {convert(path.parent)}'
    if head.startswith(_ROS_1):
        return f'it is a bag of ROS 1; {convert(path)}'
    return 'it was written by another program'


def data_fits(path: Path, on_offset: OffsetCallback = lambda _: None) -> bool:
    """
    Compare all bytes of a whole file with their checksum; True: they fit, or it has none.

    What is wrong with the end of the file is said by ``read_index``.
    """
    with McapStream(path) as stream:
        try:
            end = _read_footer(stream).summary_start - _DATA_END.size
            checksum = _data_checksum(stream, end)
        except DAMAGE:
            return True
        stream.seek(0)
        found = 0
        for start in range(0, end if checksum else 0, _PIECE):
            found = zlib.crc32(stream.read(min(end - start, _PIECE)), found)
            on_offset(stream.tell())
        return found == checksum


def read_attachment(index: FileIndex, name: str) -> Attachment:
    """
    Return an attached file with its times.

    :raises BagError: it is damaged.
    """
    with McapStream(index.path) as stream:
        try:
            _, content = stream.record(index.attachments[name].offset)
            checksum = int.from_bytes(content[-4:], 'little')
            if checksum and zlib.crc32(content[:-4]) != checksum:  # the package does not compare
                raise ValueError('it does not fit its checksum')
            attachment: Attachment = Attachment.read(_parser(content))
            return attachment
        except DAMAGE as error:
            raise BagError(f'attachment {name} of {index.path} is damaged: {error}') from error


def read_block(stream: McapStream, block: Block) -> list[McapRecord]:
    """Return the records of a block; ``DAMAGE``: they are damaged, or it claims to be huge."""
    stream.seek(block.offset)
    if block.length > LARGEST:
        raise ValueError(f'a chunk claims {block.length} bytes')
    content = stream.read(block.length)
    if not block.is_chunk:  # as a chunk that is not compressed and has no checksum
        loose = Chunk('', content, 0, 0, uncompressed_crc=0, uncompressed_size=len(content))
        return breakup_chunk(loose)
    chunk = Chunk.read(_parser(content))
    sizes = [chunk.uncompressed_size]
    if chunk.compression == 'zstd':
        sizes.append(zstandard.frame_content_size(chunk.data))
    if max(sizes) > LARGEST:
        raise ValueError(f'a chunk claims {max(sizes)} bytes')
    return breakup_chunk(chunk, validate_crc=True)


def _parser(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _read_footer(stream: McapStream) -> Footer:
    """Return the last record of a file; ``DAMAGE``: it has no end."""
    stream.seek(-FOOTER_SIZE - MAGIC_SIZE, SEEK_END)
    content = stream.read(FOOTER_SIZE + MAGIC_SIZE)
    if content[0] != Opcode.FOOTER or content[FOOTER_SIZE:] != MCAP0_MAGIC:
        raise ValueError('the file has no end')
    footer: Footer = Footer.read(_parser(content[_HEAD.size :]))
    return footer


def _data_checksum(stream: McapStream, offset: int) -> int:
    """Return the checksum of all bytes before the end of the data, at an offset; 0: none."""
    stream.seek(offset)
    opcode, _, checksum = _DATA_END.unpack(stream.read(_DATA_END.size))
    if opcode != Opcode.DATA_END:
        raise ValueError('it is not where the end of the file says')
    return int(checksum)


def _read_summary(index: FileIndex, stream: McapStream) -> bool:
    """
    Read the index at the end of a file; False: it lacks one, or what some programs leave out.

    It is compared with its checksum, its place and the file, which the ``mcap`` package does not.
    """
    footer = _read_footer(stream)
    if footer.summary_start == 0:
        return False
    _data_checksum(stream, footer.summary_start - _DATA_END.size)
    content = stream.read(stream.size - footer.summary_start)
    if footer.summary_crc and zlib.crc32(content[: -4 - MAGIC_SIZE]) != footer.summary_crc:
        raise ValueError('it does not fit its checksum')
    stream.seek(0)
    summary = SeekingReader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return False
    index.schemas, index.channels = summary.schemas, summary.channels
    index.counts.update(summary.statistics.channel_message_counts)
    index.attachments.update((each.name, each) for each in summary.attachment_indexes)
    for each in summary.metadata_indexes:
        metadata = Metadata.read(_parser(stream.record(each.offset)[1]))
        if metadata.name != each.name:
            raise ValueError('it names other metadata records')
        index.metadata[each.name] = metadata.metadata
    groups: dict[frozenset[int], frozenset[int]] = {}  # one object for all blocks that have it
    for chunk in summary.chunk_indexes:
        channels = frozenset(chunk.message_index_offsets or index.channels)
        index.blocks.append(_indexed(stream, chunk, groups.setdefault(channels, channels)))
    return bool(index.blocks and index.counts) and all(map(index.describes, index.counts))


def _indexed(stream: McapStream, chunk: ChunkIndex, channels: frozenset[int]) -> Block:
    """Return a chunk, whose beginning is compared with what the index says of it."""
    times = (chunk.message_start_time, chunk.message_end_time)
    length = chunk.chunk_length - _HEAD.size
    stream.seek(chunk.chunk_start_offset)
    head = _HEAD.unpack(stream.read(_HEAD.size))
    if head != (Opcode.CHUNK, length) or _TIMES.unpack(stream.read(_TIMES.size)) != times:
        raise ValueError(f'there is another chunk at byte {chunk.chunk_start_offset}')
    return Block(chunk.chunk_start_offset + _HEAD.size, length, *times, channels)


def _scan(index: FileIndex, stream: McapStream, on_offset: OffsetCallback) -> None:
    """Go through a file that has no index; what is damaged is noted and left out."""
    for opcode, start, end in _pieces(index, stream):
        on_offset(start)
        try:
            if opcode == Opcode.CHUNK:
                _add_block(index, stream, Block(start + _HEAD.size, end - start - _HEAD.size))
            elif opcode in _IN_CHUNKS:
                _add_block(index, stream, Block(start, end - start, is_chunk=False))
            elif opcode == Opcode.METADATA:
                metadata = Metadata.read(_parser(stream.record(start)[1]))
                index.metadata[metadata.name] = metadata.metadata
            elif opcode == Opcode.ATTACHMENT:
                file = Attachment.read(_parser(stream.record(start)[1]))
                index.attachments[file.name] = AttachmentIndex(
                    offset=start,
                    length=end - start,
                    create_time=file.create_time,
                    log_time=file.log_time,
                    data_size=len(file.data),
                    name=file.name,
                    media_type=file.media_type,
                )
        except DAMAGE as error:
            why = str(error) or 'they end too soon'
            index.note(f'bytes {start} to {end} are damaged ({why}) and left out')
        index.closed = index.closed or opcode == Opcode.DATA_END
    if not (index.closed or index.growing or index.damage):
        index.note('it was not closed: it ends without an index')
    unknown = Counter(index.counts)
    for channel_id in filter(index.describes, index.counts):
        del unknown[channel_id]
    if unknown:
        index.note(
            f'{unknown.total()} messages are left out: the record of their topic is damaged'
        )


def _pieces(index: FileIndex, stream: McapStream) -> Iterator[tuple[int, int, int]]:
    """
    Yield opcode, offset and end of every whole record; where there is none, find a chunk.

    Records outside chunks that follow one another are one piece; in an index, each is one.
    """
    at = MAGIC_SIZE
    while at < stream.size:
        opcode, end = _record_at(stream, at)
        if opcode == 0:
            found, end = _next_chunk(stream, at)
            if end == 0:
                if not (index.closed or index.growing):
                    index.note(f'it is cut short in the record at byte {at} of {stream.size}')
                return
            if found == at:
                index.note(f'the head of the chunk at byte {at} is damaged; it is read')
            else:
                index.note(f'{found - at} bytes from byte {at} on are no whole record')
            opcode, at = int(Opcode.CHUNK), found
        while opcode in _IN_CHUNKS and end - at < _PIECE and not index.closed:
            following, its_end = _record_at(stream, end)
            if following not in _IN_CHUNKS:
                break
            end = its_end
        yield opcode, at, end
        if opcode == Opcode.FOOTER:
            return
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
            content = place + match.start() - _ZSTD_AT
            if content >= at + _HEAD.size:
                try:
                    stream.seek(place + match.end())
                    (length,) = struct.unpack('<Q', stream.read(8))
                    block = Block(content, _ZSTD_AT + len(_ZSTD) + 8 + length)
                    read_block(stream, block)
                except DAMAGE:
                    continue
                return content - _HEAD.size, content + block.length
    return 0, 0


def _add_block(index: FileIndex, stream: McapStream, block: Block) -> None:
    """Keep what a block describes, and the block where it holds messages; nothing if damaged."""
    times, counts = [], Counter[int]()
    for record in read_block(stream, block):
        if isinstance(record, Message):
            times.append(record.log_time)
            counts[record.channel_id] += 1
        elif isinstance(record, Schema):
            index.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            index.channels.setdefault(record.id, record)
    if times:
        index.counts.update(counts)
        index.blocks.append(
            replace(block, start=min(times), end=max(times), channels=frozenset(counts))
        )
