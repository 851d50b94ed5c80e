"""What every node shares: one plain line for bad parameters, a life that is told, a clean end."""

import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from graph_support.live import (
    GAME,
    Graph,
    KEYBOARD,
    LEARNER,
    LESSON,
    NodeProcess,
    OPTION_SERVER,
    PLANNER,
    RECORDER,
    TEACHER,
)
from humanopts_interfaces.msg import GameState, NodeStatus
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED
from humanopts_teach.bags.reader import open_bag
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

ALL = (GAME, LEARNER, LESSON, OPTION_SERVER, PLANNER, RECORDER, TEACHER)
WRONG: list[tuple[str, dict[str, Any], str]] = [
    *((module, {'seed': -1}, 'parameter seed') for module in (GAME, LEARNER, LESSON)),
    *((module, {'seed': -1}, 'parameter seed') for module in (OPTION_SERVER, TEACHER)),
    *((module, {'expect_recorder': 3}, 'parameter expect_recorder') for module in ALL),
    (LEARNER, {'return_delta': -1.0}, 'parameter return_delta'),
    (LEARNER, {'initiation_error': 1.5}, 'parameter initiation_error'),
    (OPTION_SERVER, {'no_progress_seconds': 0.0}, 'parameter no_progress_seconds'),
    (RECORDER, {'path': ''}, 'parameter path'),
    (KEYBOARD, {}, 'terminal'),
]
MALFORMED = [(GAME, ['-p', 'seed']), (PLANNER, ['--params-file', '/nowhere']), (LEARNER, ['-x'])]


@pytest.fixture(scope='module')
def refused(shared: Graph) -> list[NodeProcess]:
    """Start all of WRONG and MALFORMED, a few at a time."""
    started = []
    for module, parameters, _ in WRONG:
        started.append(shared.start(module, '/wrong', **parameters))
        started[max(0, len(started) - 4)].ended()
    for module, arguments in MALFORMED:
        started.append(shared.run(['-m', module, '--ros-args', *arguments], module))
    for process in started:
        process.expected = {2}
    return started


@pytest.mark.parametrize(
    ('number', 'says'),
    [(n, says) for n, (_, _, says) in enumerate(WRONG)],
    ids=[f'{module.rpartition(".")[2]}-{says}' for module, _, says in WRONG],
)
def test_a_parameter_that_cannot_be_is_refused_in_one_line(
    refused: list[NodeProcess], number: int, says: str
) -> None:
    process = refused[number]
    assert process.ended() == 2
    (line,) = process.said().splitlines()
    assert line.startswith('humanopts: ')
    assert says in line


@pytest.mark.parametrize('number', range(len(MALFORMED)))
def test_arguments_that_ros_cannot_read_are_refused_in_words(
    refused: list[NodeProcess], number: int
) -> None:
    process = refused[len(WRONG) + number]
    assert process.ended() == 2
    line = process.said().splitlines()[-1]  # rcl may have said something before
    assert line.startswith('humanopts: ROS cannot start: ')
    assert MALFORMED[number][1][-1] in line


def test_a_node_tells_its_life_and_ends_cleanly(shared: Graph) -> None:
    lives = []
    for how in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        process = shared.start(GAME, '/living')
        shared.ready('/living/game')
        assert (process.kill(how), process.said()) == (0, '')
        shared.until(
            lambda: shared.state('/living/game') == NodeStatus.STATE_STOPPING, 'its last word'
        )
        lives.append(shared.statuses.pop('/living/game'))
    for life in lives:
        assert [s.state for s in life] == [
            NodeStatus.STATE_STARTING,
            NodeStatus.STATE_READY,
            NodeStatus.STATE_STOPPING,
        ]
        assert [s.sequence for s in life] == [1, 2, 3]
    ids = [{s.publisher_id for s in life} for life in lives]
    assert [len(found) for found in ids] == [1, 1, 1]
    assert len(set.union(*ids)) == 3
    assert all(name.startswith('/living/game#') for name in set.union(*ids))


def test_a_node_that_waits_for_the_game_says_that_it_is_starting(shared: Graph) -> None:
    process = shared.start(PLANNER, '/lonely')
    shared.until(lambda: '/lonely/planner' in shared.statuses, 'its status')
    assert shared.state('/lonely/planner') == NodeStatus.STATE_STARTING
    assert process.kill(signal.SIGTERM) == 0


def test_nothing_happens_before_the_recorder_is_there_and_then_all_of_it_is_in_the_bag(
    live: Graph, tmp_path: Path
) -> None:
    states = live.listen(GameState, 'current_state', LATCHED)
    live.start(GAME, expect_recorder=True)
    live.until(lambda: live.state('/game') == NodeStatus.STATE_STARTING, 'the game to start')
    assert states == []
    recorder = live.start(RECORDER, path=str(tmp_path / 'bag'))
    live.ready('/game', '/recorder')
    live.until(lambda: states, 'the first state')
    game = live.started[0]
    assert (game.kill(signal.SIGTERM), recorder.kill(signal.SIGTERM)) == (0, 0)
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
        raise ZeroDivisionError('nobody expected this')

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
    assert ended.stderr.splitlines()[-1] == 'ZeroDivisionError: nobody expected this'


def test_a_server_that_is_found_after_the_call_still_answers(shared: Graph) -> None:
    rclpy.init(domain_id=shared.domain_id, signal_handler_options=SignalHandlerOptions.NO)
    asker, server, executor = NodeBase('asker'), Node('late_server'), SingleThreadedExecutor()

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = 'here'
        return response

    try:
        executor.add_node(asker)
        client = asker.create_client(Trigger, 'late')
        task = executor.create_task(asker.answer(client, Trigger.Request(), 20.0))
        for _ in range(3):
            executor.spin_once(0.05)
        assert not task.done()
        server.create_service(Trigger, 'late', answer)
        executor.add_node(server)
        executor.spin_until_future_complete(task, 20.0)
        assert task.result().message == 'here'
        nobody = asker.create_client(Trigger, 'nobody')
        task = executor.create_task(asker.answer(nobody, Trigger.Request(), 0.2))
        executor.spin_until_future_complete(task, 20.0)
        assert task.result() is None
    finally:
        executor.shutdown()
        asker.destroy_node()
        server.destroy_node()
        rclpy.shutdown()
