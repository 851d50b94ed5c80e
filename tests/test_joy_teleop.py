"""The node ``joy_teleop``: a person drives, and answers the lesson, with a gamepad."""

from collections.abc import Iterator
from pathlib import Path
import signal
import time

from graph_support.joy_lesson import FEATURE, JoyLesson, OPTION, RECORDED
from graph_support.live import GAME, Graph, JOY, LEARNER, LESSON, open_graph, WORLD
from graph_support.player import Player
from graph_support.robot import Robot, WORLD_FILE
from humanopts_interfaces.msg import LessonState, NodeStatus
from humanopts_interfaces.srv import DefineOption, OpenSession
from humanopts_ros.qos import CURRENT
import pytest
from sensor_msgs.msg import Joy

LB, RB, A, B, X, BACK, START = 4, 5, 0, 1, 2, 6, 7
UP, DOWN, LEFT, RIGHT = {1: 1.0}, {1: -1.0}, {0: 1.0}, {0: -1.0}
AUTOREPEAT = 0.05  # s, of joy_node
REACTION = 0.5  # s until a robot stops
STAYS = 0.6  # s without a movement, longer than between two steps
AT_FOUR = 'taxi 4,4 passenger R destination B'


class Pad:
    """An Xbox pad, as joy_node publishes it."""

    def __init__(self, graph: Graph, topic: str = '/joy') -> None:
        self._graph = graph
        self._out = graph.node.create_publisher(Joy, topic, 10)
        self.message = Joy(axes=[0.0] * 8, buttons=[0] * 11)
        self._timer = graph.node.create_timer(AUTOREPEAT, self._send)
        graph.until(self._out.get_subscription_count, 'joy_teleop to listen')

    def _send(self) -> None:
        self.message.header.stamp = self._graph.node.get_clock().now().to_msg()
        self._out.publish(self.message)

    def hold(self, *buttons: int, axes: dict[int, float] | None = None) -> None:
        """Hold these buttons and axes, and no others."""
        self.message.axes = [(axes or {}).get(number, 0.0) for number in range(8)]
        self.message.buttons = [int(number in buttons) for number in range(11)]
        self._send()

    def press(self, *buttons: int, with_held: tuple[int, ...] = ()) -> None:
        """Press and release buttons, while others stay held."""
        self.hold(*with_held, *buttons)
        self._graph.spin()
        self.hold(*with_held)

    def unplug(self) -> None:
        """Fall silent."""
        self._timer.cancel()

    def plug_in(self) -> None:
        """Send again."""
        self._timer.reset()


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Graph]:
    """A graph of its own."""
    with open_graph(tmp_path) as graph:
        yield graph


def text_of(graph: Graph, node: str = '/joy_teleop') -> str:
    """Return the text of a node's last status."""
    return graph.statuses[node][-1].text


def test_taxi_with_a_gamepad(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    live.start(JOY)
    live.ready('/game', '/joy_teleop')
    player, pad = Player(live), Pad(live)
    player.reset(AT_FOUR)
    pad.hold(axes=UP)
    live.until(lambda: '/joy_teleop' in live.statuses, 'the pad')
    for _ in range(10):
        live.spin()
    assert player.state.step == 0, 'it moved without the dead-man button'
    pad.hold(LB, axes=UP)
    live.until(lambda: player.state.step >= 2, 'two steps north')
    assert player.state.previous_action == 'north'
    joy = live.node_called('/joy_teleop')
    assert player.state.action_publisher_id == joy.publisher_id
    assert player.controls[-1].holder_id == joy.publisher_id
    pad.hold(LB)
    step = player.state.step
    pad.press(A, with_held=(LB,))
    live.until(lambda: player.state.step > step, 'one attempt')
    assert (player.state.previous_action, player.state.step) == ('pickup', step + 1)
    assert not player.refusals, 'a game is sent nothing that it refuses'
    pad.hold()
    pad.press(BACK)
    live.until(lambda: not player.controls[-1].holder, 'control to be given back')
    pad.press(BACK)
    live.until(lambda: player.controls[-1].holder, 'control to be taken')
    assert player.hold(True).status != 1, 'only one person has control'


def test_two_people_with_a_pad_each(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    live.start(JOY)
    second = live.run(
        ['-m', JOY.partition(':')[0], '--ros-args', '-r', 'joy:=/joy2', '-r', '__node:=second'],
        'second',
    )
    live.ready('/game', '/joy_teleop', '/second')
    player, first, other = Player(live), Pad(live), Pad(live, '/joy2')
    player.reset(AT_FOUR)
    first.hold()
    first.hold(LB, axes=UP)
    live.until(lambda: player.state.step, 'a step of the first')
    other.hold()
    other.hold(LB, axes=DOWN)
    live.until(lambda: player.refusals, 'a refusal of the second')
    assert 'control is held by the person at /joy_teleop' in player.refusals[0].detail
    live.until(lambda: 'held by the person' in second.said(), 'the person to be told')
    assert all(state.previous_action != 'south' for state in player.states)


def test_two_pads_on_one_topic_do_nothing(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    live.start(JOY)
    live.ready('/game', '/joy_teleop')
    player, first, second = Player(live), Pad(live), Pad(live)
    player.reset(AT_FOUR)
    first.hold()
    second.hold(LB, axes=UP)
    live.until(lambda: '2 gamepads publish on /joy' in text_of(live), 'the fault')
    for _ in range(10):
        live.spin()
    assert player.state.step == 0
    assert live.state('/joy_teleop') == NodeStatus.STATE_PAUSED


def test_a_pad_that_lacks_an_axis(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    live.start(JOY)
    live.ready('/game', '/joy_teleop')
    pad = Pad(live)
    pad.message = Joy(axes=[0.0] * 6, buttons=[0] * 11)
    live.until(lambda: 'axis 7, and the gamepad has 6 axes' in text_of(live), 'the fault')
    pad.message = Joy(axes=[0.0] * 8, buttons=[0] * 11)
    live.ready('/joy_teleop')


def test_a_bad_mapping_ends_the_node(live: Graph) -> None:
    file = live.folder / 'pad.yaml'
    file.write_text('{dead_man: {button: 4}, controls: [{button: 0, action: jump}]}')
    live.start(GAME, domain='taxi')
    said = live.refused(JOY, mapping=file)
    assert said.startswith("parameter mapping: unknown action 'jump'; choose from south, north")
    assert 'cannot read' in live.refused(JOY, mapping=live.folder / 'none.yaml')


@pytest.mark.parametrize(
    'fault', ['released', 'unplugged', 'nan', 'second pad', 'ended', 'killed']
)
def test_a_robot_is_stopped(live: Graph, fault: str) -> None:
    robot = Robot(live)
    live.start(WORLD, world=robot.file())
    node = live.spawn(JOY) if fault == 'killed' else live.start(JOY)
    live.ready('/world', '/joy_teleop')
    player, pad = Player(live), Pad(live)
    player.reset()
    pad.hold()
    pad.hold(LB, axes=UP)
    live.until(lambda: player.state.step >= 3, 'three steps')
    assert player.state.previous_action == 'forward'
    assert player.controls[-1].holder_id.startswith('/joy_teleop#'), 'the first step unlocks it'
    live.until(lambda: not robot.stands, 'it to move')
    began = time.monotonic()
    match fault:
        case 'released':
            pad.hold(axes=UP)
        case 'unplugged':
            pad.unplug()
        case 'nan':
            pad.message.axes[1] = float('nan')
        case 'second pad':
            Pad(live)
        case 'ended':
            live.stop(node)
        case 'killed':
            node.kill(signal.SIGKILL)
    moved = began  # when it was last seen to move; between two steps it stands, too

    def stays() -> bool:
        nonlocal moved
        moved = moved if robot.stands else time.monotonic()
        return time.monotonic() - moved > STAYS

    live.until(stays, 'the stop')
    assert moved - began < REACTION
    if fault == 'unplugged':
        live.until(lambda: 'no message on /joy for 0.3 s' in text_of(live), 'the fault')
        pad.plug_in()
        live.ready('/joy_teleop')
        for _ in range(10):
            live.spin()
        assert robot.stands, 'the dead-man button was not released'


def test_the_stop_button_and_a_long_action(live: Graph) -> None:
    robot = Robot(live)
    patient = WORLD_FILE.replace('stale: 0.5', 'stale: 10')  # a busy machine may be late
    live.start(WORLD, world=robot.file(patient))
    live.start(JOY)
    live.ready('/world', '/joy_teleop')
    player, pad = Player(live), Pad(live)
    player.reset()
    pad.hold()
    pad.hold(LB)
    pad.press(B, with_held=(LB,))  # the second action without an arrow key takes two seconds
    live.until(lambda: robot.goals, 'the long action')
    pad.press(RB, with_held=(LB,))
    live.until(lambda: robot.canceled, 'it to be canceled')
    live.until(lambda: player.state.cut_short, 'the state')
    pad.press(B, with_held=(LB,))
    live.until(lambda: len(robot.goals) == 2, 'the long action again')
    pad.hold(LB, axes=UP)
    live.until(lambda: player.state.previous_action == 'forward', 'another action at once', 1.5)


def test_a_lesson_with_a_gamepad(live: Graph) -> None:
    live.start(GAME, domain='taxi')
    for node, folder in ((LEARNER, 'options'), (LESSON, 'demonstrations')):
        live.start(node, directory=live.folder / folder)
    live.start(JOY)
    live.ready('/game', '/learner', '/lesson', '/joy_teleop')
    player, pad = Player(live), Pad(live)
    lessons = live.listen(LessonState, 'lesson_state', CURRENT)
    assert live.ask(OpenSession, 'lesson/open_session', participant='p1').status == 1
    assert live.ask(DefineOption, 'lesson/define_option', name='go north').status == 1
    pad.hold()

    def phase() -> int:
        return int(lessons[-1].phase)

    live.until(lambda: lessons and phase() == LessonState.PHASE_ASKING, 'the questions')
    while phase() == LessonState.PHASE_ASKING:
        asked, yes = lessons[-1].question_id, lessons[-1].question_feature == 'taxi_row'
        pad.press(A if yes else B)
        live.until(lambda asked=asked: lessons[-1].question_id != asked, 'the next question')
    pad.press(A)  # no question is open: it does nothing
    pad.press(START)
    live.until(lambda: phase() == LessonState.PHASE_DEMONSTRATING, 'the first start')
    if player.state.features[0] == 0:
        pad.press(X)
        live.until(lambda: lessons[-1].n_not_here, 'the answer')
        pad.press(START)
        live.until(lambda: phase() == LessonState.PHASE_DEMONSTRATING, 'another start')
    pad.hold(LB, axes=UP)
    live.until(lambda: player.state.features[0] == 0, 'the north')
    pad.press(START, with_held=(LB,))
    live.until(lambda: lessons[-1].n_demonstrations == 1, 'the demonstration to be kept')


@pytest.mark.slow
def test_a_recorded_gamepad_gives_a_lesson_on_the_rover(live: Graph) -> None:
    lesson = JoyLesson(live)
    lesson.play(RECORDED)
    live.until(lambda: lesson.lessons[-1].n_demonstrations == 2, 'two demonstrations to be kept')
    live.until(
        lambda: any(o.n_demonstrations == 2 for o in lesson.learned[-1].options), 'both learned'
    )
    assert list(lesson.lessons[-1].chosen_features) == [FEATURE]
    (learned,) = lesson.learned[-1].options
    assert learned.option_name == OPTION
    lesson.rover.kill(signal.SIGKILL)  # as in test_own_robot.py
