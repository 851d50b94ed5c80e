"""The node ``simulated_teacher``: teaches over the graph as a person does."""

import sys
import time
from typing import Any

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import reference_options
from humanopts_env.game import moment_from_message, Transition
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionRefusal,
    DomainInfo,
    GameState,
    LessonState,
    NodeStatus,
)
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
    SetControl,
)
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.process import run_node
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_teach.dialogue.answers import LessonView
from humanopts_teach.ros.convert import verdict_to_number, view_from_message
from humanopts_teach.teacher.acts import (
    Act,
    Begin,
    Define,
    Drive,
    End,
    Finish,
    is_seen,
    Open,
    Reply,
    Wait,
)
from humanopts_teach.teacher.simulated import (
    FINISHED,
    SimulatedTeacher,
    TeacherError,
    TeacherSettings,
)
from rcl_interfaces.msg import FloatingPointRange, IntegerRange
from rclpy.task import Future

_TICK = 0.1  # s between looks at the deadline
_REFUSALS = 3  # in a row, after which it gives up
_GAME_DEADLINE = 5.0  # s for game to take control back


class SimulatedTeacherNode(NodeBase):
    """Does one thing, and the next when it can see what came of it."""

    def __init__(self) -> None:
        super().__init__('simulated_teacher')
        self._settings = self._read_settings()
        self._deadline = float(
            self.setting(
                'deadline',
                120.0,
                'longest wait for anything, s; the lesson waits for the learner in it',
                floating_point_range=[FloatingPointRange(from_value=0.1, to_value=3600.0)],
            )
        )
        self._teacher: SimulatedTeacher | None = None
        self._lesson: LessonView | None = None
        self._game: Transition | None = None
        self._act: Act | None = None  # what was done last; None: what came of it was seen
        self._answered = False  # the lesson has said yes to it
        self._episode = 0  # that the lesson said it began
        self._refused = 0  # in a row
        self._awaits = ''  # what is waited for, in words
        self._since = 0.0  # s, since when
        self._end: str | None = None  # cause of the end, empty when all was taught; None: goes on
        self._action = self.stamped_publisher(ActionCommand, 'action')
        names = {
            OpenSession: 'open_session',
            DefineOption: 'define_option',
            AnswerQuestion: 'answer_question',
            BeginDemonstration: 'begin_demonstration',
            EndDemonstration: 'end_demonstration',
        }
        self._clients_of = {
            kind: self.recorded_client(kind, f'lesson/{name}') for kind, name in names.items()
        }
        self._clients_of[SetControl] = self.recorded_client(SetControl, 'set_control')
        self.create_subscription(DomainInfo, 'domain_info', self._on_domain, CURRENT)
        self.create_subscription(LessonState, 'lesson_state', self._on_lesson, CURRENT)
        self.create_subscription(ActionRefusal, 'action_refused', self._on_refusal, STREAM)
        self._states = self.create_subscription(
            GameState, 'game_state', self._on_game_state, STREAM
        )
        self.create_timer(_TICK, self._tick)

    def waits_for(self) -> str | None:
        """Wait for the rules, the lesson and its services."""
        if self._teacher is None:
            return 'domain_info'
        if self._lesson is None:
            return 'lesson_state'
        if not (self._states.get_publisher_count() and self.count_subscribers('action')):
            return 'game'
        missing = [c.srv_name for c in self._clients_of.values() if not c.service_is_ready()]
        return missing[0] if missing else None

    def on_ready(self) -> None:
        """Begin to teach."""
        self._advance()

    def _read_settings(self) -> TeacherSettings:
        default = TeacherSettings(('',))
        share = FloatingPointRange(from_value=0.0, to_value=1.0)
        steps = IntegerRange(from_value=1, to_value=1_000_000, step=1)
        seeds = IntegerRange(from_value=0, to_value=2**62, step=1)

        def read(name: str, text: str, **limits: Any) -> Any:
            return self.setting(name, getattr(default, name), text, **limits)

        options = read('options', 'names of the reference options to teach, in order')
        return TeacherSettings(
            options=tuple(name for name in options or () if name),
            participant=read('participant', 'code under which it teaches'),
            session=read('session', 'code of the session'),
            error_rate=read(
                'error_rate',
                'probability of a wrong action before each step, below 1',
                floating_point_range=[share],
            ),
            extra_feature_rate=read(
                'extra_feature_rate',
                'probability of a needless yes for each feature, below 1',
                floating_point_range=[share],
            ),
            own_habits=read('own_habits', 'prefer actions in an order drawn for the participant'),
            step_limit=read(
                'step_limit',
                'steps after which a demonstration is discarded',
                integer_range=[steps],
            ),
            seed=read('seed', 'of every random draw', integer_range=[seeds]),
        )

    # What it sees.

    def _on_domain(self, info: DomainInfo) -> None:
        if self._teacher is not None:
            return
        try:
            domain = domain_from_info(info)
            self._teacher = SimulatedTeacher(domain, reference_options(domain), self._settings)
        except (DomainError, TeacherError) as error:
            raise StartError(str(error)) from error

    def _on_lesson(self, message: LessonState) -> None:
        self._lesson = view_from_message(message)
        self._advance()

    def _on_game_state(self, message: GameState) -> None:
        self._game = moment_from_message(message)
        self._advance()

    def _on_refusal(self, message: ActionRefusal) -> None:
        if message.command_publisher_id == self.publisher_id:
            self._was_refused(f'action {message.command_action}', message.detail)

    def _tick(self) -> None:
        """Keep the deadline, and try again what was refused."""
        late = time.monotonic() - self._since
        if not self.ready or self._end == FINISHED:
            return
        if self._end is not None:
            if late > _GAME_DEADLINE:
                self._report(self._end or 'game does not take control back')
        elif late > self._deadline:
            self._stop(f'gave up after {self._deadline:g} s of waiting for {self._awaits}')
        else:
            self._advance()

    # What it does.

    def _advance(self) -> None:
        """Do the next thing, once what came of the last one can be seen."""
        if not self.ready or self._end is not None:
            return
        if self._act is not None:
            seen = is_seen(self._act, self._lesson, self._game, self._episode)
            if not (self._answered and seen):
                return
            self._act, self._refused = None, 0
        try:
            self._do(self._teacher.next_act(self._lesson, self._game))
        except (TeacherError, PublishError) as error:
            self._stop(str(error))

    def _do(self, act: Act) -> None:
        if isinstance(act, Finish):
            self._stop('')
        elif isinstance(act, Wait):
            self._await(act.reason)
        elif isinstance(act, Drive):
            self._act, self._answered = act, True
            self._await(f'game to leave step {act.step} of episode {act.episode}')
            self._action.publish(
                ActionCommand(
                    source=ActionCommand.SOURCE_PERSON,
                    episode=act.episode,
                    step=act.step,
                    action=act.action,
                )
            )
        else:
            self._ask(act)

    def _ask(self, act: Open | Define | Reply | Begin | End) -> None:
        kind, request = _request(act)
        client = self._clients_of[kind]
        self._act, self._answered = act, False
        self._await(f'an answer of {client.srv_name}')

        def on_answer(future: Future) -> None:
            response = future.result()
            if response.status not in _YES[kind]:
                self._was_refused(client.srv_name, response.detail)
                return
            self._answered, self._episode = True, getattr(response, 'episode', 0)
            self._await(f'the lesson to show what came of {client.srv_name}')
            self._advance()

        client.call_async(request).add_done_callback(on_answer)

    def _was_refused(self, what: str, detail: str) -> None:
        """Look again at the next tick and go on from there, but not for ever."""
        self._act = None
        self._refused += 1
        if self._refused >= _REFUSALS:
            self._stop(f'{what} was refused {_REFUSALS} times: {detail}')

    def _await(self, what: str) -> None:
        if what != self._awaits:
            self._awaits, self._since = what, time.monotonic()

    def _stop(self, cause: str) -> None:
        """Give control back and say so; an empty cause means that everything was taught."""
        if self._end is not None:
            return
        self._end = cause
        self._await('game to take control back')
        request = SetControl.Request(hold=False, holder_id=self.publisher_id)
        answer = self._clients_of[SetControl].call_async(request)
        answer.add_done_callback(lambda _: self._report(cause))

    def _report(self, cause: str) -> None:
        self._end = FINISHED  # nothing is left to do
        if cause:
            self.set_status(NodeStatus.STATE_PAUSED, cause)
        else:
            self.set_status(NodeStatus.STATE_READY, FINISHED)


_YES = {
    OpenSession: {OpenSession.Response.STATUS_OK},
    DefineOption: {DefineOption.Response.STATUS_OK},
    AnswerQuestion: {
        AnswerQuestion.Response.STATUS_OK,
        AnswerQuestion.Response.STATUS_NO_FEATURE,
    },
    BeginDemonstration: {BeginDemonstration.Response.STATUS_OK},
    EndDemonstration: {EndDemonstration.Response.STATUS_OK},
}


def _request(act: Open | Define | Reply | Begin | End) -> tuple[Any, Any]:
    """Return the service of an act and its request."""
    match act:
        case Open():
            return OpenSession, OpenSession.Request(
                participant=act.participant, session=act.session
            )
        case Define():
            return DefineOption, DefineOption.Request(name=act.option_name)
        case Reply():
            return AnswerQuestion, AnswerQuestion.Request(question_id=act.question_id, yes=act.yes)
        case Begin():
            return BeginDemonstration, BeginDemonstration.Request()
        case End():
            return EndDemonstration, EndDemonstration.Request(
                verdict=verdict_to_number(act.verdict),
                episode=act.episode,
                step=act.step,
                can_start_at_end=act.can_start_at_end,
            )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(SimulatedTeacherNode, args)


if __name__ == '__main__':
    sys.exit(main())
