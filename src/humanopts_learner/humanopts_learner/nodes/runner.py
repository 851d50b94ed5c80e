"""The one runner: drives one option at a time over the graph, in lock-step with game."""

from collections.abc import Callable
from dataclasses import dataclass, field
import time
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.nodes.node_base import NodeBase
from humanopts_env.nodes.qos import CURRENT, STREAM
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import ActionCommand, ActionRefusal, GameState, OptionGoal
from humanopts_learner.convert import end_to_message
from humanopts_learner.execution import End, OptionRun, refusal, Status
from humanopts_learner.library import OptionLibrary, RunnableOption, UnknownOptionError
from humanopts_learner.options.option import Mode
from rclpy.task import Future

_CHECK_PERIOD = 0.1  # s between looks at deadlines


@dataclass
class _Active:
    """The run under way."""

    run: OptionRun
    run_id: str
    episode: int
    step: int  # of the state that the command under way answers
    canceled: Callable[[], bool]
    on_step: Callable[[OptionRun, str, str], None]
    done: Future = field(default_factory=Future)
    deadline: float = 0.0
    command: int = 0  # sequence of the command that is not answered yet


@dataclass(frozen=True)
class RunRequest:
    """What a service or action asks to be run."""

    option_name: str
    participant: str
    max_steps: int  # 0: the option's own limit
    episode: int  # 0: whatever is current
    step: int
    via: str
    canceled: Callable[[], bool] = lambda: False
    on_step: Callable[[OptionRun, str, str], None] = field(default=lambda run, action, state: None)


class Runner:
    """
    Runs options in the current episode, one at a time; a second request is answered BUSY.

    Whether the run goes on is decided here, after each state and before each command, so that no
    command is on its way when it ends, be it canceled or not. A person who takes over, or a reset,
    ends it as interrupted; silence of game ends it after a deadline.
    """

    def __init__(self, node: NodeBase, mode: Mode, seed: int, no_progress_seconds: float) -> None:
        self._node, self._mode, self._seed = node, mode, seed
        self._patience = no_progress_seconds
        self._domain: Domain | None = None
        self.library: OptionLibrary | None = None
        self.state: GameState | None = None  # newest
        self._taken_by = ''  # option that the runner is at work on; empty: it is free
        self._active: _Active | None = None  # from its first command on
        self._arrivals: list[tuple[int, int, Future, float]] = []
        self._actions = node.stamped_publisher(ActionCommand, 'action')
        self._goals = node.stamped_publisher(OptionGoal, 'option_goals')
        node.create_subscription(GameState, 'current_state', self._on_state, CURRENT)
        node.create_subscription(GameState, 'game_state', self._on_state, STREAM)
        node.create_subscription(ActionRefusal, 'action_refused', self._on_refusal, STREAM)
        node.create_timer(_CHECK_PERIOD, self._check_deadlines)

    def set_domain(self, domain: Domain) -> None:
        """Take the rules of the game; options of an earlier game are dropped."""
        self._domain, self.library = domain, OptionLibrary(domain)

    async def run(self, request: RunRequest) -> Any:
        """Run an option to its end, or refuse; return an ``OptionResult``."""
        if self._domain is None or self.library is None:
            return self._refused(request, Status.NO_EPISODE, 'game has not announced itself')
        if self._taken_by:
            return self._refused(request, Status.BUSY, self._taken_by)
        try:
            option = self.library.resolve(request.option_name, request.participant)
        except UnknownOptionError as error:
            return self._refused(request, Status.UNKNOWN_OPTION, str(error))
        self._taken_by = option.name
        try:
            return await self._drive(request, option)
        finally:
            self._taken_by = ''

    @property
    def busy(self) -> bool:
        """Whether a run is under way, or waits for its first state."""
        return bool(self._taken_by)

    def stop(self) -> None:
        """End the run under way, or the wait for its first state, because the node ends."""
        for _, _, arrival, _ in self._arrivals:
            arrival.set_result(None)
        self._arrivals = []
        if self._active is not None:
            self._finish(self._active.run.end(Status.FAILED, 'option_server stops'))

    async def _drive(self, request: RunRequest, option: RunnableOption) -> Any:
        """Wait for the state to start from, and run the option from there."""
        state = await self._arrival(request.episode, request.step)
        if state is None:
            return self._refused(request, Status.NO_EPISODE, self._missing(request))
        if state.terminated or state.truncated:
            return self._refused(request, Status.NO_EPISODE, 'the episode has ended')
        moment = state.episode, state.step
        rng = generator(self._seed, 'run', option.name, *moment)
        gamma, limit = self._domain.gamma, request.max_steps
        run = OptionRun(option, self._domain, gamma, limit, self._mode, rng)
        end = run.begin(self._domain.decode(state.state), *moment)
        if end is not None:
            return end_to_message(end, '')
        run_id = str(uuid.uuid4())
        active = _Active(run, run_id, *moment, request.canceled, request.on_step)
        self._active = active
        self._announce(request, active)
        self._send(active)
        return end_to_message(await active.done, run_id)

    def _missing(self, request: RunRequest) -> str:
        if self.state is None or not request.episode:
            return 'no state came from game'
        return (
            f'episode {request.episode} step {request.step} did not come; the game is at episode '
            f'{self.state.episode} step {self.state.step}'
        )

    def _announce(self, request: RunRequest, active: _Active) -> None:
        self._goals.publish(
            OptionGoal(
                run_id=active.run_id,
                via=request.via,
                option_name=active.run.option.name,
                participant=request.participant,
                max_steps=active.run.max_steps,
            )
        )

    async def _arrival(self, episode: int, step: int) -> GameState | None:
        """Return the state of that moment once it is here; None when it does not come."""
        state = self.state
        if state is not None and state.episode and not episode:
            return state
        if state is not None and (state.episode, state.step) == (episode, step) != (0, 0):
            return state
        past = state is not None and state.episode == episode and step < state.step
        if episode == 0 or past:
            return None
        arrival: Future = Future()
        self._arrivals.append((episode, step, arrival, time.monotonic() + self._patience))
        found: GameState | None = await arrival
        return found

    def _send(self, active: _Active) -> None:
        assert self._domain is not None
        action = self._domain.actions[active.run.next_action()].name
        command = ActionCommand(
            source=ActionCommand.SOURCE_MACHINE,
            episode=active.episode,
            step=active.step,
            action=action,
        )
        active.deadline = time.monotonic() + self._patience
        self._actions.publish(command)
        active.command = self._actions.sequence

    def _on_state(self, message: GameState) -> None:
        """Take the next state; ``current_state`` repeats those that ``game_state`` brought."""
        known, moment = self.state, (message.episode, message.step)
        same_game = known is not None and known.publisher_id == message.publisher_id
        if same_game and moment <= (known.episode, known.step):
            return
        self.state = message
        self._answer_arrivals(message)
        active = self._active
        if active is None:
            return
        if message.episode != active.episode:
            self._finish(active.run.end(Status.INTERRUPTED, 'the game was reset'))
        elif message.step > active.step:
            self._on_step(active, message)

    def _on_step(self, active: _Active, message: GameState) -> None:
        mine = message.action_publisher_id == self._node.publisher_id
        if not mine or message.action_sequence != active.command:
            who = message.action_publisher_id
            self._finish(
                active.run.end(Status.INTERRUPTED, f'{who} took {message.previous_action}')
            )
            return
        assert self._domain is not None
        active.step = message.step
        state = self._domain.decode(message.state)
        end = active.run.observe(state, message.reward, message.terminated, message.truncated)
        active.on_step(active.run, message.previous_action, message.state)
        if end is None and active.canceled():
            end = active.run.end(Status.CANCELED)
        if end is not None:
            self._finish(end)
        else:
            self._send(active)

    def _on_refusal(self, message: ActionRefusal) -> None:
        active = self._active
        mine = message.command_publisher_id == self._node.publisher_id
        if active is None or not mine or message.command_sequence != active.command:
            return
        interrupted = (ActionRefusal.REASON_HELD_BY_PERSON, ActionRefusal.REASON_STALE)
        status = Status.INTERRUPTED if message.reason in interrupted else Status.FAILED
        self._finish(active.run.end(status, message.detail))

    def _finish(self, end: End) -> None:
        active, self._active = self._active, None
        if active is not None:
            active.done.set_result(end)

    def _answer_arrivals(self, message: GameState) -> None:
        waiting = []
        for episode, step, arrival, deadline in self._arrivals:
            if (episode, step) == (message.episode, message.step):
                arrival.set_result(message)
            elif (episode, step) < (message.episode, message.step):
                arrival.set_result(None)
            else:
                waiting.append((episode, step, arrival, deadline))
        self._arrivals = waiting

    def _check_deadlines(self) -> None:
        now, active = time.monotonic(), self._active
        for _, _, arrival, deadline in self._arrivals:
            if now > deadline:
                arrival.set_result(None)
        self._arrivals = [entry for entry in self._arrivals if not entry[2].done()]
        if active is not None and now > active.deadline:
            self._finish(active.run.end(Status.NO_PROGRESS, f'{self._patience:g} s'))

    def _refused(self, request: RunRequest, status: Status, detail: str) -> Any:
        return end_to_message(refusal(status, request.option_name, detail), '')
