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
            try:
                return _from_summary(path, stream)
            except DAMAGE:
                return scan(path, stream)
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error


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

    :raises Exception: one of ``DAMAGE``, where there is none, or it does not fit the file.
    """
    _check_summary(stream)
    reader = SeekingReader(stream, record_size_limit=path.stat().st_size)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError('no summary')
    index = FileIndex(path, dict(summary.schemas), dict(summary.channels))
    index.counts.update(summary.statistics.channel_message_counts)
    for chunk in summary.chunk_indexes:
        channels = frozenset(chunk.message_index_offsets) or frozenset(index.channels)
        start = chunk.message_start_time
        index.blocks.append(Block(chunk.chunk_start_offset, chunk.chunk_length, start, channels))
    if len(index.blocks) != summary.statistics.chunk_count or (
        not index.blocks and summary.statistics.message_count
    ):
        raise ValueError('the chunks are not indexed')
    for attachment in summary.attachment_indexes:
        index.attachments[attachment.name] = attachment.offset
    for record in reader.iter_metadata():
        index.add(record)
    return index


def _check_summary(stream: BinaryIO) -> None:
    """
    Compare the summary at the end of the file with its checksum.

    :raises Exception: one of ``DAMAGE``, where they differ.
    """
    stream.seek(-_FOOTER_BYTES - MAGIC_SIZE, SEEK_END)
    footer = stream.read(_FOOTER_BYTES)
    opcode, _, start, _, checksum = struct.unpack('<BQQQI', footer)
    if opcode != Opcode.FOOTER or start == 0 or stream.read() != MCAP0_MAGIC:
        raise ValueError('no summary')
    stream.seek(start)
    summary = stream.read()[: -4 - MAGIC_SIZE]
    if checksum and zlib.crc32(summary) != checksum:
        raise ValueError('the summary is damaged')
