"""
Message definitions (ros2msg), each with all its dependencies, and decoders.

Definitions come from the installed .msg, .srv and .action files of ROS 2 packages, since generated
classes lose constants, defaults and comments.
"""

from collections.abc import Callable, Iterator
from functools import cache
import os
from pathlib import Path
import re
from typing import Any

from humanopts_teach.bags import BagError, SchemaError
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

SEPARATOR = '=' * 80
_PRIMITIVE = {'bool', 'byte', 'char', 'float32', 'float64', 'string', 'wstring'} | {
    f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64)
}
_UUID = 'unique_identifier_msgs/UUID goal_id\n'
_CONSTANT = re.compile(r'\s*[a-z0-9]+\s+([A-Z][A-Z0-9_]*)\s*=\s*(-?\d+)\b')
# Messages that ROS 2 derives from a service or action in addition to its parts; P is package/Name.
_DERIVED = {
    '_FeedbackMessage': f'{_UUID}P_Feedback feedback\n',
    '_SendGoal_Request': f'{_UUID}P_Goal goal\n',
    '_SendGoal_Response': 'bool accepted\nbuiltin_interfaces/Time stamp\n',
    '_GetResult_Request': _UUID,
    '_GetResult_Response': 'int8 status\nP_Result result\n',
    **{
        f'{call}_Event': f'service_msgs/ServiceEventInfo info\nP{call}_Request[<=1] request\n'
        f'P{call}_Response[<=1] response\n'
        for call in ('', '_SendGoal', '_GetResult')
    },
}
_SECTIONS = {'srv': ('_Request', '_Response'), 'action': ('_Goal', '_Result', '_Feedback')}


def find_schema(type_name: str) -> str:
    """
    Return the definitions of a type and of all its dependencies, each once, as one text.

    The first match in AMENT_PREFIX_PATH is used.

    :param type_name: type name such as package/msg/Name, package/srv/Name_Event or
        package/action/Name_Feedback.
    :raises SchemaError: a type is not in AMENT_PREFIX_PATH, or its name is invalid.
    """
    paths = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    prefixes = tuple(Path(path) for path in paths if path)
    texts: dict[str, str] = {}
    queue = [type_name]
    for wanted in queue:  # grows during iteration
        if wanted not in texts:
            texts[wanted] = _definition(wanted, prefixes)
            queue += _dependencies(wanted, texts[wanted])
    own, *others = texts.items()
    return own[1] + ''.join(
        f'{SEPARATOR}\nMSG: {re.sub("/.*/", "/", name)}\n{text}' for name, text in others
    )


@cache
def _definition(type_name: str, prefixes: tuple[Path, ...]) -> str:
    """Return the definition of one type, without its dependencies."""
    match = re.fullmatch(r'(\w+)/(msg|srv|action)/([^\W_]+)(\w*)', type_name)
    if match is None:
        raise SchemaError(f'{type_name!r} is not a type name such as std_msgs/msg/String')
    package, kind, name, suffix = match.groups()
    relative = Path('share', package, kind, f'{name}.{kind}')
    file = next((each for prefix in prefixes if (each := prefix / relative).is_file()), None)
    if file is None:
        raise SchemaError(
            f'no definition of {package}/{kind}/{name}: {relative} is in no folder of '
            f'AMENT_PREFIX_PATH; install or build {package}'
        )
    text = file.read_text('utf-8').rstrip('\n') + '\n'
    if kind == 'msg':
        return text
    if suffix in _SECTIONS[kind]:
        section = re.split(r'^---[ \t]*\n', text, flags=re.M)[_SECTIONS[kind].index(suffix)]
        # Readers resolve a bare name in the folder of the type that uses it, but sections and
        # messages are in different folders.
        for bare in (field for field, _ in field_lines(section)):
            if '/' not in bare and _base(bare) not in _PRIMITIVE:
                section = re.sub(
                    rf'^(\s*){re.escape(bare)}(?=\s)', rf'\1{package}/{bare}', section, flags=re.M
                )
        return section
    if suffix in _DERIVED and (kind == 'action') == (suffix != '_Event'):
        return re.sub(r'\bP_', f'{package}/{name}_', _DERIVED[suffix])
    raise SchemaError(f'{type_name} is not a message made of {package}/{name}')


def _base(field_type: str) -> str:
    """Return the type of a field or, for an array, of its elements, without bounds."""
    return re.sub(r'[<\[].*', '', field_type)


def constants(schema: str, prefix: str) -> dict[int, str]:
    """
    Return the names of a message's integer constants by value.

    :param prefix: prefix of the constants, such as STATUS_, which is removed from the names.
    """
    found = map(_CONSTANT.match, schema.split(SEPARATOR, 1)[0].splitlines())
    names = {int(match[2]): match[1] for match in found if match and match[1].startswith(prefix)}
    return {value: name.removeprefix(prefix) for value, name in names.items()}


def field_lines(schema: str) -> list[tuple[str, str]]:
    """Return (type, name) of each field of the first definition in ``schema``, in order."""
    own = re.sub('#.*', '', schema.split(SEPARATOR, 1)[0])
    found = re.findall(r'^[ \t]*(\S+)[ \t]+(\w+)[ \t]*(=?)', own, re.M)
    return [(kind, name) for kind, name, constant in found if not constant]


def _dependencies(type_name: str, text: str) -> Iterator[str]:
    """Yield the full type names of the fields in ``text``."""
    package, kind, _ = type_name.split('/')
    for field_type, _ in field_lines(text):
        owner, _, name = _base(field_type).rpartition('/')
        if owner or name not in _PRIMITIVE:
            folder = kind if '_' in name else 'msg'  # names of service and action parts contain _
            yield f'{owner.removesuffix("/msg") or package}/{folder}/{name}'


Decoder = Callable[[bytes], Any]
_TYPE = re.compile(r'^(\s*(?:MSG:\s+)?(?:\w+/)+)(\w+)', re.M)  # at the start of a line
_CHAR = re.compile(r'^(\s*)char\b', re.M)  # unsigned in ROS 2, unlike in mcap_ros2


def make_decoder(type_name: str, schema: str) -> Decoder:
    """
    Return a function that decodes a message into an object with its fields.

    mcap_ros2 rejects type names that contain _, as for parts of services and actions.

    :raises BagError: the schema is not a message definition.
    """

    def rename(text: str) -> str:
        return _TYPE.sub(lambda match: match[1] + match[2].replace('_', 'Underscore'), text)

    data = _CHAR.sub(r'\1uint8', rename(schema)).encode()
    record = Schema(id=1, data=data, encoding='ros2msg', name=rename(type_name))
    try:
        decoder = DecoderFactory().decoder_for('cdr', record)
    except Exception as error:
        raise BagError(f'the definition of {type_name} in the bag is damaged: {error}') from error
    assert decoder is not None  # None only for other encodings
    return decoder
