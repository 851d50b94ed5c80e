"""A person who teaches: asks the lesson, presses keys, and sees what comes of it."""

from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_interfaces.msg import (
    ActionCommand,
    ControlState,
    Demonstration,
    GameState,
    LearningStatus,
    LessonState,
)
from humanopts_interfaces.srv import (
    AddDemonstrations,
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    ListDemonstrations,
    OpenSession,
    SetControl,
    WithdrawDemonstration,
)
from humanopts_ros.qos import CURRENT, STREAM

from graph_support.live import Graph, LESSON
from graph_support.player import ME

PICKUP = 'go to passenger and pickup'
START = 'taxi 0,1 passenger R destination G'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col', 'passenger_in_taxi')
N_QUESTIONS = len(make_domain('taxi').features)
SERVICES: dict[type, str] = {
    OpenSession: 'lesson/open_session',
    DefineOption: 'lesson/define_option',
    AnswerQuestion: 'lesson/answer_question',
    BeginDemonstration: 'lesson/begin_demonstration',
    EndDemonstration: 'lesson/end_demonstration',
    AddDemonstrations: 'lesson/add_demonstrations',
    WithdrawDemonstration: 'lesson/withdraw_demonstration',
    ListDemonstrations: 'lesson/list_demonstrations',
    ChangeOption: 'lesson/change_option',
}


class Person:
    """
    Does and sees what a person does who teaches PICKUP.

    :ivar shown: the demonstrations that were published.
    :ivar latest: the newest message of each latched topic, by its type.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.latest: dict[type, Any] = {}
        for kind, topic in (
            (LessonState, 'lesson_state'),
            (LearningStatus, 'learning_status'),
            (ControlState, 'control'),
            (GameState, 'current_state'),
        ):
            graph.node.create_subscription(kind, topic, self._keep, CURRENT)
        self.shown: list[Demonstration] = graph.listen(Demonstration, 'demonstrations')
        self.keys = graph.node.create_publisher(ActionCommand, 'action', STREAM)

    def _keep(self, message: Any) -> None:
        self.latest[type(message)] = message

    @property
    def lesson(self) -> LessonState:
        """Newest state of the lesson."""
        state: LessonState = self.latest[LessonState]
        return state

    @property
    def folder(self) -> str:
        """The folder of the demonstrations."""
        return str(self.graph.folder / 'demonstrations')

    def start_lesson(self, **parameters: Any) -> Any:
        """Start the lesson, wait until it is ready, and return the node."""
        lesson = self.graph.start(LESSON, directory=self.folder, **parameters)
        self.graph.ready('/lesson')
        return lesson

    def ask(self, kind: Any, **fields: Any) -> Any:
        """Ask the lesson for something, and return the answer."""
        return self.graph.ask(kind, SERVICES[kind], **fields)

    def phase(self, phase: int) -> None:
        """Wait until the lesson is in a phase."""
        self.graph.until(
            lambda: LessonState in self.latest and self.lesson.phase == phase, f'phase {phase}'
        )

    def get_ready(self) -> None:
        """Open a session, name the option and answer all questions."""
        opened = self.ask(OpenSession, participant='p1', session='s1')
        assert opened.status == OpenSession.Response.STATUS_OK
        self.name_and_answer()

    def name_and_answer(self) -> None:
        """Name the option and answer all questions."""
        self.ask(DefineOption, name=PICKUP)
        for number in range(1, N_QUESTIONS + 1):
            self.graph.until(lambda n=number: self.lesson.question_id == n, f'question {number}')
            yes = self.lesson.question_feature in CHOSEN
            self.ask(AnswerQuestion, question_id=number, yes=yes)
        self.phase(LessonState.PHASE_READY)

    def begin(self) -> int:
        """Begin a demonstration from START and return its episode."""
        self.phase(LessonState.PHASE_READY)
        begun = self.ask(BeginDemonstration, start_state=START)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        assert begun.state == START
        return int(begun.episode)

    def drive(self, episode: int, *actions: str) -> None:
        """Press keys, without looking at what comes of them."""
        self.graph.until(lambda: self.keys.get_subscription_count() > 0, 'game to listen')
        for action in actions:
            self.keys.publish(
                ActionCommand(
                    publisher_id=ME,
                    source=ActionCommand.SOURCE_PERSON,
                    episode=episode,
                    action=action,
                )
            )

    def end(self, episode: int, step: int, **fields: Any) -> Any:
        """Say done, and return the answer."""
        done = EndDemonstration.Request.VERDICT_DONE
        return self.ask(EndDemonstration, verdict=done, episode=episode, step=step, **fields)

    def demonstrate(self) -> str:
        """Give a demonstration, and return its uuid."""
        episode = self.begin()
        self.drive(episode, 'west', 'pickup')
        ended = self.end(episode, 2)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        return str(ended.uuid)

    def give_back(self) -> None:
        """Give control back, and wait until it is free."""
        self.graph.ask(SetControl, 'set_control', hold=False, holder_id=ME)
        nobody = ControlState.HOLDER_NOBODY
        self.graph.until(lambda: self.latest[ControlState].holder == nobody, 'control to be free')

    def show(self) -> str:
        """Give a demonstration that a learner counts in; return its uuid."""
        uuid = self.demonstrate()
        self.graph.until(lambda: self.lesson.last_uuid == uuid, 'the lesson to keep it')
        self.phase(LessonState.PHASE_READY)
        return uuid
