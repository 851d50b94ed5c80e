"""A demo whose nodes die, or that is ended: it says so, keeps its bag and leaves nothing."""

from collections.abc import Callable, Iterator
from pathlib import Path
import shutil
import signal
from signal import SIGINT, SIGKILL, SIGTERM
import subprocess

from graph_support.command import Command, shown_in_bag, shown_on_disk
from humanopts_teach.bags.reader import Bag, open_bag
import pytest

SHOWN = 3  # demonstrations on disk before anything happens
PATIENCE = 30.0  # s for a demo to end; it takes about one
DISK = 300_000  # bytes; a demo's bag alone is about twice as large
Start = Callable[..., Command]


@pytest.fixture
def start(tmp_path: Path, domain_id: int) -> Iterator[Start]:
    """Start a demo in ``tmp_path / 'out'``."""
    started = []

    def begin(*arguments: object) -> Command:
        command = Command(
            ['demo', '--out', tmp_path / 'out', '--seed', 3, *arguments], tmp_path, domain_id
        )
        started.append(command)
        return command

    yield begin
    for command in started:
        command.close()


def teach(command: Command, folder: Path) -> None:
    """Wait until it is in the middle of teaching."""
    command.until(lambda: len(shown_on_disk(folder / 'out')) >= SHOWN, 'demonstrations')


def bag_of(folder: Path) -> Bag:
    """Open the bag, whatever became of its recorder."""
    return open_bag(folder / 'out' / 'bag')


def check_end(command: Command, *words: str) -> None:
    """The demo ends with a message that has these words first, and nothing is left of it."""
    assert command.ended(PATIENCE) == 1
    first = command.errors.partition('\n')[0]
    assert first.startswith('humanopts demo: ')
    assert [word for word in words if word not in first] == [], first
    assert 'Traceback' not in command.errors
    assert command.running() == {}


@pytest.mark.slow  # a whole demo each; every run tests the planner's end and a killed recorder
@pytest.mark.parametrize('node', ['recorder', 'lesson'])
def test_a_node_that_ends_while_it_teaches_ends_the_demo(
    start: Start, tmp_path: Path, node: str
) -> None:
    command = start()
    teach(command, tmp_path)
    command.kill(node, SIGTERM)
    check_end(command, f'the node {node} ended (exit status 0) while it was needed')
    bag = bag_of(tmp_path)
    assert bag.damage == ''
    on_disk, in_bag = shown_on_disk(tmp_path / 'out'), shown_in_bag(bag)
    assert len(in_bag) >= SHOWN
    assert in_bag == on_disk[: len(in_bag)]


def test_a_planner_that_ends_while_it_plays_ends_the_demo(start: Start, tmp_path: Path) -> None:
    command = start('--budget', 3, '--episodes', 2000)
    command.until(lambda: 'playing' in command.output, 'the first episode')
    command.kill('planner', SIGTERM)
    check_end(command, 'planner')  # it may say itself that it stops
    bag = bag_of(tmp_path)
    assert bag.damage == ''
    assert shown_in_bag(bag) == shown_on_disk(tmp_path / 'out')


def test_a_killed_recorder_leaves_what_it_had_written(start: Start, tmp_path: Path) -> None:
    command = start()
    teach(command, tmp_path)
    command.kill('recorder', SIGKILL)
    check_end(command, 'the node recorder ended (by signal SIGKILL) while it was needed')
    bag = bag_of(tmp_path)
    assert 'not closed' in bag.damage or 'cut short' in bag.damage
    in_bag = shown_in_bag(bag)
    assert in_bag == shown_on_disk(tmp_path / 'out')[: len(in_bag)]
    assert bag.n_messages > 50


@pytest.mark.parametrize('how', [SIGINT, pytest.param(SIGTERM, marks=pytest.mark.slow)])
def test_a_demo_that_is_interrupted_stops_everything(
    start: Start, tmp_path: Path, how: signal.Signals
) -> None:
    command = start()
    teach(command, tmp_path)
    command.send(how)
    command.send(how)  # an impatient second one changes nothing
    assert command.ended(PATIENCE) == 130
    assert command.errors == 'humanopts demo: interrupted; everything is stopped\n'
    assert command.running() == {}
    bag = bag_of(tmp_path)
    assert bag.damage == ''
    assert shown_in_bag(bag) == shown_on_disk(tmp_path / 'out')


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[bool]:
    """Make ``tmp_path / 'out'`` a disk of its own; False: that is not allowed here."""
    folder = tmp_path / 'out'
    folder.mkdir()
    mount = [shutil.which('mount') or 'false', '-t', 'tmpfs', '-o', f'size={DISK}', 'small']
    mounted = subprocess.run([*mount, folder], capture_output=True, check=False).returncode == 0
    yield mounted
    if mounted:
        subprocess.run(['umount', '--lazy', folder], check=True)


# Of the recorder, of the lesson's own files, and of a file size limit in place of a small disk.
CAUSES = ('No space left on device', 'the disk is full', 'File too large')


def test_a_full_disk_ends_the_demo_and_the_bag_stays_readable(
    start: Start, tmp_path: Path, small_disk: bool
) -> None:
    command = start()
    if not small_disk:
        command.limit_files(DISK // 4)
    assert command.ended(60) == 1
    (message,) = command.errors.splitlines()
    assert message.startswith('humanopts demo: ')
    assert any(cause in message for cause in CAUSES)
    assert command.running() == {}
    in_bag = shown_in_bag(bag_of(tmp_path))
    on_disk = shown_on_disk(tmp_path / 'out')
    assert len(in_bag) >= SHOWN
    assert in_bag == on_disk[: len(in_bag)]


def test_nodes_whose_launcher_was_killed_end_by_themselves(start: Start, tmp_path: Path) -> None:
    command = start()
    teach(command, tmp_path)
    command.send(SIGKILL)
    assert command.ended(PATIENCE) == -SIGKILL
    command.gone(PATIENCE)
    bag = bag_of(tmp_path)
    assert bag.damage == ''
    assert len(shown_in_bag(bag)) >= SHOWN
