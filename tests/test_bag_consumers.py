"""Two programs that are not ours read the bag of a demo: rosbags and the mcap package."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import Any

from graph_support.command import DemoRun
from humanopts_teach.bags.reader import Bag, open_bag
from mcap.reader import make_reader
from mcap.records import Message, Schema
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidResourceName
from mcap_ros2.decoder import DecoderFactory
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys.msg import normalize_msgtype

OWN = 'humanopts_interfaces/msg/'
# mcap_ros2 takes only letters and digits in the name of a type, so not those of service events
# and action feedback that a demo sends.
REFUSED = {
    'humanopts_interfaces/action/Plan_FeedbackMessage',
    'humanopts_interfaces/action/RunPolicy_FeedbackMessage',
    'humanopts_interfaces/srv/AnswerQuestion_Event',
    'humanopts_interfaces/srv/BeginDemonstration_Event',
    'humanopts_interfaces/srv/DefineOption_Event',
    'humanopts_interfaces/srv/EndDemonstration_Event',
    'humanopts_interfaces/srv/OpenSession_Event',
    'humanopts_interfaces/srv/ResetGame_Event',
    'humanopts_interfaces/srv/RunOption_Event',
    'humanopts_interfaces/srv/SetControl_Event',
}


@pytest.fixture(scope='module')
def bag(demo: DemoRun) -> Bag:
    """The same bag by our own reader."""
    return open_bag(demo.bag)


def test_rosbags_decodes_every_message_of_every_type(demo: DemoRun, bag: Bag) -> None:
    counts: Counter[str] = Counter()
    with AnyReader([demo.bag]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == {
            name: topic.type for name, topic in bag.topics.items()
        }
        for connection, _, data in reader.messages():
            assert is_dataclass(reader.deserialize(data, normalize_msgtype(connection.msgtype)))
            counts[connection.topic] += 1
    assert counts == {name: t.messages for name, t in bag.topics.items() if t.messages}


def test_rosbags_sees_what_our_reader_sees(demo: DemoRun, bag: Bag) -> None:
    topics = [name for name, topic in bag.topics.items() if topic.type.startswith(OWN)]
    with AnyReader([demo.bag]) as reader:
        wanted = [c for c in reader.connections if c.topic in topics]
        theirs = {
            (connection.topic, time, data): reader.deserialize(data, connection.msgtype)
            for connection, time, data in reader.messages(wanted)
        }
    ours = {(r.topic, r.log_time, r.data): r.message for r in bag.messages(topics)}
    assert set(theirs) == set(ours)
    assert len(ours) > 5000
    assert [key for key, message in ours.items() if not alike(message, theirs[key])] == []


def test_mcap_ros2_decodes_every_msg_type_and_refuses_names_with_underscores(
    bag: Bag,
) -> None:
    refused, decoders = set(), {}
    for schema, message in _records(bag):
        if schema.name in refused:
            continue
        if schema.name not in decoders:
            try:
                decoders[schema.name] = DecoderFactory().decoder_for('cdr', schema)
            except InvalidResourceName:
                refused.add(schema.name)
                continue
        assert decoders[schema.name](message.data) is not None
    assert refused == REFUSED
    sent = {topic.type for topic in bag.topics.values() if topic.messages}
    assert set(decoders) == sent - REFUSED
    assert {name for name in sent if '/msg/' in name} <= set(decoders)
    assert all('_' in name.rpartition('/')[2] for name in refused)


def _records(bag: Bag) -> Iterator[tuple[Schema, Message]]:
    (path,) = bag.files
    with path.open('rb') as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            assert schema is not None
            yield schema, message


def alike(ours: Any, theirs: Any) -> bool:
    """Tell whether two decoders found the same in a message, field by field."""
    if hasattr(ours, '__slots__'):
        return all(alike(getattr(ours, name), getattr(theirs, name)) for name in ours.__slots__)
    if isinstance(ours, list | tuple):
        return len(ours) == len(theirs) and all(map(alike, ours, theirs))
    return bool(ours == theirs or (ours != ours and theirs != theirs))  # NaN is like NaN
