"""
The runner, which executes one run at a time over the graph, in lock-step with ``game``.

It receives the option values and the current execution of the policy that ``planner`` runs.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
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
from humanopts_ros.codec import Codec
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT
from rclpy.task import Future

_STOPS = 'option_server stops'
_CHECK_PERIOD = 0.1  # s between checks for command timeouts
_RESULT = Codec(RunResult, OptionResult)


@dataclass
class RunRequest:
    """
    A run request from a service or action, and the run once it has begun.

    :ivar via: name of the service or action.
    :ivar execution_sequence: sequence of the ExecutionState; 0: the execution is fixed.
    :ivar canceled: returns whether the client has canceled.
    :ivar on_step: called after each step with the run and the new state.
    """

    goal: RunOption.Request | ExecuteOption.Goal
    via: str
    execution_sequence: int = 0
    canceled: Callable[[], bool] = lambda: False
    on_step: Callable[[Run, Transition], object] = lambda run, state: None


@dataclass
class _Active:
    """The current run."""

    run: Run
    run_id: str
    request: RunRequest
    done: Future = field(default_factory=Future)
    deadline: float = 0.0
    command: int = 0  # sequence of the pending command


class PolicySubscriber:
    """Stores the newest option values and execution, and creates arbiters from them."""

    def __init__(self, node: NodeBase) -> None:
        self._node = node
        self._message = OptionValues()
        self._values: PlanValues | None = None  # of the message
        self._state = ExecutionState()
        self.arbiters: dict[Arbitration, Arbiter] = {}  # of the newest values and options
        node.subscribe(OptionValues, 'option_values', self._read, self._on_values, CURRENT)
        node.subscribe(ExecutionState, 'execution', _checked, self._on_execution, CURRENT)

    @property
    def plan_id(self) -> str:
        """The plan of the newest values; empty: none have arrived yet."""
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


class Runner:
    """
    Runs options or modules in the current episode; a second request is answered with BUSY.

    The runner decides after each state and before each command whether the run continues, so no
    command is pending when the run ends, canceled or not. It also arbitrates: the same states,
    values and execution give the same run. If a person takes control or the game is reset, the run
    ends as interrupted; if the game does not respond, it ends after a timeout.

    :ivar library: options that can be run; None: the game is not known yet.
    :ivar taught_sequence: of the message that completed the taught options; 0: none has.
    :ivar patience: timeout in s for the game and for the values of a plan; may be changed.
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

        :param seed: random seed of draws in sampled mode.
        :param patience: see the attribute.
        :param unstick: whether runs that repeat themselves take random moves.
        """
        self._node, self._mode, self._seed, self.patience = node, mode, seed, patience
        self._unstick = unstick
        self._policy = PolicySubscriber(node)
        self.library: OptionLibrary | None = None
        self.taught_sequence = 0
        self._state: Observed | None = None
        self._busy_with = ''  # option or execution of the request; empty: idle
        self._active: _Active | None = None  # set with the first command
        self._stopping = False
        self._actions = node.stamped_publisher(ActionCommand, 'action')
        self._goals = node.stamped_publisher(OptionGoal, 'option_goals')
        game.follow('game_state', self._on_state)
        self._current = game.newest()  # published before the subscription to the stream
        game.follow_refusals(self._on_refusal)
        self._pace = ControlState()  # the newest
        game.follow_control(self._on_control)
        node.create_timer(_CHECK_PERIOD, self._check)

    @property
    def busy(self) -> bool:
        """Whether there is a run, or a request waiting for its first state."""
        return bool(self._busy_with)

    def serve(self, options: Iterable[LearnedOption]) -> list[str]:
        """Use the options that fit the game, once it is known; return why others do not."""
        self._policy.arbiters.clear()
        self._node.waiting.check()
        return self.library.replace(options) if self.library is not None else []

    def newest_state(self) -> Observed | None:
        """Return the newest state of the game; None: none published yet."""
        if self.library is not None and (observed := self._current.take()) is not None:
            self._on_state(observed)
        return self._state

    def stop(self) -> None:
        """End the current run, or the wait for its first state, on shutdown."""
        self._stopping = True
        self._finish(RunStatus.FAILED, _STOPS)

    async def run(self, request: RunRequest) -> OptionResult:
        """Execute a run to its end, or refuse it."""
        try:
            return _RESULT.encode(await self._run(request))
        except RefusedError as error:
            status, detail = error.status, str(error)
        except UnknownOptionError as error:
            status, detail = RunStatus.UNKNOWN_OPTION, str(error)
        except (NeedsRulesError, PlanError) as error:
            status, detail = RunStatus.NO_VALUES, str(error)
        name = request.goal.option_name
        return _RESULT.encode(RunResult(status, status.explained(detail), name))

    async def _run(self, request: RunRequest) -> RunResult:
        """
        Execute a run to its end.

        :raises RefusedError: or UnknownOptionError, NeedsRulesError, PlanError: it cannot run.
        """
        if self._stopping:
            raise RefusedError(RunStatus.FAILED, _STOPS)
        if self.library is None:
            raise RefusedError(RunStatus.NO_EPISODE, 'game has not announced itself')
        if self._busy_with:
            raise RefusedError(RunStatus.BUSY, self._busy_with)
        execution = _check(request.goal, self.library)
        self._busy_with = request.goal.option_name or execution.value
        try:
            run = await self._begin(request, execution, self.library)
            self._active = active = _Active(run, str(uuid.uuid4()), request)
            goal = request.goal
            self._goals.publish(
                OptionGoal(
                    run_id=active.run_id,
                    via=request.via,
                    option_name=run.name,
                    participant=goal.participant,
                    max_steps=run.max_steps,
                    execution=execution,
                    plan_id=goal.plan_id,
                )
            )
            self._send(active)
            end: RunResult = await active.done
            return replace(end, run_id=active.run_id)
        finally:
            self._busy_with = ''

    async def _begin(
        self, request: RunRequest, execution: Arbitration, library: OptionLibrary
    ) -> Run:
        """Wait for option values and start state, and begin the run; errors as in ``_run``."""
        goal, before = request.goal, self.newest_state()
        arbitrated, wanted = execution is not Arbitration.RUN_TO_END, (goal.episode, goal.step)
        values = self._policy
        if arbitrated and not await self._wait(request, lambda: values.plan_id == goal.plan_id):
            newest = (
                f'the newest are those of {values.plan_id}'
                if values.plan_id
                else 'none have arrived'
            )
            raise PlanError(f'the option values of plan {goal.plan_id} did not arrive; {newest}')

        def has_arrived() -> bool:  # a restarted game counts from 1
            state = self._state
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
        state = self._state
        if state is None or not _position(state)[0]:
            raise RefusedError(RunStatus.NO_EPISODE, 'the game has published no state')
        here = _position(state)
        if goal.episode and here != wanted:
            raise RefusedError(
                RunStatus.NO_EPISODE,
                f'episode {goal.episode} step {goal.step} did not arrive; the game is at episode '
                f'{here[0]} step {here[1]}',
            )
        if not state.transition.open:
            raise RefusedError(RunStatus.NO_EPISODE, 'the episode has ended')
        named = execution not in MODULAR
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

    async def _wait(self, request: RunRequest, condition: Callable[[], bool]) -> bool:
        """
        Wait for a start condition of a run, with a timeout; return whether it holds.

        :raises RefusedError: the client has canceled, or the node is shutting down.
        """
        await self._node.waiting.until(
            lambda: condition() or self._stopping or self._canceled(request), self.patience
        )
        if self._stopping:
            raise RefusedError(RunStatus.FAILED, _STOPS)
        if self._canceled(request):
            raise RefusedError(RunStatus.CANCELED)
        return condition()

    def _send(self, active: _Active) -> None:
        """Send the next action to the game."""
        run = active.run
        episode, step = run.position
        command = ActionCommand(
            source=ActionCommand.SOURCE_MACHINE,
            episode=episode,
            step=step,
            action=run.domain.actions[run.next_action()].name,
            option_name=run.acting.name,
        )
        active.deadline = self._node.monotonic() + self._pace.step_period + self.patience
        self._actions.publish(command)
        active.command = self._actions.sequence

    def _on_state(self, observed: Observed) -> None:
        """Handle a state; ``current_state`` repeats states of ``game_state``."""
        known, here = self._state, _position(observed)
        same_game = known is not None and known.publisher_id == observed.publisher_id
        if known is not None and same_game and here <= _position(known):
            return
        self._state = observed
        self._node.waiting.check()
        active = self._active
        if active is None:
            return
        position = active.run.position
        if not same_game:
            self._finish(RunStatus.INTERRUPTED, 'the game was restarted')
        elif here[0] != position[0]:
            self._finish(RunStatus.INTERRUPTED, 'the game was reset')
        elif here > position:
            self._on_step(active, observed)

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
        active.request.on_step(run, transition)
        end = end or self._stopped(active)
        if end is not None:
            self._active = None
            active.done.set_result(end)
        else:
            self._send(active)

    def _stopped(self, active: _Active) -> RunResult | None:
        """Return the result if the run ends before its next command; None: it continues."""
        run, request, plan_id = active.run, active.request, active.request.goal.plan_id
        if self._canceled(request):
            return run.end(RunStatus.CANCELED)
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

    def _canceled(self, request: RunRequest) -> bool:
        newer = self._policy.newer(request)
        return request.canceled() or (newer is not None and newer.canceled)

    def _on_refusal(self, message: ActionRefusal) -> None:
        """End the run because the game refused its command."""
        active = self._active
        is_own = message.command_publisher_id == self._node.publisher_id
        if active is None or not is_own or message.command_sequence != active.command:
            return
        interrupted = (ActionRefusal.REASON_HELD_BY_PERSON, ActionRefusal.REASON_STALE)
        status = RunStatus.INTERRUPTED if message.reason in interrupted else RunStatus.FAILED
        self._finish(status, message.detail)

    def _on_control(self, control: ControlState) -> None:
        """Restart the timeout of a command when the pace changes."""
        self._pace = control
        if self._active is not None:
            self._active.deadline = self._node.monotonic() + control.step_period + self.patience

    def _check(self) -> None:
        """Handle a state missing from the stream, or an unresponsive game."""
        self.newest_state()
        active = self._active
        if active is None or self._pace.paused_by:
            return
        if self._node.monotonic() > active.deadline:
            self._finish(RunStatus.NO_PROGRESS, f'{self.patience:g} s')

    def _finish(self, status: RunStatus, detail: str) -> None:
        """End the current run, if any."""
        active, self._active = self._active, None
        if active is not None:
            active.done.set_result(active.run.end(status, detail))


def _position(observed: Observed) -> tuple[int, int]:
    """Return the episode and step of a state."""
    return observed.transition.episode, observed.transition.step


def _check(goal: RunOption.Request | ExecuteOption.Goal, library: OptionLibrary) -> Arbitration:
    """
    Check the parts of a request that do not depend on the start state.

    :raises RefusedError: the request is invalid.
    :raises UnknownOptionError: the option does not exist.
    """
    execution = execution_named(goal.execution)
    fault = ''
    if execution is not Arbitration.RUN_TO_END and not goal.plan_id:
        fault = f'{execution} needs the values of a plan: give its plan_id'
    elif execution not in MODULAR:
        library.resolve(goal.option_name, goal.participant)
    elif goal.option_name or goal.participant:
        fault = f'{execution} runs all options of the plan: leave option_name empty'
    if fault:
        raise RefusedError(RunStatus.BAD_REQUEST, fault)
    return execution


def _checked(message: ExecutionState) -> ExecutionState:
    """
    Return the message, after checking its execution.

    :raises RefusedError: the execution does not exist.
    """
    execution_named(message.execution)
    return message
