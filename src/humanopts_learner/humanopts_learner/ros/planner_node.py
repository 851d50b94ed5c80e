"""The node ``planner``: SMDP value iteration, and acting by the policy over options it gives."""

from collections.abc import Callable
import sys
import threading
from typing import Any
import uuid

from humanopts_env.domains.base import DomainError
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.action import Plan as PlanAction
from humanopts_interfaces.msg import DomainInfo, LearnedOptions, PlanGoal, PlanResult
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import OF_MACHINES
from humanopts_learner.planning.any_domain import (
    AnyPlan,
    check_plan_request,
    judge_plan,
    Performance,
    plan_in,
    PlanRequest,
    select_options,
)
from humanopts_learner.planning.errors import NoOptionsError, PlanCanceled, PlanError
from humanopts_learner.ros.convert import (
    options_from_message,
    plan_goal_to_message,
    plan_request_from_goal,
    plan_to_message,
    refused_plan,
)
from humanopts_learner.ros.extraction import ExtractionServer
from humanopts_learner.ros.goals import end_goal, Feedback
from humanopts_learner.ros.player import Made, STOPS
from humanopts_learner.ros.policy_server import PolicyServer
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

_OPTIONS_SECONDS = 5.0  # to wait for the options that a request wants
_FAREWELL = 1.0  # s to answer who asked for what is under way, when the node ends


class PlannerNode(NodeBase):
    """Plans, and looks for options, in threads of its own; plays through the option server."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._domain: Any = None
        self._options: list[LearnedOption] = []
        self._version = 0  # sequence of the LearnedOptions that they came with
        self._plans: dict[tuple[str, str], Made] = {}  # newest by action set and participant
        self._planning = self._stopping = False
        self._threads: set[threading.Thread] = set()  # at work
        self._plan_goals = self.stamped_publisher(PlanGoal, 'plan_goals')
        self._plan_results = self.stamped_publisher(PlanResult, 'plan_results')
        self.create_subscription(DomainInfo, 'domain_info', self._on_domain, CURRENT)
        self.create_subscription(LearnedOptions, 'learned_options', self._on_options, CURRENT)
        group = ReentrantCallbackGroup()
        self.recorded_action(PlanAction, 'plan', self._execute_plan, group)
        self._policies = PolicyServer(
            self,
            group,
            plan_of=lambda action_set, who: self._plans.get((action_set, who)),
            options=self._known,
            in_thread=self._in_thread,
        )
        self._extraction = ExtractionServer(
            self,
            group,
            domain=lambda: self._domain,
            in_thread=self._in_thread,
            stopping=lambda: self._stopping,
        )

    def waits_for(self) -> str | None:
        """Wait for the rules of the game."""
        return None if self._domain is not None else 'domain_info'

    def close(self) -> None:
        """End what is under way, and answer who asked for it."""
        self._stopping = True
        self._policies.stop()
        self.finish(
            lambda: self._planning or self._policies.busy or self._extraction.busy, _FAREWELL
        )
        for thread in list(self._threads):
            thread.join()

    def _on_domain(self, info: DomainInfo) -> None:
        try:
            self._domain = domain_from_info(info)
        except DomainError as error:
            raise StartError(str(error)) from error

    def _on_options(self, message: LearnedOptions) -> None:
        self._options, problems = options_from_message(message)
        self._version = message.sequence
        self.waiting.look()
        for problem in problems:
            self.get_logger().error(problem)

    def _known(self, action_set: str) -> list[LearnedOption]:
        """Return what an action set can have; another list whenever it changed."""
        return self._extraction.options if action_set in OF_MACHINES else self._options

    async def _execute_plan(self, handle: ServerGoalHandle) -> PlanAction.Result:
        result = await self._plan(handle)
        self._plan_results.publish(result)
        usable = (PlanResult.STATUS_CONVERGED, PlanResult.STATUS_NOT_CONVERGED)
        end_goal(handle, result.status in usable, result.status == PlanResult.STATUS_CANCELED)
        return PlanAction.Result(result=result)

    async def _plan(self, handle: ServerGoalHandle) -> PlanResult:
        request = handle.request
        refused = refused_plan(request.action_set)
        await self.provided()
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
            known = self._known(request.action_set)
            options = select_options(
                known, request.action_set, request.participant, request.options
            )
            asked = check_plan_request(self._domain, options, plan_request_from_goal(request))
            refused.plan_id = str(uuid.uuid4())  # from here on it is accepted
            return await self._plan_in_thread(handle, refused.plan_id, known, options, asked)
        except NoOptionsError as error:
            refused.status, refused.detail = PlanResult.STATUS_NO_OPTIONS, str(error)
        except PlanError as error:
            refused.status, refused.detail = PlanResult.STATUS_BAD_REQUEST, str(error)
        except PlanCanceled:
            refused.status, refused.detail = PlanResult.STATUS_CANCELED, 'canceled by the client'
            if self._stopping:
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
        learned: list[LearnedOption],
        options: list[LearnedOption],
        asked: PlanRequest,
    ) -> PlanResult:
        request, domain = handle.request, self._domain
        self._plan_goals.publish(plan_goal_to_message(request, plan_id, asked, options))
        progress = Feedback(
            handle,
            lambda: self._stopping,
            lambda stage, fraction, sweeps, residual: PlanAction.Feedback(
                stage=stage, progress=fraction, sweeps=sweeps, residual=residual
            ),
        )

        def work() -> tuple[AnyPlan, Performance | None]:
            plan, performance = plan_in(domain, options, asked, progress), None
            if episodes := request.evaluation_episodes:
                performance = judge_plan(plan, request.seed, episodes, progress)
            return plan, performance

        plan, performance = await self._in_thread(work)
        made = Made(plan, plan_id, request.participant, learned)
        self._plans[request.action_set, request.participant] = made
        return plan_to_message(plan, plan_id, performance)

    async def _in_thread(self, work: Callable[[], Any]) -> Any:
        """Do work in a thread of its own; return, or raise, what comes of it."""
        done: Future = Future(executor=self.executor)

        def run() -> None:
            try:
                done.set_result(work())
            except Exception as error:
                done.set_exception(error)
            self.executor.wake()

        thread = threading.Thread(target=run, name='planner')
        self._threads.add(thread)
        thread.start()
        try:
            return await done
        finally:
            thread.join()
            self._threads.discard(thread)

    async def _options_arrive(self, sequence: int) -> None:
        """Wait until the options are at least as new as the request wants."""
        if not await self.waiting.until(lambda: self._version >= sequence, _OPTIONS_SECONDS):
            raise PlanError(f'learned_options {sequence} did not come, only {self._version}')


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
