"""Where the messages of an MCAP file are, and the records there."""

from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
import struct
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, McapRecord, Metadata, Schema
from mcap.stream_reader import breakup_chunk, CRCValidationError
import zstandard

HEAD = 9  # bytes before the content of a record: opcode and length
_LARGEST_CHUNK = 1 << 28  # uncompressed; more is damage, not data
_COMPRESSION = 28  # where a chunk's content names its compression
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
    channels: frozenset[int]  # ids of the channels that have messages in it
    loose: bool = False  # a run of records outside chunks
    cut: bool = False  # a chunk whose end is not in the file


@dataclass
class FileIndex:
    """What one MCAP file holds."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel id
    blocks: list[Block] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)  # offset of the record by name
    damage: list[str] = field(default_factory=list)
    library: str = ''  # that wrote the file

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


def read_block(stream: BinaryIO, block: Block) -> list[McapRecord]:
    """
    Return the records of a block.

    :raises Exception: one of ``DAMAGE``, where its bytes are damaged.
    """
    if block.loose:
        stream.seek(block.offset)
        data = stream.read(block.length)
        return breakup_chunk(Chunk('', data, 0, 0, 0, len(data)))
    stream.seek(block.offset + HEAD)
    content = stream.read(block.length - HEAD)
    if block.cut:
        return _leading_records(content)
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    _check_size(chunk.uncompressed_size)
    if chunk.compression == 'zstd':
        _check_size(zstandard.frame_content_size(chunk.data))
    return breakup_chunk(chunk, validate_crc=True)


def _leading_records(content: bytes) -> list[McapRecord]:
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
        return []
    end = 0
    while end + HEAD <= len(data):
        after = end + HEAD + int.from_bytes(data[end + 1 : end + HEAD], 'little')
        if after > len(data):
            break
        end = after
    return breakup_chunk(Chunk('', data[:end], 0, 0, 0, end))


def _check_size(size: int) -> None:
    """
    Refuse to make room for what no recorder writes.

    :raises ValueError: a chunk claims to be that large.
    """
    if size > _LARGEST_CHUNK:
        raise ValueError(f'a chunk claims {size} bytes')
