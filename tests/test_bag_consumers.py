"""Programs that are not ours read bags: rosbags, the mcap package, Foxglove's for JavaScript."""

from collections import Counter
from pathlib import Path
from typing import Any

from graph_support import foxglove
from graph_support.command import DemoRun
from graph_support.differences import differences
from humanopts_teach.bags.check import repair
from humanopts_teach.bags.reader import Bag, open_bag, Recorded
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.writer import BagWriter, Limits
from mcap.reader import make_reader
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys.msg import normalize_msgtype
import yaml

EVENT = '/_service_event'
FEEDBACK = '/_action/feedback'
REQUEST, RESPONSE = {0, 1}, {2, 3}  # types of service events: sent and received
FACTS = {'seed': '7', 'participant': 'p é'}
FILES = {'options.json': b'{"up": 1}', 'empty': b''}


@pytest.fixture(scope='module')
def bag(demo: DemoRun) -> Bag:
    """The bag of the demo by our own reader."""
    return open_bag(demo.bag)


@pytest.fixture(scope='module')
def ours(bag: Bag) -> list[Recorded]:
    """All messages of the demo as our own reader decodes them."""
    return list(bag.messages())


@pytest.fixture(scope='module')
def by_rosbags(demo: DemoRun) -> dict[tuple[str, int, bytes], Any]:
    """All messages of the demo as rosbags decodes them."""
    with AnyReader([demo.bag]) as reader:
        return {
            (connection.topic, time, data): reader.deserialize(
                data, normalize_msgtype(connection.msgtype)
            )
            for connection, time, data in reader.messages()
        }


@pytest.fixture(scope='module')
def by_foxglove(bag: Bag) -> list[str]:
    """What Foxglove's packages find in the bag of the demo by its index, as lines of JSON."""
    return foxglove.decode('indexed', bag.files)


@pytest.fixture(scope='module')
def split(tmp_path_factory: pytest.TempPathFactory, bag: Bag, ours: list[Recorded]) -> Path:
    """The messages of the demo in a bag of several files of several chunks, with attachments."""
    path = tmp_path_factory.mktemp('split') / 'bag'
    share = (ours[-1].log_time - ours[0].log_time) / 1e9 / 4
    with BagWriter(path, FACTS, limits=Limits(seconds=share)) as writer:
        for topic in bag.topics.values():
            writer.add_topic(topic.name, topic.type, yaml.safe_load(topic.qos), topic.type_hash)
        for number, message in enumerate(ours):
            writer.write(message.topic, message.data, message.log_time, message.publish_time)
            if number % 50 == 0:
                writer.flush()
        for name, data in FILES.items():
            writer.attach(name, data, 'application/octet-stream')
    return path


def test_rosbags_reads_metadata_and_messages_as_our_reader_does(
    demo: DemoRun, bag: Bag, ours: list[Recorded], by_rosbags: dict[tuple[str, int, bytes], Any]
) -> None:
    with Reader(demo.bag) as reader:
        found = reader.storage.metadata
        topics = {connection.topic: connection for connection in reader.connections}
    assert (found.ros_distro, found.custom) == ('jazzy', bag.facts)
    assert found.custom['seed'] == '1'
    assert (found.message_count, found.start_time) == (len(ours), ours[0].log_time)
    assert found.end_time - 1 == ours[-1].log_time == found.start_time + found.duration - 1
    assert [(c.topic, c.msgtype, c.msgcount, c.digest) for _, c in sorted(topics.items())] == [
        (topic.name, topic.type, topic.messages, topic.type_hash) for topic in bag.topics.values()
    ]
    qos = {name: connection.ext.offered_qos_profiles for name, connection in topics.items()}
    assert qos == {name: parse_qos(topic.qos) for name, topic in bag.topics.items()}
    for name, kept in (('/domain_info', 'TRANSIENT_LOCAL'), ('/parameter_events', 'VOLATILE')):
        assert {profile.durability for profile in qos[name]} == {QosDurability[kept]}
        assert {profile.reliability for profile in qos[name]} == {QosReliability.RELIABLE}
    messages = {(r.topic, r.log_time, r.data): r.message for r in ours}
    assert len(messages) == len(ours) > 2000
    assert set(by_rosbags) == set(messages)
    wrong = (differences(messages[key], by_rosbags[key], key[0]) for key in messages)
    assert [text for texts in wrong for text in texts] == []


def test_rosbags_finds_every_request_and_every_response_in_service_events(
    by_rosbags: dict[tuple[str, int, bytes], Any],
) -> None:
    events = [event for key, event in by_rosbags.items() if key[0].endswith(EVENT)]
    assert {event.info.event_type for event in events} == REQUEST | RESPONSE
    for event in events:
        held = (len(event.request), len(event.response))
        assert held == ((1, 0) if event.info.event_type in REQUEST else (0, 1))


def test_rosbags_reads_all_messages_from_a_bag_of_several_files(
    bag: Bag, ours: list[Recorded], split: Path
) -> None:
    with Reader(split) as reader:
        files = [file['path'] for file in reader.storage.files]
        found = reader.storage.metadata
        counts = {c.topic: c.msgcount for c in reader.connections}
        messages = Counter((c.topic, time, data) for c, time, data in reader.messages())
    assert files == [f'bag_{number}.mcap' for number in range(len(files))]
    assert len(files) > 2
    assert (found.message_count, found.custom) == (len(ours), FACTS)
    assert counts == {name: topic.messages for name, topic in bag.topics.items()}
    assert messages == Counter((r.topic, r.log_time, r.data) for r in ours)


def test_mcap_reads_messages_attachments_and_facts_of_several_files(
    ours: list[Recorded], split: Path
) -> None:
    sequences: list[tuple[str, int]] = []
    attached = {}
    for path in split.glob('*.mcap'):
        with path.open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            messages = [(c.topic, message.sequence) for _, c, message in reader.iter_messages()]
            summary = reader.get_summary()
            assert summary.statistics.message_count == len(messages)
            assert {chunk.compression for chunk in summary.chunk_indexes} == {'zstd'}
            sequences += messages
            attached |= {item.name: item.data for item in reader.iter_attachments()}
            records = {record.name: record.metadata for record in reader.iter_metadata()}
            assert records['humanopts'] == FACTS
    assert sorted(sequences) == sorted((r.topic, r.sequence) for r in ours)
    assert attached == FILES


def test_foxglove_decodes_every_message_as_our_reader_does(
    ours: list[Recorded], by_foxglove: list[str]
) -> None:
    lines = map(foxglove.read, by_foxglove)
    found = {(line['topic'], line['sequence']): line for line in lines if 'sequence' in line}
    assert [line for line in found.values() if 'error' in line] == []
    assert set(found) == {(r.topic, r.sequence) for r in ours}
    wrong = []
    for recorded in ours:
        line = found[recorded.topic, recorded.sequence]
        wrong += differences(recorded.message, line['value'], recorded.topic)
        assert line['type'] == recorded.type
        assert (line['logTime'], line['publishTime']) == (recorded.log_time, recorded.publish_time)
        assert line['trailing'] < 4  # a message is filled up to a multiple of 4 bytes
    assert wrong == []


def test_foxglove_finds_the_same_by_the_index_and_as_a_stream(
    bag: Bag, by_foxglove: list[str]
) -> None:
    assert sorted(foxglove.decode('streamed', bag.files)) == sorted(by_foxglove)


def test_foxglove_finds_our_header_facts_counts_and_constants(
    bag: Bag, by_foxglove: list[str]
) -> None:
    lines = [foxglove.read(line) for line in by_foxglove if '"kind":"message"' not in line]
    (header,) = (line for line in lines if line['kind'] == 'header')
    assert (header['profile'], header['library']) == ('ros2', 'humanopts')
    (statistics,) = (line for line in lines if line['kind'] == 'statistics')
    assert sum(statistics['channelMessageCounts'].values()) == bag.n_messages
    records = {line['name']: line['metadata'] for line in lines if line['kind'] == 'metadata'}
    assert records == bag.metadata
    found = {line['name']: line for line in lines if line['kind'] == 'schema'}
    schemas = {topic.type: topic.schema for topic in bag.topics.values()}
    assert set(found) == set(schemas)
    for name, schema in schemas.items():
        own = found[name]['definitions'][0]['definitions']
        values = {field['value']: field['name'] for field in own if field.get('isConstant')}
        assert values == constants(schema, ''), name


def test_foxglove_and_rosbags_read_what_a_repair_saves_of_a_file_cut_short(
    split: Path, tmp_path: Path
) -> None:
    cut, whole = tmp_path / 'cut.mcap', max(split.glob('*.mcap'), key=lambda f: f.stat().st_size)
    with whole.open('rb') as stream:
        last = make_reader(stream).get_summary().chunk_indexes[-1]
    cut.write_bytes(whole.read_bytes()[: last.chunk_start_offset + last.chunk_length // 2])
    saved = repair(open_bag(cut), tmp_path / 'saved')
    assert 0 < saved < open_bag(whole).n_messages
    lines = map(foxglove.read, foxglove.decode('indexed', [tmp_path / 'saved' / 'saved_0.mcap']))
    messages = [line for line in lines if line['kind'] == 'message']
    assert [line for line in messages if 'error' in line] == []
    with AnyReader([tmp_path / 'saved']) as reader:
        assert sum(1 for _ in reader.messages()) == len(messages) == saved
