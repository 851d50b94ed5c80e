"""The lesson over the real graph: game, learner and teacher as processes, the test as a person."""

from collections.abc import Iterator
from pathlib import Path
import signal
from typing import Any

from graph_support.live import GAME, Graph, LEARNER, LESSON, open_graph, OPTION_SERVER, TEACHER
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
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_teach.lesson.store import DemonstrationStore
import pytest

PICKUP, DROPOFF = 'go to passenger and pickup', 'go to destination and dropoff'
START = 'taxi 0,1 passenger R destination G'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col', 'passenger_in_taxi')


class LessonGraph(Graph):
    """The test does and sees what a person does who teaches."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        super().__init__(folder, domain_id)
        self.shown: list[Demonstration] = []
        self.latest: dict[type, Any] = {}
        for kind, topic in (
            (LessonState, 'lesson_state'),
            (LearningStatus, 'learning_status'),
            (ControlState, 'control'),
            (GameState, 'current_state'),
        ):
            self.node.create_subscription(kind, topic, self._keep, LATCHED)
        self.node.create_subscription(Demonstration, 'demonstrations', self.shown.append, STREAM)
        self.keys = self.node.create_publisher(ActionCommand, 'action', STREAM)

    def _keep(self, message: Any) -> None:
        self.latest[type(message)] = message

    @property
    def lesson(self) -> LessonState:
        """Newest state of the lesson."""
        state: LessonState = self.latest[LessonState]
        return state

    def start_lesson(self, **parameters: Any) -> None:
        """Start the lesson and wait until it is ready."""
        self.start(LESSON, directory=self.folder / 'demonstrations', **parameters)
        self.ready('/lesson')

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


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[LessonGraph]:
    with open_graph(tmp_path, LessonGraph) as opened:
        yield opened


def teach(graph: LessonGraph, **parameters: Any) -> None:
    """Have the simulated teacher teach, and wait until it says that it has finished."""
    graph.start(GAME)
    graph.start(LEARNER, directory=graph.folder / 'options')
    graph.start_lesson(strategy='failures', until_no_failures=True)
    graph.ready('/game', '/learner')
    graph.start(TEACHER, error_rate=0.05, **parameters)
    graph.until(
        lambda: bool(graph.statuses.get('/simulated_teacher', [NodeStatus()])[-1].text),
        'the teacher to finish',
        seconds=90,
    )
    status = graph.statuses['/simulated_teacher'][-1]
    assert (status.state, status.text) == (NodeStatus.STATE_READY, 'finished')


def uuids(graph: LessonGraph) -> list[str]:
    """Return the demonstrations, each once: a learner that is found late gets them again."""
    return list(dict.fromkeys(message.uuid for message in graph.shown))


def test_the_simulated_teacher_teaches_until_the_criteria_hold(graph: LessonGraph) -> None:
    teach(graph, options=[PICKUP, DROPOFF])
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


def test_the_same_seed_gives_the_same_lesson(tmp_path: Path) -> None:
    lessons = []
    for name in ('first', 'second'):
        with open_graph(tmp_path / name, LessonGraph) as graph:
            teach(graph, options=[PICKUP])
            lessons.append(uuids(graph))
    assert lessons[0] == lessons[1]
    assert len(lessons[0]) > 5


def test_a_lesson_that_was_killed_goes_on_where_it_was(graph: LessonGraph) -> None:
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


def test_a_learner_that_comes_late_gets_every_demonstration(graph: LessonGraph) -> None:
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


def test_what_is_taken_back_is_unlearned_and_run_no_more(graph: LessonGraph) -> None:
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
    graph: LessonGraph, refuses: bool
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


def test_a_person_gets_clear_refusals_and_can_go_on(graph: LessonGraph) -> None:
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


def test_a_reset_by_somebody_else_ends_the_demonstration(graph: LessonGraph) -> None:
    graph.start(GAME)
    graph.start_lesson()
    graph.taught_up_to_ready()
    episode = graph.begin()
    graph.ask(ResetGame, 'reset_game', source=ResetGame.Request.SOURCE_PERSON)
    graph.until(lambda: 'reset by somebody else' in graph.lesson.text, 'the lesson to notice')
    assert graph.lesson.phase == LessonState.PHASE_READY
    assert graph.end(episode, 0).status == EndDemonstration.Response.STATUS_WRONG_PHASE
    assert graph.begin() == episode + 2


def test_without_a_game_the_lesson_says_so_and_stays_ready(graph: LessonGraph) -> None:
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
def test_a_node_ends_cleanly_on_sigterm(graph: LessonGraph, module: str) -> None:
    graph.start(GAME)
    graph.start_lesson()
    graph.start(TEACHER, options=[PICKUP])
    graph.ready('/simulated_teacher')
    assert graph.kill(module, signal.SIGTERM) == (0, '')


@pytest.mark.parametrize(
    ('module', 'parameters', 'says'),
    [
        (LESSON, {'strategy': 'guess'}, "'guess' is none of random"),
        (LESSON, {'budget': 0}, 'budget'),
        (LESSON, {'participant': 'no code', 'directory': 'DIRECTORY'}, 'not a code'),
        (TEACHER, {'options': ['fly']}, "no reference option 'fly'"),
        (TEACHER, {'error_rate': 2.0}, 'error_rate'),
        (TEACHER, {'options': ['']}, 'no option'),
    ],
)
def test_a_node_that_cannot_start_says_why_in_one_line(
    graph: LessonGraph, module: str, parameters: dict[str, Any], says: str
) -> None:
    graph.start(GAME)
    given = {
        name: graph.folder if value == 'DIRECTORY' else value for name, value in parameters.items()
    }
    assert says in graph.refused(module, **given)


def test_two_lessons_cannot_share_a_folder(graph: LessonGraph) -> None:
    graph.start(GAME)
    with DemonstrationStore(graph.folder / 'demonstrations'):
        line = graph.refused(LESSON, directory=graph.folder / 'demonstrations')
    assert 'another lesson has it open' in line
