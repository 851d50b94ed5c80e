"""
A lesson on the simulated rover, given with a gamepad.

``python -m graph_support.joy_lesson`` gives it by a script that sees what the rover does, and
records what the gamepad publishes. Played back, these messages alone give the lesson again.
"""

from pathlib import Path
import re
import sys
import tempfile
import time

from humanopts_interfaces.msg import LearningStatus, LessonState
from humanopts_interfaces.srv import DefineOption, OpenSession
from humanopts_ros.qos import CURRENT
from humanopts_ros.workarounds import prepare_discovery
from humanopts_teach.bags.schemas import find_schema
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from sensor_msgs.msg import Joy, LaserScan

from graph_support.live import Graph, JOY, LEARNER, LESSON, open_graph, WORLD
from graph_support.player import Player

WORLD_FILE = Path(__file__).parents[2] / 'examples/humanopts_rover/worlds/rover.yaml'
RECORDED = Path(__file__).parents[1] / 'data/joy_lesson.mcap'
OPTION, FEATURE = 'drive up to the wall', 'ahead'
NEAR = 0.7  # m from the wall, where it ends
PERIOD, PAUSE = 0.1, 0.5  # s between messages, and between the presses of a person
IDLE = 15  # messages with nothing pressed that are recorded on end
LB, A, B, START = 4, 0, 1, 7
UP, RIGHT = {1: 1.0}, {0: -1.0}


class JoyLesson:
    """The rover, and a lesson in an option, which a gamepad answers."""

    def __init__(self, graph: Graph) -> None:
        """Start the nodes, and define the option."""
        self.graph = graph
        self.pad = graph.node.create_publisher(Joy, '/joy', 10)
        self.rover = graph.run(['-m', 'humanopts_rover.node'], 'rover')
        world = graph.folder / WORLD_FILE.name
        patient = re.sub(r'stale: [\d.]+', 'stale: 5.0', WORLD_FILE.read_text('utf-8'))
        world.write_text(patient, 'utf-8')  # a busy machine stops no rover here
        graph.start(WORLD, world=world)
        graph.spawn(LEARNER, directory=graph.folder / 'options')  # learning takes its time
        graph.start(LESSON, directory=graph.folder / 'demonstrations')
        graph.start(JOY, timeout=10.0)
        graph.ready('/world', '/learner', '/lesson', '/joy_teleop')
        self.player = Player(graph)
        self.lessons: list[LessonState] = graph.listen(LessonState, 'lesson_state', CURRENT)
        self.learned: list[LearningStatus] = graph.listen(
            LearningStatus, 'learning_status', CURRENT
        )
        self.scans: list[LaserScan] = graph.listen(LaserScan, 'scan', 10)
        assert graph.ask(OpenSession, 'lesson/open_session', participant='p1').status == 1
        assert graph.ask(DefineOption, 'lesson/define_option', name=OPTION).status == 1
        graph.until(lambda: self.phase == LessonState.PHASE_ASKING, 'the questions')

    @property
    def phase(self) -> int:
        """The phase of the lesson."""
        return int(self.lessons[-1].phase) if self.lessons else 0

    def _wait(self) -> float:
        since = time.monotonic()
        self.graph.until(lambda: self.phase != LessonState.PHASE_LEARNING, 'learning', 60.0)
        return time.monotonic() - since

    def play(self, path: Path) -> None:
        """Publish recorded messages of a gamepad at their times."""
        with path.open('rb') as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            messages = [(m.log_time, joy) for *_, m, joy in reader.iter_decoded_messages()]
        began = time.monotonic() - messages[0][0] * 1e-9
        for at, joy in messages:
            if self.phase == LessonState.PHASE_LEARNING:  # a person waits for that
                began += self._wait()
            due = began + at * 1e-9
            self.graph.until(lambda due=due: time.monotonic() >= due, 'the next message')
            self.pad.publish(Joy(axes=list(joy.axes), buttons=list(joy.buttons)))


class Script:
    """A person with a gamepad, who sees the screen and the rover."""

    def __init__(self, lesson: JoyLesson) -> None:
        self._lesson = lesson
        self.recorded: list[tuple[int, Joy]] = []  # ns, and the message
        self._at, self._before = 0, time.time_ns()
        self._idle = 0  # messages since something was pressed
        self.hold()
        lesson.graph.node.create_timer(PERIOD, self._send)

    def hold(self, *buttons: int, axes: dict[int, float] | None = None) -> None:
        """Hold these buttons and axes, and no others."""
        self._axes = [(axes or {}).get(number, 0.0) for number in range(8)]
        self._buttons = [int(number in buttons) for number in range(11)]

    def _send(self) -> None:
        message, now = Joy(axes=self._axes, buttons=self._buttons), time.time_ns()
        self._idle = 0 if any(self._axes) or any(self._buttons) else self._idle + 1
        if self._idle < IDLE:  # learning takes its time, and differs
            self._at += now - self._before
            self.recorded.append((self._at, message))
        self._before = now
        self._lesson.pad.publish(message)

    def _pass(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        self._lesson.graph.until(lambda: time.monotonic() > until, f'{seconds} s')

    def press(self, button: int) -> None:
        """Press and release a button."""
        for held in ((button,), ()):
            self.hold(*held)
            self._pass(PAUSE / 2)

    def give(self) -> None:
        """Answer the questions, and show the option twice, towards two walls."""
        lesson = self._lesson
        self._pass(PAUSE)
        while lesson.phase == LessonState.PHASE_ASKING:
            self.press(A if lesson.lessons[-1].question_feature == FEATURE else B)
        self._show()
        self.hold(LB, axes=RIGHT)
        self._pass(1.7)
        self.hold()
        self._pass(2 * PAUSE)
        self._show()

    def _show(self) -> None:
        lesson, graph = self._lesson, self._lesson.graph
        known = lesson.lessons[-1].n_demonstrations
        self.press(START)
        graph.until(lambda: lesson.phase == LessonState.PHASE_DEMONSTRATING, 'the beginning')
        self._pass(PAUSE)
        self.hold(LB, axes=UP)
        middle = len(lesson.scans[-1].ranges) // 2
        graph.until(lambda: min(lesson.scans[-1].ranges[middle - 1 : middle + 2]) < NEAR, 'wall')
        self.hold(LB)
        self._pass(3 * PAUSE)
        self.press(START)
        graph.until(lambda: lesson.lessons[-1].n_demonstrations > known, 'the demonstration')
        graph.until(lambda: lesson.phase != LessonState.PHASE_LEARNING, 'learning', 60.0)
        self._pass(2 * PAUSE)


def record(path: Path) -> None:
    """Give the lesson, and write what the gamepad published."""
    with tempfile.TemporaryDirectory() as folder, open_graph(Path(folder) / 'graph') as graph:
        script = Script(JoyLesson(graph))
        script.give()
        with path.open('wb') as file:
            writer = Writer(file)
            schema = writer.register_msgdef(
                'sensor_msgs/msg/Joy', find_schema('sensor_msgs/msg/Joy')
            )
            for at, message in script.recorded:
                writer.write_message('/joy', schema, message, log_time=at)
            writer.finish()
    print(f'{len(script.recorded)} messages in {path}, {path.stat().st_size} bytes')


if __name__ == '__main__':
    prepare_discovery()
    sys.exit(record(RECORDED))
