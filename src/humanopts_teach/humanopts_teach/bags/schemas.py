"""
Message definitions (ros2msg) of any type, complete with those that they depend on, and decoders.

Definitions are built from the .msg, .srv and .action files that every ROS 2 package installs,
since the generated classes lose constants, defaults and comments.
"""

from collections.abc import Callable, Sequence
import os
from pathlib import Path
import re
from typing import Any

from humanopts_teach.bags.errors import BagError, SchemaError
from humanopts_teach.bags.mcap_file import DAMAGE
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


class Definitions:
    """The definitions below some install prefixes."""

    def __init__(self, prefixes: Sequence[Path] | None = None) -> None:
        """
        Look below ``prefixes``, the first that has a file wins.

        :param prefixes: folders with share/; None: those of AMENT_PREFIX_PATH.
        """
        if prefixes is None:
            paths = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
            prefixes = [Path(path) for path in paths if path]
        self._prefixes = list(prefixes)
        self._schemas: dict[str, str] = {}

    def definition(self, type_name: str) -> str:
        """
        Return the definition of one type, without those that it depends on.

        :param type_name: package/msg/Name, package/srv/Name_Event, package/action/Name_Feedback
            and so on.
        :raises SchemaError: it is not installed here, or is no such name.
        """
        match = re.fullmatch(r'(\w+)/(msg|srv|action)/(\w+)', type_name)
        if match is None:
            raise SchemaError(f'{type_name!r} is not a type name such as std_msgs/msg/String')
        package, kind, name = match.groups()
        if kind == 'msg':
            return self._file(package, kind, name)
        return self._derived(package, kind, name)

    def schema(self, type_name: str) -> str:
        """
        Return the definition of a type and of all that it depends on, as one text.

        :raises SchemaError: one of them is not installed here.
        """
        if type_name not in self._schemas:
            self._schemas[type_name] = self._assemble(type_name)
        return self._schemas[type_name]

    def _assemble(self, type_name: str) -> str:
        """Append the definitions that a type depends on, each once, to its own."""
        parts = [self.definition(type_name)]
        known, queue = {type_name}, _dependencies(type_name, parts[0])
        while queue:
            wanted = queue.pop(0)
            if wanted not in known:
                known.add(wanted)
                text = self.definition(wanted)
                package, _, name = wanted.split('/')
                parts.append(f'{SEPARATOR}\nMSG: {package}/{name}\n{text}')
                queue += _dependencies(wanted, text)
        return ''.join(parts)

    def _derived(self, package: str, kind: str, name: str) -> str:
        """Return the definition of a message that is derived from a service or an action."""
        base = name.partition('_')[0]
        suffix, own = name[len(base) :], f'{package}/{base}'
        if suffix in _SECTIONS[kind]:
            sections = re.split(r'^---[ \t]*\n', self._file(package, kind, base), flags=re.M)
            return _qualified(sections[_SECTIONS[kind].index(suffix)], package)
        self._file(package, kind, base)  # only of what is installed
        if kind == 'action' and suffix in _ACTION_PARTS:
            return _ACTION_PARTS[suffix].replace('P_', own + '_')
        if suffix in {'srv': ['_Event'], 'action': ['_SendGoal_Event', '_GetResult_Event']}[kind]:
            return _EVENT.replace('P_', f'{package}/{name.removesuffix("Event")}')
        raise SchemaError(f'{package}/{kind}/{name} is not a message made of {own}')

    def _file(self, package: str, kind: str, name: str) -> str:
        relative = Path('share', package, kind, f'{name}.{kind}')
        for prefix in self._prefixes:
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


def _qualified(text: str, package: str) -> str:
    """
    Put the package before the types in ``text`` that are named without it.

    Readers look for a bare name in the folder of the type that uses it, and parts of services and
    actions are in another folder than messages.
    """
    for kind in {kind for kind, _ in field_lines(text) if '/' not in kind}:
        if _base(kind) not in _PRIMITIVE:
            place = rf'^(\s*){re.escape(kind)}(?=\s)'
            text = re.sub(place, rf'\g<1>{package}/{kind}', text, flags=re.M)
    return text


def _base(kind: str) -> str:
    """Return the type of a field without array and string bounds."""
    return re.sub(r'\[.*\]$', '', kind).partition('<')[0]


def _dependencies(type_name: str, text: str) -> list[str]:
    """Return the full names of the types of the fields in ``text``."""
    package = type_name.split('/')[0]
    found = []
    for kind, _ in field_lines(text):
        base = _base(kind)
        if base not in _PRIMITIVE:
            owner, _, name = base.rpartition('/')
            found.append(_full_name(owner.removesuffix('/msg') or package, name, type_name))
    return found


def _full_name(package: str, name: str, user: str) -> str:
    """Return a type's name with its folder: names with _ are parts of services and actions."""
    kind = user.split('/')[1] if '_' in name else 'msg'
    return f'{package}/{kind}/{name}'


Decoder = Callable[[bytes], Any]
_PLAIN = 'Underscore'  # stands for _ in a name, and is in no name
_NAME = re.compile(r'^MSG:\s+(\S+)$', re.M)
_CHAR = re.compile(r'^(\s*)char\b', re.M)  # unsigned in ROS 2, which mcap_ros2 does not know


def make_decoder(type_name: str, schema: str) -> Decoder:
    """
    Return a function that makes of a message's bytes an object with its fields.

    :raises BagError: the schema is not a message definition.
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
    Replace the _ in the type names of a schema, since mcap_ros2 refuses them.

    Parts of services and actions have them, such as Plan_Result; there may be a PlanResult too.
    """
    names = {name.rsplit('/', 1)[-1] for name in (type_name, *_NAME.findall(schema))}
    for name in sorted(name for name in names if '_' in name):
        place = rf'^((?:MSG:\s+)?(?:\w+/)*){name}\b'  # where a line names a type
        schema = re.sub(place, rf'\g<1>{name.replace("_", _PLAIN)}', schema, flags=re.M)
    package, _, name = type_name.rpartition('/')
    return f'{package}/{name.replace("_", _PLAIN)}', schema
