"""A bag of several files: nothing is lost between them, and each is whole by itself."""

from pathlib import Path
import shutil
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_teach.bags.check import check_bag, repair
from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.writer import BagWriter, Limits
from mcap.reader import make_reader
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from teach_support.bags import GAME, QOS, START, state, steps, write_states
import yaml


def information(path: Path) -> Any:
    """Return what metadata.yaml says of a bag."""
    return yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


@pytest.mark.parametrize('limits', [Limits(seconds=0.03), Limits(bytes=3000)])
def test_a_bag_goes_on_in_another_file_and_nothing_is_lost(tmp_path: Path, limits: Limits) -> None:
    write_states(tmp_path / 'bag', 100, limits=limits).close()
    opened = open_bag(tmp_path / 'bag')
    assert len(opened.files) > 2
    assert [r.message.step for r in opened.messages()] == list(range(100))
    assert [r.sequence for r in opened.messages()] == list(range(1, 101))
    assert check_bag(opened).findings == ()
    assert summarise(opened).missing == 0
    if limits.bytes:
        assert all(file.stat().st_size > limits.bytes for file in opened.files[:-1])


def test_each_file_of_a_bag_is_whole_by_itself(tmp_path: Path) -> None:
    write_states(tmp_path / 'bag', 100, limits=Limits(seconds=0.03)).close()
    found: list[int] = []
    for number in range(4):
        file = tmp_path / 'bag' / f'bag_{number}.mcap'
        alone = open_bag(file)
        assert alone.damage == ''
        assert alone.metadata['humanopts'] == {'seed': '7'}
        found += steps(file)
        with file.open('rb') as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == alone.n_messages
        assert summary.chunk_indexes
    assert found == list(range(100))


def test_metadata_tells_of_each_file(tmp_path: Path) -> None:
    write_states(tmp_path / 'bag', 100, limits=Limits(seconds=0.03)).close()
    told = information(tmp_path / 'bag')
    assert told['relative_file_paths'] == [f'bag_{number}.mcap' for number in range(4)]
    assert [file['message_count'] for file in told['files']] == [30, 30, 30, 10]
    assert [
        (f['starting_time']['nanoseconds_since_epoch'] - START, f['duration']['nanoseconds'])
        for f in told['files']
    ] == [(n * 30_000_000, 29_000_000) for n in range(3)] + [(90_000_000, 9_000_000)]
    assert (told['message_count'], told['duration']['nanoseconds']) == (100, 99_000_000)


def test_rosbags_reads_every_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag', limits=Limits(seconds=0.03)) as writer:
        writer.add_topic('/game_state', GAME, [QOS])
        for step in range(100):
            writer.write('/game_state', state(step), START + step * 10**6)
    with AnyReader([tmp_path / 'bag']) as reader:
        read = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]
        assert [message.step for message in read] == list(range(100))
        assert reader.message_count == 100


def test_a_topic_is_in_the_files_that_have_its_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag', limits=Limits(seconds=1.0)) as writer:
        for topic in ('/a', '/b', '/silent'):
            writer.add_topic(topic, GAME, [QOS])
        for second, topic, step in ((0, '/a', 0), (1, '/b', 0), (2, '/a', 1)):
            writer.write(topic, state(step), second * 10**9)
    topics = [
        list(open_bag(tmp_path / 'bag' / f'bag_{number}.mcap').topics) for number in range(3)
    ]
    assert topics == [['/a', '/b', '/silent'], ['/b'], ['/a']]
    assert set(open_bag(tmp_path / 'bag').topics) == {'/a', '/b', '/silent'}
    assert check_bag(open_bag(tmp_path / 'bag')).whole


def test_a_split_describes_the_files_so_far(tmp_path: Path) -> None:
    write_states(tmp_path / 'bag', 65, limits=Limits(seconds=0.03))
    told = information(tmp_path / 'bag')
    assert [file['message_count'] for file in told['files']] == [30, 30, 0]
    opened = open_bag(tmp_path / 'bag')  # as after kill -9
    assert [r.message.step for r in opened.messages()] == list(range(60))
    assert 'bag_2.mcap' in opened.damage


def test_a_repair_keeps_what_is_attached_to_a_bag_of_several_files(tmp_path: Path) -> None:
    with write_states(tmp_path / 'bag', 100, limits=Limits(seconds=0.03)) as writer:
        writer.attach('options/p1/go.json', b'{"a": 1}', times=(5, 6))
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    assert repair(open_bag(tmp_path / 'bag'), tmp_path / 'whole') == 100
    opened = open_bag(tmp_path / 'whole')
    assert check_bag(opened).whole
    (kept,) = opened.attached()
    assert (kept.name, kept.data, kept.create_time) == ('options/p1/go.json', b'{"a": 1}', 5)


def test_a_topic_that_is_defined_in_two_ways_is_said(tmp_path: Path) -> None:
    for name, message in (('bag', GameState()), ('other', ActionCommand())):
        with BagWriter(tmp_path / name) as writer:
            writer.add_topic('/x', f'humanopts_interfaces/msg/{type(message).__name__}')
            writer.write('/x', serialize_message(message), 1)
    shutil.copy(tmp_path / 'other' / 'other_0.mcap', tmp_path / 'bag' / 'bag_1.mcap')
    assert '/x is defined in several ways' in open_bag(tmp_path / 'bag').damage


def test_a_split_that_cannot_be_described_stops_the_writer_and_keeps_what_was_written(
    tmp_path: Path,
) -> None:
    writer = write_states(tmp_path / 'bag', 30, limits=Limits(seconds=1.0))
    obstacle = tmp_path / 'bag' / 'metadata.yaml.new'
    obstacle.mkdir()
    with pytest.raises(BagWriteError, match='cannot write in'):
        writer.write('/game_state', state(30), START + 2 * 10**9)
    writer.add_topic('/chatter', 'std_msgs/msg/String')  # nodes still come
    writer.attach('options/p1/go.json', b'{}')
    assert open_bag(tmp_path / 'bag').damage
    obstacle.rmdir()
    writer.close()
    opened = open_bag(tmp_path / 'bag')
    assert opened.damage == ''
    assert [r.message.step for r in opened.messages()] == list(range(30))
    assert [kept.name for kept in opened.attached()] == ['options/p1/go.json']
