"""A lesson whose recorder cannot go on: it pauses, and loses nothing that was shown."""

from pathlib import Path
from typing import Any

from graph_support.live import GAME, Graph, RECORDER
from graph_support.teaching import Person, SERVICES
from humanopts_interfaces.msg import NodeStatus
from humanopts_interfaces.srv import EndDemonstration, ListDemonstrations
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import open_bag
import pytest


class Session(Person):
    """A game, a lesson, the recorders of the test, and a person."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.recorder = self.record('first')
        graph.start(GAME, expect_recorder=True)
        self.start_lesson(
            expect_recorder=True, participant='p1', session='s1', learner_deadline=0.2
        )
        graph.ready('/game')

    def record(self, name: str) -> Any:
        """Start a recorder, which begins a file again and again."""
        return self.graph.start(RECORDER, path=self.graph.folder / name, max_seconds=0.2)

    def paused(self) -> str:
        """Wait until the lesson is paused, and return the cause."""
        self.graph.until(lambda: self.lesson.paused, 'the pause')
        self.graph.until(self._in(NodeStatus.STATE_PAUSED), 'the status of the node')
        return str(self.lesson.paused)

    def goes_on(self) -> None:
        """Wait until the lesson goes on."""
        self.graph.until(lambda: not self.lesson.paused, 'the end of the pause')
        self.graph.until(self._in(NodeStatus.STATE_READY), 'the status of the node')

    def _in(self, state: int) -> Any:
        return lambda: self.graph.state('/lesson') == state


@pytest.fixture
def session(live: Graph) -> Session:
    return Session(live)


def uuids(bag: Path) -> list[str]:
    """Return the demonstrations in a bag, each once."""
    return list(dict.fromkeys(demo.uuid for demo in read_demonstrations(open_bag(bag))))


def test_a_recording_that_stops_pauses_the_lesson_until_the_next_one_has_all_that_was_shown(
    session: Session,
) -> None:
    folder = session.graph.folder
    session.name_and_answer()
    shown = []
    for _ in range(2):
        episode = session.begin()
        session.drive(episode, 'west')
        if shown:  # the recording stops in the middle of the second one
            session.graph.until(lambda: uuids(folder / 'first') == shown, 'the first in the bag')
            (folder / 'first' / 'metadata.yaml.new').mkdir()
            cause = session.paused()
        session.drive(episode, 'pickup')
        ended = session.end(episode, 2)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        shown.append(ended.uuid)
    assert 'recording stopped: cannot write in' in cause
    assert 'Everything taught so far is on disk' in cause
    assert 'not in this recording: the next one has it' in ended.detail
    for kind in SERVICES.keys() - {EndDemonstration, ListDemonstrations}:
        refused = session.ask(kind)
        assert refused.status == kind.Response.STATUS_PAUSED
        assert cause in refused.detail

    second = session.record('second')
    session.goes_on()
    session.begin()
    for recorder in (session.recorder, second):
        session.graph.stop(recorder)
    with session.graph.hurried():
        assert 'nothing is heard of the recorder any more' in session.paused()
    assert uuids(folder / 'first') == shown[:1]
    assert uuids(folder / 'second') == shown
