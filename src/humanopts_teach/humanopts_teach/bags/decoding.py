"""Decodes CDR messages by their ros2msg schema, whatever their names."""

from collections.abc import Callable
import re
from typing import Any

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.mcap_file import DAMAGE
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

Decoder = Callable[[bytes], Any]
_PLAIN = 'Underscore'  # stands for _ in a name, and is in no name
_NAME = re.compile(r'^MSG:\s+(\S+)$', re.M)
_CHAR = re.compile(r'^(\s*)char\b', re.M)  # unsigned in ROS 2, which mcap_ros2 does not know


def make_decoder(type_name: str, schema: str) -> Decoder:
    """
    Return what turns the bytes of a message into an object with its fields.

    :raises BagError: the schema is no message definition.
    """
    name, text = plain_names(type_name, schema)
    text = _CHAR.sub(r'\1uint8', text)
    record = Schema(id=1, data=text.encode(), encoding='ros2msg', name=name)
    try:
        decoder = DecoderFactory().decoder_for('cdr', record)
    except Exception as error:
        raise BagError(f'the definition of {type_name} in the bag is damaged: {error}') from error
    if decoder is None:
        raise BagError(f'the definition of {type_name} in the bag is not ros2msg')
    return decoder


def decode(decoder: Decoder, data: bytes) -> Any:
    """
    Decode one message.

    :raises BagError: its bytes do not fit its type.
    """
    try:
        return decoder(data)
    except (*DAMAGE, IndexError, TypeError, AttributeError) as error:
        raise BagError(f'it does not decode: {error}') from error


def plain_names(type_name: str, schema: str) -> tuple[str, str]:
    """
    Take the _ out of the type names in a schema, since mcap_ros2 refuses them.

    Parts of services and actions have them, such as Plan_Result; there may be a PlanResult too.
    """
    names = {name.rsplit('/', 1)[-1] for name in (type_name, *_NAME.findall(schema))}
    for name in sorted(name for name in names if '_' in name):
        place = rf'^((?:MSG:\s+)?(?:\w+/)*){name}\b'  # where a line names a type
        schema = re.sub(place, rf'\g<1>{name.replace("_", _PLAIN)}', schema, flags=re.M)
    package, _, name = type_name.rpartition('/')
    return f'{package}/{name.replace("_", _PLAIN)}', schema
