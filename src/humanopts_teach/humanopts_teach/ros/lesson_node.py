"""The node ``lesson``: the teaching session behind services, its state and demonstrations out."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime, UTC
import sys
import time
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.game import moment_from_message
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.msg import (
    Demonstration as DemonstrationMessage,
)
from humanopts_interfaces.msg import (
    DemonstrationReceipt,
    DomainInfo,
    GameState,
    LearnedOptions,
    LearningStatus,
    LessonState,
    NodeStatus,
    RecorderStatus,
)
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
    ResetGame,
    WithdrawDemonstration,
)
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.option import OptionError
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.process import run_node
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_teach.dialogue.answers import Answer, LessonView, Phase, Status, Verdict
from humanopts_teach.dialogue.learned_starts import LearnedStarts
from humanopts_teach.dialogue.lesson import Lesson
from humanopts_teach.dialogue.recorders import Recorders
from humanopts_teach.ros.convert import (
    answered,
    progress_from_message,
    verdict_from_number,
    view_to_message,
)
from humanopts_teach.ros.lesson_settings import open_store, read_rules
from rcl_interfaces.msg import FloatingPointRange
from rclpy.callback_groups import ReentrantCallbackGroup

_TICK = 0.1  # s between looks at deadlines
_GAME_DEADLINE = 5.0  # s for game to answer, and for a state that was announced to arrive
_RESEND_DELAY = 0.5  # s from a learner's first word until it is sure to be listening


class LessonNode(NodeBase):
    """Serves one lesson; what it is told is on disk before it is published."""

    def __init__(self) -> None:
        super().__init__('lesson')
        self._rules = read_rules(self)
        self._until_no_failures = bool(
            self.setting(
                'until_no_failures',
                False,
                'with strategy failures: once the criteria hold, go on while the learned option '
                'fails from a state (from more than a tenth, where states are sampled)',
            )
        )
        self._learner_deadline = float(
            self.setting(
                'learner_deadline',
                30.0,
                'longest wait for the learner after a demonstration, s',
                floating_point_range=[FloatingPointRange(from_value=0.1, to_value=3600.0)],
            )
        )
        self._participant = self.setting(
            'participant', '', 'code of the person whose session is opened at the start; or empty'
        )
        self._session = self.setting('session', '', 'its session; empty: a new one')
        self._store = open_store(self)
        self._lesson: Lesson | None = None
        self._state_out = self.stamped_publisher(LessonState, 'lesson_state', LATCHED)
        self._demonstrations_out = self.stamped_publisher(DemonstrationMessage, 'demonstrations')
        self._unsent: deque[Demonstration] = deque()
        self._shown: LessonView | None = None  # what was published last
        self._recorders = Recorders(expected=self._expect_recorder)
        self._unrecorded = ''  # why nothing is recorded now; empty: all is well
        self._told = ''  # why the lesson is paused, as the node's status says
        self._learner = ''  # publisher_id of the learner that is known
        self._asked_learner = 0.0  # time of the newest demonstration, s
        self._reentrant = ReentrantCallbackGroup()
        self._reset = self.recorded_client(ResetGame, 'reset_game', self._reentrant)
        self._resend = self.create_timer(_RESEND_DELAY, self._send_again, autostart=False)
        self.create_timer(_TICK, self._tick)
        self.create_subscription(DomainInfo, 'domain_info', self._on_domain, CURRENT)
        self._game_states = self.create_subscription(
            GameState, 'game_state', self._on_game_state, STREAM
        )
        self._recorder_status = self.create_subscription(
            RecorderStatus, 'recorder_status', self._on_recorder, CURRENT
        )

    # The start and the end of the node.

    def waits_for(self) -> str | None:
        """Wait for the rules of the game and for its stream of states."""
        if self._lesson is None:
            return 'domain_info'
        return None if self._game_states.get_publisher_count() else 'game_state'

    def on_ready(self) -> None:
        """Publish all demonstrations again, and where the lesson stands."""
        assert self._lesson is not None
        self._unsent.extend(self._lesson.demonstrations())
        self._show()

    def close(self) -> None:
        """Let another lesson use the folder."""
        self._store.close()

    def _on_domain(self, info: DomainInfo) -> None:
        if self._lesson is not None:
            return
        try:
            domain = domain_from_info(info)
        except DomainError as error:
            raise StartError(str(error)) from error
        self._lesson = self._make_lesson(domain)
        self._serve()

    def _make_lesson(self, domain: Domain[Any]) -> Lesson:
        self._starts = LearnedStarts(
            domain, self._rules.strategy, until_no_failures=self._until_no_failures
        )
        lesson = Lesson(
            domain,
            self._store,
            self._starts,
            self._rules,
            clock=time.monotonic,
            today=lambda: datetime.now(UTC).strftime('%Y%m%d'),
        )
        if self._participant:
            answer = lesson.open_session(self._participant, self._session)
            if not answer.ok:
                raise StartError(answer.detail)
        return lesson

    def _serve(self) -> None:
        def serve(kind: Any, name: str, callback: Callable[..., Any]) -> None:
            self.recorded_service(kind, f'lesson/{name}', callback, self._reentrant)

        serve(OpenSession, 'open_session', self._on_open)
        serve(DefineOption, 'define_option', self._on_define)
        serve(AnswerQuestion, 'answer_question', self._on_answer)
        serve(BeginDemonstration, 'begin_demonstration', self._on_begin)
        serve(EndDemonstration, 'end_demonstration', self._on_end)
        serve(WithdrawDemonstration, 'withdraw_demonstration', self._on_withdraw)
        self.create_subscription(
            DemonstrationReceipt, 'demonstration_receipts', self._on_receipt, STREAM
        )
        self.create_subscription(LearningStatus, 'learning_status', self._on_status, CURRENT)
        self.create_subscription(LearnedOptions, 'learned_options', self._on_options, CURRENT)

    # What the person asks for.

    def _on_open(
        self, request: OpenSession.Request, response: OpenSession.Response
    ) -> OpenSession.Response:
        answer = self._lesson.open_session(request.participant, request.session)
        self._show()
        response.session = answer.session
        response.known_options = list(answer.known_options)
        return answered(response, answer)

    def _on_define(
        self, request: DefineOption.Request, response: DefineOption.Response
    ) -> DefineOption.Response:
        answer = self._lesson.define_option(request.name, request.ask_again)
        self._show()
        response.resumed = answer.resumed
        return answered(response, answer)

    def _on_answer(
        self, request: AnswerQuestion.Request, response: AnswerQuestion.Response
    ) -> AnswerQuestion.Response:
        answer = self._lesson.answer_question(request.question_id, request.yes)
        self._show()
        return answered(response, answer)

    async def _on_begin(
        self, request: BeginDemonstration.Request, response: BeginDemonstration.Response
    ) -> BeginDemonstration.Response:
        answer = self._lesson.prepare(request.start_state)
        if answer.ok:
            answer = await self._begin(answer)
        self._show()
        if answer.ok:
            response.episode, response.state = self._lesson.view.episode, answer.state
        return answered(response, answer)

    async def _begin(self, prepared: Answer) -> Answer:
        """Have game begin the episode, and wait for its first state on the stream."""
        lesson, until = self._lesson, self.waiting.until
        if not await until(self._game_is_there, _GAME_DEADLINE):
            return lesson.not_begun(Status.NO_GAME, 'Game does not serve reset_game.')
        reply = await self.answer(
            self._reset,
            ResetGame.Request(
                source=ResetGame.Request.SOURCE_PERSON,
                start_state=prepared.state,
                seed=prepared.seed,
            ),
            _GAME_DEADLINE,
        )
        if reply is None:
            return lesson.not_begun(Status.NO_GAME, 'Game does not answer.')
        if reply.status != ResetGame.Response.STATUS_OK:
            bad = reply.status == ResetGame.Response.STATUS_BAD_STATE
            return lesson.not_begun(Status.BAD_STATE if bad else Status.NO_GAME, reply.detail)
        answer = lesson.began(reply.episode, reply.state)
        if not answer.ok:
            return answer
        if not await until(lambda: lesson.reached(reply.episode, 0), _GAME_DEADLINE):
            return lesson.not_begun(Status.NO_GAME, 'The first state of the episode did not come.')
        if lesson.phase is not Phase.DEMONSTRATING:
            return Answer(Status.NO_GAME, lesson.view.text)
        return answer

    def _game_is_there(self) -> bool:
        """Tell whether game can be asked, and what it then publishes will be heard."""
        heard = self._game_states.get_publisher_count() > 0
        return heard and bool(self._reset.service_is_ready())

    async def _on_end(
        self, request: EndDemonstration.Request, response: EndDemonstration.Response
    ) -> EndDemonstration.Response:
        lesson = self._lesson
        verdict, here = verdict_from_number(request.verdict), (request.episode, request.step)
        if verdict in (Verdict.DONE, Verdict.NOT_HERE):
            await self.waiting.until(lambda: lesson.reached(*here), _GAME_DEADLINE)
        answer = lesson.end_demonstration(verdict, *here, request.can_start_at_end)
        return self._told_learner(response, answer)

    def _on_withdraw(
        self, request: WithdrawDemonstration.Request, response: WithdrawDemonstration.Response
    ) -> WithdrawDemonstration.Response:
        return self._told_learner(response, self._lesson.withdraw(request.uuid))

    def _told_learner(self, response: Any, answer: Answer) -> Any:
        """Answer, and publish the demonstration that was kept or taken back."""
        if answer.demonstration is not None:
            response.uuid = answer.demonstration.uuid
            self._asked_learner = time.monotonic()
            self._unsent.append(answer.demonstration)
        self._show()
        return answered(response, answer)

    # What game and the learner tell.

    def _on_game_state(self, message: GameState) -> None:
        if self._lesson is None:
            return
        if self._lesson.saw(moment_from_message(message)):
            self._show()
        self.waiting.look()

    def _on_receipt(self, receipt: DemonstrationReceipt) -> None:
        if receipt.status == DemonstrationReceipt.STATUS_REFUSED:
            if receipt.uuid == self._lesson.awaited:
                self._learner = ''  # a full disk of its own, perhaps: sent again with the next
            self._lesson.learner_refused(receipt.uuid, receipt.detail)
            self._show()

    def _on_status(self, status: LearningStatus) -> None:
        self._lesson.learner_said([progress_from_message(option) for option in status.options])
        self._show()
        if status.publisher_id != self._learner:  # a learner that may lack demonstrations
            self._learner = status.publisher_id
            self._resend.reset()

    def _on_options(self, message: LearnedOptions) -> None:
        for option in message.options:
            try:
                self._starts.learned(option.participant, option.name, option.model)
            except OptionError as error:
                self.get_logger().error(f'learned_options: {error}')
        self._lesson.starts_know_more()
        self._show()

    def _on_recorder(self, status: RecorderStatus) -> None:
        self._recorders.heard(
            status.publisher_id,
            complete=status.complete,
            stopped=status.stopped,
            text=status.text,
        )

    def _look_at_recording(self) -> None:
        """Notice that nothing is recorded; then that it is, and have the new bag get all."""
        there = self._recorder_status.get_publisher_count()
        fault = self._recorders.look(there > 0)
        if self._unrecorded and not fault:
            if not self.records(
                self._demonstrations_out, there
            ):  # one that stopped may be among them
                return
            self._unsent.extend(self._lesson.demonstrations())
        self._unrecorded = fault

    def _send_again(self) -> None:
        """Send everything to a learner that is new; it drops what it has."""
        self._resend.cancel()
        self._unsent.extend(self._lesson.demonstrations())
        self._show()

    def _tick(self) -> None:
        if self._lesson is None:
            return
        late = time.monotonic() - self._asked_learner > self._learner_deadline
        if self._lesson.awaited and late:
            self._lesson.learner_silent()
            self._learner = ''  # it may lack what was sent, once it is heard again
        if self.ready:
            self._look_at_recording()
        self._show()

    def _show(self) -> None:
        """Publish what is new; pause while that fails, or while nothing is recorded."""
        if not self.ready:
            return
        cause = self._unrecorded
        self._lesson.pause(cause)
        try:
            self._send()
        except PublishError as error:
            cause = str(error)
            self._lesson.pause(cause)
            with suppress(PublishError):  # where it is not this that cannot be sent
                self._send_view()
        if cause != self._told:
            self._told = cause
            self.set_status(NodeStatus.STATE_PAUSED if cause else NodeStatus.STATE_READY, cause)

    def _send(self) -> None:
        while self._unsent:
            self._demonstrations_out.publish(demonstration_to_message(self._unsent[0]))
            self._unsent.popleft()
        self._send_view()

    def _send_view(self) -> None:
        view = self._lesson.view
        if view != self._shown:
            self._state_out.publish(view_to_message(view))
            self._shown = view


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(LessonNode, args)


if __name__ == '__main__':
    sys.exit(main())
