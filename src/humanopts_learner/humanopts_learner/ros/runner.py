"""
The runner, which executes one run at a time over the graph, in lock-step with game.

What it needs of the policy that ``planner`` runs, values and execution, it receives.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import is_
import uuid

from humanopts_env.domains.described import NeedsRulesError, simulated
from humanopts_env.game import Transition
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_env.seeding import generator
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionRefusal,
    ControlState,
    ExecutionState,
    OptionGoal,
    OptionResult,
    OptionValues,
)
from humanopts_interfaces.srv import RunOption
from humanopts_learner.library import OptionLibrary, RunnableOption, UnknownOptionError
from humanopts_learner.option import Mode
from humanopts_learner.planning.interruption import OptionValues as PlanValues
from humanopts_learner.planning.request import Arbitration, MODULAR, PlanError
from humanopts_learner.ros.convert import option_values_from_message
from humanopts_learner.run import (
    Arbiter,
    execution_named,
    refusal,
    Run,
    RunError,
    RunResult,
    RunStatus,
)
from humanopts_ros.codec import Codec
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT
from rclpy.task import Future

_STOPS = 'option_server stops'
_CHECK_PERIOD = 0.1  # s between checks of the deadline of a command


class RunCanceled(Exception):  # noqa: N818 - no error: the client has canceled
    """A run was canceled, or the node ends, before its first action."""


_RESULT = Codec(
    RunResult,
    OptionResult,
    of_value=['acted'],
    of_message=['run_id', 'execution', 'acted_names', 'acted_steps'],
)


def _result(end: RunResult, run_id: str = '', execution: str = '') -> OptionResult:
    """
    Encode how a run ended.

    :param run_id: empty for a refusal.
    :param execution: in force at the end; empty for a refusal.
    """
    names, steps = list(end.acted), list(end.acted.values())
    ids = {'run_id': run_id, 'execution': execution}
    return _RESULT.encode(end, **ids, acted_names=names, acted_steps=steps)


@dataclass(frozen=True)
class RunRequest:
    """
    The request of a run, from a service or an action.

    :ivar via: name of the service or action.
    :ivar execution_sequence: of the ExecutionState with the execution; 0: it is fixed.
    :ivar canceled: returns whether the client has canceled.
    :ivar on_step: called after each step with the run and the state that the step led to.
    """

    goal: RunOption.Request | ExecuteOption.Goal
    via: str
    execution_sequence: int = 0
    canceled: Callable[[], bool] = lambda: False
    on_step: Callable[[Run, Transition], None] = lambda run, state: None


@dataclass
class _Active:
    """The current run."""

    run: Run
    run_id: str
    request: RunRequest
    library: OptionLibrary
    execution: Arbitration
    arbiter: Arbiter | None  # it may stop the run
    episode: int
    step: int  # of the state that the current command answers
    done: Future = field(default_factory=Future)
    deadline: float = 0.0
    command: int = 0  # sequence of the command that the game has not answered yet


class PolicySubscriber:
    """Keeps the newest option values and execution, and makes arbiters of them."""

    def __init__(self, node: NodeBase) -> None:
        self._node = node
        self._message: OptionValues | None = None
        self._values: PlanValues | None = None  # of the message
        self._state: ExecutionState | None = None
        self._arbiters: dict[Arbitration, Arbiter] = {}  # of the newest values, for these options
        self._options: dict[str, RunnableOption] = {}
        node.subscribe(OptionValues, 'option_values', self._read, self._on_values, CURRENT)
        node.subscribe(ExecutionState, 'execution', _checked, self._on_execution, CURRENT)

    def has(self, plan_id: str) -> bool:
        return self._message is not None and self._message.plan_id == plan_id

    def newest(self) -> str:
        """Return in words which plan the newest values belong to."""
        if self._message is None:
            return 'none came yet'
        return f'the newest are those of {self._message.plan_id}'

    def arbiter(self, execution: Arbitration, library: OptionLibrary) -> Arbiter:
        """
        Return the arbiter of the newest values.

        :raises UnknownOptionError: an option of the plan is not in the library.
        :raises ValueError: the values do not fit the options or their domain.
        """
        assert self._message is not None
        assert self._values is not None
        who, names = self._message.participant, [*self._message.names, *library.primitive_names]
        options = {name: library.resolve(name, who) for name in names}
        if not all(map(is_, options.values(), self._options.values())):
            self._arbiters = {}  # options were taught anew
        self._options = options
        if execution not in self._arbiters:
            domain = simulated(library.domain, execution.value)
            self._arbiters[execution] = Arbiter(self._values, execution, domain, options)
        return self._arbiters[execution]

    def wanted(self, execution: Arbitration, sequence: int, plan_id: str) -> Arbitration:
        """
        Return the execution that is in force for a run.

        :param execution: the execution in the request of the run.
        :param sequence: of the ExecutionState of the request; 0: the execution never changes.
        """
        state = self._state
        newer = state is not None and 0 < sequence < state.sequence
        if state is None or not newer or state.plan_id != plan_id:
            return execution
        return Arbitration(state.execution)

    def canceled(self, sequence: int) -> bool:
        """Return whether the policy run of a run is to end; ``sequence`` as in ``wanted``."""
        state = self._state
        return state is not None and 0 < sequence < state.sequence and state.canceled

    @staticmethod
    def _read(message: OptionValues) -> tuple[OptionValues, PlanValues]:
        """
        Return the message and its values.

        :raises PlanError: the parts contradict each other.
        """
        return message, option_values_from_message(message)

    def _on_values(self, read: tuple[OptionValues, PlanValues]) -> None:
        (self._message, self._values), self._arbiters = read, {}
        self._node.waiting.check()

    def _on_execution(self, message: ExecutionState) -> None:
        self._state = message


class Runner:
    """
    Runs options, or modules, in the current episode; a second request is answered BUSY.

    The runner decides after each state and before each command whether the run continues, so no
    command is pending when the run ends, canceled or not. It also arbitrates: the same states,
    values and execution give the same run. A person who takes control, or a reset, ends the run as
    interrupted; silence of the game ends it after a deadline.

    :ivar library: the options that can be run; None: the game is not known yet.
    :ivar patience: s to wait for game, and for the values of a plan; may be changed.
    """

    def __init__(
        self, node: NodeBase, game: GameSubscriber, mode: Mode, seed: int, patience: float
    ) -> None:
        """
        Subscribe to the states of the game.

        :param seed: of the random draws in sampled mode.
        :param patience: as the attribute.
        """
        self._node, self._mode, self._seed, self.patience = node, mode, seed, patience
        self._policy = PolicySubscriber(node)
        self.library: OptionLibrary | None = None
        self._state: Observed | None = None
        self._taken_by = ''  # the option or execution of the request; empty: the runner is free
        self._active: _Active | None = None  # set from the first command on
        self._stopping = False
        self._actions = node.stamped_publisher(ActionCommand, 'action')
        self._goals = node.stamped_publisher(OptionGoal, 'option_goals')
        game.follow('game_state', self._on_state)
        self._current = game.newest()  # what game published before it was heard on the stream
        game.follow_refusals(self._on_refusal)
        self._pace = ControlState()  # the newest
        game.follow_control(self._on_control)
        node.create_timer(_CHECK_PERIOD, self._check)

    @property
    def busy(self) -> bool:
        """Whether there is a run, or a request that waits for its first state."""
        return bool(self._taken_by)

    def newest_state(self) -> Observed | None:
        """Return the newest state of the game; None: none was published yet."""
        if self.library is not None and (observed := self._current.take()) is not None:
            self._on_state(observed)
        return self._state

    def stop(self) -> None:
        """End the current run, or the wait for its first state, because the node ends."""
        self._stopping = True
        if self._active is not None:
            self._finish(self._active.run.end(RunStatus.FAILED, _STOPS))

    async def run(self, request: RunRequest) -> OptionResult:
        """Execute a run to its end, or refuse it."""
        if self._stopping:
            return _refused(request, RunStatus.FAILED, _STOPS)
        if self.library is None:
            return _refused(request, RunStatus.NO_EPISODE, 'game has not announced itself')
        if self._taken_by:
            return _refused(request, RunStatus.BUSY, self._taken_by)
        try:
            execution = _check(request.goal, self.library)
            self._taken_by = request.goal.option_name or execution.value
            return await self._drive(request, execution, self.library)
        except RunCanceled:
            if self._stopping:
                return _refused(request, RunStatus.FAILED, _STOPS)
            return _refused(request, RunStatus.CANCELED)
        except UnknownOptionError as error:
            return _refused(request, RunStatus.UNKNOWN_OPTION, str(error))
        except RunError as error:
            return _refused(request, RunStatus.BAD_REQUEST, str(error))
        except (NeedsRulesError, PlanError) as error:
            return _refused(request, RunStatus.NO_VALUES, str(error))
        finally:
            self._taken_by = ''

    async def _drive(
        self, request: RunRequest, execution: Arbitration, library: OptionLibrary
    ) -> OptionResult:
        """Wait for the option values and the start state, and run from there."""
        plan_id = request.goal.plan_id
        if execution is not Arbitration.RUN_TO_END:
            await self._wait(request, lambda: self._policy.has(plan_id))
            if not self._policy.has(plan_id):
                raise PlanError(
                    f'the option values of plan {plan_id} did not come; {self._policy.newest()}'
                )
        state = await self._first_state(request)
        if state is None:
            return _refused(request, RunStatus.NO_EPISODE, self._missing(request))
        if not state.transition.open:
            return _refused(request, RunStatus.NO_EPISODE, 'the episode has ended')
        position = _position(state)
        run, arbiter = self._prepare(request, execution, library, position)
        end = run.begin(state.state, *position)
        if end is not None:
            return _result(end)
        run_id = str(uuid.uuid4())
        self._active = active = _Active(
            run, run_id, request, library, execution, arbiter, *position
        )
        self._announce(active)
        self._send(active)
        end = await active.done
        return _result(end, run_id, active.execution)

    async def _wait(self, request: RunRequest, condition: Callable[[], bool]) -> None:
        """
        Wait for a condition of the start of a run, with a deadline.

        :raises RunCanceled: the client has canceled, or the node ends.
        """
        await self._node.waiting.until(
            lambda: condition() or self._stopping or self._canceled(request), self.patience
        )
        if self._stopping or self._canceled(request):
            raise RunCanceled

    async def _first_state(self, request: RunRequest) -> Observed | None:
        """
        Return the state that a run is to start from; None: it is not received in time.

        :raises RunCanceled: the client has canceled.
        """
        before, wanted = self.newest_state(), (request.goal.episode, request.goal.step)

        def is_here() -> bool:
            state = self._state
            return state is not None and wanted == _position(state)

        def is_past() -> bool:  # a game that was restarted counts from 1
            state = self._state
            if state is None:
                return False
            newer = _position(state)[0] == wanted[0] or state is not before
            return newer and wanted < _position(state)

        if not wanted[0]:
            return before if before is not None and _position(before)[0] else None
        await self._wait(request, lambda: is_here() or is_past())
        return self._state if is_here() else None

    def _missing(self, request: RunRequest) -> str:
        """Return in words which state is missing."""
        goal, state = request.goal, self._state
        if state is None or not goal.episode:
            return 'no state came from game'
        return (
            f'episode {goal.episode} step {goal.step} did not come; the game is at episode '
            f'{state.transition.episode} step {state.transition.step}'
        )

    def _prepare(
        self,
        request: RunRequest,
        execution: Arbitration,
        library: OptionLibrary,
        position: tuple[int, int],
    ) -> tuple[Run, Arbiter | None]:
        """Return the run, and the arbiter that may stop it; errors are those of ``run``."""
        goal, domain = request.goal, library.domain
        rng = generator(self._seed, 'run', goal.option_name or execution, *position)
        rest = domain, domain.gamma, goal.max_steps, self._mode, rng
        arbiter = None
        if execution is not Arbitration.RUN_TO_END:
            arbiter = self._policy.arbiter(execution, library)
        if arbiter is not None and execution in MODULAR:
            return Run(arbiter, *rest), None
        return Run(library.resolve(goal.option_name, goal.participant), *rest), arbiter

    def _announce(self, active: _Active) -> None:
        """Publish that a run begins."""
        self._goals.publish(
            OptionGoal(
                run_id=active.run_id,
                via=active.request.via,
                option_name=active.run.name,
                participant=active.request.goal.participant,
                max_steps=active.run.max_steps,
                execution=active.execution,
                plan_id=active.request.goal.plan_id,
            )
        )

    def _send(self, active: _Active) -> None:
        """Send the next action to game."""
        action = active.library.domain.actions[active.run.next_action()].name
        command = ActionCommand(
            source=ActionCommand.SOURCE_MACHINE,
            episode=active.episode,
            step=active.step,
            action=action,
            option_name=active.run.acting.name,
        )
        active.deadline = self._node.monotonic() + self._pace.step_period + self.patience
        self._actions.publish(command)
        active.command = self._actions.sequence

    def _on_state(self, observed: Observed) -> None:
        """Handle the next state; ``current_state`` repeats those of ``game_state``."""
        known, (episode, step) = self._state, _position(observed)
        same_game = known is not None and known.publisher_id == observed.publisher_id
        if known is not None and same_game and (episode, step) <= _position(known):
            return
        self._state = observed
        self._node.waiting.check()
        active = self._active
        if active is None:
            return
        if not same_game:
            self._finish(active.run.end(RunStatus.INTERRUPTED, 'the game was started again'))
        elif episode != active.episode:
            self._finish(active.run.end(RunStatus.INTERRUPTED, 'the game was reset'))
        elif step > active.step:
            self._on_step(active, observed)

    def _on_step(self, active: _Active, observed: Observed) -> None:
        """Handle the state that the current command led to, or that another driver's led to."""
        led = observed.transition
        mine = led.action_publisher_id == self._node.publisher_id
        if not mine or led.action_sequence != active.command:
            text = f'{shown(led.action_publisher_id)} took {led.previous_action}'
            self._finish(active.run.end(RunStatus.INTERRUPTED, text))
            return
        active.step = led.step
        end = active.run.observe(observed.state, led.reward, led.terminated, led.truncated)
        active.request.on_step(active.run, led)
        end = end or self._stopped(active)
        if end is not None:
            self._finish(end)
        else:
            self._send(active)

    def _stopped(self, active: _Active) -> RunResult | None:
        """Return how the run ends before its next command; None: it continues."""
        run, request, before = active.run, active.request, active.execution
        if self._canceled(request):
            return run.end(RunStatus.CANCELED)
        plan_id = request.goal.plan_id
        wanted = self._policy.wanted(before, request.execution_sequence, plan_id)
        if wanted is not before:
            if wanted in MODULAR or before in MODULAR:
                return run.end(RunStatus.EXECUTION_CHANGED, f'from {before} to {wanted}')
            try:
                self._change(active, wanted)
            except ValueError as error:  # the options were taught anew meanwhile
                return run.end(RunStatus.FAILED, str(error))
        return run.stopped(active.arbiter) if active.arbiter is not None else None

    def _change(self, active: _Active, wanted: Arbitration) -> None:
        """Change the execution of an option, unless the values for it are not received yet."""
        if wanted is Arbitration.RUN_TO_END:
            active.execution, active.arbiter = wanted, None
        elif self._policy.has(active.request.goal.plan_id):
            active.arbiter = self._policy.arbiter(wanted, active.library)
            active.execution = wanted

    def _canceled(self, request: RunRequest) -> bool:
        return request.canceled() or self._policy.canceled(request.execution_sequence)

    def _on_refusal(self, message: ActionRefusal) -> None:
        """End the run because the game refused its command."""
        active = self._active
        mine = message.command_publisher_id == self._node.publisher_id
        if active is None or not mine or message.command_sequence != active.command:
            return
        interrupted = (ActionRefusal.REASON_HELD_BY_PERSON, ActionRefusal.REASON_STALE)
        status = RunStatus.INTERRUPTED if message.reason in interrupted else RunStatus.FAILED
        self._finish(active.run.end(status, message.detail))

    def _on_control(self, control: ControlState) -> None:
        """Begin the deadline of a command anew where the pace has changed."""
        self._pace = control
        if self._active is not None:
            self._active.deadline = self._node.monotonic() + control.step_period + self.patience

    def _check(self) -> None:
        """Handle a state that the stream did not bring, or the silence of game."""
        self.newest_state()
        active = self._active
        if active is None or self._pace.paused_by:
            return
        if self._node.monotonic() > active.deadline:
            self._finish(active.run.end(RunStatus.NO_PROGRESS, f'{self.patience:g} s'))

    def _finish(self, end: RunResult) -> None:
        active, self._active = self._active, None
        if active is not None:
            active.done.set_result(end)


def _position(observed: Observed) -> tuple[int, int]:
    """Return the episode and the step of a state."""
    return observed.transition.episode, observed.transition.step


def _check(goal: RunOption.Request | ExecuteOption.Goal, library: OptionLibrary) -> Arbitration:
    """
    Check the parts of a request that do not depend on the start state.

    :raises RunError: the request is invalid.
    :raises UnknownOptionError: there is no such option.
    """
    execution = execution_named(goal.execution)
    if execution is not Arbitration.RUN_TO_END and not goal.plan_id:
        raise RunError(f'{execution} needs the values of a plan: give its plan_id')
    if execution not in MODULAR:
        library.resolve(goal.option_name, goal.participant)
    elif goal.option_name or goal.participant:
        raise RunError(f'{execution} runs all options of the plan: leave option_name empty')
    return execution


def _refused(request: RunRequest, status: RunStatus, detail: str = '') -> OptionResult:
    return _result(refusal(status, request.goal.option_name, detail))


def _checked(message: ExecutionState) -> ExecutionState:
    """
    Return the message.

    :raises ValueError: its execution does not exist.
    """
    try:
        execution_named(message.execution)
    except RunError as error:
        raise ValueError(str(error)) from None
    return message
