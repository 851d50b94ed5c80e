"""The lesson over the real graph: game, learner and teacher as processes, the test as a person."""

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from humanopts_interfaces.msg import (
    ActionCommand,
    ControlState,
    Demonstration,
    DemonstrationReceipt,
    GameState,
    LearningStatus,
    LessonState,
    NodeStatus,
)
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    ListOptions,
    OpenSession,
    ResetGame,
    WithdrawDemonstration,
)
from humanopts_ros.qos import LATCHED, LATCHED_ALL, STREAM
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

PICKUP, DROPOFF = 'go to passenger and pickup', 'go to destination and dropoff'
START = 'taxi 0,1 passenger R destination G'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col', 'passenger_in_taxi')
GAME, LEARNER = 'humanopts_env.ros.game_node', 'humanopts_learner.ros.learner_node'
OPTION_SERVER = 'humanopts_learner.ros.option_server'
LESSON = 'humanopts_teach.ros.lesson_node'
TEACHER = 'humanopts_teach.ros.simulated_teacher'


class Graph:
    """Processes of one test, and a node that sees and asks what a person does."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        self.folder, self.domain_id = folder, domain_id
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node('person', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.statuses: dict[str, NodeStatus] = {}
        self.shown: list[Demonstration] = []
        self.latest: dict[type, Any] = {}
        for kind, topic in (
            (LessonState, 'lesson_state'),
            (LearningStatus, 'learning_status'),
            (ControlState, 'control'),
            (GameState, 'current_state'),
        ):
            self.node.create_subscription(kind, topic, self._keep, LATCHED)
        self.node.create_subscription(
            NodeStatus, 'node_status', lambda m: self.statuses.update({m.node: m}), LATCHED_ALL
        )
        self.node.create_subscription(Demonstration, 'demonstrations', self.shown.append, STREAM)
        self.keys = self.node.create_publisher(ActionCommand, 'action', STREAM)

    def _keep(self, message: Any) -> None:
        self.latest[type(message)] = message

    @property
    def lesson(self) -> LessonState:
        """Newest state of the lesson."""
        state: LessonState = self.latest[LessonState]
        return state

    def start(self, module: str, **parameters: Any) -> None:
        """Start a node in its own process."""
        arguments = [f'{name}:={value}' for name, value in parameters.items()]
        options = [part for text in arguments for part in ('-p', text)]
        command = [sys.executable, '-m', module, '--ros-args', *options]
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(self.domain_id)}
        self.processes[module] = subprocess.Popen(
            command, env=environment, text=True, stderr=subprocess.PIPE
        )

    def start_lesson(self, **parameters: Any) -> None:
        """Start the lesson and wait until it is ready."""
        self.start(LESSON, directory=self.folder / 'demonstrations', **parameters)
        self.ready('/lesson')

    def ready(self, *names: str) -> None:
        """Wait until nodes are ready."""
        self.until(
            lambda: all(self._state(name) == NodeStatus.STATE_READY for name in names),
            f'{names} to be ready',
        )

    def _state(self, name: str) -> int:
        return self.statuses[name].state if name in self.statuses else 0

    def until(self, condition: Callable[[], bool], what: str, seconds: float = 30.0) -> None:
        """Serve the node until a condition holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f'waited in vain for {what}'
            self.executor.spin_once(0.05)

    def ask(self, kind: Any, service: str, /, **fields: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f'service {service}')
        future = client.call_async(kind.Request(**fields))
        self.until(future.done, f'an answer of {service}')
        self.node.destroy_client(client)
        return future.result()

    def phase(self, phase: int) -> None:
        """Wait until the lesson is in a phase."""
        self.until(
            lambda: LessonState in self.latest and self.lesson.phase == phase, f'phase {phase}'
        )

    def taught_up_to_ready(self) -> None:
        """Open a session, name an option and answer all questions."""
        opened = self.ask(OpenSession, 'lesson/open_session', participant='p1', session='s1')
        assert opened.status == OpenSession.Response.STATUS_OK
        self.ask(DefineOption, 'lesson/define_option', name=PICKUP)
        for number in range(1, 11):
            self.until(lambda n=number: self.lesson.question_id == n, f'question {number}')
            yes = self.lesson.question_feature in CHOSEN
            self.ask(AnswerQuestion, 'lesson/answer_question', question_id=number, yes=yes)
        self.phase(LessonState.PHASE_READY)

    def begin(self) -> int:
        """Begin a demonstration from START and return its episode."""
        begun = self.ask(BeginDemonstration, 'lesson/begin_demonstration', start_state=START)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        assert begun.state == START
        return int(begun.episode)

    def drive(self, episode: int, *actions: str) -> None:
        """Press keys, without looking at what comes of them."""
        self.until(lambda: self.keys.get_subscription_count() > 0, 'game to listen')
        for action in actions:
            self.keys.publish(
                ActionCommand(
                    publisher_id='/person#1',
                    source=ActionCommand.SOURCE_PERSON,
                    episode=episode,
                    action=action,
                )
            )

    def end(self, episode: int, step: int) -> Any:
        """Say done."""
        return self.ask(
            EndDemonstration,
            'lesson/end_demonstration',
            verdict=EndDemonstration.Request.VERDICT_DONE,
            episode=episode,
            step=step,
        )

    def show(self) -> str:
        """Give a demonstration that a learner counts in; return its uuid."""
        episode = self.begin()
        self.drive(episode, 'west', 'pickup')
        ended = self.end(episode, 2)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        self.until(lambda: self.lesson.last_uuid == ended.uuid, 'the lesson to keep it')
        self.phase(LessonState.PHASE_READY)
        return str(ended.uuid)

    def kill(self, module: str, how: signal.Signals = signal.SIGKILL) -> tuple[int, str]:
        """End a process; return its status and what it said."""
        process = self.processes.pop(module)
        process.send_signal(how)
        said = process.communicate(timeout=20)[1]
        return process.returncode, said

    def close(self) -> None:
        """End everything."""
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            process.communicate(timeout=20)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def graph(tmp_path: Path, domain_id: int) -> Iterator[Graph]:
    opened = Graph(tmp_path, domain_id)
    yield opened
    opened.close()


def teach(graph: Graph, **parameters: Any) -> None:
    """Have the simulated teacher teach, and wait until it says that it has finished."""
    graph.start(GAME)
    graph.start(LEARNER, directory=graph.folder / 'options')
    graph.start_lesson(strategy='failures', until_no_failures=True)
    graph.ready('/game', '/learner')
    graph.start(TEACHER, error_rate=0.05, **parameters)
    graph.until(
        lambda: (
            '/simulated_teacher' in graph.statuses
            and bool(graph.statuses['/simulated_teacher'].text)
        ),
        'the teacher to finish',
        seconds=90,
    )
    status = graph.statuses['/simulated_teacher']
    assert (status.state, status.text) == (NodeStatus.STATE_READY, 'finished')


def uuids(graph: Graph) -> list[str]:
    """Return the demonstrations, each once: a learner that is found late gets them again."""
    return list(dict.fromkeys(message.uuid for message in graph.shown))


def test_the_simulated_teacher_teaches_until_the_criteria_hold(graph: Graph) -> None:
    teach(graph, options=f"['{PICKUP}','{DROPOFF}']")
    assert graph.lesson.phase == LessonState.PHASE_FINISHED
    assert 'All criteria hold' in graph.lesson.text
    learned = {option.option_name: option for option in graph.latest[LearningStatus].options}
    assert set(learned) == {PICKUP, DROPOFF}
    assert all(option.criteria_met for option in learned.values())
    assert graph.latest[ControlState].holder == ControlState.HOLDER_NOBODY
    graph.kill(LESSON, signal.SIGTERM)
    with DemonstrationStore(graph.folder / 'demonstrations') as store:
        kept = [entry.uuid for entry in store.entries('simulated') if hasattr(entry, 'uuid')]
    assert kept == uuids(graph)
    numbers = [message.sequence for message in graph.shown]
    assert numbers == list(range(1, len(numbers) + 1))


def test_the_same_seed_gives_the_same_lesson(tmp_path: Path, domain_id: int) -> None:
    lessons = []
    for name in ('first', 'second'):
        graph = Graph(tmp_path / name, domain_id)
        try:
            teach(graph, options=f"['{PICKUP}']")
            lessons.append(uuids(graph))
        finally:
            graph.close()
    assert lessons[0] == lessons[1]
    assert len(lessons[0]) > 5


def test_a_lesson_that_was_killed_goes_on_where_it_was(graph: Graph) -> None:
    graph.start(GAME)
    graph.start(LEARNER, directory=graph.folder / 'options')
    graph.start_lesson()
    graph.taught_up_to_ready()
    uuid = graph.show()
    graph.until(lambda: bool(graph.shown), 'the demonstration')
    first = graph.shown[0]
    assert first.uuid == uuid
    graph.begin()
    graph.kill(LESSON)

    graph.latest.pop(LessonState)
    graph.start_lesson(participant='p1', session='s1')
    graph.phase(LessonState.PHASE_READY)
    assert graph.lesson.option_name == PICKUP
    assert tuple(graph.lesson.chosen_features) == CHOSEN
    assert graph.lesson.n_demonstrations == 1
    graph.until(
        lambda: graph.shown[-1].publisher_id != first.publisher_id,
        'the demonstration to be sent again',
    )
    again = graph.shown[-1]
    assert (again.uuid, again.states, again.rewards) == (first.uuid, first.states, first.rewards)
    episode = graph.begin()
    graph.drive(episode, 'pickup')
    graph.end(episode, 1)
    graph.until(lambda: graph.shown[-1].number == 2, 'demonstration 2')


def test_a_learner_that_comes_late_gets_every_demonstration(graph: Graph) -> None:
    graph.start(GAME)
    graph.start_lesson(learner_deadline=0.2)
    graph.taught_up_to_ready()
    episode = graph.begin()
    graph.drive(episode, 'west', 'pickup')
    assert graph.end(episode, 2).status == EndDemonstration.Response.STATUS_OK
    graph.until(lambda: 'learner does not answer' in graph.lesson.text, 'the lesson to go on')
    assert graph.lesson.phase == LessonState.PHASE_READY
    graph.start(LEARNER, directory=graph.folder / 'options')
    graph.until(
        lambda: LearningStatus in graph.latest and bool(graph.latest[LearningStatus].options),
        'the learner to know of it',
    )
    assert graph.latest[LearningStatus].options[0].last_uuid == graph.shown[0].uuid


def test_what_is_taken_back_is_unlearned_and_run_no_more(graph: Graph) -> None:
    graph.start(GAME)
    graph.start(LEARNER, directory=graph.folder / 'options')
    graph.start(OPTION_SERVER)
    graph.start_lesson()
    graph.taught_up_to_ready()
    first, second = graph.show(), graph.show()

    def learned() -> list[tuple[int, str]]:
        status = graph.latest.get(LearningStatus)
        options = status.options if status is not None else ()
        return [(option.n_demonstrations, option.last_uuid) for option in options]

    def served() -> list[str]:
        return list(graph.ask(ListOptions, 'list_options').option_names)

    stale = graph.ask(WithdrawDemonstration, 'lesson/withdraw_demonstration', uuid=first)
    assert stale.status == WithdrawDemonstration.Response.STATUS_NO_DEMONSTRATION
    for uuid, left in ((second, [(1, first)]), (first, [])):
        taken = graph.ask(WithdrawDemonstration, 'lesson/withdraw_demonstration', uuid=uuid)
        assert (taken.status, taken.uuid) == (WithdrawDemonstration.Response.STATUS_OK, uuid)
        graph.until(lambda left=left: learned() == left, 'the learner to count it out')
        newest = left[0][1] if left else ''
        graph.until(lambda uuid=newest: graph.lesson.last_uuid == uuid, 'the lesson to say so')
        graph.phase(LessonState.PHASE_READY)
    graph.until(lambda: not served(), 'the option to be gone')
    graph.until(lambda: sum(m.withdrawn for m in graph.shown) == 2, 'both words of it')
    none = graph.ask(WithdrawDemonstration, 'lesson/withdraw_demonstration')
    assert none.status == WithdrawDemonstration.Response.STATUS_NO_DEMONSTRATION

    graph.kill(LEARNER)
    graph.latest.pop(LearningStatus)
    graph.start(LEARNER, directory=graph.folder / 'forgot everything')
    graph.until(lambda: LearningStatus in graph.latest, 'the new learner')
    episode = graph.begin()
    graph.drive(episode, 'west', 'pickup')
    third = graph.end(episode, 2).uuid
    graph.until(lambda: learned() == [(1, third)], 'the new learner to know what counts')


@pytest.mark.parametrize('refuses', [False, True])
def test_a_learner_that_missed_something_gets_it_once_it_is_heard_again(
    graph: Graph, refuses: bool
) -> None:
    graph.start(GAME)
    graph.start_lesson(learner_deadline=5.0 if refuses else 0.2)
    says = graph.node.create_publisher(LearningStatus, 'learning_status', LATCHED)
    answers = graph.node.create_publisher(DemonstrationReceipt, 'demonstration_receipts', STREAM)
    graph.until(lambda: says.get_subscription_count() > 1, 'the lesson to listen')
    graph.until(lambda: answers.get_subscription_count() > 0, 'the lesson to listen')
    says.publish(LearningStatus(publisher_id='/learner#1'))
    graph.taught_up_to_ready()
    episode = graph.begin()
    graph.drive(episode, 'west', 'pickup')
    uuid = graph.end(episode, 2).uuid
    if refuses:
        status = DemonstrationReceipt.STATUS_REFUSED
        answers.publish(DemonstrationReceipt(uuid=uuid, status=status, detail='a full disk'))
        words = 'refused the demonstration: a full disk'
    else:
        words = 'learner does not answer'
    graph.until(lambda: words in graph.lesson.text, words)
    known = len(graph.shown)
    says.publish(LearningStatus(publisher_id='/learner#1'))
    graph.until(lambda: len(graph.shown) > known, 'the demonstration again')
    assert graph.shown[-1].uuid == uuid


def test_a_person_gets_clear_refusals_and_can_go_on(graph: Graph) -> None:
    graph.start(GAME)
    graph.start_lesson(learner_deadline=0.2)
    graph.phase(LessonState.PHASE_NO_SESSION)
    early = graph.ask(BeginDemonstration, 'lesson/begin_demonstration')
    assert early.status == BeginDemonstration.Response.STATUS_WRONG_PHASE
    assert 'Open a session' in early.detail
    bad = graph.ask(OpenSession, 'lesson/open_session', participant='no code')
    assert bad.status == OpenSession.Response.STATUS_BAD_NAME
    graph.taught_up_to_ready()
    unasked = graph.ask(AnswerQuestion, 'lesson/answer_question', question_id=3, yes=True)
    assert unasked.status == AnswerQuestion.Response.STATUS_NOT_ASKED
    nowhere = graph.ask(BeginDemonstration, 'lesson/begin_demonstration', start_state='nowhere')
    assert nowhere.status == BeginDemonstration.Response.STATUS_BAD_STATE

    episode = graph.begin()
    assert graph.end(episode, 0).status == EndDemonstration.Response.STATUS_NO_STEPS
    verdict = graph.ask(EndDemonstration, 'lesson/end_demonstration', verdict=9)
    assert verdict.status == EndDemonstration.Response.STATUS_BAD_VERDICT
    other = graph.end(episode + 1, 0)
    assert other.status == EndDemonstration.Response.STATUS_NOT_CURRENT
    graph.drive(episode, 'west')
    assert graph.end(episode, 1).status == EndDemonstration.Response.STATUS_OK


def test_a_reset_by_somebody_else_ends_the_demonstration(graph: Graph) -> None:
    graph.start(GAME)
    graph.start_lesson()
    graph.taught_up_to_ready()
    episode = graph.begin()
    graph.ask(ResetGame, 'reset_game', source=ResetGame.Request.SOURCE_PERSON)
    graph.until(lambda: 'reset by somebody else' in graph.lesson.text, 'the lesson to notice')
    assert graph.lesson.phase == LessonState.PHASE_READY
    assert graph.end(episode, 0).status == EndDemonstration.Response.STATUS_WRONG_PHASE
    assert graph.begin() == episode + 2


def test_without_a_game_the_lesson_says_so_and_stays_ready(graph: Graph) -> None:
    graph.start(GAME)
    graph.start_lesson()
    graph.taught_up_to_ready()
    graph.kill(GAME, signal.SIGTERM)
    answer = graph.ask(BeginDemonstration, 'lesson/begin_demonstration')
    assert answer.status == BeginDemonstration.Response.STATUS_NO_GAME
    assert 'ame' in answer.detail
    assert graph.lesson.phase == LessonState.PHASE_READY
    graph.start(GAME)
    graph.begin()


@pytest.mark.parametrize('module', [LESSON, TEACHER])
def test_a_node_ends_cleanly_on_sigterm(graph: Graph, module: str) -> None:
    graph.start(GAME)
    graph.start_lesson()
    graph.start(TEACHER, options=f"['{PICKUP}']")
    graph.ready('/simulated_teacher')
    assert graph.kill(module, signal.SIGTERM) == (0, '')


@pytest.mark.parametrize(
    ('module', 'parameters', 'says'),
    [
        (LESSON, {'strategy': 'guess'}, "'guess' is none of random"),
        (LESSON, {'budget': 0}, 'budget'),
        (LESSON, {'participant': 'no code', 'directory': 'DIRECTORY'}, 'not a code'),
        (TEACHER, {'options': '[fly]'}, "no reference option 'fly'"),
        (TEACHER, {'error_rate': 2.0}, 'error_rate'),
        (TEACHER, {'options': '[]'}, 'no option'),
    ],
)
def test_a_node_that_cannot_start_says_why_in_one_line(
    graph: Graph, module: str, parameters: dict[str, Any], says: str
) -> None:
    graph.start(GAME)
    given = {
        name: graph.folder if value == 'DIRECTORY' else value for name, value in parameters.items()
    }
    graph.start(module, **given)
    process = graph.processes.pop(module)
    said = process.communicate(timeout=20)[1]
    assert process.returncode == 2
    assert says in said
    assert len(said.splitlines()) == 1


def test_two_lessons_cannot_share_a_folder(graph: Graph) -> None:
    graph.start(GAME)
    with DemonstrationStore(graph.folder / 'demonstrations'):
        graph.start(LESSON, directory=graph.folder / 'demonstrations')
        process = graph.processes.pop(LESSON)
        said = process.communicate(timeout=20)[1]
    assert process.returncode == 2
    assert 'another lesson has it open' in said
