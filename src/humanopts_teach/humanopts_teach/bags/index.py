"""Finds the messages of an MCAP file: by its index or, where that is damaged, by a scan."""

from collections.abc import Iterable
from io import BytesIO
from os import SEEK_END
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from humanopts_teach.bags.blocks import Block, DAMAGE, FileIndex, HEAD
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.scan import scan
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, ChunkIndex, Header
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC

_FOOTER_BYTES = HEAD + 8 + 8 + 4
_DATA_END_BYTES = HEAD + 4
_PIECE = 1 << 20  # bytes read at a time for a checksum


class _NoIndexError(Exception):
    """The file is whole and has no index of its chunks, as some programs write it."""


def read_index(path: Path) -> FileIndex:
    """
    Find the messages of a file; one that was cut short is scanned up to where it ends.

    :raises BagError: it cannot be read, is empty, or is not an MCAP file.
    """
    try:
        with path.open('rb') as stream:
            magic = stream.read(MAGIC_SIZE)
            if not magic:
                raise BagError(f'{path} is empty')
            if magic != MCAP0_MAGIC:
                raise BagError(f'{path} is not an MCAP file: it was written by another program')
            index = _index(path, stream)
            index.library = _library(stream)
            return index
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


def _index(path: Path, stream: BinaryIO) -> FileIndex:
    """Use the file's index, or do without it."""
    try:
        return _from_summary(path, stream)
    except _NoIndexError:
        return scan(path, stream)
    except DAMAGE as error:
        index = scan(path, stream)
        if not index.damage:
            index.note(f'its index is damaged ({error}); everything else that was found is whole')
        return index


def data_fits(path: Path) -> bool:
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
        return bool(found == checksum)


def read_attachment(index: FileIndex, name: str) -> Attachment:
    """
    Return an attached file with its times.

    :raises BagError: there is none of this name, or it is damaged.
    """
    if name not in index.attachments:
        raise BagError(f'{index.path} has no attachment {name!r}')
    with index.path.open('rb') as stream:
        stream.seek(index.attachments[name])
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
    _check_summary(stream)
    stream.seek(0)
    reader = SeekingReader(stream, record_size_limit=path.stat().st_size)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        raise _NoIndexError
    _check_chunks(stream, summary.chunk_indexes)
    index = FileIndex(path, dict(summary.schemas), dict(summary.channels))
    index.counts.update(summary.statistics.channel_message_counts)
    for chunk in summary.chunk_indexes:
        channels = frozenset(chunk.message_index_offsets) or frozenset(index.channels)
        start = chunk.message_start_time
        index.blocks.append(Block(chunk.chunk_start_offset, chunk.chunk_length, start, channels))
    for attachment in summary.attachment_indexes:
        index.attachments[attachment.name] = attachment.offset
    for record in reader.iter_metadata():
        index.add(record)
    return index


def _check_summary(stream: BinaryIO) -> None:
    """
    Compare the summary at the end of the file with its checksum.

    :raises _NoIndexError: there is none.
    :raises Exception: one of ``DAMAGE``, where they differ or the file has no end.
    """
    start = _summary_start(stream)
    stream.seek(start)
    content = stream.read()
    checksum = int.from_bytes(content[-4 - MAGIC_SIZE : -MAGIC_SIZE], 'little')
    if checksum and zlib.crc32(content[: -4 - MAGIC_SIZE]) != checksum:
        raise ValueError('it does not fit its checksum')


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


def _check_chunks(stream: BinaryIO, chunks: Iterable[ChunkIndex]) -> None:
    """
    Compare where the index says that chunks are with what is there.

    :raises Exception: one of ``DAMAGE``, where they differ.
    """
    for chunk in chunks:
        stream.seek(chunk.chunk_start_offset)
        said = (chunk.chunk_length - HEAD, chunk.message_start_time, chunk.message_end_time)
        if struct.unpack('<BQQQ', stream.read(HEAD + 16)) != (Opcode.CHUNK, *said):
            raise ValueError(f'there is another chunk at byte {chunk.chunk_start_offset}')
