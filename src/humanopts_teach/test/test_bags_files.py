"""
Bag files: what is written is read again, and damage costs only what is damaged.

Files of other programs are read where they are bags of ours, or refused with the reason.
"""

from collections.abc import Callable
from pathlib import Path
import resource
import shutil
from typing import Any

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_teach.bags import BagError, BagWriteError, SchemaError
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.schemas import find_schema
from humanopts_teach.bags.writer import BagWriter, Limits
from mcap.reader import make_reader
from mcap.writer import CompressionType, MCAP0_MAGIC, Writer
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from teach_support.bags import GAME, QOS, START, state, steps, write_messages, write_states
import yaml


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A whole bag of 100 game states in 10 chunks."""
    write_states(tmp_path / 'bag', 100).close()
    return tmp_path / 'bag'


@pytest.fixture
def data(bag: Path) -> bytes:
    """The bytes of its file."""
    return (bag / 'bag_0.mcap').read_bytes()


def killed(bag: Path) -> Bag:
    """Open a copy of a bag that is being written: what its recorder leaves when it is killed."""
    return open_bag(shutil.copytree(bag, bag.with_name('killed'), dirs_exist_ok=True))


def test_what_was_written_is_read(bag: Path) -> None:
    opened = open_bag(bag)
    assert [(r.log_time, r.publish_time, r.message.step) for r in opened.messages()] == [
        (START + step * 10**6, START + step * 10**6 - 5, step) for step in range(100)
    ]
    assert opened.damage == ''
    assert opened.facts == {'seed': '7'}
    topic = opened.topics['/game_state']
    assert (topic.type, topic.messages, topic.type_hash) == (GAME, 100, 'RIHS01_ab')
    assert yaml.safe_load(topic.qos) == [QOS]


def test_messages_come_in_order_of_time_whatever_the_order_of_writing(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        for topic in ('/a', '/b'):
            writer.add_topic(topic, GAME)
        for step in (3, 1, 4, 0, 5, 2):
            writer.write('/a' if step % 2 else '/b', state(step), step)
            writer.flush()
    assert steps(tmp_path / 'bag') == [0, 1, 2, 3, 4, 5]
    only = open_bag(tmp_path / 'bag').messages(['/a'])
    assert [(r.topic, r.log_time) for r in only] == [('/a', 1), ('/a', 3), ('/a', 5)]


def test_a_bag_that_was_not_closed_holds_every_flushed_message(tmp_path: Path) -> None:
    writer = write_states(tmp_path / 'bag', 0)
    opened = killed(tmp_path / 'bag')
    assert (opened.n_messages, opened.facts) == (0, {'seed': '7'})
    assert 'was not closed' in opened.damage
    assert 'nothing was recorded' in summarise(opened).to_text()
    for step in range(57):
        writer.write('/game_state', state(step), START + step)
        if step % 10 == 9:
            writer.flush()
    opened = killed(tmp_path / 'bag')
    assert [r.message.step for r in opened.messages()] == list(range(50))
    assert (opened.n_messages, opened.facts) == (50, {'seed': '7'})
    assert 'was not closed' in opened.damage


def test_a_bag_cut_at_any_byte_opens_with_every_whole_chunk(bag: Path, data: bytes) -> None:
    file = bag / 'bag_0.mcap'
    with file.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    for size in range(200, len(data), 397):
        file.write_bytes(data[:size])
        opened = open_bag(bag)
        assert opened.damage
        found = [r.message.step for r in opened.messages()]
        whole = sum(each.chunk_start_offset + each.chunk_length <= size for each in chunks)
        assert found == list(range(10 * whole))


def test_a_file_that_cannot_grow_stops_the_writer_and_keeps_what_was_written(
    tmp_path: Path,
) -> None:
    writer = write_states(tmp_path / 'bag', 30)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer.write('/game_state', state(30), START)
    resource.setrlimit(resource.RLIMIT_FSIZE, (writer.bytes_written + 100, hard))
    try:
        with pytest.raises(BagWriteError, match='what was written before is kept'):
            writer.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    for again in (writer.flush, writer.close):
        with pytest.raises(BagWriteError, match='cannot write to'):
            again()
    opened = open_bag(tmp_path / 'bag')
    assert [r.message.step for r in opened.messages()] == list(range(30))
    assert 'was not closed' in opened.damage  # it ends after a whole record


def write_by_another(file: Path, *, without_counts: bool = False, **how: Any) -> None:
    """
    Write five game states as another program does.

    :param without_counts: of the messages of each topic; an empty map is how a file says so.
    """
    with file.open('wb') as stream:
        writer = Writer(stream, **how)
        writer.start(profile='ros2')
        schema = writer.register_schema(GAME, 'ros2msg', find_schema(GAME).encode())
        channel = writer.register_channel('/game_state', 'cdr', schema)
        for step in range(5):
            writer.add_message(channel, step, state(step), step)
        if without_counts:
            writer._Writer__statistics.channel_message_counts.clear()
        writer.finish()


@pytest.mark.parametrize(
    'how',
    [
        {'use_chunking': False, 'compression': CompressionType.NONE},
        {'repeat_channels': False},
        {'repeat_schemas': False},
        {'use_statistics': False},
        {'without_counts': True},
    ],
    ids=['no chunks', 'no topics', 'no types', 'no statistics', 'no counts'],
)
def test_files_with_a_shorter_summary_are_whole(tmp_path: Path, how: Any) -> None:
    file = tmp_path / 'other.mcap'
    write_by_another(file, **how)
    assert steps(file) == [0, 1, 2, 3, 4]
    assert check_bag(open_bag(file)).damage == []


def write_others(path: Path) -> None:
    """Record something else."""
    with BagWriter(path) as writer:
        writer.add_topic('/chatter', 'std_msgs/msg/String')
        writer.write('/chatter', serialize_message(String(data='hello')), 1)


def write_file(name: str, content: bytes) -> Callable[[Path], None]:
    """Return a function that makes a folder with one file."""

    def write(path: Path) -> None:
        path.mkdir()
        (path / name).write_bytes(content)

    return write


@pytest.mark.parametrize(
    ('make', 'reason'),
    [
        (lambda path: None, 'there is no bag at'),
        (Path.mkdir, 'is not a bag: there is no MCAP file'),
        (Path.touch, 'is empty'),
        (write_file('bag_0.mcap', b'some text'), 'written by another program'),
        (write_file('bag_0.mcap', b'SQLite format 3\0' + bytes(100)), 'sqlite3 format'),
        (write_file('bag_0.db3', b''), 'sqlite3 format'),
        (write_file('bag_0.mcap', MCAP0_MAGIC), 'holds no messages'),
        (write_others, 'no humanopts topics'),
    ],
)
def test_what_is_not_a_bag_is_refused_with_the_reason(
    tmp_path: Path, make: Callable[[Path], None], reason: str
) -> None:
    make(tmp_path / 'bag')
    with pytest.raises(BagError, match=reason):
        open_bag(tmp_path / 'bag')


# Of messages that are written one a millisecond.
@pytest.mark.parametrize('limits', [Limits(seconds=0.03), Limits(bytes=3000)])
def test_a_bag_goes_on_in_another_file_and_nothing_is_lost(tmp_path: Path, limits: Limits) -> None:
    write_states(tmp_path / 'bag', 100, limits=limits).close()
    opened = open_bag(tmp_path / 'bag')
    assert len(opened.files) > 2
    assert [(r.message.step, r.sequence) for r in opened.messages()] == [
        (step, step + 1) for step in range(100)
    ]
    assert check_bag(opened).findings == []
    if limits.bytes:
        assert all(file.stat().st_size > limits.bytes for file in opened.files[:-1])
    (
        tmp_path / 'bag' / 'metadata.yaml'
    ).unlink()  # so that the names of the files give their order
    assert steps(tmp_path / 'bag') == list(range(100))


def test_a_topic_that_is_defined_in_two_ways_is_reported(tmp_path: Path) -> None:
    for name, message in (('bag', GameState()), ('other', ActionCommand())):
        write_messages(tmp_path / name, [('/x', message)])
    shutil.copy(tmp_path / 'other' / 'other_0.mcap', tmp_path / 'bag' / 'bag_1.mcap')
    assert '/x has several definitions' in open_bag(tmp_path / 'bag').damage


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
        find_schema(name)
