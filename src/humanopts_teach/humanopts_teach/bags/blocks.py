"""Where the messages of an MCAP file are, and the records there."""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
import zstandard

HEAD = 9  # bytes before the content of a record: opcode and length
_LARGEST_CHUNK = 1 << 28  # uncompressed; more is damage, not data
_COMPRESSION = 28  # where a chunk's content names its compression
_RECORD = struct.Struct('<BQ')  # opcode and length
_MESSAGE = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time; its data follow
_DESCRIBE: dict[int, type[Schema] | type[Channel] | type[Metadata]] = {
    int(Opcode.SCHEMA): Schema,
    int(Opcode.CHANNEL): Channel,
    int(Opcode.METADATA): Metadata,
}
# What damaged bytes make the parsers raise.
DAMAGE = (
    McapError,
    CRCValidationError,
    zstandard.ZstdError,
    struct.error,
    UnicodeDecodeError,
    ValueError,
    KeyError,
    OSError,
    MemoryError,
    OverflowError,
)


@dataclass(frozen=True, slots=True)
class Block:
    """A chunk, or a run of records outside chunks."""

    offset: int
    length: int
    start: int  # earliest log time, ns
    end: int  # latest
    channels: frozenset[int]  # ids of the channels that have messages in it
    loose: bool = False  # a run of records outside chunks
    cut: bool = False  # a chunk whose end is not in the file


class Stored(NamedTuple):
    """A message as it is in its file; these sort by time, then by place."""

    log_time: int  # ns since the epoch
    file: int  # number of the file in its bag
    block: int  # offset of the block
    place: int  # in the block
    channel: int
    sequence: int
    publish_time: int
    data: bytes


class Attached(NamedTuple):
    """Where an attached file is."""

    offset: int  # of its record
    size: int  # of the attached file, bytes
    media_type: str


@dataclass
class FileIndex:
    """What one MCAP file holds."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel id
    blocks: list[Block] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attached] = field(default_factory=dict)  # by name
    damage: list[str] = field(default_factory=list)
    library: str = ''  # that wrote the file
    _groups: dict[frozenset[int], frozenset[int]] = field(default_factory=dict)

    def group(self, channels: frozenset[int]) -> frozenset[int]:
        """Return an equal set of channels, one object for all blocks that have it."""
        return self._groups.setdefault(channels, channels)

    def note(self, damage: str) -> None:
        """Keep what is wrong with the file, in words."""
        self.damage.append(f'{self.path.name}: {damage}')

    def add(self, record: McapRecord) -> None:
        """Take in a record that describes others."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata


def read_messages(
    stream: BinaryIO, block: Block, channels: Collection[int], file: int = 0
) -> list[Stored]:
    """
    Return the messages of some channels in a block, as they follow each other.

    :raises Exception: one of ``DAMAGE``, where its bytes are damaged.
    """
    data = block_data(stream, block)
    found = []
    for opcode, start, end in split(data):
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            if channel in channels:
                content = data[start + _MESSAGE.size : end]
                found.append(
                    Stored(
                        *(log_time, file, block.offset, start),
                        *(channel, sequence, publish_time, content),
                    )
                )
    return found


def block_data(stream: BinaryIO, block: Block) -> bytes:
    """
    Return the bytes of a block's records, one after another.

    :raises Exception: one of ``DAMAGE``, where they are damaged.
    """
    if block.loose:
        _check_size(block.length)
        stream.seek(block.offset)
        return stream.read(block.length)
    stream.seek(block.offset + HEAD)
    content = stream.read(min(block.length - HEAD, _LARGEST_CHUNK))
    if block.cut:
        return _leading_records(content)
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    _check_size(chunk.uncompressed_size)
    if chunk.compression == 'zstd':
        _check_size(zstandard.frame_content_size(chunk.data))
    records, size = get_chunk_data_stream(chunk, validate_crc=True)
    return records.read(size)


def split(data: bytes) -> Iterator[tuple[int, int, int]]:
    """
    Yield opcode, beginning and end of the content of every record.

    :raises Exception: one of ``DAMAGE``, where the bytes are no records.
    """
    at, size = 0, len(data)
    while at < size:
        opcode, length = _RECORD.unpack_from(data, at)
        start = at + HEAD
        at = start + length
        if at > size or (opcode == Opcode.MESSAGE and length < _MESSAGE.size):
            raise ValueError('its records do not fit into it')
        yield opcode, start, at


def describe(opcode: int, content: bytes) -> McapRecord | None:
    """
    Return the record that describes others; None: it is of another kind.

    :raises Exception: one of ``DAMAGE``, where it is damaged.
    """
    kind = _DESCRIBE.get(opcode)
    if kind is None:
        return None
    record: McapRecord = kind.read(ReadDataStream(BytesIO(content)))
    return record


def attached(offset: int, content: bytes) -> tuple[str, Attached]:
    """
    Return the name of an attached file and where it is.

    :param content: of its record, from the beginning; the file itself need not be in it.
    :raises Exception: one of ``DAMAGE``, where it is damaged.
    """
    stream = ReadDataStream(BytesIO(content))
    stream.read(16)  # its times
    name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
    return name, Attached(offset, stream.read8(), media_type)


def _leading_records(content: bytes) -> bytes:
    """
    Return the whole records at the beginning of a chunk that was cut short.

    zstd compresses in parts of up to 128 KiB, of which only whole ones can be had.
    """
    (size,) = struct.unpack_from('<Q', content, 16)
    (length,) = struct.unpack_from('<I', content, _COMPRESSION)
    _check_size(size)
    start = _COMPRESSION + 4 + length
    compression, data = content[_COMPRESSION + 4 : start], content[start + 8 :]
    if compression == b'zstd':
        data = zstandard.ZstdDecompressor().stream_reader(data).read(size)
    elif compression:
        return b''
    end = 0
    while end + HEAD <= len(data):
        after = end + HEAD + int.from_bytes(data[end + 1 : end + HEAD], 'little')
        if after > len(data):
            break
        end = after
    return data[:end]


def _check_size(size: int) -> None:
    """
    Refuse to make room for what no recorder writes.

    :raises ValueError: a chunk claims to be that large.
    """
    if size > _LARGEST_CHUNK:
        raise ValueError(f'a chunk claims {size} bytes')
