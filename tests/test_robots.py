"""The simulated robots of the examples as plain ROS nodes: what they publish and obey."""

from collections.abc import Callable, Iterator
import math
from pathlib import Path
import re
import signal
import time
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, Twist
from graph_support.live import Graph, NodeProcess, open_graph, WORLD
from graph_support.player import PERSON, Player
from humanopts_env.worlds.sensors import Sensors
from humanopts_env.worlds.world import load_world
from humanopts_gripper.simulation import MOTIONS
from humanopts_interfaces.msg import GameState
from humanopts_rover import messages
from humanopts_rover.messages import quaternion, yaw_of
from humanopts_rover.simulation import BEAMS, PLACES, Simulation
from humanopts_rover_interfaces.action import DriveTo
from nav_msgs.msg import Odometry
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, JointState, LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage

EXAMPLES = Path(__file__).parents[1] / 'examples'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Driver:
    """A plain client of the rover."""

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        self.graph = graph
        self.odometry: list[Odometry] = graph.listen(Odometry, 'odom', 10)
        self._twist = graph.node.create_publisher(Twist, 'cmd_vel', 10)
        self._hand = graph.node.create_publisher(PoseStamped, 'carry_to', 10)
        self.process: NodeProcess = graph.run(
            ['-m', 'humanopts_rover.node', '--ros-args'], 'rover', parameters
        )
        graph.until(lambda: self.odometry, 'the rover')
        graph.until(self._twist.get_subscription_count, 'cmd_vel')
        graph.until(self._hand.get_subscription_count, 'carry_to')

    def carry(self, x: float, y: float, yaw: float) -> None:
        to = PoseStamped()
        to.pose.position.x, to.pose.position.y, to.pose.orientation = x, y, quaternion(yaw)
        self._hand.publish(to)
        self.graph.until(lambda: math.dist(self.at()[:2], (x, y)) < 0.05, 'the hand')

    def at(self) -> tuple[float, float, float]:
        pose = self.odometry[-1].pose.pose
        return pose.position.x, pose.position.y, yaw_of(pose.orientation)

    def speed(self) -> float:
        return self.odometry[-1].twist.twist.linear.x

    def command(self, linear: float, angular: float = 0.0) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = linear, angular
        self._twist.publish(twist)

    def drive(self, condition: Callable[[], bool], linear: float, angular: float = 0.0) -> None:
        """Command a speed again and again until something is so."""
        sent = 0.0

        def done() -> bool:
            nonlocal sent
            if time.monotonic() - sent > 0.05:
                self.command(linear, angular)
                sent = time.monotonic()
            return condition()

        self.graph.until(done, 'the drive')

    def set_fault(self, name: str, value: str) -> None:
        given = [Parameter(name, value=value).to_parameter_msg()]
        reply = self.graph.ask(SetParameters, 'rover/set_parameters', parameters=given)
        assert all(result.successful for result in reply.results), reply


@pytest.fixture(scope='module')
def rover(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driver]:
    with open_graph(tmp_path_factory.mktemp('rover')) as graph:
        driver = Driver(graph, seed=1)
        yield driver
        driver.process.kill(signal.SIGKILL)  # as in test_own_robot.py


def goal_at(x: float, y: float, yaw: float) -> PoseStamped:
    goal = PoseStamped()
    goal.header.frame_id = 'odom'
    goal.pose.position.x, goal.pose.position.y, goal.pose.orientation = x, y, quaternion(yaw)
    return goal


def test_it_drives_as_commanded_and_stops_when_no_command_follows(rover: Driver) -> None:
    rover.carry(1.0, 3.5, 0.0)
    rover.drive(lambda: rover.at()[0] > 1.3, 0.3)
    last = rover.odometry[-1].header.stamp
    rover.graph.until(lambda: rover.speed() == 0.0, 'it to stop', 2.0)
    stopped = next(
        o.header.stamp
        for o in rover.odometry
        if o.header.stamp.sec >= last.sec
        and not o.twist.twist.linear.x
        and (o.header.stamp.sec, o.header.stamp.nanosec) > (last.sec, last.nanosec)
    )
    took = stopped.sec - last.sec + (stopped.nanosec - last.nanosec) / 1e9
    assert took < 0.5
    assert rover.at()[1] == pytest.approx(3.5, abs=0.05)


def test_its_sensors_agree_with_each_other(rover: Driver) -> None:
    graph = rover.graph
    scans = graph.listen(LaserScan, 'scan', 10)
    frames = graph.listen(TFMessage, '/tf', 10)
    ways = graph.listen(PointStamped, 'waypoint/charger', 10)
    charge = graph.listen(BatteryState, 'battery', 10)
    rover.carry(3.0, 4.5, 0.0)
    for heard in (scans, frames, ways, charge):
        heard.clear()
        graph.until(lambda h=heard: len(h) > 3, 'messages')
    scan = scans[-1]
    assert len(scan.ranges) == BEAMS
    ahead = round(-scan.angle_min / scan.angle_increment)
    assert scan.ranges[ahead] == pytest.approx(1.0, abs=0.1)
    moved = frames[-1].transforms[0]
    assert (moved.header.frame_id, moved.child_frame_id) == ('odom', 'base_link')
    assert moved.transform.translation.x == pytest.approx(3.0, abs=0.05)
    corner = ways[-1].point
    assert (corner.x, corner.y) == (4.0, 2.5)  # in the door
    assert 0.5 < charge[-1].percentage <= 1.0


def test_doors_are_closed_by_a_service_and_then_no_way_leads_through(rover: Driver) -> None:
    graph = rover.graph
    states = graph.listen(Bool, 'doors/door', LATCHED)
    ways = graph.listen(PointStamped, 'waypoint/charger', 10)
    rover.carry(1.0, 3.5, 0.0)
    assert graph.ask(SetBool, 'doors/door/set', data=False).success
    graph.until(lambda: states and not states[-1].data, 'the closed door')
    place = PLACES['charger'][:2]
    graph.until(lambda: ways and (ways[-1].point.x, ways[-1].point.y) == place, 'no way')
    goal = graph.act(DriveTo, 'drive_to', pose=goal_at(*PLACES['charger']))
    assert goal.result()[1].status == DriveTo.Result.STATUS_NO_PATH
    assert graph.ask(SetBool, 'doors/door/set', data=True).success
    rover.carry(4.0, 2.5, 0.0)
    refused = graph.ask(SetBool, 'doors/door/set', data=False)
    assert (refused.success, refused.message) == (False, 'the rover is in the way of door')


def test_a_goal_is_reached_with_feedback_or_canceled_or_overridden(rover: Driver) -> None:
    graph = rover.graph
    rover.carry(1.0, 3.5, 0.0)
    goal = graph.act(DriveTo, 'drive_to', pose=goal_at(1.6, 3.8, 1.0))
    _, result = goal.result()
    assert result.status == DriveTo.Result.STATUS_REACHED, result.message
    assert rover.at() == pytest.approx((1.6, 3.8, 1.0), abs=0.15)
    remaining = [feedback.distance_remaining for feedback in goal.feedback]
    assert remaining == sorted(remaining, reverse=True)

    goal = graph.act(DriveTo, 'drive_to', pose=goal_at(*PLACES['charger']))
    graph.until(lambda: rover.speed() > 0.1, 'it to drive')
    goal.cancel()
    assert goal.result()[1].status == DriveTo.Result.STATUS_CANCELED
    graph.until(lambda: rover.speed() == 0.0, 'it to stop', 2.0)

    goal = graph.act(DriveTo, 'drive_to', pose=goal_at(*PLACES['charger']))
    graph.until(lambda: rover.speed() > 0.1, 'it to drive')
    rover.command(0.0)
    assert goal.result()[1].status == DriveTo.Result.STATUS_OVERRIDDEN


def test_faults_can_be_switched_on(rover: Driver) -> None:
    graph = rover.graph
    scans = graph.listen(LaserScan, 'scan', 10)
    rover.set_fault('scan_fault', 'nan')
    graph.until(lambda: scans and math.isnan(scans[-1].ranges[0]), 'NaN')
    rover.set_fault('scan_fault', 'stopped')
    known = len(rover.odometry) + 25
    graph.until(lambda: len(rover.odometry) > known, 'odometry')
    last = len(scans)
    graph.until(lambda: len(rover.odometry) > known + 25, 'odometry')
    assert len(scans) == last
    rover.set_fault('scan_fault', 'none')
    graph.until(lambda: len(scans) > last, 'the scan')
    rover.carry(1.0, 3.5, 0.0)
    rover.set_fault('drive_to_fault', 'no_result')
    goal = graph.act(DriveTo, 'drive_to', pose=goal_at(1.6, 3.5, 0.0))
    goal.cancel()
    with pytest.raises(AssertionError):
        goal.result(1.0)
    rover.set_fault('drive_to_fault', 'none')
    assert goal.result()[1].status == DriveTo.Result.STATUS_CANCELED


def test_it_is_carried_to_another_place(rover: Driver) -> None:
    before = rover.at()
    moved = rover.graph.ask(Trigger, 'carry_somewhere')
    assert moved.success
    rover.graph.until(lambda: math.dist(rover.at()[:2], before[:2]) > 0.1, 'the hand')
    assert f'x {rover.at()[0]:.1f}'[:3] == moved.message[:3]


def test_hands_carry_it_and_move_doors(rover: Driver) -> None:
    graph = rover.graph

    def hand(*words: str) -> str:
        process = graph.run(['-m', 'humanopts_rover.hand', *words], 'hand')
        process.expected.add(1)
        graph.until(lambda: process.process.poll() is not None, 'the hand')
        return process.said()

    assert hand('carry', '4.0', '2.5', '0') == ''
    graph.until(lambda: math.dist(rover.at()[:2], (4.0, 2.5)) < 0.05, 'the hand')
    assert hand('close', 'door') == 'the rover is in the way of door\n'
    before = rover.at()
    assert hand('carry') == ''
    graph.until(lambda: math.dist(rover.at()[:2], before[:2]) > 0.1, 'the hand')


def test_at_another_speed_it_publishes_a_clock(live: Graph) -> None:
    driver = Driver(live, seed=1, speed=5.0)
    clock = live.listen(Clock, '/clock', 10)
    live.until(lambda: clock, 'the clock')
    begun = clock[-1].clock
    taken = live.until(lambda: clock[-1].clock.sec >= begun.sec + 3, 'three seconds', 10.0)
    assert taken < 2.5
    assert driver.odometry[-1].header.stamp.sec < 1000
    driver.process.kill(signal.SIGKILL)


def test_the_gripper_moves_by_services_that_answer_at_the_end(live: Graph) -> None:
    process = live.run(['-m', 'humanopts_gripper.node', '--ros-args'], 'gripper', {'seed': 1})
    joints = live.listen(JointState, 'joint_states', 10)
    holding = live.listen(Bool, 'holding', 10)
    at = live.listen(PoseStamped, 'object', 10)
    live.until(lambda: joints and at, 'the gripper')

    def slider() -> float:
        return dict(zip(joints[-1].name, joints[-1].position))['slider']

    while abs(off := at[-1].pose.position.x) > 0.05:
        before = slider()
        assert live.ask(Trigger, 'right' if off > 0 else 'left').success
        known = len(joints)
        live.until(lambda n=known: len(joints) > n + 1, 'the joints')
        assert abs(slider() - before) > 0.05
    assert live.ask(Trigger, 'lower').success
    refused = live.ask(Trigger, 'left')
    assert (refused.success, refused.message) == (False, 'raise the gripper before it travels')
    assert live.ask(Trigger, 'close').success
    live.until(lambda: holding[-1].data, 'the grasp')
    process.kill(signal.SIGKILL)


def test_the_world_file_of_the_rover_reads_what_it_publishes() -> None:
    world = load_world(f'ros:{EXAMPLES}/humanopts_rover/worlds/rover.yaml')
    rover = Simulation(noise=False)
    rover.place(3.0, 4.5, 0.0)
    sensors = Sensors(world.file.topics)
    for name, message in messages.sensed(rover).items():
        sensors.note(name, message, 1.0)
    values = dict(zip(world.file.features, world.sense(sensors).features))
    assert values['x'] == 3.0
    assert values['ahead'] == pytest.approx(1.0)
    assert values['left'] == pytest.approx(0.5)
    assert values['door'] == 1.0
    assert values['charger_bearing'] == pytest.approx(math.atan2(2.5 - 4.5, 4.0 - 3.0))
    assert abs(values['dock_turn']) == pytest.approx(math.pi, abs=1e-4)


def test_the_world_file_and_the_class_on_the_page_can_be_used(tmp_path: Path) -> None:
    page = (EXAMPLES.parent / 'docs/how-to/teach-a-robot.md').read_text('utf-8')
    for kind, file, name in (('yaml', 'robot.yaml', ''), ('python', 'robot.py', ':Crane')):
        (text,) = re.findall(rf'```{kind}\n(.*?)```', page, re.DOTALL)
        (tmp_path / file).write_text(text)
        assert load_world(f'ros:{tmp_path}/{file}{name}').domain.actions


def test_the_world_file_of_the_gripper_can_be_used() -> None:
    world = load_world(f'ros:{EXAMPLES}/humanopts_gripper/worlds/gripper.yaml')
    assert [action.name for action in world.domain.actions] == [*MOTIONS]


def test_a_person_drives_the_gripper_by_the_world_that_its_file_makes(
    live: Graph, tmp_path: Path
) -> None:
    process = live.run(['-m', 'humanopts_gripper.node', '--ros-args'], 'gripper', {'seed': 1})
    world = tmp_path / 'gripper.yaml'
    text = (EXAMPLES / 'humanopts_gripper/worlds/gripper.yaml').read_text()
    world.write_text(text.replace('stale: 0.3', 'stale: 10'))  # a busy machine may be late
    live.start(WORLD, world=world)
    live.ready('/world')
    player = Player(live)
    names = list(load_world(f'ros:{world}').file.features)

    def do(action: str) -> dict[str, float]:
        state = player.do(action, PERSON)
        assert isinstance(state, GameState), state
        assert not state.cut_short
        return dict(zip(names, state.features))

    player.reset()
    now = do('raise')
    while abs(now['object']) > 0.05:
        before = now
        now = do('right' if now['object'] > 0 else 'left')
        assert abs(now['slider'] - before['slider']) > 0.05
    assert [do(action)['holding'] for action in ('lower', 'close', 'raise')] == [0, 1, 1]
    while now['slider'] < 0.86:
        now = do('right')
    do('lower')
    state = player.do('left', PERSON)  # refused by the gripper
    assert (state.cut_short, state.features[0]) == (True, now['slider'])
    assert do('open')['in_bin'] == 1
    assert player.state.terminated
    process.kill(signal.SIGKILL)
