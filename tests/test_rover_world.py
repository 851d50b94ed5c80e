"""The simulated rover as a world: its transforms, an action of its own type, and its clock."""

from collections.abc import Iterator
import signal
import time

from graph_support.live import Graph, NodeProcess, open_graph, WORLD
from graph_support.player import PERSON, Player
from humanopts_env.ros import world_node
from humanopts_interfaces.msg import ActionProgress, ActionRefusal, GameState
from humanopts_ros.qos import CURRENT
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

WORLD_FILE = """
name: by_frames
use_sim_time: yes
topics:
  tf: {topic: /tf, type: tf2_msgs/msg/TFMessage, stale: 5.0}
  fixed: {topic: /tf_static, type: tf2_msgs/msg/TFMessage, latched: yes}
  odom: {topic: /odom, type: nav_msgs/msg/Odometry, stale: 5.0}
places:
  corner: {x: 2.5, y: 3.5, yaw: 1.0}
features:
  x: {tf: [odom, base_link], part: x, question: how far east it is, range: [0, 8]}
  yaw: {tf: [odom, base_link], part: yaw, question: where it looks}
  height: {tf: [odom, laser], part: z, question: how high the laser is, range: [0, 1]}
actions:
  forward: {key: up, twist: {linear: 0.4}}
  corner: {key: c, action: /drive_to, type: humanopts_rover_interfaces/action/DriveTo,
           goal: {pose: {header: {frame_id: odom}, pose: corner}}, seconds: 20}
"""
SPEED = 4.0
SILENCE = world_node._CLOCK_SILENCE


class Rover:
    """The rover with a clock of its own, its world, and a person who drives."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.process: NodeProcess = graph.run(
            ['-m', 'humanopts_rover.node', '--ros-args'], 'rover', {'speed': SPEED}
        )
        path = graph.folder / 'rover.yaml'
        path.write_text(WORLD_FILE)
        graph.start(WORLD, world=path)
        graph.ready('/world')
        self.player = Player(graph)
        self.progress: list[ActionProgress] = graph.listen(
            ActionProgress, 'action_progress', CURRENT
        )
        self.player.reset()

    def set_fault(self, fault: str) -> None:
        given = [Parameter('drive_to_fault', value=fault).to_parameter_msg()]
        self.graph.ask(SetParameters, 'rover/set_parameters', parameters=given)

    def do(self, action: str) -> GameState:
        state = self.player.do(action, PERSON)
        assert isinstance(state, GameState), state
        return state


@pytest.fixture(scope='module')
def rover(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rover]:
    with (
        pytest.MonkeyPatch.context() as patch,
        open_graph(tmp_path_factory.mktemp('rover')) as graph,
    ):
        patch.setattr(world_node, '_CLOCK_SILENCE', 4.0)  # a busy machine may be late
        rover = Rover(graph)
        yield rover
        rover.process.kill(signal.SIGKILL)  # as in test_own_robot.py


def test_features_are_read_from_chains_of_transforms(rover: Rover) -> None:
    assert rover.player.state.features == pytest.approx([2.0, -1.57, 0.2], abs=0.05)


def test_an_action_takes_its_time_by_the_clock_of_the_robot(rover: Rover) -> None:
    rover.do('forward')
    before = time.monotonic()
    for _ in range(10):
        assert not rover.do('forward').cut_short
    assert time.monotonic() - before > 10 * 0.2 / SPEED * 0.9


def test_an_action_of_the_robots_own_interfaces_ends_with_its_goal(rover: Rover) -> None:
    state = rover.do('corner')
    assert not state.cut_short
    assert state.features == pytest.approx([2.5, 1.0, 0.2], abs=0.15)
    said = {each.feedback for each in rover.progress}
    assert any(text.startswith('distance remaining ') for text in said)


@pytest.mark.parametrize('fault', ['no_answer', 'no_result'])
def test_a_server_that_does_not_answer_is_given_up_at_the_deadline(
    rover: Rover, fault: str
) -> None:
    rover.set_fault(fault)
    state = rover.do('corner')
    assert state.cut_short
    rover.set_fault('none')
    assert not rover.do('forward').cut_short


def test_without_its_clock_the_robot_stands_and_the_refusal_says_why(
    rover: Rover, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world_node, '_CLOCK_SILENCE', SILENCE)
    rover.process.pause()
    rover.graph.until(lambda: rover.progress[-1].stopped, 'the end of time', 2.0)
    refusal = rover.player.do('forward', PERSON)
    assert isinstance(refusal, ActionRefusal)
    assert refusal.reason == ActionRefusal.REASON_PAUSED
    assert 'use_sim_time is set, and no time arrives on /clock' in refusal.detail
    monkeypatch.undo()
    rover.process.go_on()
    rover.graph.until(lambda: not rover.progress[-1].stopped, 'time')
    assert not rover.do('forward').cut_short
