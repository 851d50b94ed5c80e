"""The node ``planner``: SMDP value iteration, and acting by the resulting policy over options."""

from collections.abc import Callable
from functools import partial
import sys
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.ros.game_subscriber import GameSubscriber
from humanopts_interfaces.action import Plan
from humanopts_interfaces.msg import LearnedOptions, PlanGoal, PlanResult
from humanopts_learner.planning.evaluate import Coverage, find_coverage
from humanopts_learner.planning.exact import ExactPlan
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan, Performance
from humanopts_learner.planning.request import OPTIONS_ONLY, PlanError, select_options
from humanopts_learner.ros.convert import (
    options_from_message,
    plan_goal_to_message,
    plan_request_from_goal,
    plan_to_message,
    refused_plan,
)
from humanopts_learner.ros.extraction import ExtractionAction
from humanopts_learner.ros.planner_actions import in_thread, LongAction, MadePlan, PlannerState
from humanopts_learner.ros.policy_server import PolicyServer
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT
from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup

_OPTIONS_SECONDS = 5.0  # s to wait for the options of a request
_FAREWELL = 1.0  # s to answer the clients of current goals when the node ends


class PlanAction(LongAction[PlanResult]):
    """Plans with an action set, and evaluates the plan if the goal has episodes."""

    goal_noun = 'plan'
    good = (PlanResult.STATUS_CONVERGED, PlanResult.STATUS_NOT_CONVERGED)

    def __init__(self, node: NodeBase, group: CallbackGroup, state: PlannerState) -> None:
        self._goals = node.stamped_publisher(PlanGoal, 'plan_goals')
        results = node.stamped_publisher(PlanResult, 'plan_results')
        super().__init__(node, group, Plan, 'plan', results, state)

    def blank(self, goal: Plan.Goal) -> PlanResult:
        """Return a result without a plan."""
        return refused_plan(goal.action_set)

    def feedback(self, stage: str, *numbers: Any) -> Plan.Feedback:
        """Encode the progress of planning."""
        progress, sweeps, residual = numbers
        return Plan.Feedback(stage=stage, progress=progress, sweeps=sweeps, residual=residual)

    async def work(
        self,
        domain: Domain[Any],
        goal: Plan.Goal,
        result: PlanResult,
        progress: Callable[..., None],
    ) -> PlanResult:
        """
        Plan with the options that the goal names.

        :raises PlanError: the request is invalid, or its options were not received in time.
        """
        await self._wait_for_options(goal.options_sequence)
        known = self._state.options(goal.action_set)
        options = select_options(known, goal.action_set, goal.participant, goal.options)
        request = plan_request_from_goal(goal).in_force(domain, options)
        result.plan_id = plan_id = str(uuid.uuid4())  # the result from here on
        self._goals.publish(plan_goal_to_message(goal, plan_id, request, options))

        def compute() -> tuple[AnyPlan, Performance | None, Coverage | None]:
            plan, performance, coverage = make_plan(domain, options, request, progress), None, None
            if goal.evaluation_episodes:
                performance = judge_plan(plan, goal.seed, goal.evaluation_episodes, progress)
            if isinstance(plan, ExactPlan) and goal.action_set in OPTIONS_ONLY:
                coverage = find_coverage(plan) if domain.max_steps else None
            return plan, performance, coverage

        plan, performance, coverage = await in_thread(self._node, self._state.pool, compute)
        made = MadePlan(plan, plan_id, goal.participant, known)
        self._state.plans[goal.action_set, goal.participant] = made
        return plan_to_message(plan, plan_id, performance, coverage)

    async def _wait_for_options(self, sequence: int) -> None:
        """
        Wait until the options are at least as new as a goal requires.

        :raises PlanError: they are not received in time.
        """
        state = self._state
        come = await self._node.waiting.until(
            lambda: state.taught_sequence >= sequence, _OPTIONS_SECONDS
        )
        if not come:
            raise PlanError(
                f'learned_options {sequence} did not come, only {state.taught_sequence}'
            )


class PlannerNode(NodeBase):
    """Plans and searches for options in worker threads; plays through the option server."""

    def __init__(self, **options: Any) -> None:
        super().__init__('planner', **options)
        self._state = PlannerState()
        GameSubscriber(self, self._on_domain)
        self.create_subscription(LearnedOptions, 'learned_options', self._on_options, CURRENT)
        shared = self, ReentrantCallbackGroup(), self._state
        self._policies = PolicyServer(*shared)
        self._actions = PlanAction(*shared), ExtractionAction(*shared)

    def waits_for(self) -> str | None:
        """Return what the node waits for: the domain of the game."""
        return None if self._state.domain is not None else 'domain_info'

    def close(self) -> None:
        """End the current goals, and answer their clients."""
        self._state.stopping = True
        self._policies.stop()
        self.finish(
            lambda: self._policies.busy or any(action.busy for action in self._actions), _FAREWELL
        )
        self._state.pool.shutdown()

    def _on_domain(self, domain: Domain[Any]) -> None:
        self._state.domain = domain

    def _on_options(self, message: LearnedOptions) -> None:
        self._state.taught, problems = options_from_message(message)
        self._state.taught_sequence = message.sequence
        self.waiting.check()
        for problem in problems:
            self.refuse('learned_options', message, problem)


main = partial(run_node, PlannerNode)

if __name__ == '__main__':
    sys.exit(main())
