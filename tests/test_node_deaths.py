"""A demo whose nodes die goes on; one that is ended says so, keeps its bag and leaves nothing."""

from collections.abc import Callable, Iterator
import json
from pathlib import Path
import shutil
import signal
from signal import SIGINT, SIGKILL, SIGTERM
import subprocess
from typing import Any

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
    (last,) = [s for s in command.errors.splitlines() if s.startswith('humanopts demo: ')]
    assert [word for word in words if word not in last] == [], command.errors
    assert 'Traceback' not in command.errors
    assert command.running() == {}


def check_survives(command: Command, folder: Path, node: str, how: str) -> dict[str, Any]:
    """The demo does all its work, says which node was started again, and ends with status 1."""
    assert command.ended(3 * PATIENCE) == 1, command.errors
    said = f'the node {node} ended ({how}), and is started again; its '
    assert f'humanopts: {said}' in command.errors
    summed = f'humanopts demo: the node {node} ended once ({how}) and was started again\n'
    assert summed in command.errors
    assert 'Traceback' not in command.errors
    assert command.running() == {}
    found: dict[str, Any] = json.loads((folder / 'out' / 'summary.json').read_text('utf-8'))
    assert [(end['node'], end['how']) for end in found['ended_nodes']] == [(node, how)]
    assert said.split(';')[0] in (folder / f'out/log/{node}.log').read_text('utf-8')
    return found


KILLED = 'by signal SIGKILL'
TEACHING = ['game', 'lesson', 'learner', 'simulated_teacher', 'option_server']
slow = pytest.mark.slow


@pytest.mark.parametrize(
    'node', [pytest.param(n, marks=[] if n == 'game' else slow) for n in TEACHING]
)
def test_a_lesson_survives_the_death_of_a_node(start: Start, tmp_path: Path, node: str) -> None:
    command = start('--episodes', 5, '--budget', 8)
    teach(command, tmp_path)
    command.kill(node, SIGKILL)
    check_survives(command, tmp_path, node, KILLED)
    bag, shown = bag_of(tmp_path), shown_on_disk(tmp_path / 'out')
    assert bag.damage == ''
    assert shown_in_bag(bag) == shown
    assert len({demo.uuid for demo in shown}) == len(shown)
    conductor = [r.message.text for r in bag.messages(['/node_status']) if is_conductor(r)]
    assert f'the node {node} ended ({KILLED}), and is started again; so far {node} 1' in conductor


def is_conductor(recorded: Any) -> bool:
    return bool(recorded.message.node == '/conductor')


@pytest.mark.parametrize(
    'node', ['planner', *(pytest.param(n, marks=slow) for n in ('game', 'option_server'))]
)
def test_a_policy_that_is_played_survives_the_death_of_a_node(
    start: Start, tmp_path: Path, node: str
) -> None:
    command = start('--budget', 12, '--episodes', 20)
    command.until(lambda: 'playing' in command.output, 'the first episode')
    command.kill(node, SIGKILL)
    found = check_survives(command, tmp_path, node, KILLED)
    assert found['execution']['episodes'] == 20
    assert bag_of(tmp_path).damage == ''


@pytest.mark.parametrize('how', [SIGKILL, pytest.param(SIGTERM, marks=slow)])
def test_a_recorder_that_is_started_again_begins_a_bag_with_all_that_was_shown(
    start: Start, tmp_path: Path, how: signal.Signals
) -> None:
    command = start('--episodes', 5, '--budget', 8)
    teach(command, tmp_path)
    command.kill('recorder', how)
    ended = KILLED if how == SIGKILL else 'exit status 0'
    found = check_survives(command, tmp_path, 'recorder', ended)
    first, second = bag_of(tmp_path), open_bag(tmp_path / 'out' / 'bag-2')
    assert f'the recording is in several bags, and has gaps between them: {first.path}' in (
        command.errors
    )
    if how == SIGKILL:
        assert 'not closed' in first.damage or 'cut short' in first.damage
    else:
        assert first.damage == ''
    assert second.damage == ''
    assert second.facts['continues'] == 'bag'
    assert found['bag']['path'] == 'bag-2'
    shown = shown_on_disk(tmp_path / 'out')
    in_first = shown_in_bag(first)
    assert in_first == shown[: len(in_first)]
    assert len(in_first) >= SHOWN - 1  # the newest may not have been written yet
    assert {demo.uuid: demo for demo in shown_in_bag(second)} == {d.uuid: d for d in shown}
    pauses = [r.message.paused for r in second.messages(['/lesson_state'])]
    assert pauses[-1] == ''


def test_a_node_that_cannot_go_on_is_given_up(start: Start, tmp_path: Path) -> None:
    command = start()
    teach(command, tmp_path)
    shutil.rmtree(tmp_path / 'out' / 'options')
    (tmp_path / 'out' / 'options').write_text('')
    command.kill('learner', SIGKILL)
    check_end(command, 'the node learner ended', 'while it was needed')
    assert 'options' in command.errors


@pytest.mark.parametrize('how', [SIGINT, pytest.param(SIGTERM, marks=slow)])
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
