"""Message definitions in bags: complete, and read by two packages that are not ours."""

from array import array
import os
from pathlib import Path
import re
from typing import Any

from humanopts_teach.bags.errors import SchemaError
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.schemas import constants, Definitions, field_lines, SEPARATOR
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.nodes.intake import load_type
from mcap.reader import make_reader
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidResourceName
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys.msg import normalize_msgtype

OURS = 'humanopts_interfaces/'
CALLS = ('SendGoal', 'GetResult')
PARTS = {
    'msg': [''],
    'srv': ['_Request', '_Response', '_Event'],
    'action': [
        '_FeedbackMessage',
        *(f'_{call}_{part}' for call in CALLS for part in ('Request', 'Response', 'Event')),
    ],
}
NUMBERS = r'(u?int\d+|float|double|octet|boolean)'


def installed_types() -> list[str]:
    """Return every type that a topic can have here."""
    prefixes = [Path(p) for p in os.environ['AMENT_PREFIX_PATH'].split(os.pathsep)]
    files = [file for prefix in prefixes for file in prefix.glob('share/*/*/*.*')]
    return sorted(
        {
            f'{file.parent.parent.name}/{kind}/{file.stem}{part}'
            for file in files
            for kind, parts in PARTS.items()
            for part in parts
            if file.suffix == f'.{kind}' and file.parent.name == kind
        }
    )


def filled(type_name: str) -> Any:
    """Return a message with something in every field and every array."""
    message = load_type(type_name)()
    for number, (name, kind) in enumerate(message.get_fields_and_field_types().items(), start=1):
        setattr(message, name, sample(kind, getattr(message, name), number))
    return message


def sample(kind: str, default: Any, number: int) -> Any:
    """Return a value for a field."""
    if (fixed := re.fullmatch(r'(.*)\[(\d+)\]', kind)) is not None:
        return [sample(fixed[1], None, number)] * int(fixed[2])
    if (sequence := re.fullmatch(r'sequence<(.*?)(, \d+)?>', kind)) is not None:
        return [sample(sequence[1], None, number)] * (1 if sequence[2] else 2)
    if 'string' in kind:
        return f'text {number} é'
    if kind == 'boolean':
        return True
    if kind == 'octet':
        return bytes([number])
    if re.fullmatch(NUMBERS, kind):
        return number + 0.5 if kind in ('float', 'double') else number
    package, name = kind.split('/')
    return filled(f'{package}/{part_folder(name)}/{name}')


def part_folder(name: str) -> str:
    """Say where a nested type lives."""
    if '_' not in name:
        return 'msg'
    return 'action' if re.search('_(SendGoal|GetResult|Feedback|Goal|Result)', name) else 'srv'


def plain(value: Any, like: Any) -> Any:
    """
    Return a decoded value as lists, dictionaries, numbers and texts, whoever decoded it.

    :param like: the message that was encoded; it says which fields there are.
    """
    if hasattr(like, 'get_fields_and_field_types'):
        names = [name for name in like.get_fields_and_field_types() if 'at_least_one' not in name]
        return {name: plain(getattr(value, name), getattr(like, name)) for name in names}
    if isinstance(like, bytes):
        return value[0] if isinstance(value, bytes) else value
    if isinstance(like, list | array | np.ndarray):
        values = list(value)
        assert len(values) == len(like)
        return [plain(v, reference) for v, reference in zip(values, like, strict=True)]
    return value.item() if isinstance(value, np.generic) else value


def expected(samples: dict[str, Any]) -> dict[str, Any]:
    """Return what a reader must find, by topic."""
    return {topic: plain(message, message) for topic, (_, message) in samples.items()}


@pytest.fixture(scope='module')
def samples() -> dict[str, Any]:
    """One message of every installed type that has a class, by topic."""
    found: dict[str, Any] = {}
    for number, name in enumerate(installed_types()):
        found[f'/t{number}'] = (name, filled(name))
    return found


@pytest.fixture(scope='module')
def bag_path(tmp_path_factory: pytest.TempPathFactory, samples: dict[str, Any]) -> Path:
    """A bag of all of them."""
    path = tmp_path_factory.mktemp('types') / 'bag'
    with BagWriter(path) as writer:
        for time, (topic, (name, message)) in enumerate(samples.items(), start=1):
            writer.add_topic(topic, name)
            writer.write(topic, serialize_message(message), time)
    return path


def test_every_type_here_is_covered(samples: dict[str, Any]) -> None:
    kinds = {name.split('/')[1] for name, _ in samples.values()}
    names = {name for name, _ in samples.values()}
    assert kinds == {'msg', 'srv', 'action'}
    assert 'humanopts_interfaces/action/ExecuteOption_FeedbackMessage' in names
    assert 'humanopts_interfaces/srv/RunOption_Event' in names


def test_our_reader_decodes_every_type(bag_path: Path, samples: dict[str, Any]) -> None:
    decoded = {
        recorded.topic: plain(recorded.message, samples[recorded.topic][1])
        for recorded in open_bag(bag_path).messages()
    }
    assert decoded == expected(samples)


def test_rosbags_decodes_every_type(bag_path: Path, samples: dict[str, Any]) -> None:
    with AnyReader([bag_path]) as reader:
        decoded = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, normalize_msgtype(connection.msgtype))
            decoded[connection.topic] = plain(message, samples[connection.topic][1])
    assert decoded == expected(samples)


def test_mcap_ros2_decodes_every_message_and_refuses_only_names_with_underscores(
    bag_path: Path, samples: dict[str, Any]
) -> None:
    refused, wanted = set(), expected(samples)
    with (bag_path / 'bag_0.mcap').open('rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            try:
                decoder = DecoderFactory().decoder_for('cdr', schema)
                assert decoder is not None
                decoded = decoder(message.data)
            except InvalidResourceName:
                refused.add(schema.name)
            else:
                found = plain(decoded, samples[channel.topic][1])
                assert found == wanted[channel.topic], schema.name
    assert not any('/msg/' in name for name in refused)
    with_underscores = {name for name, _ in samples.values() if '_' in name.rpartition('/')[2]}
    parts_of_services = {n for n in with_underscores if '/srv/' in n and not n.endswith('_Event')}
    assert refused == with_underscores - parts_of_services
    ours = {name.removeprefix(OURS) for name in refused if name.startswith(OURS)}
    assert {name.partition('_')[2] for name in ours} == {
        'Event',
        'FeedbackMessage',
        *(f'{call}_{part}' for call in CALLS for part in ('Request', 'Response', 'Event')),
    }


def test_a_schema_holds_every_dependency_once() -> None:
    schema = Definitions().schema('humanopts_interfaces/srv/RunOption_Event')
    names = re.findall(r'^MSG: (\S+)$', schema, re.M)
    assert sorted(names) == [
        'builtin_interfaces/Time',
        'humanopts_interfaces/OptionResult',
        'humanopts_interfaces/RunOption_Request',
        'humanopts_interfaces/RunOption_Response',
        'service_msgs/ServiceEventInfo',
        'std_msgs/Header',
    ]


def test_constants_defaults_and_comments_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / 'share' / 'some_msgs' / 'msg'
    folder.mkdir(parents=True)
    text = '# A thing.\nuint8 KIND_A=1 # first\nint32 LOW = -2\nuint8 kind 1\nPart[] parts\n'
    (folder / 'Thing.msg').write_text(text)
    (folder / 'Part.msg').write_text('string<=5 name "x"')
    schema = Definitions([tmp_path]).schema('some_msgs/msg/Thing')
    assert schema == f'{text}{SEPARATOR}\nMSG: some_msgs/Part\nstring<=5 name "x"\n'
    assert constants(schema, 'KIND_') == {1: 'A'}
    assert constants(schema, '') == {1: 'KIND_A', -2: 'LOW'}
    assert field_lines(schema) == [('uint8', 'kind'), ('Part[]', 'parts')]


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('no_such_msgs/msg/Thing', 'install or build no_such_msgs'),
        ('std_srvs/srv/Trigger_Feedback', 'not a message made of std_srvs/Trigger'),
        ('std_srvs/srv/NoSuch_Event', 'install or build std_srvs'),
        ('String', 'not a type name'),
    ],
)
def test_a_type_that_is_not_there_is_named(name: str, reason: str) -> None:
    with pytest.raises(SchemaError, match=reason):
        Definitions().schema(name)
