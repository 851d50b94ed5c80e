"""A person's node: what the dialogue asks for goes to the graph, and what comes back to it."""

from collections.abc import Callable
from functools import partial
import json
from operator import attrgetter
from pathlib import Path
import time
from typing import Any

from humanopts_interfaces.msg import (
    ActionCommand,
    ExecutionState,
    LearningStatus,
    OptionGoal,
    StudyEvent,
)
from humanopts_ros.node_base import NodeBase, SEEDS
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import CURRENT, DISPLAY, STREAM
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.lesson.requests import (
    Answer,
    CancelRun,
    OptionStatus,
    Request,
    RequestStatus,
    Run,
)
from humanopts_teach.ros.convert import (
    LESSON_SERVICES,
    option_status_from_message,
    TERMINAL_SERVICES,
)
from humanopts_teach.ros.lesson_client import LessonClient
from humanopts_teach.ros.runs import Runs
from humanopts_teach.study.plan import Part
from humanopts_teach.study.record import Record, TOPIC
from rclpy.task import Future

POLL_SECONDS = 0.015  # between looks at what a person does, and at what is due
PARTING_SECONDS = 1.0  # for the last requests
_FRAME_SECONDS = 0.03  # least time between frames
_SETTLING_SECONDS = 0.1  # a frame waits so long for the answer to what was just asked
_PRESENCE_SECONDS = 0.5  # between looks who is on the graph
_START_SECONDS = 5.0  # before a node that has not come is called missing
_NEEDED = {'game': 'current_state', 'lesson': 'lesson_state'}  # and what shows that they are there


class TeleopNode(NodeBase):
    """
    A person's place on the graph; ``dialogue.app`` and its screens decide everything.

    Whoever shows the dialogue hands keys to ``press``, calls ``go_on`` again and again, and draws
    when ``frame_due`` says so.
    """

    def __init__(self, **options: Any) -> None:
        """Begin the dialogue; options are those of the base class."""
        super().__init__('keyboard_teleop', **options)
        participant = self.setting('participant', 'p1', 'code that is proposed to the person')
        ask = self.setting('ask_participant', True, 'ask who teaches; false: it is participant')
        seed = self.setting('seed', 0, 'of the start states of free play and of plans', SEEDS)
        services = {**LESSON_SERVICES, **TERMINAL_SERVICES}
        self._client = LessonClient(self, services, on_news=self._on_news)
        self._world = self._client.world
        self.app = self._study(participant, seed) or App(
            opening(participant, ask=ask), self._world, seed=seed
        )
        self._runs = Runs(self, self.app)
        self._held: Request | None = None  # its server is not there yet
        self._came: set[str] = set()  # nodes that were there once
        self._started = self._looked = time.monotonic()
        self._drawn = self._asked = 0.0
        self._news = True  # something came in since the last frame
        self._seen: object = None  # what the last frame showed
        for kind, topic, shown, read, qos in (
            (LearningStatus, 'learning_status', 'progress', _progress, CURRENT),
            (ExecutionState, 'execution', 'execution', attrgetter('execution'), CURRENT),
            (OptionGoal, 'option_goals', 'running', attrgetter('option_name'), DISPLAY),
        ):
            self.create_subscription(kind, topic, partial(self._show, shown, read), qos)
        self.create_subscription(ActionCommand, 'action', self._on_action, DISPLAY)

    def _study(self, participant: str, seed: int) -> App | None:
        """Return the dialogue of a study; None: there is none."""
        parts = self.setting('study_parts', '', 'of a study, JSON; empty: there is no study')
        path = self.setting('study_record', '', 'file of the events of the participant')
        if not parts:
            return None
        record = published_record(self, Path(path), participant)
        left = [Part.from_dict(part) for part in json.loads(parts)]
        return StudyApp(left, record, participant, self._world, seed=seed)

    def waits_for(self) -> str | None:
        """Wait for the rules of the game."""
        return None if self._world.domain is not None else 'domain_info'

    @property
    def busy(self) -> bool:
        """Whether something is due soon: a frame, or the answer to a request."""
        return self._news or self.app.waits_for is not None or not self.ready

    def press(self, keys: list[str], frame: int | None = None) -> None:
        """Take keys as ``App.type`` does."""
        self.app.type(keys, frame)
        self._news |= bool(keys)

    def go_on(self) -> None:
        """Carry out what can be carried out now."""
        now = time.monotonic()
        request = self.app.advance(now) if self.ready else None
        if request is not None:
            self._asked = now
        self._send(request or self._held)
        self._look_around(now)
        self._news |= self._seen != self.app.shown

    def frame_due(self) -> bool:
        """Return whether to draw now: something has changed, and what was asked is settled."""
        now = time.monotonic()
        unsettled = self.app.waits_for is not None and now - self._asked < _SETTLING_SECONDS
        return self._news and not unsettled and now - self._drawn > _FRAME_SECONDS

    def drawn(self) -> int:
        """Note that everything was drawn; return the number of the frame."""
        self._drawn, self._seen, self._news = time.monotonic(), self.app.shown, False
        return self.app.drawn()

    def part(self) -> list[Future]:
        """Make the last requests to those who are there; return what answers them."""
        sent = [self._send_last(request) for request in self.app.parting()]
        return [future for future in sent if future is not None]

    def _send(self, request: Request | None) -> None:
        """Send the request that is under way, or hold it until its server is there."""
        self._held = None
        if request is None or request is not self.app.waits_for:
            return
        if isinstance(request, CancelRun):
            self._runs.cancel()
            self._answer(request, Answer(RequestStatus.OK, ''))
        elif isinstance(request, Run):
            if self._runs.is_ready(request):
                self._runs.start(request)
            else:
                self._held = request
        elif not self._client.is_ready(request):
            self._held = request
        else:
            try:
                sent = self._client.send(request)
            except PublishError as error:
                self._answer(request, Answer(RequestStatus.REFUSED, str(error)))
            else:
                sent.add_done_callback(lambda done: self._answer(request, done.result()))

    def _answer(self, request: Request, answer: Answer) -> None:
        self.app.replied(request, answer, time.monotonic())

    def _look_around(self, now: float) -> None:
        """Notice nodes that are gone."""
        if now - self._looked < _PRESENCE_SECONDS:
            return
        self._looked = now
        there = {node for node, topic in _NEEDED.items() if self.count_publishers(topic)}
        self._came |= there
        late = now - self._started > _START_SECONDS
        self._world.missing = tuple(
            node for node in _NEEDED if node not in there and (late or node in self._came)
        )
        self._runs.check_server()

    def _send_last(self, request: Request) -> Future | None:
        """Send one of the last requests; None: nobody is there to answer it."""
        if isinstance(request, CancelRun):
            return self._runs.cancel()
        assert not isinstance(request, Run), 'a terminal that ends begins nothing'
        return self._client.send(request) if self._client.is_ready(request) else None

    def _on_action(self, message: ActionCommand) -> None:
        """Keep whose the two newest actions are: one may wait while the other is shown."""
        before = list(self._world.acted.items())[:1]
        newest = {(message.publisher_id, message.sequence): message.option_name}
        self._world.acted = newest | dict(before)
        self._news = True

    def _on_news(self) -> None:
        self._news = True

    def _show(self, shown: str, read: Callable[[Any], object], message: Any) -> None:
        """Show what a message holds, in one field of the world."""
        setattr(self._world, shown, read(message))
        self._news = True


def published_record(node: NodeBase, path: Path, participant: str) -> Record:
    """
    Return the record of a participant; a node publishes each of its new events.

    :raises OSError: the record cannot be read.
    """
    publisher = node.stamped_publisher(StudyEvent, TOPIC, STREAM)

    def publish(line: str) -> None:
        publisher.publish(StudyEvent(participant=participant, event=line))

    return Record(path, publish)


def _progress(message: LearningStatus) -> list[OptionStatus]:
    return [option_status_from_message(status) for status in message.options]
