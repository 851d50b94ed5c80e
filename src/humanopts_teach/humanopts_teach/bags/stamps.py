"""The publisher and sequence number that begin every humanopts message, read without decoding."""

import struct
from typing import NamedTuple

from humanopts_teach.bags.schemas import field_lines

_FIELDS = [
    ('std_msgs/Header', 'header'),
    ('string', 'publisher_id'),
    ('uint64', 'sequence'),
]
_PLACE = [('uint32', 'episode'), ('uint32', 'step')]
_ORIGIN = 4  # CDR aligns from after the encapsulation header
_FRAME_ID = _ORIGIN + 8  # after header.stamp


class Stamp(NamedTuple):
    """Who sent a message, and its number among those of this publisher on this topic."""

    publisher_id: str
    sequence: int  # 1, 2, 3, ...


def is_stamped(schema: str) -> bool:
    """Tell whether messages of a schema begin with header, publisher_id and sequence."""
    return field_lines(schema)[:3] == _FIELDS


def tells_place(schema: str) -> bool:
    """Tell whether episode and step follow the stamp."""
    return field_lines(schema)[:5] == [*_FIELDS, *_PLACE]


def read_stamp(data: bytes) -> Stamp | None:
    """Return the stamp of a CDR message whose type ``is_stamped``; None: it is damaged."""
    try:
        return _read(data)[0]
    except (struct.error, IndexError, UnicodeDecodeError):
        return None


def read_place(data: bytes) -> tuple[int, int] | None:
    """Return episode and step of a message whose type ``tells_place``; None: it is damaged."""
    try:
        _, end = _read(data)
        episode, step = struct.unpack_from('<II' if data[1] & 1 else '>II', data, end)
        return episode, step
    except (struct.error, IndexError, UnicodeDecodeError):
        return None


def _read(data: bytes) -> tuple[Stamp, int]:
    """Return the stamp of a message, and where it ends."""
    order = '<' if data[1] & 1 else '>'
    (length,) = struct.unpack_from(order + 'I', data, _FRAME_ID)
    start = _align(_FRAME_ID + 4 + length, 4)
    (length,) = struct.unpack_from(order + 'I', data, start)
    end = start + 4 + length
    place = _align(end, 8)
    (sequence,) = struct.unpack_from(order + 'Q', data, place)
    return Stamp(data[start + 4 : end - 1].decode(), sequence), place + 8


def _align(offset: int, size: int) -> int:
    return offset + (_ORIGIN - offset) % size
