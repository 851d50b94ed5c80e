"""The node ``simulated_teacher``: teaches over the graph like a person."""

from contextlib import suppress
from functools import partial
import sys
from typing import Any, ClassVar

from humanopts_env.domains.described import NeedsRulesError, simulated
from humanopts_env.game import Transition
from humanopts_interfaces.msg import NodeStatus, OptionResult
from humanopts_ros.guarded_node import PATIENCE, SEEDS, StartError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_teach.lesson.requests import (
    Drive,
    EndDemonstration,
    LessonRequest,
    Phase,
    RequestStatus,
    RunOption,
    SetControl,
    SetPace,
    Verdict,
)
from humanopts_teach.lesson.simulated_teacher import (
    Act,
    Finish,
    FINISHED,
    SimulatedTeacher,
    TeacherError,
    TeacherSettings,
    Wait,
    Watch,
)
from humanopts_teach.ros.convert import ACTIONS, TEACHING, TERMINAL_SERVICES
from humanopts_teach.ros.graph_client import ClientError, Goal, GraphClient, RefusedError
from rclpy.callback_groups import ReentrantCallbackGroup

_TICK = 0.1  # s until a refused request is retried
_ENDPOINTS = {
    **TEACHING,
    SetPace: TERMINAL_SERVICES[SetPace],
    RunOption: ACTIONS[RunOption],
}
_ENDED = (
    OptionResult.STATUS_REACHED,
    OptionResult.STATUS_EPISODE_OVER,
    OptionResult.STATUS_MAX_STEPS,
)
_LOST_RUNS = 10  # maximum number of consecutive exam runs that do not end by themselves
_REFUSALS = 3  # consecutive refusals before giving up; an unresponsive game gets more time


class SimulatedTeacherNode(NodeBase):
    """Performs one act at a time and waits for its effect before the next."""

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        super().__init__('simulated_teacher', **options)
        self._settings = self._read_settings()
        self._deadline = self.setting(
            'deadline',
            120.0,
            'maximum wait for any answer, s, including the time for learning',
            PATIENCE,
        )
        self._teacher: SimulatedTeacher | None = None
        self._client = GraphClient(
            self, _ENDPOINTS, patience=self._deadline, on_change=self._create_teacher
        )
        self._run: Goal | None = None  # of the option in the exam
        self._lost = 0  # consecutive runs that did not end by themselves

    def waits_for(self) -> str | None:
        """Wait for the rules, the lesson and its services."""
        return self._client.waits_for()

    def on_ready(self) -> None:
        """Start teaching."""
        # A timer: a task that never starts would cause a warning if the node ends immediately.
        self._begin = self.create_timer(0.0, self._teach, callback_group=ReentrantCallbackGroup())

    def _read_settings(self) -> TeacherSettings:
        names = self.setting('options', [''], 'names of the reference options to teach, in order')
        share = (0.0, 1.0)
        return self.settings(
            TeacherSettings(tuple(filter(None, names or ()))),
            {
                'participant': 'code under which it teaches',
                'session': 'code of the session',
                'error_rate': 'probability of a wrong action before each step, below 1',
                'extra_feature_rate': 'probability of a needless yes for each feature, below 1',
                'own_habits': 'prefer actions in an order drawn for the participant',
                'step_limit': 'steps after which a demonstration is discarded',
                'seed': 'seed of all random draws',
            },
            {
                'error_rate': share,
                'extra_feature_rate': share,
                'step_limit': (1, 1_000_000),
                'seed': SEEDS,
            },
        )

    def _create_teacher(self) -> None:
        """Create the teacher when the rules of the game are known."""
        domain = self._client.world.domain
        if self._teacher is None and domain is not None:
            try:
                with_rules = simulated(domain, 'the simulated teacher')
                self._teacher = SimulatedTeacher(with_rules, self._settings)
            except (NeedsRulesError, TeacherError) as error:
                raise StartError(str(error)) from error

    async def _teach(self) -> None:
        """Teach everything, return control, and publish the outcome."""
        self._begin.cancel()
        cause, refused, answered = '', 0, self.monotonic()
        lesson = self._client.world.lesson
        try:
            if lesson.phase is Phase.DEMONSTRATING:  # left by an earlier teacher
                with suppress(RefusedError):  # it has ended meanwhile
                    await self._client.ask(EndDemonstration(Verdict.DISCARD, lesson.episode, 0))
            while not isinstance(act := await self._next_act(), Finish):
                try:
                    await self._carry_out(act)
                    refused, answered = 0, self.monotonic()
                except RefusedError as error:
                    silent = error.answer.status is RequestStatus.NO_GAME
                    refused += not silent or self.monotonic() > answered + self._deadline
                    if refused == _REFUSALS:
                        detail = error.answer.detail
                        cause = f'{error.what} was refused {_REFUSALS} times: {detail}'
                        break
                    await self.waiting.until(lambda: False, _TICK)
            else:
                with suppress(RefusedError):  # another participant is in control
                    await self._client.ask(SetControl(hold=False))
        except (TeacherError, ClientError) as error:
            cause = str(error)
        except Exception as error:  # unexpected; the demo waits for an outcome
            cause = self.guard.caught('teaching', error)
        self._client.unsubscribe()  # control that is not renewed returns to the machine
        state = NodeStatus.STATE_PAUSED if cause else NodeStatus.STATE_READY
        self.set_status(state, cause or FINISHED)

    async def _carry_out(self, act: LessonRequest | Drive | RunOption | Watch) -> None:
        """
        Carry out an act; while a run is watched, the machine is paused and takes single steps.

        :raises RefusedError: the act was not carried out.
        :raises ClientError: there was no answer.
        """
        client, run = self._client, self._run
        period, seen = client.world.step_period, client.world.game
        if isinstance(act, RunOption):
            await client.ask(SetControl(hold=False))
            await client.ask(SetPace(period, paused=True))
            started = client.start(act, lambda feedback: None)
            await client.until(started.accepted.done, 'an answer of execute_option')
            if not (answer := started.accepted.result()).ok:
                raise RefusedError('execute_option', answer)
            self._run = started
        elif isinstance(act, Watch):
            assert run is not None
            await client.ask(SetPace(period, paused=True, steps=1))
            moved = lambda: client.world.game != seen or run.result.done()  # noqa: E731
            await client.until(moved, 'a step of the machine')
        else:
            await client.ask(act)
        if isinstance(act, EndDemonstration) and run is not None:
            if not run.result.done():
                await client.ask(SetControl(hold=True))  # ends the run
            await client.ask(SetPace(period, paused=False))
            await client.until(run.result.done, 'the end of the run')
            self._run = None

    def _is_lost(self, run: Goal) -> bool:
        """
        Return whether a run ended for a reason other than its option.

        :raises TeacherError: too many consecutive runs did so.
        """
        result = run.result.result() if run.result.done() else None
        lost = run.result.done() and (result is None or result.status not in _ENDED)
        self._lost = self._lost + 1 if lost else 0
        if self._lost > _LOST_RUNS:
            raise TeacherError(f'runs in the exam do not end: {result and result.detail}')
        return lost

    async def _next_act(self) -> LessonRequest | Drive | RunOption | Watch | Finish:
        """
        Wait for and return the next act.

        :raises NoAnswerError: nothing changed in time.
        """
        client, teacher = self._client, self._teacher
        assert teacher is not None, 'the node waited for the game'
        while True:
            lesson, game, run = client.world.lesson, client.world.game, self._run
            if run is not None and self._is_lost(run) and lesson.exam:
                return EndDemonstration(Verdict.DISCARD, lesson.episode, 0)
            running = run is not None and not run.result.done()
            if run is not None and not running and _is_ahead(run, game):
                act: Act = Wait('the last state of the run')
            else:
                act = teacher.next_act(lesson, game, running=running)
            if not isinstance(act, Wait):
                return act

            def is_news(seen: tuple[object, object] = (lesson, game)) -> bool:
                return (client.world.lesson, client.world.game) != seen

            await client.until(is_news, act.reason)


def _is_ahead(run: Goal, seen: Transition) -> bool:
    """Return whether a run has ended in a state that has not arrived yet."""
    result = run.result.result()
    last = (0, 0) if result is None else (result.episode, result.first_step + result.step_count)
    return (seen.episode, seen.step) < last


main = partial(run_node, SimulatedTeacherNode)

if __name__ == '__main__':
    sys.exit(main())
