"""
Message definitions (ros2msg) of any type, complete with those that they depend on, and decoders.

Definitions are built from the .msg, .srv and .action files that every ROS 2 package installs,
since the generated classes lose constants, defaults and comments.
"""

from collections.abc import Callable
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
_UUID = 'unique_identifier_msgs/UUID goal_id'
_CONSTANT = re.compile(r'\s*[a-z0-9]+\s+([A-Z][A-Z0-9_]*)\s*=\s*(-?\d+)\b')
# Messages that ROS 2 derives from an action, apart from its three parts. P is package/Action.
_ACTION_PARTS = {
    '_FeedbackMessage': f'{_UUID}\nP_Feedback feedback\n',
    '_SendGoal_Request': f'{_UUID}\nP_Goal goal\n',
    '_SendGoal_Response': 'bool accepted\nbuiltin_interfaces/Time stamp\n',
    '_GetResult_Request': f'{_UUID}\n',
    '_GetResult_Response': 'int8 status\nP_Result result\n',
}
# P is package/Service.
_EVENT = 'service_msgs/ServiceEventInfo info\nP_Request[<=1] request\nP_Response[<=1] response\n'
_SECTIONS = {'srv': ('_Request', '_Response'), 'action': ('_Goal', '_Result', '_Feedback')}
_EVENTS = {'srv': ('_Event',), 'action': ('_SendGoal_Event', '_GetResult_Event')}


def find_schema(type_name: str) -> str:
    """
    Return the definition of a type and of all that it depends on, each once, as one text.

    :param type_name: package/msg/Name, package/srv/Name_Event, package/action/Name_Feedback
        and so on.
    :raises SchemaError: one of the types is not below the folders of AMENT_PREFIX_PATH, the first
        of which that has a file wins, or is not a type name.
    """
    paths = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    prefixes = tuple(Path(path) for path in paths if path)
    texts = {type_name: _definition(type_name, prefixes)}
    queue = _dependencies(type_name, texts[type_name])
    for wanted in queue:  # which grows
        if wanted not in texts:
            texts[wanted] = _definition(wanted, prefixes)
            queue += _dependencies(wanted, texts[wanted])
    own, *others = texts.items()
    return own[1] + ''.join(
        f'{SEPARATOR}\nMSG: {name.split("/")[0]}/{name.split("/")[2]}\n{text}'
        for name, text in others
    )


@cache
def _definition(type_name: str, prefixes: tuple[Path, ...]) -> str:
    """Return the definition of one type, without those that it depends on."""
    match = re.fullmatch(r'(\w+)/(msg|srv|action)/(\w+)', type_name)
    if match is None:
        raise SchemaError(f'{type_name!r} is not a type name such as std_msgs/msg/String')
    package, kind, name = match.groups()
    if kind == 'msg':
        return _read_file(package, kind, name, prefixes)
    base = name.partition('_')[0]
    suffix, own = name[len(base) :], f'{package}/{base}'
    text = _read_file(package, kind, base, prefixes)
    if suffix in _SECTIONS[kind]:
        sections = re.split(r'^---[ \t]*\n', text, flags=re.M)
        return _qualified(sections[_SECTIONS[kind].index(suffix)], package)
    if kind == 'action' and suffix in _ACTION_PARTS:
        return _ACTION_PARTS[suffix].replace('P_', own + '_')
    if suffix in _EVENTS[kind]:
        return _EVENT.replace('P_', f'{package}/{name.removesuffix("Event")}')
    raise SchemaError(f'{type_name} is not a message made of {own}')


def _read_file(package: str, kind: str, name: str, prefixes: tuple[Path, ...]) -> str:
    relative = Path('share', package, kind, f'{name}.{kind}')
    for prefix in prefixes:
        try:
            text = (prefix / relative).read_text('utf-8')
        except OSError:
            continue
        return text if text.endswith('\n') else text + '\n'
    raise SchemaError(
        f'no definition of {package}/{kind}/{name}: {relative} is below none of the prefixes '
        f'in AMENT_PREFIX_PATH; install or build {package}'
    )


def constants(schema: str, prefix: str) -> dict[int, str]:
    """
    Return the names of a message's integer constants by value.

    :param prefix: of the names that are wanted, such as STATUS_; it is dropped from them.
    """
    own = schema.split(SEPARATOR, 1)[0]
    found = (match.groups() for match in map(_CONSTANT.match, own.splitlines()) if match)
    return {
        int(value): name.removeprefix(prefix) for name, value in found if name.startswith(prefix)
    }


def field_lines(schema: str) -> list[tuple[str, str]]:
    """Return (type, name) of the fields of the first definition in ``schema``, in order."""
    own = schema.split(SEPARATOR, 1)[0]
    tokens = (line.partition('#')[0].split(maxsplit=1) for line in own.splitlines())
    pairs = ((parts[0], parts[1]) for parts in tokens if len(parts) == 2)
    return [
        (kind, rest.split()[0])
        for kind, rest in pairs
        if not re.match(r'[A-Z][A-Z0-9_]*\s*=', rest)
    ]


def _types(text: str) -> dict[str, str]:
    """Return the types of the fields in ``text`` that are messages, with and without bounds."""
    kinds = {kind: re.sub(r'\[.*\]$', '', kind).partition('<')[0] for kind, _ in field_lines(text)}
    return {kind: base for kind, base in kinds.items() if base not in _PRIMITIVE}


def _qualified(text: str, package: str) -> str:
    """
    Put the package before the types in ``text`` that are named without it.

    Readers look for a bare name in the folder of the type that uses it, and parts of services and
    actions are in another folder than messages.
    """
    for kind in _types(text):
        if '/' not in kind:
            place = rf'^(\s*){re.escape(kind)}(?=\s)'
            text = re.sub(place, rf'\g<1>{package}/{kind}', text, flags=re.M)
    return text


def _dependencies(type_name: str, text: str) -> list[str]:
    """Return the full names of the types of the fields in ``text``."""
    package, kind, _ = type_name.split('/')
    found = []
    for base in _types(text).values():
        owner, _, name = base.rpartition('/')
        folder = kind if '_' in name else 'msg'  # parts of services and actions have an _
        found.append(f'{owner.removesuffix("/msg") or package}/{folder}/{name}')
    return found


Decoder = Callable[[bytes], Any]
_PLAIN = 'Underscore'  # stands for _ in a name, and is in no name
_NAME = re.compile(r'^MSG:\s+(\S+)$', re.M)
_CHAR = re.compile(r'^(\s*)char\b', re.M)  # unsigned in ROS 2, which mcap_ros2 does not know


def make_decoder(type_name: str, schema: str) -> Decoder:
    """
    Return a function that makes of a message's bytes an object with its fields.

    The _ in type names is replaced, since mcap_ros2 refuses it. Parts of services and actions have
    it, such as Plan_Result; there may be a PlanResult too.

    :raises BagError: the schema is not a message definition.
    """
    names = {name.rsplit('/', 1)[-1] for name in (type_name, *_NAME.findall(schema))}
    text = schema
    for name in sorted(name for name in names if '_' in name):
        place = rf'^((?:MSG:\s+)?(?:\w+/)*){name}\b'  # where a line names a type
        text = re.sub(place, rf'\g<1>{name.replace("_", _PLAIN)}', text, flags=re.M)
    package, _, name = type_name.rpartition('/')
    record = Schema(
        id=1,
        data=_CHAR.sub(r'\1uint8', text).encode(),
        encoding='ros2msg',
        name=f'{package}/{name.replace("_", _PLAIN)}',
    )
    try:
        decoder = DecoderFactory().decoder_for('cdr', record)
    except Exception as error:
        raise BagError(f'the definition of {type_name} in the bag is damaged: {error}') from error
    assert decoder is not None  # it is None for other encodings
    return decoder
