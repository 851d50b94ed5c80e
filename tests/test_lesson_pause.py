"""A lesson whose recorder cannot go on: it pauses, and loses nothing that was shown."""

from collections.abc import Iterator
from pathlib import Path
import resource
import signal
from typing import Any

from graph_support.live import GAME, Graph, LESSON, NodeProcess, RECORDER
from humanopts_env.domains.registry import make_domain
from humanopts_interfaces.msg import ActionCommand, LessonState, NodeStatus
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
    WithdrawDemonstration,
)
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import open_bag
import pytest

OPTION = 'go to passenger and pickup'
START = 'taxi 0,1 passenger R destination G'
SERVICES: dict[type, str] = {
    OpenSession: 'lesson/open_session',
    DefineOption: 'lesson/define_option',
    AnswerQuestion: 'lesson/answer_question',
    BeginDemonstration: 'lesson/begin_demonstration',
    EndDemonstration: 'lesson/end_demonstration',
    WithdrawDemonstration: 'lesson/withdraw_demonstration',
}


class Session:
    """A game, a lesson, the recorders of the test, and a person."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.states: list[LessonState] = graph.listen(LessonState, 'lesson_state', CURRENT)
        self.keys = graph.node.create_publisher(ActionCommand, 'action', STREAM)
        self.recorder = self.record('first')
        graph.start(GAME, expect_recorder=True)
        graph.start(
            LESSON,
            expect_recorder=True,
            directory=str(graph.folder / 'demonstrations'),
            participant='p1',
            session='s1',
            learner_deadline=0.2,
        )
        graph.ready('/game', '/lesson')

    def record(self, name: str) -> NodeProcess:
        """Start a recorder."""
        return self.graph.start(RECORDER, path=str(self.graph.folder / name))

    def ask(self, kind: Any, **fields: Any) -> Any:
        """Ask the lesson for something."""
        return self.graph.ask(kind, SERVICES[kind], **fields)

    def get_ready(self) -> None:
        """Name an option and answer all questions."""
        self.ask(DefineOption, name=OPTION)
        for number in range(1, len(make_domain('taxi').features) + 1):
            self.ask(AnswerQuestion, question_id=number, yes=True)

    def begin(self) -> int:
        """Begin a demonstration, and return its episode."""
        self.graph.until(
            lambda: self.states[-1].phase == LessonState.PHASE_READY, 'the lesson to be ready'
        )
        begun = self.ask(BeginDemonstration, start_state=START)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        return int(begun.episode)

    def drive(self, episode: int, action: str) -> None:
        """Press a key."""
        self.graph.until(lambda: self.keys.get_subscription_count() > 0, 'game to listen')
        person = ActionCommand.SOURCE_PERSON
        self.keys.publish(
            ActionCommand(publisher_id='/p#1', source=person, episode=episode, action=action)
        )

    def end(self, episode: int, step: int) -> Any:
        """Say done."""
        done = EndDemonstration.Request.VERDICT_DONE
        return self.ask(EndDemonstration, verdict=done, episode=episode, step=step)

    def paused(self) -> str:
        """Wait until the lesson is paused, and return the cause."""
        self.graph.until(lambda: self.states[-1].paused, 'the pause')
        self.graph.until(self._in(NodeStatus.STATE_PAUSED), 'the status of the node')
        return str(self.states[-1].paused)

    def goes_on(self) -> None:
        """Wait until the lesson goes on."""
        self.graph.until(lambda: not self.states[-1].paused, 'the end of the pause')
        self.graph.until(self._in(NodeStatus.STATE_READY), 'the status of the node')

    def _in(self, state: int) -> Any:
        return lambda: self.graph.state('/lesson') == state


@pytest.fixture
def session(live: Graph) -> Iterator[Session]:
    return Session(live)


def uuids(bag: Path) -> list[str]:
    """Return the demonstrations in a bag, each once."""
    return list(dict.fromkeys(demo.uuid for demo in read_demonstrations(open_bag(bag))))


def test_a_full_disk_pauses_the_lesson_until_the_next_recorder_has_all_that_was_shown(
    session: Session,
) -> None:
    folder = session.graph.folder
    session.get_ready()
    shown = []
    for _ in range(2):
        episode = session.begin()
        session.drive(episode, 'west')
        if shown:  # the disk fills up in the middle of the second one
            session.graph.until(lambda: uuids(folder / 'first') == shown, 'the first in the bag')
            number = session.recorder.process.pid
            resource.prlimit(number, resource.RLIMIT_FSIZE, (1000, 1000))
            cause = session.paused()
        session.drive(episode, 'pickup')
        ended = session.end(episode, 2)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        shown.append(ended.uuid)
    assert 'recording stopped: cannot write to' in cause
    assert 'Everything taught so far is on disk' in cause
    assert 'not in this recording: the next one has it' in ended.detail
    for kind, fields in (
        (OpenSession, {'participant': 'p2'}),
        (DefineOption, {'name': 'another'}),
        (AnswerQuestion, {'question_id': 1}),
        (BeginDemonstration, {}),
        (WithdrawDemonstration, {}),
    ):
        refused = session.ask(kind, **fields)
        assert refused.status == kind.Response.STATUS_PAUSED
        assert cause in refused.detail

    second = session.record('second')
    session.goes_on()
    session.begin()
    session.recorder.kill(signal.SIGTERM)
    second.kill(signal.SIGTERM)
    assert 'nothing is heard of the recorder any more' in session.paused()
    assert uuids(folder / 'first') == shown[:1]
    assert uuids(folder / 'second') == shown
