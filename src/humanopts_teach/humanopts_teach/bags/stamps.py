"""The publisher and sequence number that begin every humanopts message, read without decoding."""

import struct
from typing import NamedTuple

from humanopts_teach.bags.schemas import field_lines

_FIELDS = [
    ('std_msgs/Header', 'header'),
    ('string', 'publisher_id'),
    ('uint64', 'sequence'),
]
_ORIGIN = 4  # CDR aligns from after the encapsulation header
_FRAME_ID = _ORIGIN + 8  # after header.stamp


class Stamp(NamedTuple):
    """Who sent a message, and its number among those of this publisher on this topic."""

    publisher_id: str
    sequence: int  # 1, 2, 3, ...


def is_stamped(schema: str) -> bool:
    """Tell whether messages of a schema begin with header, publisher_id and sequence."""
    return field_lines(schema)[:3] == _FIELDS


def read_stamp(data: bytes) -> Stamp | None:
    """Return the stamp of a CDR message whose type ``is_stamped``; None: it is damaged."""
    try:
        order = '<' if data[1] & 1 else '>'
        (length,) = struct.unpack_from(order + 'I', data, _FRAME_ID)
        start = _align(_FRAME_ID + 4 + length, 4)
        (length,) = struct.unpack_from(order + 'I', data, start)
        end = start + 4 + length
        (sequence,) = struct.unpack_from(order + 'Q', data, _align(end, 8))
        return Stamp(data[start + 4 : end - 1].decode(), sequence)
    except (struct.error, IndexError, UnicodeDecodeError):
        return None


def _align(offset: int, size: int) -> int:
    return offset + (_ORIGIN - offset) % size
