"""Conversion between dataclasses and messages, matching fields by name."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from enum import Enum
from functools import partial
import math
from typing import Any, cast, Generic, get_args, get_type_hints, TypeVar
import uuid

import numpy as np
from unique_identifier_msgs.msg import UUID

V = TypeVar('V')
M = TypeVar('M')
_NONE = uuid.UUID(int=0)
_STAMP = {'header', 'publisher_id', 'sequence'}  # filled in by the publisher
Convert = Callable[[Any], Any]


class Codec(Generic[V, M]):
    """
    Converts between a dataclass and a message type.

    The enum member ``NAME`` in a field such as ``action_source`` maps to the message constant
    ``SOURCE_NAME``, where the prefix is the last word of the field name. Tuples map to sequences,
    None in a numeric field to NaN, and a UUID string to its message.
    """

    def __init__(
        self,
        kind: type[V],
        message: type[M],
        *,
        of_value: Collection[str] = (),
        of_message: Collection[str] = (),
        computed: Collection[str] = (),
        subset: bool = False,
        parts: Mapping[str, tuple[Convert, Convert]] | None = None,
    ) -> None:
        """
        Match the fields of the two types.

        :param of_value: fields only in the dataclass; their defaults are used when decoding.
        :param of_message: fields only in the message, filled in by the caller.
        :param computed: properties of the dataclass that are message fields.
        :param subset: whether the dataclass may have additional fields and enum members.
        :param parts: encoder and decoder for the elements of a sequence, by field.
        :raises TypeError: any other field or an enum constant is missing on one side.
        """
        self._kind: type[V] = kind
        self._message = cast(Any, message)
        hints = get_type_hints(kind)
        value_fields = {field.name for field in fields(kind)} - set(of_value)  # type: ignore[arg-type]
        types = self._message.get_fields_and_field_types()
        message_fields = set(types) - {*of_message, *computed}
        message_fields -= _STAMP - value_fields
        unmatched = message_fields - value_fields
        if not subset:
            unmatched |= value_fields - message_fields
        if unmatched:
            raise TypeError(f'{kind.__name__} and {message.__name__} do not share {unmatched}')
        self._encode: dict[str, Convert | None] = dict.fromkeys(computed)
        self._decode: dict[str, Convert | None] = {}
        for name in sorted(message_fields):
            hint = hints[name]
            converts: tuple[Convert | None, Convert | None] = None, None
            members = [t for t in (hint, *get_args(hint)) if isinstance(t, type)]
            enum = next((t for t in members if issubclass(t, Enum)), None)
            if parts and name in parts:
                encode, decode = parts[name]
                converts = partial(_each, list, encode), partial(_each, tuple, decode)
            elif types[name] == 'unique_identifier_msgs/UUID':
                converts = uuid_to_message, uuid_from_message
            elif enum is not None:
                converts = _enum_converts(enum, message, name, subset, type(None) in members)
            elif type(None) in members:
                converts = (
                    lambda value: math.nan if value is None else value,
                    lambda found: None if math.isnan(found) else found,
                )
            elif getattr(hint, '__origin__', None) is tuple:
                converts = list, tuple
            self._encode[name], self._decode[name] = converts

    def encode(self, value: V, /, **more: Any) -> M:
        """
        Encode a value as a message.

        :param more: fields that only the message has; others keep their defaults.
        """
        for name, convert in self._encode.items():
            field = getattr(value, name)
            more[name] = field if convert is None else convert(field)
        found: M = self._message(**more)
        return found

    def decode(self, message: Any, /, **more: Any) -> V:
        """
        Decode a message.

        :param more: fields that only the dataclass has; others keep their defaults.
        :raises ValueError: a number is not an enum constant.
        """
        for name, convert in self._decode.items():
            found = getattr(message, name)
            more[name] = found if convert is None else convert(found)
        return self._kind(**more)


def uuid_to_message(text: str) -> UUID:
    """Convert a UUID string to a message; an empty string becomes all zeros."""
    return UUID(uuid=np.frombuffer((uuid.UUID(text) if text else _NONE).bytes, np.uint8))


def uuid_from_message(message: Any) -> str:
    """Convert a UUID message, from rclpy or a bag reader, to a string; empty for all zeros."""
    found = uuid.UUID(bytes=bytes(message.uuid))
    return '' if found == _NONE else str(found)


def _each(kind: type, convert: Convert, values: Any) -> Any:
    return kind(map(convert, values))


def _enum_converts(
    enum: type[Enum], message: Any, name: str, subset: bool, optional: bool
) -> tuple[Convert, Convert]:
    """Return the conversions between enum members and message constants."""
    prefix = f'{name.rpartition("_")[2].upper()}_'
    numbers: dict[Enum | None, int] = {
        member: number
        for member in enum
        if (number := getattr(message, prefix + member.name, None)) is not None
    }
    constants = {each for each in dir(type(message)) if each.startswith(prefix)}
    strange = constants - {prefix + member.name for member in enum} - {f'{prefix}UNKNOWN'}
    if strange or not (subset or len(numbers) == len(enum)):
        raise TypeError(f'{enum.__name__} and the {prefix} of {message.__name__} differ')
    values = {number: member for member, number in numbers.items()}
    if optional:
        numbers[None] = 0

    def decode(number: int) -> Enum | None:
        if number not in values and not optional:
            raise ValueError(f'{name} is {number}, which is not a {prefix} constant')
        return values.get(number)

    return numbers.__getitem__, decode
