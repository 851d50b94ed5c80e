"""The node ``lesson``: offers the teaching session as services, and publishes its state."""

from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import datetime, UTC
from functools import partial
from pathlib import Path
import sys
from typing import Any

from humanopts_env.domains.base import ActableDomain, StateError
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_interfaces import msg
from humanopts_interfaces.srv import ResetGame
from humanopts_learner.demonstrations import Demonstration, METHODS
from humanopts_learner.options.learned_option import OptionError
from humanopts_learner.options.starts import STRATEGIES
from humanopts_learner.ros.convert import demonstration_to_message, summary_from_message
from humanopts_ros.guarded_node import PATIENCE, SEEDS, StartError
from humanopts_ros.node_base import NodeBase, RECORDER
from humanopts_ros.process import run_node
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.recorders import Recorders
from humanopts_teach.lesson.requests import (
    Answer,
    BeginDemonstration,
    EndDemonstration,
    LessonRequest,
    LessonView,
    OpenSession,
    Phase,
    RequestStatus,
    Verdict,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.store import DemonstrationStore, OpenSessionFile, StoreError
from humanopts_teach.ros.convert import Endpoint, LESSON_SERVICES, LESSON_STATE
from rclpy.event_handler import SubscriptionEventCallbacks

_NO_NAME_YET = '_NODE_NAME_UNKNOWN_'  # the middleware's placeholder for a newly discovered node
_TICK = 0.1  # s between checks while something is pending
_IDLE_TICKS = 5  # ticks between checks while nothing is
_GAME_DEADLINE = 5.0  # s for the game to respond, and for an announced state to arrive
_RESEND_DELAY = 0.5  # s from a learner's first status until its subscription is surely matched


class LessonNode(NodeBase):
    """Serves a lesson; answers and demonstrations are saved to disk before publication."""

    def __init__(self, **options: Any) -> None:
        """
        Open the folder of demonstrations, and wait for the rules of the game.

        :param options: options of ``NodeBase``.
        :raises StartError: a parameter or the folder is invalid.
        """
        super().__init__('lesson', **options)
        self._rules = self._read_rules()
        self._learner_deadline = self.setting(
            'learner_deadline',
            30.0,
            'longest wait for the learner after a demonstration, s',
            PATIENCE,
            on_change=partial(setattr, self, '_learner_deadline'),
        )
        self._participant = self.setting(
            'participant', '', 'code of the person whose session is opened at the start; or empty'
        )
        self._session = self.setting('session', '', 'its session; empty: a new one')
        directory = self.setting('directory', 'demonstrations', 'folder of all demonstrations')
        try:
            self._store = DemonstrationStore(Path(directory))
        except StoreError as error:
            raise StartError(str(error)) from error
        self._open_session = OpenSessionFile(Path(directory))
        for damage in self._store.damage:
            self.get_logger().warning(damage)
        self._opened: Lesson | None = None  # None until the game is known
        self._state_out = self.stamped_publisher(
            msg.LessonState, 'lesson_state', LATCHED, repeated=True
        )
        self._demonstrations_out = self.stamped_publisher(msg.Demonstration, 'demonstrations')
        self._unsent: deque[Demonstration] = deque()
        self._shown: LessonView | None = None  # last published state
        self._recorders = Recorders(expected=self._expect_recorder)
        self._unrecorded = ''  # reason why nothing is recorded; empty: recording works
        self._reported = ''  # reason for the pause, as in the node's status
        self._learner = ''  # publisher_id of the known learner
        self._asked_learner = 0.0  # s, time of the latest demonstration
        self._reset = self.recorded_client(ResetGame, 'reset_game')
        self._resend = self.create_timer(_RESEND_DELAY, self._send_again, autostart=False)
        self._ticks = 1  # between checks
        self._timer = self.create_timer(_TICK, self._tick)
        self._game = GameSubscriber(self, self._on_domain)
        self.peers.on_restart.append(self._on_restart)
        self._game_states = self._game.follow('game_state', self._on_game_state)
        self._recorder_status = self.create_subscription(
            msg.RecorderStatus,
            'recorder_status',
            self._on_recorder,
            CURRENT,
            event_callbacks=SubscriptionEventCallbacks(matched=self._on_recorder_matched),
        )
        self._recorder_said: tuple[object, ...] = ()  # significant part of its last status

    def _read_rules(self) -> LessonRules:
        what, default = f'of start states: {", ".join(STRATEGIES)}', LessonRules().strategy
        strategy = self.setting('strategy', default, what, among=STRATEGIES)
        what = 'default learning method of a new option: trees, forest or goal'
        method = self.setting('learn', LessonRules().method, what, among=tuple(METHODS))
        what = 'formulas over features, added as features of every participant'
        formulas = self.setting('derive', [''], what)
        return self.settings(
            LessonRules(strategy, method=method, derive=tuple(filter(None, formulas or ()))),
            {
                'budget': 'maximum number of start states per option',
                'seed': 'seed of all random draws',
                'until_no_failures': 'with the strategy failures: when the criteria hold, '
                'continue while the learned option fails from any state (from more than a tenth, '
                'if states are sampled)',
            },
            {'budget': (1, 1_000_000), 'seed': SEEDS},
        )

    @property
    def _lesson(self) -> Lesson:
        """The lesson; its services and subscriptions exist only when the game is known."""
        assert self._opened is not None
        return self._opened

    # Startup and shutdown.

    def waits_for(self) -> str | None:
        """Wait for the rules of the game and its stream of states."""
        if self._opened is None:
            return 'domain_info'
        return None if self._game_states.get_publisher_count() else 'game_state'

    def on_ready(self) -> None:
        """Republish all demonstrations and the state of the lesson."""
        self._unsent.extend(self._lesson.demonstrations())
        self._show()

    def close(self) -> None:
        """Release the folder and close the session."""
        self._open_session.forget()
        self._store.close()

    def _on_domain(self, domain: ActableDomain) -> None:
        """Open the lesson and create its services and subscriptions."""
        self._opened = Lesson(
            domain,
            self._store,
            SeededStarts(domain, self._rules),
            clock=self.monotonic,
            today=lambda: datetime.now(UTC).strftime('%Y%m%d'),
        )
        left = self._open_session.left()
        if left is not None:
            answer = self._opened.resume(*left)
            self._asked_learner = self.monotonic()
        elif self._participant:
            answer = self._opened.carry_out(OpenSession(self._participant, self._session))
        if (left is not None or self._participant) and not answer.ok:
            raise StartError(answer.detail)
        for service in LESSON_SERVICES.values():
            self.recorded_service(service.kind, service.name, self._handler(service))
        for kind, topic, use, qos in (
            (msg.DemonstrationReceipt, 'demonstration_receipts', self._on_receipt, STREAM),
            (msg.LearningStatus, 'learning_status', self._on_status, CURRENT),
            (msg.LearnedOption, 'learned_options', self._on_option, STREAM),
            (msg.PlanResult, 'plan_results', self._on_plan, STREAM),
        ):
            self.create_subscription(kind, topic, use, qos)

    # Requests of the person.

    def _handler(self, service: Endpoint) -> Callable[[Any, Any], Awaitable[Any]]:
        """Return the callback of a service."""

        async def handle(message: Any, response: Any) -> Any:
            request: LessonRequest = service.request.decode(message)
            if isinstance(request, EndDemonstration) and request.verdict is not Verdict.DISCARD:
                # The state that the person saw may not have arrived yet.
                seen = request.episode, request.step
                await self.waiting.until(lambda: self._lesson.reached(*seen), _GAME_DEADLINE)
            answer = self._lesson.carry_out(request)
            if isinstance(request, OpenSession) and answer.ok:
                self._open_session.keep(request.participant, answer.session)
            if isinstance(request, BeginDemonstration) and answer.ok:
                answer = await self._begin(answer)
            if answer.unsent:
                self._asked_learner = self.monotonic()
                self._unsent.extend(answer.unsent)
                self._check_each(1)
                for demo in answer.unsent:
                    done = 'withdrawn' if demo.withdrawn else 'kept'
                    self.get_logger().info(
                        f'{demo.option_name}: demonstration {demo.number} is {done}'
                    )
            self._show()
            if answer.unsent:
                self._lesson.draw_ahead()
            assert service.answer is not None, 'not an action'
            return service.answer.encode(answer)

        return handle

    async def _begin(self, prepared: Answer) -> Answer:
        """Start the episode in the game, and wait for its first state on the stream."""
        lesson, until = self._lesson, self.waiting.until
        no_game = RequestStatus.NO_GAME
        if not await until(self._is_game_ready, _GAME_DEADLINE):
            return lesson.not_begun(no_game, 'Game does not serve reset_game.')
        person, start, seed = ResetGame.Request.SOURCE_PERSON, prepared.state, prepared.seed
        request = ResetGame.Request(source=person, start_state=start, seed=seed)
        reply = await self.waiting.answer(self._reset, request, _GAME_DEADLINE)
        if reply is None:
            return lesson.not_begun(no_game, 'The game is not responding.')
        if reply.status != ResetGame.Response.STATUS_OK:
            bad = reply.status == ResetGame.Response.STATUS_BAD_STATE
            return lesson.not_begun(RequestStatus.BAD_STATE if bad else no_game, reply.detail)
        answer = lesson.began(reply.episode, reply.state)
        if not answer.ok:
            return answer
        if not await until(lambda: lesson.reached(reply.episode, 0), _GAME_DEADLINE):
            return lesson.not_begun(no_game, 'The first state of the episode did not arrive.')
        if lesson.phase is not Phase.DEMONSTRATING:
            return Answer(no_game, lesson.view.text)
        return answer

    def _is_game_ready(self) -> bool:
        """Return whether the game is available and its states will be received."""
        matched = self._game_states.get_publisher_count() > 0
        return matched and bool(self._reset.service_is_ready())

    # Messages from the game, the learner and the recorder.

    def _on_restart(self, name: str) -> None:
        if name == self._game.name and self._opened and self._opened.game_restarted():
            self._show()

    def _on_game_state(self, observed: Observed) -> None:
        if self._lesson.add_transition(observed.transition):
            self._show()
        self.waiting.check()

    def _on_receipt(self, receipt: msg.DemonstrationReceipt) -> None:
        if receipt.status != receipt.STATUS_REFUSED:
            return
        if receipt.uuid == self._lesson.awaited:
            self._learner = ''  # perhaps its disk is full: resend at the next status
        self._lesson.learner_refused(receipt.uuid, receipt.detail)
        self._show()

    def _on_status(self, status: msg.LearningStatus) -> None:
        self._lesson.update_summaries([summary_from_message(option) for option in status.options])
        self._show()
        if status.publisher_id != self._learner:  # a new learner may lack demonstrations
            self._learner = status.publisher_id
            self._resend.reset()

    def _on_option(self, option: msg.LearnedOption) -> None:
        if not option.model:
            return
        try:
            self._lesson.update_option(option.participant, option.name, option.model)
        except OptionError as error:
            self.refuse('learned_options', option, error)
        self._show()

    def _on_plan(self, result: msg.PlanResult) -> None:
        """Offer the states in which a plan got stuck."""
        stuck = zip(result.stuck_options, result.stuck_states)
        try:
            self._lesson.feedback.update_trial(result.participant, result.trial_games, stuck)
        except StateError as error:
            self.refuse('plan_results', result, error)
        self._show()

    def _on_recorder(self, status: msg.RecorderStatus) -> None:
        self._recorders.update(
            status.publisher_id,
            complete=status.complete,
            stopped=status.stopped,
            text=status.text,
        )
        said = status.publisher_id, status.complete, status.stopped
        if said != self._recorder_said:
            self._recorder_said = said
            self._check_each(1)

    def _on_recorder_matched(self, event: Any) -> None:
        self._check_each(1)

    def _check_each(self, ticks: int) -> None:
        """Check pending work every ``ticks`` ticks from now on."""
        self._ticks, self._timer.timer_period_ns = ticks, int(ticks * _TICK * 1e9)
        self._timer.reset()

    def _check_recording(self) -> None:
        """Pause while nothing is recorded, then republish everything for the new bag."""
        fault = self._recorders.check(self._recorder_status.get_publisher_count() > 0, self._ticks)
        if self._unrecorded and not fault:
            # Other nodes may publish on the topic. Also count stopped recorders and nodes without
            # a known name: a bag misses messages sent before its recorder subscribes.
            readers = self.get_publishers_info_by_topic('recorder_status')
            present = sum(each.node_name in (RECORDER, _NO_NAME_YET) for each in readers)
            if not self.records(self._demonstrations_out, present):
                return
            self._unsent.extend(self._lesson.demonstrations())
        self._unrecorded = fault

    def _send_again(self) -> None:
        """Resend everything for a new learner, which drops duplicates."""
        self._resend.cancel()
        self._unsent.extend(self._lesson.demonstrations())
        self._show()

    def _tick(self) -> None:
        if self._opened is None:
            return
        late = self.monotonic() - self._asked_learner > self._learner_deadline
        if self._lesson.awaited and late:
            self._lesson.learner_silent()
            self._learner = ''  # it may lack demonstrations when it returns
        if self.ready:
            self._check_recording()
        self._show()
        pending = self._lesson.awaited or self._unrecorded or self._reported
        ticks = 1 if pending or not self.ready else _IDLE_TICKS
        if ticks != self._ticks:
            self._check_each(ticks)

    def _show(self) -> None:
        """Publish changes; pause while publishing fails or nothing is recorded."""
        if not self.ready:
            return
        cause = self._unrecorded
        self._lesson.pause(cause)
        try:
            while self._unsent:
                self._demonstrations_out.publish(demonstration_to_message(self._unsent[0]))
                self._unsent.popleft()
            self._send_view()
        except PublishError as error:
            cause = str(error)
            self._lesson.pause(cause)
            with suppress(PublishError):  # may fail for the same reason
                self._send_view()
        if cause != self._reported:
            self._reported = cause
            status = msg.NodeStatus
            self.set_status(status.STATE_PAUSED if cause else status.STATE_READY, cause)

    def _send_view(self) -> None:
        view = self._lesson.view
        if view != self._shown:
            self._state_out.publish(LESSON_STATE.encode(view))
            self._shown = view


main = partial(run_node, LessonNode)

if __name__ == '__main__':
    sys.exit(main())
