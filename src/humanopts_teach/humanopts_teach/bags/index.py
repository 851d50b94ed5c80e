"""Finds the messages of an MCAP file: by its index or, where that is damaged, by a scan."""

from io import BytesIO
from os import SEEK_END
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from humanopts_teach.bags.blocks import (
    Attached,
    Block,
    DAMAGE,
    describe,
    FileIndex,
    HEAD,
    split,
)
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.scan import ProgressCallback, scan
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
)
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC

_FOOTER_BYTES = HEAD + 8 + 8 + 4
_DATA_END_BYTES = HEAD + 4
_PIECE = 1 << 20  # bytes read at a time for a checksum
_CHUNK_INDEX = struct.Struct('<QQQQI')  # first and last time, offset, length, bytes of channels


class _NoIndexError(Exception):
    """The file is whole and has no index of its chunks, as some programs write it."""


def read_index(path: Path, on_byte: ProgressCallback = lambda _: None) -> FileIndex:
    """
    Find the messages of a file; one that was cut short is scanned up to where it ends.

    :param on_byte: told how far a scan is.
    :raises BagError: it cannot be read, is empty, or is not an MCAP file.
    """
    try:
        with path.open('rb') as stream:
            magic = stream.read(MAGIC_SIZE)
            if not magic:
                raise BagError(f'{path} is empty')
            if magic != MCAP0_MAGIC:
                raise BagError(f'{path} is not an MCAP file: it was written by another program')
            index = _index(path, stream, on_byte)
            index.library = _library(stream)
            return index
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


def _index(path: Path, stream: BinaryIO, on_byte: ProgressCallback) -> FileIndex:
    """Use the file's index, or do without it."""
    try:
        return _from_summary(path, stream)
    except _NoIndexError:
        return scan(path, stream, on_byte)
    except DAMAGE as error:
        index = scan(path, stream, on_byte)
        if not index.damage:
            index.note(f'its index is damaged ({error}); everything else that was found is whole')
        return index


def data_fits(path: Path, on_byte: ProgressCallback = lambda _: None) -> bool:
    """Compare all bytes of a whole file with their checksum; True: they fit, or it has none."""
    with path.open('rb') as stream:
        try:
            place = _summary_start(stream) - _DATA_END_BYTES
            stream.seek(place)
            opcode, _, checksum = struct.unpack('<BQI', stream.read(_DATA_END_BYTES))
        except (_NoIndexError, *DAMAGE):
            return True  # what is wrong with its end is said elsewhere
        if opcode != Opcode.DATA_END:
            return False
        stream.seek(0)
        found = 0
        while checksum and place > 0:
            found = zlib.crc32(stream.read(min(place, _PIECE)), found)
            place -= _PIECE
            on_byte(stream.tell())
        return bool(found == checksum)


def read_attachment(index: FileIndex, name: str) -> Attachment:
    """
    Return an attached file with its times.

    :raises BagError: there is none of this name, or it is damaged.
    """
    if name not in index.attachments:
        raise BagError(f'{index.path} has no attachment {name!r}')
    with index.path.open('rb') as stream:
        stream.seek(index.attachments[name].offset)
        try:
            _, length = struct.unpack('<BQ', stream.read(HEAD))
            if length > index.path.stat().st_size:
                raise ValueError('it is cut short')
            content = stream.read(length)
            checksum = int.from_bytes(content[-4:], 'little')
            if checksum and zlib.crc32(content[:-4]) != checksum:
                raise ValueError('it does not fit its checksum')
            attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
            return attachment
        except DAMAGE as error:
            raise BagError(f'attachment {name} of {index.path} is damaged: {error}') from error


def _library(stream: BinaryIO) -> str:
    """Return which program wrote the file; empty: its header is damaged."""
    try:
        stream.seek(MAGIC_SIZE + HEAD)
        return str(Header.read(ReadDataStream(BytesIO(stream.read(_PIECE)))).library)
    except DAMAGE:
        return ''


def _from_summary(path: Path, stream: BinaryIO) -> FileIndex:
    """
    Read the index at the end of the file.

    :raises _NoIndexError: the file is whole and has none.
    :raises Exception: one of ``DAMAGE``, where it is damaged.
    """
    content = _summary(stream)
    index = FileIndex(path)
    chunks = []
    for opcode, start, end in split(content):
        part = ReadDataStream(BytesIO(content[start:end]))
        if opcode == Opcode.CHUNK_INDEX:
            chunks.append(content[start:end])
        elif opcode == Opcode.STATISTICS:
            index.counts.update(Statistics.read(part).channel_message_counts)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            at = AttachmentIndex.read(part)
            index.attachments[at.name] = Attached(at.offset, at.data_size, at.media_type)
        elif opcode == Opcode.METADATA_INDEX:
            index.add(_metadata(stream, MetadataIndex.read(part)))
        elif (record := describe(opcode, content[start:end])) is not None:
            index.add(record)
    if not index.counts or not chunks or not _describes_all(index):
        raise _NoIndexError
    index.blocks.extend(_block(index, stream, chunk) for chunk in chunks)
    return index


def _describes_all(index: FileIndex) -> bool:
    """Tell whether topics and types of all messages are there, which some programs leave out."""
    channels = [index.channels.get(channel) for channel in index.counts]
    return all(channel and channel.schema_id in {0, *index.schemas} for channel in channels)


def _block(index: FileIndex, stream: BinaryIO, content: bytes) -> Block:
    """
    Return the chunk that a chunk index tells of.

    :raises Exception: one of ``DAMAGE``, where something else is there.
    """
    first, last, offset, length, size = _CHUNK_INDEX.unpack_from(content)
    stream.seek(offset)
    said = (Opcode.CHUNK, length - HEAD, first, last)
    if struct.unpack('<BQQQ', stream.read(HEAD + 16)) != said:
        raise ValueError(f'there is another chunk at byte {offset}')
    listed = content[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]
    channels = frozenset(channel for channel, _ in struct.iter_unpack('<HQ', listed))
    return Block(offset, length, first, last, index.group(channels or frozenset(index.channels)))


def _metadata(stream: BinaryIO, at: MetadataIndex) -> McapRecord:
    """
    Return the metadata record that is told of.

    :raises Exception: one of ``DAMAGE``, where it is damaged.
    """
    stream.seek(at.offset)
    ((opcode, start, end),) = split(data := stream.read(at.length))
    record = describe(opcode, data[start:end])
    if not isinstance(record, Metadata) or record.name != at.name:
        raise ValueError(f'there is no record {at.name} at byte {at.offset}')
    return record


def _summary(stream: BinaryIO) -> bytes:
    """
    Return the records at the end of the file, which fit their checksum.

    :raises _NoIndexError: there are none.
    :raises Exception: one of ``DAMAGE``, where they do not fit or the file has no end.
    """
    start = _summary_start(stream)
    stream.seek(start - _DATA_END_BYTES)
    if stream.read(_DATA_END_BYTES)[:1] != bytes([Opcode.DATA_END]):
        raise ValueError('it is not where the end of the file says')
    content = stream.read()[:-MAGIC_SIZE]
    checksum = int.from_bytes(content[-4:], 'little')
    if checksum and zlib.crc32(content[:-4]) != checksum:
        raise ValueError('it does not fit its checksum')
    return content


def _summary_start(stream: BinaryIO) -> int:
    """
    Return where the summary begins, as the footer says.

    :raises _NoIndexError: there is none.
    :raises Exception: one of ``DAMAGE``, where the file has no end.
    """
    stream.seek(-_FOOTER_BYTES - MAGIC_SIZE, SEEK_END)
    opcode, _, start, _, _ = struct.unpack('<BQQQI', stream.read(_FOOTER_BYTES))
    if opcode != Opcode.FOOTER or stream.read() != MCAP0_MAGIC:
        raise ValueError('the file has no end')
    if start == 0:
        raise _NoIndexError
    return int(start)
