"""The node world with a robot in plain rclpy: what moves it, what stops it, what is said."""

from collections.abc import Iterator
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from graph_support.live import (
    Goal,
    Graph,
    JOY,
    KEYBOARD,
    NodeProcess,
    open_graph,
    OPTION_SERVER,
    TEACHER,
    WORLD,
)
from graph_support.player import MACHINE, ME, PERSON, Player
from graph_support.robot import Robot, WORLD_FILE
from humanopts_env.ros.interfaces import filled
from humanopts_env.worlds.sensors import planar
from humanopts_env.worlds.world_file import Place, WorldFileError
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ActionProgress,
    ActionRefusal,
    ControlState,
    DomainInfo,
    GameState,
    NodeStatus,
    OptionResult,
)
from humanopts_interfaces.srv import ResetGame
from humanopts_ros.liveliness import Liveliness
from humanopts_ros.qos import CURRENT, LATCHED, LIVELY
from humanopts_ros.senders import id_topic
from nav_msgs.msg import Path as Path_
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

DRIVER = Path(__file__).parent / 'graph_support/driver.py'
LATE = 0.5  # s within which the robot stands after a fault


def elapse(graph: Graph, seconds: float) -> None:
    until = time.monotonic() + seconds
    graph.until(lambda: time.monotonic() > until, f'{seconds} s')


class Course:
    """A robot, its world, and who plays in it."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.robot = graph, Robot(graph)
        self.world = graph.start(WORLD, world=self.robot.file())
        graph.ready('/world')
        self.player = Player(graph)
        self.progress: list[ActionProgress] = graph.listen(
            ActionProgress, 'action_progress', CURRENT
        )
        graph.until(lambda: self.progress, 'the progress')

    def fresh(self) -> None:
        """Begin an episode at x = 2, enabled by this player, with nothing wrong."""
        robot = self.robot
        robot.silent.clear()
        robot.x, robot.speed, robot.blind = 2.0, 0.0, False
        robot.accepts = robot.grips = True
        robot.hold(False)
        game = self.world._game
        self.graph.until(lambda: not (game.paused or game.outside), 'nothing to be wrong')
        self.graph.until(lambda: not game.under_way, 'the end of an action')
        self.player.hold(True)
        self.player.hold(False)
        self.player.reset()
        robot.twists.clear()
        robot.goals.clear()
        robot.canceled = 0

    def begin(self, action: str, source: int = MACHINE, **fields: Any) -> None:
        """Send a command that begins an action."""
        self.player.send(self.player.command(action, source, **fields))
        self.graph.until(lambda: self.progress[-1].action == action, f'{action} to begin')

    def ended(self, seconds: float = 20.0) -> GameState:
        """Wait for the state after the action under way."""
        self.graph.until(lambda: not self.progress[-1].action, 'the end of the action', seconds)
        return self.newest()

    def newest(self) -> GameState:
        """Return the newest state that led somewhere."""
        return [s for s in self.player.states if not s.refreshed][-1]

    def stands(self, why: str) -> float:
        """Wait until the robot stands because of a fault, and return the seconds that it took."""
        return self.graph.until(lambda: self.progress[-1].stopped.startswith(why), why)

    def refused(self, action: str = 'forward', source: int = MACHINE) -> tuple[int, str]:
        """Return why a command is refused."""
        answer = self.player.do(action, source)
        assert isinstance(answer, ActionRefusal), answer
        return answer.reason, answer.detail


@pytest.fixture(scope='module')
def shared_course(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Course]:
    with open_graph(tmp_path_factory.mktemp('world')) as graph:
        yield Course(graph)


@pytest.fixture
def course(shared_course: Course) -> Course:
    shared_course.fresh()
    return shared_course


def test_a_robot_is_a_described_world_that_nothing_has_moved(shared_course: Course) -> None:
    graph, robot = shared_course.graph, shared_course.robot
    info = graph.listen(DomainInfo, 'domain_info', CURRENT)
    graph.until(lambda: info, 'the domain')
    assert (info[0].domain, info[0].parameters) == ('scout', '{}')
    seconds = {a.name: (a.seconds, a.idle) for a in info[0].actions}
    assert seconds['forward'] == (pytest.approx(0.2), False)
    assert seconds['grip'] == (pytest.approx(1.2), False)
    assert shared_course.player.controls[-1].holder == ControlState.HOLDER_LOCKED
    assert [t for t in robot.twists if t] == []
    reason, detail = shared_course.refused()
    assert reason == ActionRefusal.REASON_LOCKED
    assert detail.startswith('no person has enabled the robot: take control and give it back')
    assert [t for t in robot.twists if t] == []


def test_a_key_drives_at_20_hz_for_its_time_and_then_the_robot_stands(course: Course) -> None:
    before = course.newest()
    state = course.player.do('forward', PERSON)
    course.graph.until(lambda: course.robot.stands, 'the end of the twist')
    driven = [t for t in course.robot.twists if t]
    assert set(driven) == {0.5}
    assert 1 < len(driven) <= 5  # some may be missed where the machine is busy
    assert (state.step, state.previous_action, state.cut_short) == (1, 'forward', False)
    assert state.reward == -1.0
    assert 0.02 < state.features[0] - before.features[0] < 0.2
    assert state.state.startswith(f'x {state.features[0]:.4g} m, charger ')
    assert course.player.controls[-1].holder_id == ME
    course.robot.twists.clear()
    with course.graph.hurried(0.2):  # five times as long: none is missed
        course.player.do('forward', PERSON)
    course.graph.until(lambda: course.robot.stands, 'the end of the twist')
    assert len([t for t in course.robot.twists if t]) in (4, 5)


def test_a_machine_drives_after_a_person_has_enabled_it(course: Course) -> None:
    assert course.player.controls[-1].supervisor_id == ME
    state = course.player.do('back')
    assert (state.step, state.action_source) == (1, MACHINE)
    assert isinstance(course.player.do('forward'), GameState)


def test_while_an_action_lasts_another_command_is_late_and_a_stop_ends_it(course: Course) -> None:
    course.begin('go')
    assert course.refused()[0] == ActionRefusal.REASON_STALE
    course.player.send(course.player.command(''))
    state = course.ended()
    assert (state.previous_action, state.cut_short) == ('go', True)
    course.graph.until(lambda: course.robot.canceled, 'the goal to be canceled')


def test_a_person_stops_it_and_takes_control(course: Course) -> None:
    course.begin('go')
    course.player.send(course.player.command('', PERSON))
    assert course.ended().cut_short
    course.graph.until(lambda: course.player.controls[-1].holder_id == ME, 'control')


def test_a_goal_of_an_action_server_is_followed_to_its_end(course: Course) -> None:
    course.begin('go')
    course.graph.until(lambda: course.robot.goals, 'the goal')
    goal = course.robot.goals[0].request
    assert (goal.option_name, goal.max_steps) == ('charger', 7)
    course.graph.until(lambda: 'step count 3' in course.progress[-1].feedback, 'feedback')
    course.robot.ended.set_result('succeed')
    state = course.ended()
    assert (state.previous_action, state.cut_short) == ('go', False)
    course.graph.until(lambda: course.progress[-1].feedback == '/go succeeded', 'how')
    assert course.robot.canceled == 0


@pytest.mark.parametrize('how', ['abort', 'reject'])
def test_a_goal_that_fails_cuts_the_step_short(how: str, course: Course) -> None:
    course.robot.accepts = how != 'reject'
    course.player.send(course.player.command('go'))
    if how == 'abort':
        course.graph.until(lambda: course.robot.goals, 'the goal')
        course.robot.ended.set_result('abort')
    course.graph.until(lambda: course.newest().step, 'the state')
    assert course.newest().cut_short
    text = '/go aborted' if how == 'abort' else '/go rejected the goal'
    course.graph.until(lambda: course.progress[-1].feedback == text, 'why')


def test_an_action_server_that_never_answers_is_given_up_at_the_deadline(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        course = Course(graph)
        course.robot.accepts = None
        began = time.monotonic()
        course.begin('go', PERSON)
        assert course.ended(2.5).cut_short
        assert time.monotonic() - began > 1.8
        assert isinstance(course.player.do('forward', PERSON), GameState)


def test_what_is_not_there_is_refused_at_once(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        robot = Robot(graph)
        text = WORLD_FILE.replace('/grip,', '/nowhere,').replace('/go,', '/away,')
        graph.start(WORLD, world=robot.file(text))
        graph.ready('/world')
        player = Player(graph)
        for action, what in (('grip', 'service /nowhere'), ('go', 'action server /away')):
            answer = player.do(action, PERSON)
            assert answer.reason == ActionRefusal.REASON_FAILED
            assert answer.detail == f'the {what} is not there'


def test_a_service_is_called_and_its_effect_is_awaited(course: Course) -> None:
    state = course.player.do('grip')
    assert (state.cut_short, state.features[3]) == (False, 1.0)
    course.robot.grips = False
    state = course.player.do('grip')
    assert (state.cut_short, state.features[3]) == (True, 0.0)
    course.graph.until(
        lambda: course.progress[-1].feedback == '/grip: nothing is between the fingers', 'why'
    )


def test_a_message_is_published_once(course: Course) -> None:
    before = course.robot.beeps
    assert course.player.do('beep').step == 1
    course.graph.until(lambda: course.robot.beeps == before + 1, 'the beep')


def test_a_robot_that_is_pushed_publishes_its_step_again(course: Course) -> None:
    course.robot.x = 4.0
    course.graph.until(lambda: course.player.state.refreshed, 'the step again')
    state = course.player.state
    assert (state.step, state.features[0]) == (0, 4.0)
    assert isinstance(course.player.do('wait'), GameState)


def test_the_charger_ends_the_episode_and_the_next_begins_there(course: Course) -> None:
    course.robot.x = 6.69
    course.graph.until(lambda: course.player.state.features[0] == 6.69, 'it to be pushed')
    with course.graph.hurried(0.5):  # twice as long: a busy machine moves it far enough, too
        state = course.player.do('forward')
    assert (state.terminated, state.reward) == (True, 4.0)
    refused = course.player.reset('x 3')
    assert refused.status == ResetGame.Response.STATUS_BAD_STATE
    assert refused.detail == 'scout can only begin where the robot is: drive it to another start'
    begun = course.player.reset()
    assert begun.state.startswith('x 6.')
    assert not course.player.do('back').terminated


# Options


@pytest.fixture(scope='module')
def served(shared_course: Course) -> Course:
    shared_course.graph.start(OPTION_SERVER)
    shared_course.graph.ready('/option_server')
    return shared_course


def run(course: Course) -> Goal:
    """Begin the action that takes seconds, as an option."""
    goal = course.graph.act(ExecuteOption, 'execute_option', option_name='action:go')
    course.graph.until(lambda: course.robot.goals, 'the goal')
    return goal


def test_a_canceled_option_cancels_what_the_robot_does(served: Course, course: Course) -> None:
    goal = run(course)
    course.graph.until(lambda: goal.feedback, 'feedback while it lasts')
    assert goal.feedback[-1].action == 'go'
    goal.cancel()
    _, result = goal.result()
    assert (result.status, result.step_count) == (OptionResult.STATUS_CANCELED, 1)
    course.graph.until(lambda: course.robot.canceled, 'the goal to be canceled')
    assert course.newest().cut_short


def test_an_option_whose_action_is_cut_short_says_why(served: Course, course: Course) -> None:
    for how, why in (
        (lambda: course.robot.ended.set_result('abort'), '/go aborted'),
        (lambda: course.graph.ask(Trigger, 'stop'), 'the service stop was called'),
    ):
        goal = run(course)
        how()
        _, result = goal.result()
        assert result.status == OptionResult.STATUS_INTERRUPTED
        assert result.detail == f'it was interrupted: go was stopped before its end: {why}'
        course.robot.goals.clear()


def test_an_option_of_a_locked_robot_is_rejected(served: Course, course: Course) -> None:
    assert course.graph.ask(Trigger, 'stop').success
    course.graph.until(
        lambda: not course.graph.accepts(ExecuteOption, 'execute_option', option_name='action:go'),
        'the lock',
    )


# Faults


def test_the_service_stop_locks(course: Course) -> None:
    course.begin('go')
    assert course.graph.ask(Trigger, 'stop').success
    assert course.ended().cut_short
    assert course.player.controls[-1].holder == ControlState.HOLDER_LOCKED
    assert course.refused()[0] == ActionRefusal.REASON_LOCKED


@pytest.mark.parametrize('qos', [LATCHED, 10], ids=['latched', 'volatile'])
def test_the_emergency_stop_locks_and_refuses_even_a_person(qos: Any, course: Course) -> None:
    pressed = course.graph.node.create_publisher(Bool, '/emergency_stop', qos)
    course.graph.until(lambda: pressed.get_subscription_count() > 0, 'the world to listen')
    course.begin('go')
    pressed.publish(Bool(data=True))
    course.stands('the emergency stop is pressed')
    assert course.newest().cut_short
    assert course.refused('forward', PERSON) == (
        ActionRefusal.REASON_PAUSED,
        'the emergency stop is pressed',
    )
    pressed.publish(Bool(data=False))
    course.graph.until(lambda: not course.progress[-1].stopped, 'the end of the emergency')
    assert course.refused()[0] == ActionRefusal.REASON_LOCKED
    course.graph.node.destroy_publisher(pressed)


def break_scan(robot: Robot) -> None:
    robot.silent.add('scan')


def break_beam(robot: Robot) -> None:
    robot.blind = True


FAULTS = {
    'stale': (break_scan, '/scan is stale: its last message is 0.'),
    'nan': (break_beam, 'the feature ahead cannot be read: a range of the scan is nan'),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_a_sensor_that_fails_stops_the_robot_with_one_sentence(fault: str, course: Course) -> None:
    break_it, sentence = FAULTS[fault]
    course.begin('go')
    before = course.newest()
    break_it(course.robot)
    assert course.stands(sentence) < LATE + 0.2  # as long as a scan may be old, and a check
    state = course.newest()
    assert (state.previous_action, state.cut_short) == ('go', True)
    assert state.features[0] == pytest.approx(before.features[0], abs=0.2)
    status = course.graph.statuses['/world']
    course.graph.until(lambda: status[-1].state == NodeStatus.STATE_PAUSED, 'the status')
    assert status[-1].text.startswith(sentence)
    assert course.refused()[1].startswith(sentence)
    course.fresh()
    assert isinstance(course.player.do('forward'), GameState)


def test_out_of_the_range_of_a_feature_only_a_person_drives(course: Course) -> None:
    course.begin('go')
    course.robot.x = 8.5
    sentence = 'the feature x is out of its range 0 to 8: it is 8.5; only a person can drive it'
    course.stands(sentence)
    assert (course.newest().previous_action, course.newest().cut_short) == ('go', True)
    assert course.refused('forward', MACHINE)[1].startswith(sentence)
    out = course.player.do('forward', PERSON)
    assert not out.cut_short
    assert (out.features[0], '; the feature x is out of its range' in out.state) == (8.0, True)
    course.robot.x = 7.5
    course.graph.until(lambda: not course.progress[-1].stopped, 'its return')
    course.player.hold(False)
    back = course.player.do('forward', MACHINE)
    assert 'out of its range' not in back.state


@pytest.mark.parametrize('how', [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize('source', [MACHINE, PERSON])
def test_a_driver_that_dies_or_stops_stops_the_robot(
    source: int, how: signal.Signals, course: Course
) -> None:
    driver = course.graph.run(
        [str(DRIVER), '--ros-args'], 'driver', {'source': source, 'action': 'forward'}
    )
    course.graph.until(lambda: course.newest().step > 3, 'it to drive')
    elapse(course.graph, 0.5)  # its liveliness is watched
    if how == signal.SIGKILL:
        driver.kill(how)
    else:
        driver.pause()
    course.graph.until(
        lambda: course.robot.stands and not course.progress[-1].action,
        'the robot to stand',
        LATE + 0.1,
    )
    if source == PERSON:
        locked = ControlState.HOLDER_LOCKED
        course.graph.until(lambda: course.player.controls[-1].holder == locked, 'the lock')
        assert course.player.controls[-1].reason.endswith('was not heard for 0.25 s')
    if how == signal.SIGSTOP:
        driver.kill(signal.SIGKILL)


def test_a_supervisor_that_dies_stops_what_the_machine_does(course: Course) -> None:
    driver = course.graph.run(
        [str(DRIVER), '--ros-args'], 'driver', {'source': PERSON, 'action': 'wait'}
    )
    course.graph.until(lambda: course.player.controls[-1].holder_id.startswith('/driver'), 'it')
    holder = course.player.controls[-1].holder_id
    course.player.hold(False, holder)  # its key may take it again
    elapse(course.graph, 0.5)  # its liveliness is watched
    driver.kill(signal.SIGKILL)
    locked = ControlState.HOLDER_LOCKED
    course.graph.until(lambda: course.player.controls[-1].holder == locked, 'the lock', 1.0)


def test_a_node_is_lost_even_if_the_middleware_never_said_that_it_was_alive(
    course: Course,
) -> None:
    """Fast DDS does not say it to the second subscription of a process."""
    driver = course.graph.run([str(DRIVER), '--ros-args'], 'driver', {'source': PERSON})
    course.graph.until(lambda: course.player.controls[-1].holder_id.startswith('/driver'), 'it')
    holder, lost = course.player.controls[-1].holder_id, list[str]()
    elapse(course.graph, 0.5)
    second = Liveliness(course.world, 'node', lost.append)
    second.watch(holder)
    elapse(course.graph, 0.5)
    second.watch()  # it is still on the graph
    driver.pause()
    course.graph.until(lambda: lost == [holder], 'its loss', LATE)
    driver.go_on()
    course.graph.until(lambda: not second.lost, 'its return', 2.0)
    assert lost == [holder]
    driver.kill(signal.SIGKILL)
    course.graph.until(lambda: len(lost) == 2, 'its end')


def test_two_worlds_in_one_namespace_both_stand(course: Course) -> None:
    me = course.player.state.publisher_id
    other = course.graph.spawn(WORLD, world=course.robot.file())
    course.stands('two worlds in one namespace: stop this one or /world#')
    reasons = (
        ActionRefusal.REASON_PAUSED,
        ActionRefusal.REASON_LOCKED,
    )  # of this world and the other
    assert course.refused()[0] in reasons
    elapse(course.graph, 0.5)  # its liveliness is watched
    other.kill(signal.SIGKILL)
    course.graph.until(lambda: not course.progress[-1].stopped, 'the other to be gone', 5.0)
    assert [s.publisher_id for s in course.player.states if s.publisher_id != me] == []
    assert isinstance(course.player.do('forward'), GameState)


def test_two_worlds_in_two_namespaces_do_not_drive_one_robot(course: Course) -> None:
    other = course.graph.spawn(WORLD, '/second', world=course.robot.file())
    course.stands('two worlds drive one robot: stop this one or /second/world')
    assert other.kill(signal.SIGTERM) == 0
    course.graph.until(lambda: not course.progress[-1].stopped, 'the other to be gone', 5.0)


def going(graph: Graph) -> tuple[Robot, NodeProcess, Player]:
    """Return a robot on its way to a goal, with its world in a process of its own."""
    robot = Robot(graph)
    world = graph.spawn(WORLD, world=robot.file())
    graph.ready('/world')
    player = Player(graph)
    player.send(player.command('go', PERSON))
    graph.until(lambda: robot.goals, 'the goal')
    return robot, world, player


def test_a_process_of_its_own_acts_and_stops_as_well(tmp_path: Path) -> None:
    """It has another executor than the nodes of a test."""
    with open_graph(tmp_path) as graph:
        robot, world, player = going(graph)
        robot.ended.set_result('succeed')
        graph.until(lambda: player.state.previous_action == 'go', 'its end')
        assert not player.state.cut_short
        assert player.do('grip', PERSON).features[3] == 1.0
        player.hold(False)
        words = [str(DRIVER), '--ros-args'], 'driver'
        driver = graph.run(*words, {'source': PERSON, 'action': 'forward'})
        graph.until(lambda: player.state.step > 4, 'it to drive')
        elapse(graph, 1.0)  # its liveliness is watched
        driver.kill(signal.SIGKILL)
        locked = ControlState.HOLDER_LOCKED
        graph.until(lambda: player.controls[-1].holder == locked, 'the lock', LATE + 0.1)
        assert world.kill(signal.SIGTERM) == 0
        graph.until(lambda: robot.stands, 'the robot to stand')


def test_a_world_that_starts_cancels_what_a_killed_one_began(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        robot, world, _ = going(graph)
        world.kill(signal.SIGKILL)
        assert not robot.canceled
        robot.silent.add('odom')  # so the new one never gets ready
        graph.spawn(WORLD, world=robot.file())
        graph.until(lambda: robot.canceled, 'the goal to be canceled', 40.0)


@pytest.mark.parametrize('node', [WORLD, KEYBOARD, JOY, OPTION_SERVER, TEACHER])
def test_every_node_that_drives_announces_that_it_is_alive(node: str, tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        own = {WORLD: {'world': Robot(graph).file()}, TEACHER: {'options': ['any']}}
        started = graph.start(node, **own.get(node, {}))
        topic = f'/{id_topic(started.publisher_id, started.role)}'
        (announced,) = graph.node.get_publishers_info_by_topic(topic)
        lease = announced.qos_profile.liveliness_lease_duration
        assert lease.nanoseconds == LIVELY.liveliness_lease_duration.nanoseconds < 0.5e9


# Start


OTHER_TYPE = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import String
rclpy.init()
node = Node('other')
publisher = node.create_publisher(String, '/mode', 10)
try:
    rclpy.spin(node)
except rclpy.executors.ExternalShutdownException:
    pass
"""


def waits(graph: Graph) -> str:
    graph.until(lambda: '/world' in graph.statuses, 'its status')
    statuses = graph.statuses['/world']
    with graph.hurried():
        graph.until(lambda: statuses[-1].text, 'what it waits for')
    return statuses[-1].text


def test_it_waits_for_topics_and_says_which(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        robot = Robot(graph)
        robot.silent.add('odom')
        scan = WORLD_FILE.replace('/scan, type', '/scam, type').replace(
            'holds: {topic: /holds', 'holds: {topic: /mode'
        )
        graph.start(WORLD, world=robot.file(scan))
        assert waits(graph) == 'waits for a message on /odom (nav_msgs/msg/Odometry)'
        robot.silent.clear()
        graph.until(lambda: '/scam' in graph.statuses['/world'][-1].text, 'the next')
        assert graph.statuses['/world'][-1].text == (
            'waits for a message on /scam (sensor_msgs/msg/LaserScan): nothing publishes it'
        )


def test_it_waits_for_a_topic_of_another_type_or_that_is_latched(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        robot = Robot(graph)
        graph.run(['-c', OTHER_TYPE], 'other')
        graph.until(lambda: graph.node.count_publishers('/mode'), 'the other type')
        graph.start(WORLD, world=robot.file(WORLD_FILE.replace('/holds', '/mode')))
        assert waits(graph) == (
            'waits for /mode as std_msgs/msg/Bool: it is published as std_msgs/msg/String'
        )
    with open_graph(tmp_path) as graph:
        robot = Robot(graph)
        graph.start(WORLD, world=robot.file(WORLD_FILE.replace(', latched: yes', '')))
        assert waits(graph) == (
            'waits for a message on /holds (std_msgs/msg/Bool): it is latched, add latched: yes'
        )


def test_the_time_of_a_simulator_is_needed_and_used(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        robot = Robot(graph)
        graph.start(WORLD, world=robot.file(WORLD_FILE + 'use_sim_time: yes\n'))
        assert waits(graph) == 'waits for /clock, because use_sim_time is set'
        clock, now = graph.node.create_publisher(Clock, '/clock', 10), Clock()
        running = [True]

        def tick() -> None:
            now.clock.nanosec += 10_000_000 if now.clock.nanosec < 990_000_000 else -990_000_000
            now.clock.sec += now.clock.nanosec == 0
            if running[0]:
                clock.publish(now)

        graph.node.create_timer(0.02, tick)  # half as fast as the time of day
        graph.ready('/world')
        player, began = Player(graph), time.monotonic()
        assert isinstance(player.do('forward', PERSON), GameState)
        assert time.monotonic() - began > 0.35
        running[0] = False
        status = graph.statuses['/world']
        graph.until(lambda: status[-1].state == NodeStatus.STATE_PAUSED, 'the fault')
        assert status[-1].text == 'use_sim_time is set, and no time arrives on /clock'


REFUSED = {
    'no file': ('', 'cannot read'),
    'mistake': ('name: scout', 'scout.yaml: features: '),
    'type': (
        WORLD_FILE.replace('std_msgs/msg/Bool', 'no_msgs/msg/Bool'),
        'the type no_msgs/msg/Bool is not installed: ',
    ),
    'field': (
        WORLD_FILE.replace('holds.data', 'holds.value'),
        "scout.yaml: features holding: holds.value: std_msgs/msg/Bool has no field 'value' there",
    ),
    'goal': (
        WORLD_FILE.replace('max_steps: 7', 'max_stepz: 7'),
        'actions go max_stepz: ExecuteOption_Goal has no such field; it has option_name',
    ),
    'value': (WORLD_FILE.replace('max_steps: 7', 'max_steps: far'), 'actions go max_steps: '),
}


@pytest.mark.parametrize('case', REFUSED)
def test_a_world_that_cannot_be_made_is_refused_with_one_line(case: str, shared: Graph) -> None:
    text, sentence = REFUSED[case]
    path = shared.folder / 'scout.yaml'
    path.write_text(text)
    said = shared.refused(WORLD, world=path if text else shared.folder / 'none.yaml')
    assert sentence in said
    assert '\n' not in said


def test_the_page_names_what_the_node_has_beside_that_of_game(shared_course: Course) -> None:
    page = (Path(__file__).parents[1] / 'docs/reference/graph.md').read_text()
    tables = page.split('## Topics')[1].split('## Nodes')[0]
    rows = [[c.strip(' `') for c in line.split('|')] for line in tables.splitlines()]
    cells = {row[1]: row[2:] for row in rows if len(row) > 4}
    node = shared_course.graph.node
    at = 'world', '/'
    published = {n.strip('/'): t for n, (t,) in node.get_publisher_names_and_types_by_node(*at)}
    served = {n.strip('/'): t for n, (t,) in node.get_service_names_and_types_by_node(*at)}
    of_game = {n for n, row in cells.items() if 'game' in row[-3] or row[-3] in ('all',)}
    wanted = {'action_progress', *of_game} - {'reset_game', 'set_control', 'set_pace'}
    assert wanted <= published.keys()
    assert {'stop', 'reset_game', 'set_control', 'set_pace'} <= served.keys()
    for name in (*wanted, 'stop', 'reset_game'):
        assert cells[name][0] == (published | served)[name], name
    others = {n for n in published if n.startswith('_') is False and '/' not in n} - wanted
    assert others <= {'cmd_vel', 'beep', 'rosout', 'parameter_events'}


def test_messages_are_filled_from_the_values_of_a_file() -> None:
    places = {'charger': Place(x=7, y=2, yaw=1.5)}
    path = {
        'header': {'frame_id': 'map', 'stamp': {'sec': 3}},
        'poses': [{'pose': 'charger'}, {'pose': {'position': {'x': 1}}}],
    }
    message = filled(Path_(), path, places, 'goal')
    first, second = (each.pose for each in message.poses)
    assert (message.header.frame_id, message.header.stamp.sec) == ('map', 3)
    assert planar(first) == pytest.approx((7.0, 2.0, 1.5))
    assert planar(second) == (1.0, 0.0, 0.0)
    joints = filled(JointState(), {'position': [1, 2.5], 'name': ['a', 'b']}, {}, 'message')
    assert [*joints.position] == [1.0, 2.5]
    for values, fault in (
        ({'poses': [{'pose': 'dock'}]}, "goal poses pose: unknown place 'dock'; the file has ch"),
        ({'poses': [{'position': 1}]}, 'goal poses position: PoseStamped has no such field'),
        ({'header': {'frame_id': 5}}, 'goal header frame_id: '),
        ({'header': 5}, 'goal header: '),
        ({'poses': 5}, 'goal poses: '),
    ):
        with pytest.raises(WorldFileError, match=fault):
            filled(Path_(), values, places, 'goal')


def test_values_are_checked_where_messages_are_not() -> None:
    """ROS_PYTHON_CHECK_FIELDS is set in tests only."""
    code = (
        'from humanopts_env.ros.interfaces import filled\n'
        'from std_msgs.msg import Int32\n'
        "filled(Int32(), {'data': 'far'}, {}, 'message')"
    )
    environment = {k: v for k, v in os.environ.items() if k != 'ROS_PYTHON_CHECK_FIELDS'}
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=False
    )
    assert 'WorldFileError: message data: ' in done.stderr
