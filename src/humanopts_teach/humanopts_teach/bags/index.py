"""Finds the messages of an MCAP file: by its index or, where that is damaged, by a scan."""

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
from mcap.records import Attachment
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import MCAP0_MAGIC

_FOOTER_BYTES = HEAD + 8 + 8 + 4


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
            return _index(path, stream)
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
            index.note(f'its index is damaged ({error}); everything else is whole')
        return index


def read_attachment(index: FileIndex, name: str) -> bytes:
    """
    Return an attached file.

    :raises BagError: there is none of this name, or it is damaged.
    """
    if name not in index.attachments:
        raise BagError(f'{index.path} has no attachment {name!r}')
    with index.path.open('rb') as stream:
        stream.seek(index.attachments[name] + HEAD)
        try:
            return bytes(Attachment.read(ReadDataStream(stream)).data)
        except DAMAGE as error:
            raise BagError(f'attachment {name} of {index.path} is damaged: {error}') from error


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
    stream.seek(-_FOOTER_BYTES - MAGIC_SIZE, SEEK_END)
    footer = stream.read(_FOOTER_BYTES)
    opcode, _, start, _, checksum = struct.unpack('<BQQQI', footer)
    if opcode != Opcode.FOOTER or stream.read() != MCAP0_MAGIC:
        raise ValueError('the file has no end')
    if start == 0:
        raise _NoIndexError
    stream.seek(start)
    summary = stream.read()[: -4 - MAGIC_SIZE]
    if checksum and zlib.crc32(summary) != checksum:
        raise ValueError('it does not fit its checksum')
