"""Plays episodes by a plan: game begins them, and option_server runs the options."""

from typing import Any

from humanopts_env.nodes.node_base import NodeBase
from humanopts_interfaces.msg import OptionResult, PolicyResult
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_learner.planning.any_domain import AnyPlan
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup

STOPS = 'the planner stops'
_RESET_SECONDS, _OPTION_SECONDS = (
    5.0,
    600.0,
)  # to wait for an answer; the server's own deadline is shorter
_GO_ON = (
    OptionResult.STATUS_REACHED,
    OptionResult.STATUS_EPISODE_OVER,
    OptionResult.STATUS_MAX_STEPS,
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

    async def run_option(self, name: str, participant: str, episode: int, step: int) -> Any:
        """Run an option to its end; None when option_server does not answer."""
        request = RunOption.Request(
            option_name=name, participant=participant, episode=episode, step=step
        )
        response = await self._node.answer(self._run, request, _OPTION_SECONDS)
        return None if response is None else response.result


class Episode:
    """One episode by a plan; its counts go into the result of the whole run."""

    def __init__(
        self, player: Player, plan: AnyPlan, result: PolicyResult, handle: ServerGoalHandle
    ) -> None:
        self._player, self._plan, self._result, self._handle = player, plan, result, handle
        self.total = self.discounted = 0.0

    async def play(self, start: Any, seed: int, limit: int) -> bool:
        """Play to the end; False: the run is over, and the result says why."""
        domain, state, step = self._plan.domain, start, 0
        reset = await self._player.reset(domain.encode(start), seed)
        if reset is None:
            return self._fail('game did not answer reset_game')
        if reset.status == ResetGame.Response.STATUS_HELD_BY_PERSON:
            return self._stop(PolicyResult.STATUS_INTERRUPTED, reset.detail)
        if reset.status != ResetGame.Response.STATUS_OK:
            return self._fail(f'game refused to begin an episode: {reset.detail}')
        for _ in range(limit):
            if self._handle.is_cancel_requested:
                return self._stop(PolicyResult.STATUS_CANCELED, 'canceled by the client')
            if self._player.stopping:
                return self._fail(STOPS)
            decision = self._plan.choose(state)
            self._result.decisions += 1
            self._result.fallbacks += decision.fallback
            participant = self._handle.request.participant
            run = await self._player.run_option(decision.name, participant, reset.episode, step)
            if run is None:
                return self._fail('option_server did not answer run_option')
            self.total += run.total_reward
            self.discounted += self._plan.gamma**step * run.discounted_return
            step += run.step_count
            if run.status == OptionResult.STATUS_INTERRUPTED:
                return self._stop(PolicyResult.STATUS_INTERRUPTED, run.detail)
            if run.status not in _GO_ON:
                return self._fail(f'{decision.name!r} in {run.final_state!r}: {run.detail}')
            if run.terminated or run.truncated:
                self._result.successes += run.terminated
                return True
            state = domain.decode(run.final_state)
        return True

    def _fail(self, detail: str) -> bool:
        return self._stop(PolicyResult.STATUS_FAILED, detail)

    def _stop(self, status: int, detail: str) -> bool:
        self._result.status, self._result.detail = status, detail
        return False
