"""The node ``planner``: SMDP value iteration, and acting by the policy over options it gives."""

from collections.abc import Callable
from dataclasses import dataclass
import math
import sys
import threading
import time
from typing import Any
import uuid

from humanopts_env.convert import domain_from_info
from humanopts_env.domains.base import DomainError
from humanopts_env.nodes.node_base import NodeBase, run_node, StartError
from humanopts_env.nodes.qos import CURRENT
from humanopts_interfaces.action import Plan as PlanAction
from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import (
    DomainInfo,
    LearnedOptions,
    PlanGoal,
    PlanResult,
    PolicyGoal,
    PolicyResult,
)
from humanopts_learner.convert import (
    options_from_message,
    plan_goal_to_message,
    plan_request_from_goal,
    plan_to_message,
    refused_plan,
)
from humanopts_learner.nodes.player import Episode, Player, STOPS
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.any_domain import (
    AnyPlan,
    check_plan_request,
    judge_plan,
    plan_in,
    PlanRequest,
    select_options,
)
from humanopts_learner.planning.errors import NoOptionsError, PlanCanceled, PlanError
from humanopts_learner.planning.evaluate import episode_start
from humanopts_learner.planning.plan import PRIMITIVE
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

_FEEDBACK_PERIOD = 0.1  # s
_OPTIONS_SECONDS = 5.0  # to wait for the options that a request wants
_FAREWELL = 1.0  # s to answer who asked for what is under way, when the node ends


@dataclass(frozen=True)
class _Made:
    """A plan, and the options that were known when it was made."""

    plan: AnyPlan
    plan_id: str
    learned: list[LearnedOption]


class PlannerNode(NodeBase):
    """Plans on request in a thread of its own, and plays episodes through the option server."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._domain: Any = None
        self._options: list[LearnedOption] = []
        self._version = 0  # sequence of the LearnedOptions that they came with
        self._plans: dict[tuple[str, str], _Made] = {}  # newest by action set and participant
        self._waiting: list[tuple[int, Future]] = []
        self._planning = self._playing = False
        self._thread = threading.Thread()  # that plans
        self._plan_goals = self.stamped_publisher(PlanGoal, 'plan_goals')
        self._plan_results = self.stamped_publisher(PlanResult, 'plan_results')
        self._policy_goals = self.stamped_publisher(PolicyGoal, 'policy_goals')
        self._policy_results = self.stamped_publisher(PolicyResult, 'policy_results')
        self.create_subscription(DomainInfo, 'domain_info', self._on_domain, CURRENT)
        self.create_subscription(LearnedOptions, 'learned_options', self._on_options, CURRENT)
        group = ReentrantCallbackGroup()
        self._player = Player(self, group)
        self.recorded_action(PlanAction, 'plan', self._execute_plan, group)
        self.recorded_action(RunPolicy, 'run_policy', self._execute_policy, group)

    def waits_for(self) -> str | None:
        """Wait for the rules of the game."""
        return None if self._domain is not None else 'domain_info'

    def close(self) -> None:
        """End what is under way, and answer who asked for it."""
        self._player.stopping = True
        self.finish(lambda: self._planning or self._playing, _FAREWELL)
        if self._thread.is_alive():
            self._thread.join()

    def _on_domain(self, info: DomainInfo) -> None:
        try:
            self._domain = domain_from_info(info)
        except DomainError as error:
            raise StartError(str(error)) from error

    def _on_options(self, message: LearnedOptions) -> None:
        self._options, problems = options_from_message(message)
        self._version = message.sequence
        for problem in problems:
            self.get_logger().error(problem)
        for sequence, arrival in self._waiting:
            if sequence <= self._version and not arrival.done():
                arrival.set_result(None)
        self._waiting = [entry for entry in self._waiting if not entry[1].done()]

    async def _execute_plan(self, handle: ServerGoalHandle) -> PlanAction.Result:
        result = await self._plan(handle)
        self._plan_results.publish(result)
        usable = (PlanResult.STATUS_CONVERGED, PlanResult.STATUS_NOT_CONVERGED)
        _end(handle, result.status in usable, result.status == PlanResult.STATUS_CANCELED)
        return PlanAction.Result(result=result)

    async def _plan(self, handle: ServerGoalHandle) -> PlanResult:
        request = handle.request
        refused = refused_plan(request.action_set)
        if self._planning:
            refused.status = PlanResult.STATUS_BUSY
            refused.detail = 'the planner is at work on another plan'
            return refused
        if self._domain is None:
            refused.status = PlanResult.STATUS_FAILED
            refused.detail = 'game has not announced itself'
            return refused
        self._planning = True
        try:
            await self._options_arrive(request.options_sequence)
            options = select_options(
                self._options, request.action_set, request.participant, request.options
            )
            asked = check_plan_request(self._domain, options, plan_request_from_goal(request))
            refused.plan_id = str(uuid.uuid4())  # from here on it is accepted
            return await self._plan_in_thread(handle, refused.plan_id, options, asked)
        except NoOptionsError as error:
            refused.status, refused.detail = PlanResult.STATUS_NO_OPTIONS, str(error)
        except PlanError as error:
            refused.status, refused.detail = PlanResult.STATUS_BAD_REQUEST, str(error)
        except PlanCanceled:
            refused.status, refused.detail = PlanResult.STATUS_CANCELED, 'canceled by the client'
            if self._player.stopping:
                refused.status, refused.detail = PlanResult.STATUS_FAILED, STOPS
        except Exception as error:  # such as no memory for the tables of so many states
            refused.status, refused.detail = PlanResult.STATUS_FAILED, repr(error)
        finally:
            self._planning = False
        return refused

    async def _plan_in_thread(
        self,
        handle: ServerGoalHandle,
        plan_id: str,
        options: list[LearnedOption],
        asked: PlanRequest,
    ) -> PlanResult:
        request, domain, learned = handle.request, self._domain, self._options
        self._plan_goals.publish(plan_goal_to_message(request, plan_id, asked, options))
        progress = _Feedback(handle, lambda: self._player.stopping)
        done: Future = Future(executor=self.executor)

        def work() -> None:
            try:
                plan, performance = plan_in(domain, options, asked, progress), None
                if episodes := request.evaluation_episodes:
                    performance = judge_plan(plan, request.seed, episodes, progress)
                done.set_result((plan, performance))
            except Exception as error:
                done.set_exception(error)
            self.executor.wake()

        self._thread = threading.Thread(target=work, name='plan')
        self._thread.start()
        try:
            plan, performance = await done
        finally:
            self._thread.join()
        self._plans[request.action_set, request.participant] = _Made(plan, plan_id, learned)
        return plan_to_message(plan, plan_id, performance)

    async def _options_arrive(self, sequence: int) -> None:
        """Wait until the options are at least as new as the request wants."""
        if self._version >= sequence:
            return
        arrival: Future = Future()
        self._waiting.append((sequence, arrival))
        timer = self.create_timer(_OPTIONS_SECONDS, arrival.cancel)
        try:
            await arrival
        finally:
            timer.cancel()
            self.destroy_timer(timer)
        if self._version < sequence:
            raise PlanError(f'learned_options {sequence} did not come, only {self._version}')

    async def _execute_policy(self, handle: ServerGoalHandle) -> RunPolicy.Result:
        result = await self._act(handle)
        self._policy_results.publish(result)
        canceled = result.status == PolicyResult.STATUS_CANCELED
        _end(handle, result.status == PolicyResult.STATUS_DONE, canceled)
        return RunPolicy.Result(result=result)

    async def _act(self, handle: ServerGoalHandle) -> PolicyResult:
        request = handle.request
        result = PolicyResult(
            action_set=request.action_set, mean_return=math.nan, mean_discounted_return=math.nan
        )
        made = self._plans.get((request.action_set, request.participant))
        if self._playing:
            result.status, result.detail = result.STATUS_BUSY, 'a policy is running already'
        elif made is None:
            result.status = result.STATUS_NO_PLAN
            result.detail = f'there is no {request.action_set!r} plan yet: plan it first'
        elif made.learned is not self._options and request.action_set != PRIMITIVE:
            result.status = result.STATUS_NO_PLAN
            result.detail = 'the options changed since they were planned with: plan again'
        elif request.episodes == 0:
            result.status, result.detail = result.STATUS_BAD_REQUEST, 'episodes is 0'
        elif not (request.max_decisions or made.plan.domain.max_steps):
            result.status = result.STATUS_BAD_REQUEST
            result.detail = (
                f'{made.plan.domain.name} never cuts an episode off: give max_decisions'
            )
        else:
            self._playing = True
            try:
                await self._play(handle, made, result)
            finally:
                self._playing = False
        return result

    async def _play(self, handle: ServerGoalHandle, made: '_Made', result: PolicyResult) -> None:
        request, domain = handle.request, made.plan.domain
        result.run_id = str(uuid.uuid4())
        limit = request.max_decisions or domain.max_steps
        self._policy_goals.publish(
            PolicyGoal(
                run_id=result.run_id,
                plan_id=made.plan_id,
                action_set=request.action_set,
                participant=request.participant,
                episodes=request.episodes,
                seed=request.seed,
                max_decisions=limit,
            )
        )
        totals, discounted = [], []
        for number in range(request.episodes):
            start = episode_start(domain, request.seed, number)
            episode = Episode(self._player, made.plan, result, handle)
            seed = (request.seed + number) % 2**64
            if not await episode.play(start, seed, limit):
                return
            totals.append(episode.total)
            discounted.append(episode.discounted)
            result.episodes += 1
            result.mean_return = math.fsum(totals) / len(totals)
            result.mean_discounted_return = math.fsum(discounted) / len(discounted)
            handle.publish_feedback(
                RunPolicy.Feedback(
                    episodes=result.episodes,
                    successes=result.successes,
                    fallbacks=result.fallbacks,
                    mean_return=result.mean_return,
                )
            )
        result.status = PolicyResult.STATUS_DONE


class _Feedback:
    """Publishes how far planning is, and raises ``PlanCanceled`` when the client wants no more."""

    def __init__(self, handle: ServerGoalHandle, stopping: Callable[[], bool]) -> None:
        self._handle, self._stopping = handle, stopping
        self._stage, self._next = '', 0.0

    def __call__(self, stage: str, fraction: float, sweeps: int, residual: float) -> None:
        if self._handle.is_cancel_requested or self._stopping():
            raise PlanCanceled
        now = time.monotonic()
        if stage != self._stage or now >= self._next:
            self._stage, self._next = stage, now + _FEEDBACK_PERIOD
            self._handle.publish_feedback(
                PlanAction.Feedback(
                    stage=stage, progress=fraction, sweeps=sweeps, residual=residual
                )
            )


def _end(handle: ServerGoalHandle, good: bool, canceled: bool) -> None:
    if good:
        handle.succeed()
    elif canceled:
        handle.canceled()
    else:
        handle.abort()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
