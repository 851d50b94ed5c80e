"""
A person's node: sends requests of the dialogue to the graph and returns the answers.

All requests are sent by a ``GraphClient``.
"""

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
import time
from typing import Any, ClassVar

from humanopts_interfaces import action as actions
from humanopts_interfaces.msg import (
    ActionCommand,
    ExecutionState,
    OptionGoal,
    OptionResult,
    PlanResult,
    StudyEvent,
)
from humanopts_ros.guarded_node import SEEDS
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT, DISPLAY, STREAM
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.lesson.requests import (
    ActionGoal,
    Answer,
    CancelRun,
    Drive,
    Request,
    RequestStatus,
)
from humanopts_teach.ros.convert import ACTIONS, TEACHING, TERMINAL_SERVICES
from humanopts_teach.ros.graph_client import Goal, GraphClient
from humanopts_teach.study.plan import PARTS
from humanopts_teach.study.record import OpenRecord, TOPIC
from rclpy.task import Future

POLL_SECONDS = 0.015  # polling period for input and pending work
_FINISH_SECONDS = 1.0  # timeout for the last requests
_FRAME_SECONDS = 0.03  # minimum time between frames
_SETTLING_SECONDS = 0.1  # maximum delay of a frame while an answer is pending
_PRESENCE_SECONDS = 0.5  # period of presence checks
_START_SECONDS = 5.0  # time before an absent node is reported missing
_NEEDED = {'game': 'current_state', 'lesson': 'lesson_state'}  # topics that prove presence
_WELL = ('REACHED', 'EPISODE_OVER', 'CONVERGED', 'NOT_CONVERGED', 'DONE')


class TeleopNode(NodeBase):
    """
    A person's node on the graph; all decisions are made by ``dialogue.app`` and its screens.

    The owner passes keys to ``press``, calls ``process_pending`` repeatedly, and draws a frame
    when ``frame_due`` returns True.
    """

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        """Start the dialogue; the options are those of the base class."""
        super().__init__('keyboard_teleop', **options)
        participant = self.setting('participant', 'p1', 'code that is proposed to the person')
        ask = self.setting(
            'ask_participant', True, 'ask who is teaching; false: it is participant'
        )
        seed = self.setting('seed', 0, 'of the start states of free play and of plans', SEEDS)
        endpoints = {**TEACHING, **TERMINAL_SERVICES, **ACTIONS}
        self._client = GraphClient(self, endpoints, on_change=self._request_redraw)
        self._world = self._client.world
        self.app = self._study(participant, seed) or App(
            opening(participant, ask=ask), self._world, seed=seed
        )
        self.app.pictures = self.setting('pictures', True, 'show the world; false: only features')
        self.app.language = self.setting('language', '', 'code or PO file; empty: as in the code')
        self._goal: Goal | None = None  # goal of the active run
        self._unsent: Request | None = None  # request waiting for its server
        self._started = self._checked = time.monotonic()
        self._drawn = self._asked = 0.0
        self._redraw = True  # whether anything has changed since the last frame
        self._seen: object = None  # contents of the last frame
        self.last_answers: list[Future] | None = None  # pending last answers; None: not ending
        self._finish_by = 0.0
        execution, running = attrgetter('execution'), attrgetter('option_name')
        for kind, topic, shown, read, qos in (
            (ExecutionState, 'execution', 'execution', execution, CURRENT),
            (OptionGoal, 'option_goals', 'running', running, DISPLAY),
        ):
            show = partial(self._show, shown, read)
            self.create_subscription(kind, topic, show, qos)
        self.create_subscription(ActionCommand, 'action', self._on_action, DISPLAY)

    def _study(self, participant: str, seed: int) -> App | None:
        """Return the dialogue of a study; None: no study."""
        parts = self.setting('study_parts', '', 'of a study, JSON; empty: no study')
        path = self.setting('study_record', '', 'file of the events of the participant')
        if not parts:
            return None
        record = published_record(self, Path(path), participant)
        left = record.remaining(PARTS.validate_json(parts))
        return StudyApp(left, record, participant, self._world, seed=seed)

    def waits_for(self) -> str | None:
        """Wait for the rules of the game."""
        return None if self._world.domain is not None else 'domain_info'

    @property
    def busy(self) -> bool:
        """Whether a frame or the answer to a request is pending."""
        return self._redraw or self.app.waits_for is not None or not self.ready

    def press(self, keys: list[str], frame: int | None = None) -> None:
        """Accept keys, as in ``App.type``."""
        self.app.type(keys, frame)
        self._redraw |= bool(keys)

    def process_pending(self) -> None:
        """Process pending work."""
        now = time.monotonic()
        request = self.app.advance(now) if self.ready else None
        if request is not None:
            self._asked = now
        self._send(request or self._unsent)
        self._check_presence(now)
        self._redraw |= self._seen != self.app.shown

    def frame_due(self) -> bool:
        """Return whether to draw: something has changed, and the last request is settled."""
        now = time.monotonic()
        unsettled = self.app.waits_for is not None and now - self._asked < _SETTLING_SECONDS
        return self._redraw and not unsettled and now - self._drawn > _FRAME_SECONDS

    def drawn(self) -> int:
        """Record that the frame was drawn, and return its number."""
        self._drawn, self._seen, self._redraw = time.monotonic(), self.app.shown, False
        return self.app.drawn()

    def send_last_requests(self) -> None:
        """Send the last requests to the available servers."""
        sent = [self._send_last(request) for request in self.app.last_requests()]
        self.last_answers = [future for future in sent if future is not None]
        self._finish_by = time.monotonic() + _FINISH_SECONDS

    @property
    def finished(self) -> bool:
        """Whether the last requests are answered or have timed out."""
        answers = self.last_answers
        late = time.monotonic() > self._finish_by
        return answers is not None and (late or all(future.done() for future in answers))

    def _send(self, request: Request | None) -> None:
        """Send the pending request, or hold it until its server is available."""
        if isinstance(request, Drive) and not request.action:
            self._client.send(request)  # stops the robot, even if a request is pending
            return
        self._unsent = None
        if request is None or request is not self.app.waits_for:
            return
        if isinstance(request, CancelRun):
            self._send_last(request)
            self._answer(request, Answer(RequestStatus.OK, ''))
        elif not self._client.is_ready(type(request)):
            self._unsent = request
        elif isinstance(request, ActionGoal):
            self._start(request)
        else:
            sent = self._client.send(request)
            sent.add_done_callback(lambda done: self._answer(request, done.result()))

    def _answer(self, request: Request, answer: Answer) -> None:
        self.app.replied(request, answer, time.monotonic())

    def _check_presence(self, now: float) -> None:
        """Check which nodes are missing."""
        if now - self._checked < _PRESENCE_SECONDS:
            return
        self._checked = now
        if now - self._started > _START_SECONDS:
            self._world.missing = tuple(
                node for node, topic in _NEEDED.items() if not self.count_publishers(topic)
            )
        if self.app.run is not None and not self._client.is_ready(type(self.app.run)):
            self.app.lost_server()

    def _send_last(self, request: Request) -> Future | None:
        """Send one of the last requests and return its future; None: its server is gone."""
        if isinstance(request, CancelRun):
            return self._goal.cancel() if self._goal is not None else None
        assert not isinstance(request, ActionGoal), (
            'this terminal is closing, so it starts nothing'
        )
        return self._client.send(request) if self._client.is_ready(type(request)) else None

    def _start(self, run: ActionGoal) -> None:
        """Send the goal of a run; the app receives an answer when it is accepted or rejected."""

        def on_feedback(feedback: Any) -> None:
            if self.app.run is run:
                self.app.run_text = _progress_text(feedback)

        def on_accepted(done: Future) -> None:
            answer: Answer = done.result()
            if answer.ok and self.app.waits_for is not run:  # the app has given up
                goal.cancel()
                return
            self._goal = goal if answer.ok else None
            self._answer(run, answer)

        def on_result(done: Future) -> None:
            self._goal, result = None, done.result()
            if result is None:
                if self.app.run is run:
                    self.app.lost_server()
                return
            if isinstance(result, PlanResult):
                self._world.uncovered = _uncovered(result)
            self.app.run_ended(run, *result_text(result, self._world.in_control))

        goal = self._client.start(run, on_feedback)
        goal.accepted.add_done_callback(on_accepted)
        goal.result.add_done_callback(on_result)

    def _on_action(self, message: ActionCommand) -> None:
        """Keep the options of the two latest actions: one may be pending while one is shown."""
        before = list(self._world.acted.items())[:1]
        newest = {(message.publisher_id, message.sequence): message.option_name}
        self._world.acted = newest | dict(before)
        self._redraw = True

    def _request_redraw(self) -> None:
        self._redraw = True

    def _show(self, shown: str, read: Callable[[Any], object], message: Any) -> None:
        """Store a value from a message in a field of the world."""
        setattr(self._world, shown, read(message))
        self._redraw = True


def published_record(node: NodeBase, path: Path, participant: str) -> OpenRecord:
    """
    Open the record of a participant so that a node publishes each new event.

    :raises OSError: the record cannot be read.
    """
    publisher = node.stamped_publisher(StudyEvent, TOPIC, STREAM)

    def publish(line: str) -> None:
        publisher.publish(StudyEvent(participant=participant, event=line))

    return OpenRecord(path, publish)


def _uncovered(result: PlanResult) -> list[tuple[str, float]] | None:
    """Return the states that the options do not cover; None: unknown."""
    if not result.coverage_known:
        return None
    steps = zip(result.single_step_states, result.single_step_gains)
    return [*((state, 0.0) for state in result.fallback_states), *steps]


def result_text(result: Any, in_control: bool) -> tuple[bool, str]:
    """
    Return whether a run was successful, and a description of its end.

    :param in_control: whether this terminal is in control.
    """
    kind, status = type(result), result.status
    well = [getattr(kind, f'STATUS_{name}', None) for name in _WELL]
    what = f' ({_counts(result)})' if not isinstance(result, PlanResult) else ''
    if status == getattr(kind, 'STATUS_INTERRUPTED', None) and in_control:
        return True, f'You took over{what}.'
    if status == kind.STATUS_CANCELED:
        return True, f'Stopped{what}.'
    if status == getattr(kind, 'STATUS_NOT_AVAILABLE', None):
        return False, f'{result.detail}. Drive to where it can, or try a new start.'
    if status not in well:
        return False, f'{result.detail}.'
    if isinstance(result, OptionResult):
        return True, f'{result.option_name}: {result.detail}{what}.'
    return True, f'{_counts(result)}.'


def _counts(result: Any) -> str:
    if isinstance(result, OptionResult):
        count = result.step_count
        steps = '1 step' if count == 1 else f'{count} steps'
        steps += f', {result.random_moves} of them random' if result.random_moves else ''
        return f'{steps}, reward {result.total_reward:g}'
    if isinstance(result, PlanResult):
        seconds = result.table_seconds + result.model_seconds + result.sweep_seconds
        planned = f'Planned for {result.n_states} states in {seconds:.2f} s'
        if not result.recorded_runs:
            return planned
        missing = ', '.join(
            f'{name} at {state}'
            for name, state in zip(result.missing_options[:2], result.missing_states)
        )
        lacks = f'; too few runs of {missing}' if missing else ''
        return f'{planned} from {result.recorded_runs} recorded runs{lacks}'
    done = f'{result.successes} of {result.episodes} episodes done'
    played = done if result.episodes else 'no episode was played to its end'
    mean = f', mean return {result.mean_return:.2f}' if result.episodes else ''
    stops = f', {result.interruptions} options stopped' if result.interruptions else ''
    moves = f', {result.random_moves} random moves' if result.random_moves else ''
    learned = f', learned from {result.learned_runs} runs' if result.learned_runs else ''
    return f'{played}, {result.fallbacks} fallbacks{moves}{stops}{mean}{learned}'


def _progress_text(feedback: Any) -> str:
    if isinstance(feedback, actions.ExecuteOption.Feedback):
        return f'{feedback.step_count} steps, reward {feedback.total_reward:g}'
    if isinstance(feedback, actions.Plan.Feedback):
        return f'planning: {feedback.stage} {100 * feedback.progress:.0f} %'
    return f'{feedback.episodes} played, {feedback.successes} done'
