"""Plays episodes by a plan: game begins them, and option_server runs the options."""

from dataclasses import dataclass
from typing import Any

from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import OptionResult, PolicyResult
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_learner.execution import MODULAR
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.any_domain import AnyPlan
from humanopts_learner.planning.arbitration import Execution
from humanopts_ros.node_base import NodeBase
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup

STOPS = 'the planner stops'
_RESET_SECONDS = 5.0  # to wait for an answer
_RUN_SECONDS = 86_400.0  # modules may run for a whole episode that is paced; the server itself
# does not wait long for game
_GO_ON = (
    OptionResult.STATUS_REACHED,
    OptionResult.STATUS_EPISODE_OVER,
    OptionResult.STATUS_MAX_STEPS,
    OptionResult.STATUS_STOPPED_BY_PLAN,
    OptionResult.STATUS_EXECUTION_CHANGED,
)


@dataclass(frozen=True)
class Made:
    """A plan, and the options that were known when it was made."""

    plan: AnyPlan
    plan_id: str
    participant: str  # as it was asked for
    learned: list[LearnedOption]


@dataclass
class PolicyRun:
    """The policy that runs."""

    handle: ServerGoalHandle
    made: Made
    execution: Execution
    result: PolicyResult
    execution_sequence: int = 0  # of the ExecutionState that says the execution
    canceled: bool = False  # the client wants no more

    @property
    def request(self) -> Any:
        """The goal."""
        return self.handle.request

    def tell(self) -> None:
        """Publish how far it is."""
        result = self.result
        self.handle.publish_feedback(
            RunPolicy.Feedback(
                episodes=result.episodes,
                successes=result.successes,
                fallbacks=result.fallbacks,
                mean_return=result.mean_return,
                interruptions=result.interruptions,
                execution=self.execution,
            )
        )


class Player:
    """Asks game and option_server; ``stopping`` ends what is played."""

    def __init__(self, node: NodeBase, group: CallbackGroup) -> None:
        self._node = node
        self._reset = node.recorded_client(ResetGame, 'reset_game', group)
        self._run = node.recorded_client(RunOption, 'run_option', group)
        self.stopping = False

    async def reset(self, state: str, seed: int) -> Any:
        """Begin an episode; None when game does not answer."""
        request = ResetGame.Request(
            source=ResetGame.Request.SOURCE_MACHINE, start_state=state, seed=seed
        )
        return await self._node.answer(self._reset, request, _RESET_SECONDS)

    async def run(self, run: PolicyRun, name: str, limit: int, episode: int, step: int) -> Any:
        """
        Run an option, or all of them as modules; None when option_server does not answer.

        :param name: of the option; empty: modules.
        :param limit: of steps, of modules.
        """
        request = RunOption.Request(
            option_name=name,
            participant=run.request.participant if name else '',
            max_steps=0 if name else limit,
            episode=episode,
            step=step,
            execution=run.execution,
            plan_id=run.made.plan_id,
            execution_sequence=run.execution_sequence,
        )
        response = await self._node.answer(self._run, request, _RUN_SECONDS)
        return None if response is None else response.result


class Episode:
    """One episode by a plan; its counts go into the result of the whole run."""

    def __init__(self, player: Player, run: PolicyRun) -> None:
        self._player, self._run, self._result = player, run, run.result
        self._plan = run.made.plan
        self.total = self.discounted = 0.0

    async def play(self, start: Any, seed: int, limit: int) -> bool:
        """Play to the end; False: the run is over, and the result says why."""
        state, step, decided = start, 0, 0
        reset = await self._player.reset(self._plan.domain.encode(start), seed)
        if reset is None:
            return self._fail('game did not answer reset_game')
        if reset.status == ResetGame.Response.STATUS_HELD_BY_PERSON:
            return self._stop(PolicyResult.STATUS_INTERRUPTED, reset.detail)
        if reset.status != ResetGame.Response.STATUS_OK:
            return self._fail(f'game refused to begin an episode: {reset.detail}')
        while decided < limit:
            if self._unwanted():
                return False
            modular = self._run.execution in MODULAR
            name = '' if modular else self._plan.choose(state).name
            left = limit - decided
            ran = await self._player.run(self._run, name, left, reset.episode, step)
            if ran is None:
                return self._fail('option_server did not answer run_option')
            decisions = ran.step_count if modular else min(ran.step_count, 1)
            decided += decisions
            self._count(ran, decisions, step)
            step += ran.step_count
            if ran.status == OptionResult.STATUS_INTERRUPTED:
                return self._stop(PolicyResult.STATUS_INTERRUPTED, ran.detail)
            if ran.status == OptionResult.STATUS_CANCELED and self._unwanted():
                return False
            if ran.status not in _GO_ON:
                what = repr(name) if name else self._run.execution
                return self._fail(f'{what} in {ran.final_state!r}: {ran.detail}')
            if ran.terminated or ran.truncated:
                self._result.successes += ran.terminated
                return True
            state = self._plan.domain.decode(ran.final_state)
        return True

    def _count(self, ran: OptionResult, decisions: int, step: int) -> None:
        """Add what a run came to."""
        fallback = self._plan.names[self._plan.first_fallback :]
        acted = zip(ran.acted_names, ran.acted_steps)
        self._result.decisions += decisions
        self._result.fallbacks += sum(steps for name, steps in acted if name in fallback)
        self._result.interruptions += ran.status == OptionResult.STATUS_STOPPED_BY_PLAN
        self.total += ran.total_reward
        self.discounted += self._plan.gamma**step * ran.discounted_return

    def _unwanted(self) -> bool:
        """Tell, also in the result, whether nobody wants more."""
        if self._run.canceled:
            self._stop(PolicyResult.STATUS_CANCELED, 'canceled by the client')
        elif self._player.stopping:
            self._fail(STOPS)
        return self._run.canceled or self._player.stopping

    def _fail(self, detail: str) -> bool:
        return self._stop(PolicyResult.STATUS_FAILED, detail)

    def _stop(self, status: int, detail: str) -> bool:
        self._result.status, self._result.detail = status, detail
        return False
