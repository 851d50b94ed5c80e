"""Four readers decode a bag with a message of every type that is installed here."""

import os
from pathlib import Path
import re
from typing import Any

from graph_support import foxglove
from graph_support.differences import differences
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.schemas import find_schema
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.ros.raw_subscriber import load_type
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.msg import normalize_msgtype

CALLS = ('SendGoal', 'GetResult')
PARTS = {
    'msg': [''],
    'srv': ['_Request', '_Response', '_Event'],
    'action': [
        '_FeedbackMessage',
        *(f'_{call}_{part}' for call in CALLS for part in ('Request', 'Response', 'Event')),
    ],
}
OURS = 'humanopts_interfaces/'
PADDING = {0, 1, 2, 3}  # bytes after a message, whose size is a multiple of 4
SOME = 'some_msgs/msg/Thing'
THING = """# A thing.
uint8 KIND_A=1 # first
int32 LOW = -2
int64 FAR=9007199254740993
float64 HALF=0.5
bool YES=true
string NAME='a b'
uint8 kind 1
bool on true  # by default
int8[] steps [-1, 0, 1]
float32[2] pair [0.5, 1.5]
string<=5 word "it's"
string[<=3] words ["a", "b c"]
Part[] parts
"""
Samples = dict[str, Any]  # message by type


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
        setattr(message, name, sample(kind, number))
    return message


def sample(kind: str, number: int) -> Any:
    """Return a value for a field; an integer that needs all bits of its type."""
    if (fixed := re.fullmatch(r'(.*)\[(\d+)\]', kind)) is not None:
        return [sample(fixed[1], number)] * int(fixed[2])
    if (sequence := re.fullmatch(r'sequence<(.*?)(, \d+)?>', kind)) is not None:
        return [sample(sequence[1], number)] * (1 if sequence[2] else 2)
    if (integer := re.fullmatch(r'(u?)int(\d+)', kind)) is not None:
        bits = int(integer[2])
        return 2**bits - number if integer[1] else number - 2 ** (bits - 1)
    if '/' in kind:
        package, name = kind.split('/')
        return filled(f'{package}/{part_folder(name)}/{name}')
    return {
        'boolean': True,
        'octet': bytes([256 - number]),
        'float': number + 0.5,
        'double': number + 0.1,
        'string': f'text {number} é \N{GRINNING FACE}\N{LINE SEPARATOR}',
    }[kind.partition('<')[0]]


def part_folder(name: str) -> str:
    """Say where a nested type lives."""
    if '_' not in name:
        return 'msg'
    return 'action' if re.search('_(SendGoal|GetResult|Feedback|Goal|Result)', name) else 'srv'


@pytest.fixture(scope='module')
def samples() -> Samples:
    """One message of every installed type."""
    return {name: filled(name) for name in installed_types()}


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory, samples: Samples) -> Path:
    """A bag of all of them; each topic is called as its type."""
    path = tmp_path_factory.mktemp('types') / 'bag'
    with BagWriter(path) as writer:
        for time, (name, message) in enumerate(samples.items(), start=1):
            writer.add_topic(f'/{name}', name)
            writer.write(f'/{name}', serialize_message(message), time)
    return path


def wrong(samples: Samples, found: dict[str, Any]) -> list[str]:
    """Return where a reader found something else than was written."""
    return [text for name in found for text in differences(samples[name], found[name], name)]


def misread(texts: list[str]) -> set[str]:
    """Return the names of the fields that differences are in."""
    found = [re.match(r'\S+\.(\w+)', text) for text in texts]
    return {match[1] for match in found if match}


def test_our_reader_decodes_every_type(bag: Path, samples: Samples) -> None:
    assert {name.split('/')[1] for name in samples} == {'msg', 'srv', 'action'}
    assert 'humanopts_interfaces/action/ExecuteOption_FeedbackMessage' in samples
    assert 'humanopts_interfaces/srv/RunOption_Event' in samples
    found = {recorded.type: recorded.message for recorded in open_bag(bag).messages()}
    assert set(found) == set(samples)
    assert wrong(samples, found) == []


def test_rosbags_decodes_every_type_and_takes_bytes_to_be_signed(
    bag: Path, samples: Samples
) -> None:
    with AnyReader([bag]) as reader:  # which compares all type hashes with the definitions
        found = {
            connection.msgtype: reader.deserialize(data, normalize_msgtype(connection.msgtype))
            for connection, _, data in reader.messages()
        }
    assert set(found) == set(samples)
    assert misread(wrong(samples, found)) == {'byte_array_value', 'data', 'level', 'passed'}


def test_foxglove_decodes_every_type_that_has_more_than_constants(
    bag: Path, samples: Samples
) -> None:
    lines = map(foxglove.read, foxglove.decode('indexed', [bag / 'bag_0.mcap']))
    found = {line['type']: line for line in lines if line['kind'] == 'message'}
    refused = {name for name, line in found.items() if 'error' in line}
    assert refused == {'rcl_interfaces/msg/ParameterType'}
    decoded = {name: line['value'] for name, line in found.items() if name not in refused}
    assert set(decoded) == set(samples) - refused
    assert wrong(samples, decoded) == []
    assert {line['trailing'] for name, line in found.items() if name not in refused} <= PADDING


def test_constants_and_defaults_of_every_kind_hinder_no_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'share' / 'some_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Thing.msg').write_text(THING)
    (folder / 'Part.msg').write_text('string<=9 name "part"\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    schema = find_schema(SOME)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema, SOME))
    part = store.types['some_msgs/msg/Part']('left')
    thing = store.types[SOME](3, True, np.int8([-3]), np.float32([0.25, 4]), 'w', ['x, y'], [part])
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/thing', SOME, schema=schema)
        writer.write('/thing', bytes(store.serialize_cdr(thing, SOME)), 1)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    with file.open('rb') as stream:
        ((*_, ours),) = make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages()
    assert list(differences(ours, thing, 'thing')) == []
    lines = list(map(foxglove.read, foxglove.decode('indexed', [file])))
    (message,) = (line for line in lines if line['kind'] == 'message')
    assert list(differences(ours, message['value'], 'thing')) == []
    (own, _) = next(line for line in lines if line['kind'] == 'schema')['definitions']
    found = {f['name']: f.get('value', f.get('defaultValue')) for f in own['definitions']}
    assert (found['FAR'], found['NAME'], found['word']) == (2**53 + 1, 'a b', "it's")
    assert (found['steps'], found['words']) == ([-1, 0, 1], ['a', 'b c'])
