"""Files of other programs: read where they are bags of ours, or refused with the reason."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.writer import BagWriter
from mcap.writer import CompressionType, Writer
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from teach_support.bags import GAME, state, steps

PLAIN = {'use_chunking': False, 'compression': CompressionType.NONE}


def write_by_another(file: Path, count: int, *, without_counts: bool = False, **how: Any) -> None:
    """
    Write game states as another program does.

    :param without_counts: of the messages of each topic; an empty map is how a file says so.
    """
    schema = open_schema(file.parent)
    with file.open('wb') as stream:
        writer = Writer(stream, **how)
        writer.start(profile='ros2')
        channel = writer.register_channel(
            '/game_state', 'cdr', writer.register_schema(GAME, 'ros2msg', schema)
        )
        for step in range(count):
            writer.add_message(channel, step, state(step), step)
        if without_counts:
            writer._Writer__statistics.channel_message_counts.clear()
        writer.finish()


def open_schema(tmp_path: Path) -> bytes:
    """Return the schema of GameState."""
    with BagWriter(tmp_path / 'for_schema') as writer:
        return writer.add_topic('/game_state', GAME).encode()


@pytest.mark.parametrize(
    'how',
    [
        PLAIN,
        {'repeat_channels': False},
        {'repeat_schemas': False},
        {'use_statistics': False},
        {'without_counts': True},
    ],
    ids=['no chunks', 'no topics', 'no types', 'no statistics', 'no counts'],
)
def test_files_whose_end_tells_less_are_read_and_whole(tmp_path: Path, how: Any) -> None:
    file = tmp_path / 'other.mcap'
    write_by_another(file, 5, **how)
    assert steps(file) == [0, 1, 2, 3, 4]
    assert check_bag(open_bag(file)).damage == ()


def test_a_scan_of_messages_outside_chunks_tells_how_far_it_is(tmp_path: Path) -> None:
    file, told = tmp_path / 'plain.mcap', list[int]()
    write_by_another(file, 50, **PLAIN)
    open_bag(file, lambda done, _: told.append(done))
    assert told == sorted(told)
    assert len(told) > 50


def nothing(path: Path) -> None:
    """Leave nothing there."""


def empty_folder(path: Path) -> None:
    """Make an empty folder."""
    path.mkdir()


def empty_file(path: Path) -> None:
    """Make an empty file."""
    path.touch()


def foreign_file(path: Path) -> None:
    """Make a file of another program."""
    path.write_bytes(b'SQLite format 3\0' + bytes(100))


def foreign_bag(path: Path) -> None:
    """Record something else."""
    with BagWriter(path) as writer:
        writer.add_topic('/chatter', 'std_msgs/msg/String')
        writer.write('/chatter', serialize_message(String(data='hello')), 1)


def nothing_in_it(path: Path) -> None:
    """Make what another program leaves that recorded nothing."""
    path.mkdir()
    with (path / 'bag_0.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'another')
        writer.finish()


def sqlite_bag(path: Path) -> None:
    """Make what ros2 bag makes with its other storage."""
    path.mkdir()
    (path / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n'
    )


@pytest.mark.parametrize(
    ('make', 'reason'),
    [
        (nothing, 'there is no bag at'),
        (empty_folder, 'is not a bag: there is no MCAP file'),
        (empty_file, 'is empty'),
        (foreign_file, 'written by another program'),
        (foreign_bag, 'no humanopts topics'),
        (sqlite_bag, 'sqlite3 format'),
        (nothing_in_it, 'holds no messages'),
    ],
)
def test_what_is_no_bag_is_refused_with_the_reason(
    tmp_path: Path, make: Callable[[Path], None], reason: str
) -> None:
    make(tmp_path / 'bag')
    with pytest.raises(BagError, match=reason):
        open_bag(tmp_path / 'bag')
