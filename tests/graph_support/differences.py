"""Compares what two programs found in the same message."""

from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np

SEQUENCES = (list, tuple, bytes, array, np.ndarray)
FILLER = 'structure_needs_at_least_one_member'  # what is sent for a message without fields


def differences(ours: Any, theirs: Any, place: str) -> Iterator[str]:
    """
    Yield where two decoders disagree, field by field.

    :param ours: a message of rclpy, or one that mcap_ros2 decoded.
    :param theirs: one with the same attributes, or a dictionary with no other keys.
    :param place: what the message is called in what is yielded.
    """
    if (names := _fields(ours)) is not None:
        found = theirs
        if not isinstance(theirs, dict):
            found = {name: getattr(theirs, name) for name in names if hasattr(theirs, name)}
        if set(found) != names:
            yield f'{place} has the fields {names} and {set(found)}'
        for name in names & set(found):
            yield from differences(getattr(ours, name), found[name], f'{place}.{name}')
    elif isinstance(ours, SEQUENCES) and isinstance(theirs, SEQUENCES):
        if len(ours) != len(theirs):
            yield f'{place} has {len(ours)} and {len(theirs)} elements'
        for number, pair in enumerate(zip(ours, theirs)):
            yield from differences(*pair, f'{place}[{number}]')
    else:
        value = ours[0] if isinstance(ours, bytes) else ours  # rclpy's byte
        if not (value == theirs or (value != value and theirs != theirs)):  # NaN is like NaN
            yield f'{place} is {value!r} and {theirs!r}'


def _fields(message: Any) -> set[str] | None:
    """Return the names of the fields of a message; None: it is none."""
    if hasattr(message, 'get_fields_and_field_types'):
        return set(message.get_fields_and_field_types())
    return set(message.__slots__) - {FILLER} if hasattr(message, '__slots__') else None
