"""A robot is taught through its world file, and its options are run: all nodes, but the robot."""

from collections.abc import Iterator
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import Graph, LEARNER, LESSON, open_graph, OPTION_SERVER, WORLD
from graph_support.player import MACHINE, ME, PERSON, Player
from graph_support.robot import Robot, WORLD_FILE
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ControlState, LearningStatus, LessonState, OptionResult
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
    RunOption,
)
from humanopts_ros.qos import CURRENT
import pytest
from std_srvs.srv import Trigger

DOCK = 'go to the charger'
MOST_STEPS = 200
QUICK = (
    WORLD_FILE.replace('step: 0.2', 'step: 0.1')
    .replace('linear: 0.5', 'linear: 2.0')  # a busy machine is late, and it must not pass the end
    .replace('charger < 0.3', 'charger < 0.6')
    .replace('stale: 0.5', 'stale: 10')  # this process learns, too, and senses nothing meanwhile
)


class Lesson:
    """A person who drives the robot and teaches it."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.robot = graph, Robot(graph)
        self.lessons = graph.listen(LessonState, 'lesson_state', CURRENT)
        self.learned = graph.listen(LearningStatus, 'learning_status', CURRENT)
        self.world = graph.start(WORLD, world=self.robot.file(QUICK))
        for node, folder in ((LEARNER, 'options'), (LESSON, 'demonstrations')):
            graph.start(node, directory=graph.folder / folder)
        graph.start(OPTION_SERVER)
        graph.ready('/world', '/learner', '/lesson', '/option_server')
        assert [speed for speed in self.robot.twists if speed] == []  # no node has moved it
        self.player = Player(graph)

    def ask(self, kind: Any, service: str, **fields: Any) -> Any:
        answer = self.graph.ask(kind, f'lesson/{service}', **fields)
        assert answer.status == answer.STATUS_OK, answer.detail
        return answer

    def name_the_option(self) -> None:
        self.ask(OpenSession, 'open_session', participant='p1', session='s1')
        self.ask(DefineOption, 'define_option', name=DOCK)
        for feature in ('x', 'charger', 'ahead', 'holding'):
            self.graph.until(
                lambda f=feature: self.lessons[-1].question_feature == f, f'question: {feature}'
            )
            question, yes = self.lessons[-1].question_id, feature == 'charger'
            self.ask(AnswerQuestion, 'answer_question', question_id=question, yes=yes)

    def show(self, x: float) -> None:
        """Drive from a place to the charger."""
        phases = LessonState.PHASE_READY, LessonState.PHASE_EXAM
        self.graph.until(lambda: self.lessons[-1].phase in phases, 'the lesson to be ready')
        self.carry(x)
        episode = self.ask(BeginDemonstration, 'begin_demonstration').episode
        self.graph.until(lambda: self.player.state.episode == episode, 'the episode')
        for _ in range(MOST_STEPS):
            if self.player.state.terminated:
                break
            self.player.do('forward', PERSON)
        assert self.player.state.terminated, 'it has passed the charger'
        done, step = EndDemonstration.Request.VERDICT_DONE, self.player.state.step
        ended = {'verdict': done, 'episode': episode, 'step': step}
        uuid = self.ask(EndDemonstration, 'end_demonstration', **ended).uuid
        self.graph.until(
            lambda: any(o.last_uuid == uuid for o in self.learned[-1].options), 'it to be learned'
        )

    def carry(self, x: float) -> None:
        """Carry the robot to a place, between episodes."""
        self.robot.x = x
        sensed = self.world._robot.sense
        self.graph.until(lambda: abs(sensed().features[0] - x) < 0.01, 'it to be there')

    def enable(self, x: float) -> None:
        """Let the machine drive from a place."""
        self.carry(x)
        self.player.hold(True)
        self.player.hold(False)
        self.player.reset()


@pytest.fixture(scope='module')
def lesson(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lesson]:
    with open_graph(tmp_path_factory.mktemp('robot')) as graph:
        lesson = Lesson(graph)
        lesson.name_the_option()
        for x in (1.0, 2.0, 3.0, 0.5):
            lesson.show(x)
        yield lesson


def test_the_option_that_was_shown_drives_to_the_charger(lesson: Lesson) -> None:
    lesson.enable(1.5)
    asked = {'option_name': DOCK, 'episode': lesson.player.state.episode}
    result = lesson.graph.ask(RunOption, 'run_option', **asked).result
    assert result.status == OptionResult.STATUS_REACHED, result.detail
    assert abs(lesson.robot.x - 7) < 0.8


def test_it_is_refused_while_no_person_has_enabled_the_robot(lesson: Lesson) -> None:
    lesson.enable(1.5)
    lesson.player.hold(True)
    lesson.graph.ask(Trigger, 'stop')
    lesson.graph.until(
        lambda: lesson.player.controls[-1].holder == ControlState.HOLDER_LOCKED, 'the lock'
    )
    result = lesson.graph.ask(RunOption, 'run_option', option_name=DOCK).result
    assert result.status != OptionResult.STATUS_REACHED
    assert 'the robot is locked (the service stop was called)' in result.detail
    assert abs(lesson.robot.x - 1.5) < 0.05


def test_a_canceled_run_cancels_the_goal_of_the_robot(lesson: Lesson) -> None:
    lesson.enable(1.5)
    goal = lesson.graph.act(ExecuteOption, 'execute_option', option_name='action:go')
    lesson.graph.until(lambda: lesson.robot.goals, 'the goal of the robot')
    goal.cancel()
    status, result = goal.result()
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, OptionResult.STATUS_CANCELED)
    assert lesson.robot.canceled == 1
    assert lesson.player.states[-1].cut_short


def test_a_person_takes_over_a_running_option(lesson: Lesson) -> None:
    lesson.enable(0.5)
    goal = lesson.graph.act(ExecuteOption, 'execute_option', option_name=DOCK)
    lesson.graph.until(lambda: lesson.player.state.action_source == MACHINE, 'it to drive')
    lesson.player.send(lesson.player.command('wait', PERSON))
    _, result = goal.result()
    assert result.status == OptionResult.STATUS_INTERRUPTED
    lesson.graph.until(lambda: lesson.player.controls[-1].holder_id == ME, 'control')


def test_a_world_file_that_was_changed_needs_all_nodes_to_be_started_again(
    lesson: Lesson,
) -> None:
    """The last test: the lesson keeps to the world that it knows."""
    graph = lesson.graph
    graph.stop(lesson.world)
    graph.start(WORLD, world=lesson.robot.file(QUICK.replace('range: [0, 8]', 'range: [0, 9]')))
    text = 'the features or actions of scout have changed: start its nodes again'
    for node in ('/lesson', '/learner', '/option_server'):
        graph.until(lambda n=node: text in graph.statuses[n][-1].text, f'{node} to say so')
