"""
The runner, which executes one run at a time over the graph, in lock-step with ``game``.

It receives the option values and the current execution of the policy run by ``planner``.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
import math
import uuid

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import NeedsRulesError, simulated
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_env.seeding import generator
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionProgress,
    ActionRefusal,
    ControlState,
    ExecutionState,
    OptionGoal,
    OptionResult,
    OptionValues,
)
from humanopts_interfaces.srv import RunOption
from humanopts_learner.library import OptionLibrary, UnknownOptionError
from humanopts_learner.option import Mode
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.interruption import OptionValues as PlanValues
from humanopts_learner.planning.request import Arbitration, MODULAR, PlanError
from humanopts_learner.ros.convert import option_values_from_message
from humanopts_learner.run import (
    Arbiter,
    execution_named,
    RefusedError,
    Run,
    RunResult,
    RunStatus,
)
from humanopts_ros.codec import Codec, uuid_to_message
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT, LATCHED

_STOPS = 'option_server is stopping'
_FAREWELL = 0.3  # s to wait on shutdown for the end of a stopped action
_CHECK_PERIOD = 0.1  # s between checks for command timeouts
_INTERRUPTED = (
    ActionRefusal.REASON_HELD_BY_PERSON,
    ActionRefusal.REASON_STALE,
    ActionRefusal.REASON_PAUSED,
    ActionRefusal.REASON_LOCKED,
)
_RESULT = Codec(RunResult, OptionResult)
Goal = RunOption.Request | ExecuteOption.Goal
Ending = tuple[RunStatus, str]  # status and details


@dataclass
class RunRequest:
    """
    A run request from a service or action, and the run once it has begun.

    :ivar via: name of the service or action.
    :ivar run_id: UUID of the run.
    :ivar execution_sequence: sequence of the ExecutionState; 0: the execution is fixed.
    :ivar on_progress: called after each step and during long actions, with the run and the name of
        the action.
    :ivar ending: status and details of an early end; None: no early end.
    """

    goal: Goal
    via: str
    execution_sequence: int = 0
    on_progress: Callable[[Run, str], object] = lambda run, action: None
    ending: Ending | None = None
    run_id: str = field(default_factory=lambda: str(uuid.uuid4()))


@dataclass
class _Active:
    """The current run."""

    run: Run
    request: RunRequest
    deadline: float = 0.0
    command: int = 0  # sequence of the pending command
    seconds: float = 0.0  # maximum duration of its action
    stopped: bool = False  # whether a command to stop the action was sent
    cut_short: str = ''  # action that was stopped from outside; empty: none
    result: RunResult | None = None


class PolicySubscriber:
    """Stores the newest option values and execution, and creates arbiters from them."""

    def __init__(self, node: NodeBase, on_execution: Callable[[], object]) -> None:
        """
        Subscribe.

        :param on_execution: called after each new execution.
        """
        self._node, self._changed = node, on_execution
        self._message = OptionValues()
        self._values: PlanValues | None = None  # values of the message
        self._state = ExecutionState()
        self.arbiters: dict[Arbitration, Arbiter] = {}  # for the newest values and options
        node.subscribe(OptionValues, 'option_values', self._read, self._on_values, CURRENT)
        node.subscribe(ExecutionState, 'execution', _checked, self._on_execution, CURRENT)

    @property
    def plan_id(self) -> str:
        """The plan of the newest values; empty: no values have arrived yet."""
        return str(self._message.plan_id)

    def arbiter(self, execution: Arbitration, library: OptionLibrary) -> Arbiter:
        """
        Return the arbiter for the newest values.

        :raises UnknownOptionError: an option of the plan is not in the library.
        :raises ValueError: the values do not fit the options or their domain.
        """
        if execution not in self.arbiters:
            assert self._values is not None
            who, names = (
                self._message.participant,
                [*self._message.names, *library.primitive_names],
            )
            options = {name: library.resolve(name, who) for name in names}
            domain = simulated(library.domain, execution.value)
            self.arbiters[execution] = Arbiter(self._values, execution, domain, options)
        return self.arbiters[execution]

    def newer(self, request: RunRequest) -> ExecutionState | None:
        """Return the execution published after a request; None: unchanged since the request."""
        newer = 0 < request.execution_sequence < self._state.sequence
        return self._state if newer else None

    @staticmethod
    def _read(message: OptionValues) -> tuple[OptionValues, PlanValues]:
        """
        Return the message and its values.

        :raises PlanError: the message is inconsistent.
        """
        return message, option_values_from_message(message)

    def _on_values(self, read: tuple[OptionValues, PlanValues]) -> None:
        (self._message, self._values), self.arbiters = read, {}
        self._node.waiting.check()

    def _on_execution(self, message: ExecutionState) -> None:
        self._state = message
        self._changed()


class Runner:
    """
    Runs options or modules in the current episode, one request at a time.

    The runner decides after each state and before each command whether the run continues. If a run
    ends early, the runner stops an action that takes time, so that no command is pending when the
    run ends, canceled or not. It also arbitrates: the same states, values and execution give the
    same run. If a person takes control, an action is cut short or the game is reset, the run ends
    as interrupted; if the game does not respond, it ends after a timeout.

    :ivar library: options that can be run; None: the game is not known yet.
    :ivar taught_sequence: sequence of the message that completed the taught options; 0: none yet.
    :ivar patience: timeout in s for the game and for the values of a plan; may be changed.
    :ivar state: newest state of the game; None: no state has arrived yet.
    """

    def __init__(
        self,
        node: NodeBase,
        game: GameSubscriber,
        mode: Mode,
        seed: int,
        patience: float,
        *,
        unstick: bool,
    ) -> None:
        """
        Subscribe to the states of the game.

        :param seed: random seed of sampled mode and of random moves.
        :param patience: initial value.
        :param unstick: whether runs that repeat themselves take random moves.
        """
        self._node, self._mode, self._seed, self.patience = node, mode, seed, patience
        self._game, self._unstick = game, unstick
        self._policy = PolicySubscriber(node, self._on_execution)
        self.library: OptionLibrary | None = None
        self.taught_sequence = 0
        self.state: Observed | None = None
        self._requests: list[RunRequest] = []  # the first runs; each preempted those before it
        self._active: _Active | None = None  # set with the first command
        self._stopping = False
        self._actions = node.stamped_publisher(ActionCommand, 'action')
        self._goals = node.stamped_publisher(OptionGoal, 'option_goals')
        game.follow('game_state', self._on_state)
        game.follow('current_state', self._on_state, LATCHED)  # published before the subscription
        game.follow_refusals(self._on_refusal)
        self._control = ControlState()
        game.follow_control(self._on_control)
        self._progress = ActionProgress()
        self._check_timer = node.create_timer(_CHECK_PERIOD, self._check, autostart=False)

    @property
    def busy(self) -> bool:
        """Whether there is a run, or a request waiting for its first state."""
        return bool(self._requests)

    def open(self, domain: ActableDomain) -> None:
        """Begin serving options of the game."""
        self.library = OptionLibrary(domain)
        if any(action.seconds for action in domain.actions):
            self._game.subscribe(
                ActionProgress, 'action_progress', lambda m: m, self._on_progress, CURRENT
            )

    def serve(self, options: Iterable[LearnedOption]) -> list[str]:
        """Use the options that fit the game, once it is known; return the faults of the others."""
        self._policy.arbiters.clear()
        faults = self.library.replace(options) if self.library is not None else []
        self._node.waiting.check()
        return faults

    def stop(self) -> None:
        """End the current run, or the wait for its first state, on shutdown."""
        self._stopping = True
        for request in list(self._requests):
            self.end(request, RunStatus.FAILED, _STOPS)
        if self._active is not None and not self._active.stopped:
            self._finish(RunStatus.FAILED, _STOPS)

    def end(self, request: RunRequest, status: RunStatus, detail: str = '') -> None:
        """
        End a run early: at once if it has not begun, otherwise with the next state.

        :param status: status of the result, unless the run ends earlier for another reason.
        :param detail: details of the status.
        """
        request.ending = request.ending or (status, detail)
        if self._active is not None and self._active.request is request:
            self._stop_action(self._active)
        self._node.waiting.check()

    def refusal(self, goal: Goal) -> OptionResult | None:
        """Return the result of a goal that cannot run now; None: nothing known prevents it."""
        try:
            execution = self._check_goal(goal)
            waits = self._requests or goal.options_sequence > self.taught_sequence
            if execution is Arbitration.RUN_TO_END and not waits and not goal.episode:
                self._new_run(goal, execution)
        except (PlanError, UnknownOptionError) as error:
            return _refused(goal, error)
        return None

    async def run(self, request: RunRequest) -> OptionResult:
        """Execute a run to its end, or refuse it."""
        try:
            return _RESULT.encode(await self._run(request))
        except (NeedsRulesError, PlanError, UnknownOptionError) as error:
            return _refused(request.goal, error)

    async def _run(self, request: RunRequest) -> RunResult:
        """
        Execute a run to its end.

        :raises RefusedError: or UnknownOptionError, NeedsRulesError, PlanError: it cannot run.
        """
        goal, execution = request.goal, self._check_goal(request.goal)
        name, others = goal.option_name or execution.value, list(self._requests)
        self._requests.append(request)
        try:
            for other in others:
                self.end(other, RunStatus.INTERRUPTED, f'{name} preempted it')
            await self._wait(request, lambda: self._requests[0] is request, math.inf)
            run = await self._begin(request, execution)
            self._active = active = _Active(run, request)
            self._goals.publish(
                OptionGoal(
                    run_id=uuid_to_message(request.run_id),
                    via=request.via,
                    option_name=run.name,
                    participant=goal.participant,
                    max_steps=run.max_steps,
                    execution=execution,
                    plan_id=goal.plan_id,
                )
            )
            if not request.execution_sequence:  # policies have too many runs to log each
                where = 'episode {} step {}'.format(*run.position)
                self._node.get_logger().info(f'{name} runs from {where} ({request.via})')
            self._check_timer.reset()
            self._send(active)
            await self._node.waiting.until(lambda: active.result is not None, math.inf)
            assert active.result is not None
            result = replace(active.result, run_id=request.run_id)
            if not request.execution_sequence:
                text = f'{name} ended at step {result.first_step + result.step_count}'
                self._node.get_logger().info(f'{text}: {result.detail}')
            return result
        finally:
            self._requests.remove(request)
            self._node.waiting.check()

    def _check_goal(self, goal: Goal) -> Arbitration:
        """
        Check all conditions except those on the start state, and return the execution.

        :raises RefusedError: the goal cannot run now.
        :raises UnknownOptionError: the option does not exist.
        """
        if self._stopping:
            raise RefusedError(RunStatus.FAILED, _STOPS)
        if self.library is None:
            raise RefusedError(RunStatus.NO_EPISODE, 'game has not announced itself')
        execution = execution_named(goal.execution)
        if self._requests and not goal.preempt:
            under_way = self._requests[0].goal
            raise RefusedError(RunStatus.BUSY, under_way.option_name or under_way.execution)
        fault = ''
        if execution is not Arbitration.RUN_TO_END and not goal.plan_id:
            fault = f'{execution} needs the values of a plan: give its plan_id'
        elif execution not in MODULAR:
            self.library.resolve(goal.option_name, goal.participant)
        elif goal.option_name or goal.participant:
            fault = f'{execution} runs all options of the plan: leave option_name empty'
        if fault:
            raise RefusedError(RunStatus.BAD_REQUEST, fault)
        if self._control.holder == ControlState.HOLDER_LOCKED:
            text = f'the robot is locked ({self._control.reason}): take control and give it back'
            raise RefusedError(RunStatus.INTERRUPTED, text)
        if self._progress.stopped:
            raise RefusedError(RunStatus.INTERRUPTED, self._progress.stopped)
        return execution

    async def _begin(self, request: RunRequest, execution: Arbitration) -> Run:
        """Wait for option values and start state, and return the run; errors as in ``_run``."""
        goal, before = request.goal, self.state
        wanted, values = (goal.episode, goal.step), self._policy
        if execution is not Arbitration.RUN_TO_END and not await self._wait(
            request, lambda: values.plan_id == goal.plan_id
        ):
            newest = (
                f'the newest are those of {values.plan_id}'
                if values.plan_id
                else 'none have arrived'
            )
            raise PlanError(f'the option values of plan {goal.plan_id} did not arrive; {newest}')

        def has_arrived() -> bool:  # a restarted game counts from 1
            state = self.state
            if state is None:
                return False
            newer = _position(state)[0] == wanted[0] or state is not before
            return newer and wanted <= _position(state)

        sequence = goal.options_sequence
        if not await self._wait(request, lambda: self.taught_sequence >= sequence):
            detail = f'learned_options {sequence} did not arrive, only {self.taught_sequence}'
            raise RefusedError(RunStatus.FAILED, detail)
        if goal.episode:
            await self._wait(request, has_arrived)
        return self._new_run(goal, execution)

    def _new_run(self, goal: Goal, execution: Arbitration) -> Run:
        """Return a run from the newest state; errors as in ``_run``."""
        library, state = self.library, self.state
        assert library is not None
        if state is None or not _position(state)[0]:
            raise RefusedError(RunStatus.NO_EPISODE, 'the game has published no state')
        here = _position(state)
        if goal.episode and here != (goal.episode, goal.step):
            raise RefusedError(
                RunStatus.NO_EPISODE,
                f'episode {goal.episode} step {goal.step} did not arrive; the game is at episode '
                f'{here[0]} step {here[1]}',
            )
        if not state.transition.open:
            raise RefusedError(RunStatus.NO_EPISODE, 'the episode has ended')
        arbitrated, named = execution is not Arbitration.RUN_TO_END, execution not in MODULAR
        key = goal.option_name or execution, *here
        return Run(
            library.resolve(goal.option_name, goal.participant) if named else None,
            library.domain,
            state.state,
            here,
            goal.max_steps,
            arbiter=self._policy.arbiter(execution, library) if arbitrated else None,
            rng=generator(self._seed, 'run', *key) if self._mode is Mode.SAMPLED else None,
            unstick=generator(self._seed, 'random moves', *key) if self._unstick else None,
        )

    async def _wait(
        self, request: RunRequest, condition: Callable[[], bool], seconds: float | None = None
    ) -> bool:
        """
        Wait for a start condition of a run; return whether it holds.

        :param seconds: timeout; None: ``patience``.
        :raises RefusedError: the run was ended before it began.
        """
        seconds = self.patience if seconds is None else seconds
        await self._node.waiting.until(
            lambda: condition() or self._ending(request) is not None, seconds
        )
        if (ending := self._ending(request)) is not None:
            raise RefusedError(*ending)
        return condition()

    def _send(self, active: _Active) -> None:
        """Send the next action to the game."""
        run = active.run
        episode, step = run.position
        action = run.domain.actions[run.next_action()]
        command = ActionCommand(
            source=ActionCommand.SOURCE_MACHINE,
            episode=episode,
            step=step,
            action=action.name,
            option_name=run.acting.name,
        )
        active.seconds = action.seconds
        self._set_deadline(active)
        self._actions.publish(command)
        active.command = self._actions.sequence

    def _set_deadline(self, active: _Active) -> None:
        allowed = active.seconds + self._control.step_period + self.patience
        active.deadline = self._node.monotonic() + allowed

    def _stop_action(self, active: _Active) -> None:
        """Stop the pending action if it takes time; the resulting state ends the run."""
        if not active.seconds or active.stopped:
            return
        episode, step = active.run.position
        active.stopped = True
        patience = _FAREWELL if self._stopping else self.patience
        active.deadline = self._node.monotonic() + patience
        machine = ActionCommand.SOURCE_MACHINE
        self._actions.publish(ActionCommand(source=machine, episode=episode, step=step))

    def _on_state(self, observed: Observed) -> None:
        """Handle a state; ``current_state`` repeats states of ``game_state``."""
        known, here = self.state, _position(observed)
        same_game = known is not None and known.publisher_id == observed.publisher_id
        if known is not None and same_game and here <= _position(known):
            newer = observed.transition.refreshed and observed.stamp > known.stamp
            if here < _position(known) or not newer:
                return
        self.state = observed
        if self._active is not None:
            self._continue(self._active, observed, same_game=same_game)
        self._node.waiting.check()

    def _continue(self, active: _Active, observed: Observed, *, same_game: bool) -> None:
        """Handle a newer state during a run."""
        here, position = _position(observed), active.run.position
        if not same_game:
            self._finish(RunStatus.INTERRUPTED, 'the game was restarted')
        elif here[0] != position[0]:
            self._finish(RunStatus.INTERRUPTED, 'the game was reset')
        elif here > position:
            self._on_step(active, observed)
        else:  # the state was refreshed before the command arrived
            active.run.state = observed.state

    def _on_step(self, active: _Active, observed: Observed) -> None:
        """Handle the state after the current command, or after an action of another driver."""
        transition, run = observed.transition, active.run
        is_own = transition.action_publisher_id == self._node.publisher_id
        if not is_own or transition.action_sequence != active.command:
            text = f'{shown(transition.action_publisher_id)} took {transition.previous_action}'
            self._finish(RunStatus.INTERRUPTED, text)
            return
        end = run.observe(
            observed.state, transition.reward, transition.terminated, transition.truncated
        )
        active.request.on_progress(run, transition.previous_action)
        ending = self._ending(active.request)
        if transition.cut_short and ending is None:  # the reason arrives later
            active.cut_short, active.seconds = transition.previous_action, 0.0
            active.deadline = self._node.monotonic() + _CHECK_PERIOD
            return
        if ending is not None and (end is None or transition.cut_short):
            end = run.end(*ending)
        end = end or self._stopped(active)
        if end is not None:
            self._finish_with(end)
        else:
            self._send(active)

    def _stopped(self, active: _Active) -> RunResult | None:
        """Return the result if the run ends before its next command; None: it continues."""
        run, request, plan_id = active.run, active.request, active.request.goal.plan_id
        newer, before = self._policy.newer(request), run.execution
        if newer is None or newer.plan_id != plan_id or newer.execution == before:
            return run.stopped()
        wanted = Arbitration(newer.execution)
        if wanted in MODULAR or before in MODULAR:
            return run.end(RunStatus.EXECUTION_CHANGED, f'from {before} to {wanted}')
        if wanted is Arbitration.RUN_TO_END:
            run.arbiter = None
        elif self._policy.plan_id == plan_id and self.library is not None:
            try:
                run.arbiter = self._policy.arbiter(wanted, self.library)
            except ValueError as error:  # the options have been relearned
                return run.end(RunStatus.FAILED, str(error))
        return run.stopped()

    def _ending(self, request: RunRequest) -> Ending | None:
        """Return status and details of an early end; None: no early end."""
        newer = self._policy.newer(request)
        canceled = newer is not None and newer.canceled
        return (RunStatus.CANCELED, '') if canceled else request.ending

    def _on_execution(self) -> None:
        """End the run of a canceled policy."""
        for request in list(self._requests):
            if (ending := self._ending(request)) is not None:
                self.end(request, *ending)

    def _on_refusal(self, message: ActionRefusal) -> None:
        """End the run because the game refused its command."""
        active = self._active
        is_own = message.command_publisher_id == self._node.publisher_id
        if active is None or not is_own or message.command_sequence != active.command:
            return
        status = RunStatus.INTERRUPTED if message.reason in _INTERRUPTED else RunStatus.FAILED
        self._finish(*self._ending(active.request) or (status, message.detail))

    def _on_progress(self, message: ActionProgress) -> None:
        """Report the action under way, and store why the robot does not move."""
        self._progress = message
        active, at = self._active, (message.episode, message.step)
        if active is not None and message.action and at == active.run.position:
            active.request.on_progress(active.run, message.action)

    def _on_control(self, control: ControlState) -> None:
        """Restart the timeout of a command when the pace changes."""
        self._control = control
        active = self._active
        if active is not None and not active.stopped and not active.cut_short:
            self._set_deadline(active)

    def _check(self) -> None:
        """End the run if the game does not respond."""
        active = self._active
        if active is None or self._node.monotonic() <= active.deadline:
            return
        ending = self._ending(active.request)
        if active.cut_short:
            why, control = self._progress.stopped or self._progress.feedback, self._control
            if control.holder != ControlState.HOLDER_NOBODY:
                why = control.reason
            text = f'{active.cut_short} was stopped before its end'
            cut = RunStatus.INTERRUPTED, f'{text}: {why}' if why else text
            self._finish(*ending or cut)
        elif ending is not None and active.stopped:
            status, detail = ending
            text = 'the game did not respond to the stop'
            self._finish(status, f'{detail}; {text}' if detail else text)
        elif not self._control.paused_by:
            self._stop_action(active)
            self._finish(RunStatus.NO_PROGRESS, f'{active.seconds + self.patience:g} s')

    def _finish(self, status: RunStatus, detail: str) -> None:
        """End the current run, if any."""
        if self._active is not None:
            self._finish_with(self._active.run.end(status, detail))

    def _finish_with(self, result: RunResult) -> None:
        active, self._active = self._active, None
        assert active is not None
        self._check_timer.cancel()
        active.result = result
        self._node.waiting.check()


def _position(observed: Observed) -> tuple[int, int]:
    """Return the episode and step of a state."""
    return observed.transition.episode, observed.transition.step


def _refused(goal: Goal, error: Exception) -> OptionResult:
    """Return the result of a request that was refused with an error."""
    status = RunStatus.NO_VALUES
    if isinstance(error, RefusedError):
        status = error.status
    elif isinstance(error, UnknownOptionError):
        status = RunStatus.UNKNOWN_OPTION
    return _RESULT.encode(RunResult(status, status.explained(str(error)), goal.option_name))


def _checked(message: ExecutionState) -> ExecutionState:
    """
    Return the message, after checking its execution.

    :raises RefusedError: the execution does not exist.
    """
    execution_named(message.execution)
    return message
