"""Launching: what dies is named, the recorder is the last to go, and places are kept apart."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
import itertools
import json
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import time
from typing import Any

from graph_support.command import Command
from graph_support.live import GAME, Graph, module_of, RECORDER
from humanopts_interfaces.msg import (
    LearnedOption,
    LearningStatus,
    NodeStatus,
)
from humanopts_learner.summary import OptionSummary
from humanopts_ros.qos import CURRENT
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.forks import prepare
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec, Value
from humanopts_teach.lesson.requests import LessonView, Phase, UNKNOWN
from humanopts_teach.ros.conductor import Conductor
import psutil
import pytest

Launch = Callable[..., Launcher]


def spec(name: str, module: str, **parameters: Value) -> ProcessSpec:
    return ProcessSpec(name, module_of(module), parameters)


@pytest.fixture
def live(live: Graph, monkeypatch: pytest.MonkeyPatch) -> Graph:
    """The graph of a test, whose ROS_DOMAIN_ID this process has."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(live.domain_id))
    return live


@pytest.fixture
def launch(live: Graph, tmp_path: Path) -> Iterator[Launch]:
    """Start processes on the graph of the test."""
    launchers = []

    def start(*specs: ProcessSpec, **options: int) -> Launcher:
        launchers.append(Launcher(specs, tmp_path / 'log', **options))
        launchers[-1].start()
        return launchers[-1]

    live.watch('/')
    yield start
    for launcher in launchers:
        launcher.stop()


def death(launcher: Launcher) -> str:
    """Wait until a node is missed, and return what is said of it."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            launcher.check()
        except LaunchError as error:
            return str(error)
        time.sleep(0.02)
    raise AssertionError('no node ended')


def test_a_node_that_ends_is_named_with_its_last_lines(launch: Launch) -> None:
    launcher = launch(spec('game', GAME, domain='chess'))
    first, *_, last = death(launcher).splitlines()  # Fast DDS may have said something, too
    assert first == ('the node game ended (exit status 2) while it was needed; its last lines:')
    assert last.startswith("  humanopts: unknown domain 'chess'; choose from")


def test_a_node_that_was_killed_is_started_again_in_a_limited_number(
    launch: Launch, live: Graph
) -> None:
    launcher = launch(spec('game', GAME), restarts=2)
    gone: list[str] = []
    launcher.on_end = lambda end, instance: gone.append(f'/game#{instance}')
    for count in range(3):
        live.until(lambda n=count: starts(live) == n + 1, 'the next life', 30.0)
        assert [end.again for end in launcher.ends] == [True] * count
        pid = launcher.pid('game')
        os.kill(pid, signal.SIGKILL)
        if count < 2:
            live.until(lambda p=pid: not launcher.check() and launcher.pid('game') != p, 'a start')
    first, *others = death(launcher).splitlines()
    ended = 'the node game ended (by signal SIGKILL)'
    assert first == f'{ended} after 2 restarts in a row while it was needed; its last lines:'
    again = f'  humanopts: {ended}, and is started again'
    assert [line for line in others if line.startswith('  humanopts')] == [again, again]
    assert [end.again for end in launcher.ends] == [True, True, False]
    assert gone == list(dict.fromkeys(s.publisher_id for s in live.statuses['/game']))


def test_a_launch_goes_on_though_nothing_it_writes_can_be_written(
    live: Graph, tmp_path: Path
) -> None:
    out = tmp_path / 'out'
    read, unread = os.pipe()
    os.close(read)
    with (
        Path('/dev/full').open('wb') as full,
        subprocess.Popen(
            [sys.executable, '-m', 'humanopts_teach', *words('/', out)],
            stdin=subprocess.DEVNULL,
            stdout=full,
            stderr=unread,
        ) as command,
    ):
        os.close(unread)
        live.watch('/')
        live.ready('/game', '/conductor')
        resource.prlimit(command.pid, resource.RLIMIT_FSIZE, (0, 0))
        for count in (2, 3):
            (game,) = [
                c
                for c in psutil.Process(command.pid).children(recursive=True)
                if 'game.yaml' in ' '.join(c.cmdline())
            ]
            game.kill()
            live.until(lambda n=count: starts(live) == n, 'the restart', 30.0)
        command.send_signal(signal.SIGINT)
        assert command.wait(30.0) == 1


def starts(live: Graph) -> int:
    """Return how many processes of the game have become ready."""
    ready = [s for s in live.statuses.get('/game', []) if s.state == NodeStatus.STATE_READY]
    return len({status.publisher_id for status in ready})


def test_the_recorder_is_stopped_when_the_others_are_gone(
    launch: Launch, live: Graph, tmp_path: Path
) -> None:
    launcher = launch(
        spec('recorder', RECORDER, path=str(tmp_path / 'bag')),
        spec('game', GAME, expect_recorder=True),
    )
    live.ready('/game')
    assert launcher.stop() == []
    bag = open_bag(tmp_path / 'bag')
    assert bag.damage == ''
    statuses = [r.message for r in bag.messages(['/node_status'])]
    of_game = [s.state for s in statuses if s.node == '/game']
    assert of_game == [
        NodeStatus.STATE_STARTING,
        NodeStatus.STATE_READY,
        NodeStatus.STATE_STOPPING,
    ]
    assert launcher.node_names == []


def test_a_bag_that_could_not_be_ended_is_told(
    launch: Launch, live: Graph, tmp_path: Path
) -> None:
    (tmp_path / 'go.json').write_text('x' * 100_000)
    recorder = spec(
        'recorder', RECORDER, path=str(tmp_path / 'bag'), attach=[str(tmp_path / 'go.json')]
    )
    launcher = launch(recorder)
    live.ready('/recorder')
    resource.prlimit(launcher.pid('recorder'), resource.RLIMIT_FSIZE, (90_000, 90_000))
    (problem,) = launcher.stop()
    assert problem.startswith('the node recorder ended (exit status 1); its last lines:')
    assert f'recording stopped: cannot write to {tmp_path}/bag/bag_0.mcap' in problem
    assert 'was not closed' in open_bag(tmp_path / 'bag').damage


def test_a_bag_that_is_short_is_told_though_another_recorder_took_over(
    live: Graph, tmp_path: Path
) -> None:
    def check() -> None:
        live.spin()
        if len(said) > 1:
            raise LaunchError('the other is there')

    said: list[str] = []
    first = live.start(RECORDER, path=tmp_path / 'first', max_seconds=0.2)
    parameters = {'expect_recorder': True}
    conductor = Conductor('/', parameters, tmp_path / 'first', watch=live.spin)
    conductor.note_start('recorder', first.publisher_id.partition('#')[2])
    conductor.report = said.append
    try:
        conductor.wait_ready(['/recorder'])
        conductor.starting = False
        assert conductor.unrecorded() == ''
        (tmp_path / 'first' / 'metadata.yaml.new').mkdir()
        with pytest.raises(LaunchError, match='recording stopped: cannot write in'):
            conductor.wait(lambda: False, 20.0, 'the end of the recording')
        live.start(RECORDER, path=tmp_path / 'second')
        with pytest.raises(LaunchError, match='the other is there'):
            conductor.run_until_interrupt(check, said.append)
        assert conductor.unrecorded().startswith('recording stopped: cannot write in')
        assert conductor.unrecorded().endswith(f'humanopts bag info {tmp_path}/first')
        assert {line.partition(':')[0] for line in said} == {
            '/recorder is paused',
            'another process runs /recorder in this ROS_DOMAIN_ID and namespace; end it',
        }
    finally:
        conductor.close()


def test_a_launch_that_runs_goes_on_whatever_has_or_claims_the_names_of_its_nodes(
    live: Graph, tmp_path: Path
) -> None:
    """A claim by a message alone is not even reported, also after a node has ended."""
    out = live.node.create_publisher(NodeStatus, 'node_status', CURRENT)
    live.watch('/')

    def forge(state: int) -> None:
        out.publish(NodeStatus(node='/game', publisher_id='/game#another', state=state))

    with Command(words('/', tmp_path), tmp_path, live.domain_id) as command:
        command.until(lambda: 'ready: /game' in command.output, 'the nodes')
        live.ready('/game')
        forge(NodeStatus.STATE_READY)
        command.kill('game', signal.SIGKILL)
        forge(NodeStatus.STATE_PAUSED)
        live.until(lambda: starts(live) == 3, 'the restart', 30.0)  # the forged one, too
        forge(NodeStatus.STATE_STOPPING)
        live.start(GAME)
        live.until(lambda: starts(live) == 4, 'a game beside it')
        command.kill('game', signal.SIGKILL)
        live.until(lambda: starts(live) == 5, 'another restart', 30.0)
        assert 'runs' not in command.errors.replace('another process runs /game', '')
        command.send(signal.SIGINT)
        assert command.ended(30.0) == 1  # as nodes were started again
        assert command.output.endswith('stopped\n')


def test_a_fork_is_what_a_process_of_its_own_would_be(
    live: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'tells.py').write_text(
        'import json, os, signal, sys, time\n'
        'def main():\n'
        "    print(json.dumps([os.getcwd(), os.environ['WHO'], sys.argv[1:4], os.getpgrp()]))\n"
        "    if os.getcwd() == '/':\n"
        '        signal.signal(signal.SIGTERM, lambda *_: os.abort())\n'
        "    print('ready', flush=True)\n"
        '    time.sleep(60)\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    prepare()  # the server does not know what follows
    monkeypatch.setenv('WHO', 'anna')
    (tmp_path / 'here').mkdir()
    monkeypatch.chdir(tmp_path / 'here')
    launcher = Launcher([spec('game', 'tells')], tmp_path)
    log = tmp_path / 'game.log'

    def started() -> list[Any]:
        launcher.start()
        live.until(lambda: log.exists() and log.read_text().endswith('ready\n'), 'the node')
        found: list[Any] = json.loads(log.read_text().partition('\n')[0])
        return found

    pid = (told := started())[-1]
    assert told == [str(tmp_path / 'here'), 'anna', ['--ros-args', '-r', '__ns:=/'], pid]
    assert pid == launcher.pid('game')
    title = Path(f'/proc/{pid}/cmdline').read_bytes().decode()
    assert f'-m tells --ros-args -r __ns:=/ --params-file {tmp_path}/game.yaml' in title
    assert launcher.stop() == []
    (tmp_path / 'here').rmdir()
    assert started()[0] == '/'
    (problem,) = launcher.stop()
    assert problem.startswith('the node game ended (by signal SIGABRT); its last lines:')


def test_no_process_outlives_a_command_that_is_refused_or_killed(
    live: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder := tmp_path / ('temporary' * 10)).mkdir()  # too long for the path of a socket
    monkeypatch.setenv('TMPDIR', str(folder))
    with Command(['up', 'chess'], tmp_path, live.domain_id) as command:
        assert command.ended(30.0) == 2
        command.gone(2.0)
    with Command(words('/', tmp_path / 'out'), tmp_path, live.domain_id) as command:
        command.until(lambda: 'ready: /game' in command.output, 'the nodes')
        command.send(signal.SIGKILL)
        command.gone(10.0)


def test_nodes_end_when_the_server_that_forked_them_is_killed(launch: Launch, live: Graph) -> None:
    launcher = launch(spec('game', GAME))
    live.ready('/game')
    node = psutil.Process(launcher.pid('game'))
    node.parent().kill()
    why = 'its parent process, the fork server, was killed'
    assert death(launcher).startswith(f'the node game ended ({why}) while')
    live.until(lambda: not node.is_running(), 'the end of the node')


def test_a_stopped_node_is_reported_and_a_stopped_server_does_not_block_the_end(
    launch: Launch, live: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    launcher = launch(spec('game', GAME))
    said: list[str] = []
    launcher.report = said.append
    live.ready('/game')
    pid = launcher.pid('game')
    os.kill(pid, signal.SIGSTOP)
    live.until(lambda: not launcher.check() and said, 'a line')
    os.kill(pid, signal.SIGCONT)
    live.until(lambda: not launcher.check() and len(said) > 1, 'another line')
    stopped = f'the node game is stopped; kill -CONT {pid} resumes it'
    assert said == [stopped, 'the node game continues']
    assert launcher.ends == []
    server = psutil.Process(pid).parent()
    server.suspend()
    monkeypatch.setattr('humanopts_teach.launching.launcher._STOP_SECONDS', 0.5)
    assert launcher.stop() == ['game did not stop when asked and was killed']
    live.until(lambda: server.status() == psutil.STATUS_ZOMBIE, 'its end')


def test_what_was_learned_is_known_once_all_of_it_has_come_in_any_order(
    domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))

    conductor = Conductor('/', {'expect_recorder': False}, tmp_path, watch=lambda: None)
    client, world = conductor.client, conductor.client.world

    def receive(topic: str, phase: Phase, sequence: int, uuid: str) -> None:
        if topic == 'lesson_state':
            world.lesson = LessonView(phase, 'p01', option_name='go', last_uuid='second')
        elif topic == 'learned_options':
            conductor.newest_option = LearnedOption(publisher_id='learner', sequence=sequence)
        else:
            client.learning = LearningStatus(publisher_id='learner', options_sequence=sequence)
            world.summaries = [OptionSummary('go', 'p01', last_uuid=uuid)]

    topics = 'lesson_state', 'learned_options', 'learning_status'
    try:
        for order in itertools.permutations(topics):
            world.lesson, world.summaries, client.learning = UNKNOWN, [], None
            conductor.newest_option = LearnedOption()
            for values in ((Phase.LEARNING, 1, 'first'), (Phase.FINISHED, 2, 'second')):
                for topic in order:
                    assert not conductor.knows_learned('go')
                    receive(topic, *values)
            assert conductor.knows_learned('go')
            assert not conductor.knows_learned('another option')
    finally:
        conductor.close()


def test_a_log_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / 'log').write_text('')
    with pytest.raises(LaunchError, match=r'cannot write logs in .*/log'):
        Launcher([spec('game', GAME)], tmp_path / 'log').start()


def words(namespace: str, out: Path, only: str = 'game') -> list[str]:
    """Return the words of a launch."""
    options = ['--no-record', '--only', only, '--out', str(out), '--namespace', namespace]
    return ['up', 'taxi', *options]


def contents(folder: Path) -> dict[Path, bytes]:
    """Return all files of a folder."""
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}


def test_a_launch_refuses_another_in_its_place_and_one_beside_it_where_a_game_runs_already(
    live: Graph,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Launches side by side are in test_browser.py: a graph for each participant."""
    (tmp_path / 'east').mkdir()
    (tmp_path / 'beside').mkdir()
    game = live.start(GAME, '/west')
    renamed = ['--ros-args', '-r', '__node:=simulator', '-r', '__ns:=/north']
    live.run(['-m', module_of(GAME), *renamed], 'simulator')
    for namespace in ('/east', '/north'):
        live.watch(namespace)
    folder = tmp_path / 'east/out'
    with Command(words('/east', folder), tmp_path, live.domain_id) as east:
        east.until(lambda: 'ready: /east/game' in east.output, 'the nodes')
        before = contents(folder)
        monkeypatch.setenv('TMPDIR', str(tmp_path / 'west'))  # no other place for it
        monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path / 'none'))
        live.ready('/west/game', '/east/game', '/north/simulator')
        for namespace, out, only, why in (
            ('/east', 'east/out', 'game', 'already runs game in ROS_DOMAIN_ID'),
            ('/east', 'new', 'lesson,game', 'namespace /east; stop it'),
            ('/west', 'new', 'game', '/west/game already runs in ROS_DOMAIN_ID'),
            ('/north', 'new', 'game', '/north/simulator already runs in ROS_DOMAIN_ID'),
            ('/room', 'east/out', 'game', 'east/out; stop it, or choose another --out'),
        ):
            assert main(words(namespace, tmp_path / out, only)) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert why in line
        after = contents(folder)
        assert after.keys() == before.keys()
        for path, text in before.items():  # its nodes may log more
            assert (after[path][: len(text)] if path.suffix == '.log' else after[path]) == text
        assert not (tmp_path / 'new').exists()
        assert live.node_called('/west/game') is game
        arguments = words('/east', folder, 'lesson')
        with Command(arguments, tmp_path / 'beside', live.domain_id) as beside:
            beside.until(lambda: 'ready: /east/lesson' in beside.output, 'another part of it')
            for part in (beside, east):
                assert part.running()
                part.send(signal.SIGINT)
                assert part.ended(30.0) == 0
                assert part.output.endswith('stopped\n')
                assert part.errors == ''
                part.gone(2.0)


def test_of_launches_that_come_at_once_one_stays(domain_id: int, tmp_path: Path) -> None:
    with ExitStack() as stack:
        commands = []
        for number in range(3):
            (folder := tmp_path / str(number)).mkdir()
            command = Command(words('/', folder / 'out'), folder, domain_id)
            commands.append(stack.enter_context(command))
        (winner,) = [command for command in commands if not _refused(command)]
        winner.until(lambda: 'ready: /game' in winner.output, 'the nodes')
        winner.send(signal.SIGINT)
        assert winner.ended(30.0) == 0
        assert len(list(tmp_path.glob('*/out'))) == 1


def _refused(command: Command) -> bool:
    """Wait until a launch is ready or ends; return whether it was refused."""
    deadline = time.monotonic() + 60.0
    while 'ready' not in command.output and 'already' not in command.errors:
        assert time.monotonic() < deadline, command.errors
        time.sleep(0.05)
    return 'ready' not in command.output and command.ended(30.0) == 2
