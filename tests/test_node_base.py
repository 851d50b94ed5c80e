"""What every node shares: one line for bad parameters, a status, restarts, a clean end."""

import ctypes
import itertools
import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from graph_support.live import (
    GAME,
    Graph,
    LEARNER,
    LESSON,
    OPTION_SERVER,
    PLANNER,
    RECORDER,
    TEACHER,
)
from graph_support.machine import Machine
from humanopts_interfaces.msg import GameState, LearningStatus, NodeStatus
from humanopts_interfaces.srv import SetPace
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT, LATCHED
from humanopts_ros.senders import id_topic
from humanopts_ros.workarounds import MemoryReturn, reset_postponed
from humanopts_teach.bags.reader import open_bag
import psutil
import pytest
from rcl_interfaces.msg import Log
from rclpy.timer import Timer
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

STARTING, READY, STOPPING = (
    NodeStatus.STATE_STARTING, NodeStatus.STATE_READY, NodeStatus.STATE_STOPPING,
)  # fmt: skip
ALL = (GAME, LEARNER, LESSON, OPTION_SERVER, PLANNER, RECORDER, TEACHER)
BLOCK = 65536  # bytes
WRONG: list[tuple[str, dict[str, Any], str]] = [
    *((node, {'seed': -1}, 'seed') for node in (LEARNER, LESSON, OPTION_SERVER, TEACHER)),
    *((node, {'expect_recorder': 3}, 'expect_recorder') for node in ALL),
    (LEARNER, {'return_share': -1.0}, 'return_share'),
    (LEARNER, {'initiation_error': 1.5}, 'initiation_error'),
    (OPTION_SERVER, {'no_progress_seconds': 0.0}, 'no_progress_seconds'),
    (RECORDER, {'path': ''}, 'path'),
]


@pytest.mark.parametrize(
    ('node', 'parameters', 'name'), WRONG, ids=[f'{n.partition(":")[2]}-{p}' for n, _, p in WRONG]
)
def test_a_parameter_that_cannot_be_is_named(
    shared: Graph, node: str, parameters: dict[str, Any], name: str
) -> None:
    assert shared.refused(node, '/wrong', **parameters).startswith(f'parameter {name}: ')


BURST = 50  # calls at once

# A node that does nothing, called as its first argument says.
PLAIN = """
import sys
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node

sys.exit(run_node(lambda: NodeBase(sys.argv[1])))
"""


def test_memory_that_is_free_is_given_back_when_it_is_time_to() -> None:
    libc, blocks, now = ctypes.CDLL(None), 1000, 0.0
    libc.malloc.restype = ctypes.c_void_p

    def memory() -> int:
        return psutil.Process().memory_info().rss

    give_back = MemoryReturn(lambda: now)
    give_back()
    taken = [ctypes.c_void_p(libc.malloc(BLOCK)) for _ in range(blocks)]
    for block in taken:
        ctypes.memset(block, 1, BLOCK)
    most = memory()
    for block in taken[:-1]:  # the last keeps those before it from being given back by themselves
        libc.free(block)
    give_back()
    assert memory() > most - blocks * BLOCK // 2
    now += 5.0
    give_back()
    assert memory() < most - blocks * BLOCK // 2
    libc.free(taken[-1])


def test_a_timer_whose_next_call_was_put_off_is_called_after_its_period(live: Graph) -> None:
    late, right, stopped = (live.node.create_timer(60.0, lambda: None) for _ in range(3))
    stopped.cancel()

    def left(timer: Timer) -> float:
        return timer.time_until_next_call() / 1e9

    for _ in range(50):
        late.handle.call_timer()
    assert left(late) > 2000.0
    before = left(right)
    reset_postponed(live.node)
    assert left(late) <= 60.0
    assert left(right) < before
    assert stopped.is_canceled()


def test_a_node_goes_on_and_ends_although_the_time_of_day_is_set_back(
    live: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = Machine(tmp_path)
    for name, value in machine.environment.items():
        monkeypatch.setenv(name, value)
    said = live.listen(Log, '/rosout', LATCHED)
    game = live.spawn(GAME)
    planner = live.spawn(PLANNER)  # none of its timers runs
    live.ready('/game', '/planner')
    machine.set_time(-3600.0)
    live.until(
        lambda: (
            {m.name for m in said if 'the time of day was set by -3600.' in m.msg}
            >= {'game', 'planner'}
        ),
        'both to report it',
    )
    assert {game.kill(signal.SIGTERM), planner.kill(signal.SIGTERM)} == {0}


def test_a_node_that_cannot_start_says_so_in_one_line_and_ends_with_2(shared: Graph) -> None:
    wrong = shared.spawn(GAME, '/wrong', seed=-1)
    malformed = shared.run(['-c', PLAIN, '--ros-args', '-p', 'seed'], 'plain')
    for process in (wrong, malformed):
        process.expected = {2}
        assert process.ended() == 2
    (line,) = wrong.said().splitlines()
    assert line.startswith('humanopts: parameter seed')
    line = malformed.said().splitlines()[-1]  # rcl may have said something before
    assert line.startswith('humanopts: ROS cannot start: ')
    assert 'seed' in line


def test_a_node_that_the_middleware_holds_up_ends_all_the_same(shared: Graph) -> None:
    code = (
        'import sys, time\n'
        'from humanopts_ros import node_base, process, workarounds\n'
        'class Held(node_base.NodeBase):\n'
        '    def destroy_node(self):\n'
        '        time.sleep(60)\n'
        'workarounds._LEAVING = 1\n'
        "sys.exit(process.run_node(lambda: Held('held')))\n"
    )
    shared.watch('/')
    held = shared.run(['-c', code], 'held')
    shared.ready('/held')
    assert held.kill(signal.SIGTERM) == 0
    assert held.process.returncode == -signal.SIGALRM
    shared.until(lambda: shared.state('/held') == STOPPING, 'its last status')


@pytest.mark.parametrize(('longest', 'status'), [(0.0, 1), (60.0, 0)])
def test_a_node_that_was_stopped_for_too_long_ends_and_says_so(
    shared: Graph, longest: float, status: int
) -> None:
    name = f'stopped_{status}'
    code = f'from humanopts_ros import workarounds\nworkarounds.MAX_PAUSE = {longest}\n{PLAIN}'
    shared.watch('/')
    node = shared.run(['-c', code, name], name)
    node.expected = {0, 1}
    shared.ready(f'/{name}')
    node.pause()
    node.go_on()
    if status:
        assert node.ended() == status
        assert 'other nodes may have lost it' in node.said()
    else:
        assert node.kill(signal.SIGTERM) == status


def test_a_node_publishes_its_life_and_ends_cleanly(shared: Graph) -> None:
    shared.watch('/')
    # SIGTERM ends the nodes of every launch
    processes = {
        how: shared.run(['-c', PLAIN, how.name.lower()], how.name)
        for how in (signal.SIGINT, signal.SIGHUP)
    }
    for how, process in processes.items():
        node = f'/{how.name.lower()}'
        shared.ready(node)
        assert process.kill(how) == 0
        (line,) = process.said().splitlines()
        assert line.endswith(': ready')
        shared.until(lambda n=node: shared.state(n) == STOPPING, 'its last status')
        life = shared.statuses[node]
        whole = [(1, STARTING), (2, READY), (3, STOPPING)]
        # What was replaced before it was found is left out.
        assert [(s.sequence, s.state) for s in life] == whole[-len(life) :]
        (publisher_id,) = {s.publisher_id for s in life}
        assert publisher_id.startswith(f'{node}#')


def test_a_node_that_waits_for_the_game_is_starting(shared: Graph) -> None:
    shared.start(PLANNER, '/lonely')
    shared.until(lambda: '/lonely/planner' in shared.statuses, 'its status')
    assert shared.state('/lonely/planner') == STARTING
    with shared.hurried():
        shared.until(lambda: shared.statuses['/lonely/planner'][-1].text, 'what it waits for')
    assert shared.statuses['/lonely/planner'][-1].text == 'waits for domain_info'


def test_nothing_happens_before_the_recorder_is_there_and_then_all_of_it_is_in_the_bag(
    live: Graph, tmp_path: Path
) -> None:
    states = live.listen(GameState, 'current_state', CURRENT)
    game = live.start(GAME, expect_recorder=True)
    live.until(lambda: live.state('/game') == STARTING, 'the game to start')
    assert states == []
    recorder = live.start(RECORDER, path=tmp_path / 'bag')
    live.ready('/game', '/recorder')
    live.until(lambda: states, 'the first state')
    live.stop(game)
    live.stop(recorder)
    recorded = [r.message for r in open_bag(tmp_path / 'bag').messages()]
    of_game = [m for m in recorded if getattr(m, 'publisher_id', '').startswith('/game#')]
    sequences: dict[str, list[int]] = {}
    for message in of_game:
        sequences.setdefault(type(message).__name__, []).append(message.sequence)
    assert sequences == {
        'NodeStatus': [1, 2, 3],
        'DomainInfo': [1],
        'ControlState': [1],
        'GameState': [1, 1],  # on game_state and on current_state
    }


FAULTY = """
import sys
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node

class Faulty(NodeBase):
    def on_ready(self):
        raise ZeroDivisionError('this was unexpected')

    def close(self):
        print('closed')

sys.exit(run_node(lambda: Faulty('faulty')))
"""


def test_an_unexpected_error_closes_the_node_and_shows_the_traceback(domain_id: int) -> None:
    ended = subprocess.run(
        [sys.executable, '-c', FAULTY],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout) == (1, 'closed\n')
    assert 'Traceback' in ended.stderr
    assert ended.stderr.splitlines()[-1] == 'ZeroDivisionError: this was unexpected'


def test_a_server_that_is_found_after_the_call_still_answers(live: Graph) -> None:
    asker = live.start(LISTENER)

    def ask(name: str, seconds: float) -> Any:
        client = asker.create_client(Trigger, name)
        return asker.executor.create_task(asker.waiting.answer(client, Trigger.Request(), seconds))

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = 'here'
        return response

    late = ask('late', 20.0)
    for _ in range(3):
        live.spin()
    assert not late.done()
    live.node.create_service(Trigger, 'late', answer)
    live.until(late.done, 'the answer')
    assert late.result().message == 'here'
    unanswered = ask('nobody', 0.2)
    live.until(unanswered.done, 'the end of its wait')
    assert unanswered.result() is None


def test_a_burst_of_calls_loses_no_request_and_no_answer(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    lesson = live.start(LESSON, directory=live.folder / 'demonstrations')
    live.ready('/game', '/lesson')
    client = lesson.recorded_client(SetPace, 'set_pace')
    live.until(client.service_is_ready, 'its server')
    with live.silent('/lesson'):
        awaited = client.call_async(SetPace.Request())
        with live.silent('/game'):
            calls = [live.request(SetPace, 'set_pace') for _ in range(BURST)]
        live.until(lambda: all(call.done() for call in calls), 'an answer to each of the others')
    live.until(awaited.done, 'an answer that came before them')
    assert awaited.result().status == calls[0].result().status


def test_a_condition_that_held_for_a_moment_is_waited_for_again(live: Graph) -> None:
    node = live.start(GAME, domain='taxi')
    looks = iter([False, True, False, False])  # and from then on it holds
    task = node.executor.create_task(node.waiting.until, lambda: next(looks, True), 20.0)
    live.until(task.done, 'its end')
    assert task.result() is True
    task = node.executor.create_task(node.waiting.until, lambda: False, 0.1)
    live.until(task.done, 'its end')
    assert task.result() is False


def test_a_restart_is_seen_when_the_node_begins_and_when_it_is_ready_unless_it_is_forged(
    live: Graph,
) -> None:
    watcher = live.start(LISTENER, '/room')
    found: list[str] = []
    watcher.peers.on_restart.append(found.append)
    out = live.node.create_publisher(NodeStatus, '/room/node_status', CURRENT)
    live.until(out.get_subscription_count, 'the watcher to listen')
    number = itertools.count()

    def publish(publisher_id: str, state: int, restarts: list[str], name: str = '') -> None:
        found.clear()
        last = str(next(number))
        for signed, text in ((publisher_id, ''), ('/room/last#1', last)):
            node = name or signed.partition('#')[0]
            out.publish(NodeStatus(node=node, publisher_id=signed, state=state, text=text))
            name = ''
        taken = watcher.peers.statuses
        live.until(lambda: 'last' in taken and taken['last'].text == last, 'all to be taken')
        assert found == restarts

    def state_id(publisher_id: str) -> None:
        live.node.create_publisher(Empty, f'/room/{id_topic(publisher_id, "node")}', LATCHED)

    state_id('/room/last#1')
    for part in '123':
        state_id(f'/room/game#{part}')
    publish('/room/game#1', STARTING, [])
    publish('/room/game#1', READY, [])
    publish('/room/game#forged', STARTING, [])
    publish('/room/game#1', STOPPING, [])
    publish('/room/game#2', STARTING, ['game'])
    publish('/room/game#2', READY, ['game'])
    publish('/room/game#2', READY, [])
    publish('/room/game#1', READY, [])  # replaced
    publish('/room/game#3', READY, ['game'])  # its beginning was not heard
    publish('/room/game#3', READY, [], name='/room/lesson')
    publish('/hall/game#2', READY, [])  # of another namespace
    assert watcher.peers.restarts == {'game': 3}
    assert watcher.peers.state('game') == READY


LISTENER = f'{__name__}:Listener'


class Listener(NodeBase):
    """Keeps what the learner publishes of itself."""

    def __init__(self, **options: object) -> None:
        super().__init__('listener', **options)
        self.kept: list[LearningStatus] = []
        self.create_subscription(LearningStatus, 'learning_status', self.kept.append, CURRENT)


def test_what_a_stranger_publishes_displaces_no_current_value_of_the_owner(live: Graph) -> None:
    owner, stranger = (
        live.node.create_publisher(LearningStatus, 'learning_status', LATCHED) for _ in range(2)
    )
    owner.publish(LearningStatus(publisher_id='/learner#1'))
    listener = live.start(LISTENER)
    live.until(lambda: stranger.get_subscription_count() and listener.kept, 'the first value')
    for number in (2, 3):  # nothing is taken meanwhile
        owner.publish(LearningStatus(publisher_id=f'/learner#{number}'))
        for _ in range(50):
            stranger.publish(LearningStatus(publisher_id='/stranger#1'))
    live.until(lambda: listener.guard.refused == 100, 'all to be taken')
    assert [status.publisher_id[-2:] for status in listener.kept] == ['#1', '#2', '#3']
