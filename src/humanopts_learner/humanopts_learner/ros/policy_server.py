"""Acting by the policies of plans: the action run_policy, and who changes it while it runs."""

from collections.abc import Awaitable, Callable
import math
from typing import Any
import uuid

from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import ExecutionState, OptionValues, PolicyGoal, PolicyResult
from humanopts_interfaces.srv import SetExecution
from humanopts_learner.execution import execution_named, RunError
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import PRIMITIVE
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.evaluate import episode_start
from humanopts_learner.planning.interruption import option_values
from humanopts_learner.planning.plan import Plan
from humanopts_learner.ros.convert import option_values_to_message
from humanopts_learner.ros.goals import end_goal
from humanopts_learner.ros.player import Episode, Made, Player, PolicyRun
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED, LATCHED_LARGE
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup

InThread = Callable[[Callable[[], Any]], Awaitable[Any]]


class PolicyServer:
    """
    Plays episodes by the newest plans, one policy at a time.

    Values go to option_server once a policy needs them. Which option acts is decided there; the
    execution can be changed from here at any time, and is in force from the next action on.
    """

    def __init__(
        self,
        node: NodeBase,
        group: CallbackGroup,
        plan_of: Callable[[str, str], Made | None],
        options: Callable[[str], list[LearnedOption]],
        in_thread: InThread,
    ) -> None:
        """
        Serve.

        :param plan_of: finds the newest plan of an action set and a participant.
        :param options: returns those that an action set can have now.
        :param in_thread: does long work beside the executor.
        """
        self._plan_of, self._options, self._in_thread = plan_of, options, in_thread
        self._player = Player(node, group)
        self._run: PolicyRun | None = None
        self._published = ''  # plan_id of the newest OptionValues
        self._goals = node.stamped_publisher(PolicyGoal, 'policy_goals')
        self._results = node.stamped_publisher(PolicyResult, 'policy_results')
        self._values = node.stamped_publisher(OptionValues, 'option_values', LATCHED_LARGE)
        self._executions = node.stamped_publisher(ExecutionState, 'execution', LATCHED)
        node.recorded_action(RunPolicy, 'run_policy', self._execute, group, self._on_cancel)
        node.recorded_service(SetExecution, 'set_execution', self._on_set, group)

    @property
    def busy(self) -> bool:
        """Whether a policy runs."""
        return self._run is not None

    def stop(self) -> None:
        """End the run, because the node ends."""
        self._player.stopping = True
        if self._run is not None:
            self._say(self._run, canceled=True)

    async def _execute(self, handle: ServerGoalHandle) -> RunPolicy.Result:
        result = await self._act(handle)
        self._results.publish(result)
        canceled = result.status == PolicyResult.STATUS_CANCELED
        end_goal(handle, result.status == PolicyResult.STATUS_DONE, canceled)
        return RunPolicy.Result(result=result)

    async def _act(self, handle: ServerGoalHandle) -> PolicyResult:
        request = handle.request
        result = PolicyResult(
            action_set=request.action_set, mean_return=math.nan, mean_discounted_return=math.nan
        )
        made = self._plan_of(request.action_set, request.participant)
        result.status, result.detail = self._refusal(request, made)
        if made is None or result.status:
            return result
        self._run = run = PolicyRun(handle, made, execution_named(request.execution), result)
        try:
            await self._play(run)
        except Exception as error:  # such as no memory for the values of so many states
            result.status, result.detail = result.STATUS_FAILED, repr(error)
        finally:
            self._run = None
        result.execution = run.execution
        return result

    def _refusal(self, request: Any, made: Made | None) -> tuple[int, str]:
        """Return status and detail of what cannot be played; status 0: it can."""
        if self._run is not None:
            return PolicyResult.STATUS_BUSY, 'a policy is running already'
        bad, no_plan = PolicyResult.STATUS_BAD_REQUEST, PolicyResult.STATUS_NO_PLAN
        try:
            execution_named(request.execution)
        except RunError as error:
            return bad, str(error)
        if made is None:
            return no_plan, f'there is no {request.action_set!r} plan yet: plan it first'
        known = self._options(request.action_set)
        if made.learned is not known and request.action_set != PRIMITIVE:
            return no_plan, 'the options changed since they were planned with: plan again'
        if request.episodes == 0:
            return bad, 'episodes is 0'
        if not (request.max_decisions or made.plan.domain.max_steps):
            return bad, f'{made.plan.domain.name} never cuts an episode off: give max_decisions'
        return 0, ''

    async def _play(self, run: PolicyRun) -> None:
        request, result, domain = run.request, run.result, run.made.plan.domain
        result.run_id = str(uuid.uuid4())
        limit = request.max_decisions or domain.max_steps
        self._goals.publish(
            PolicyGoal(
                run_id=result.run_id,
                plan_id=run.made.plan_id,
                action_set=request.action_set,
                participant=request.participant,
                episodes=request.episodes,
                seed=request.seed,
                max_decisions=limit,
                execution=run.execution,
            )
        )
        if run.execution is not Execution.RUN_TO_END:
            await self._publish_values(run.made)
        self._say(run)
        totals, discounted = [], []
        for number in range(request.episodes):
            start = episode_start(domain, request.seed, number)
            episode = Episode(self._player, run)
            if not await episode.play(start, (request.seed + number) % 2**64, limit):
                return
            totals.append(episode.total)
            discounted.append(episode.discounted)
            result.episodes += 1
            result.mean_return = math.fsum(totals) / len(totals)
            result.mean_discounted_return = math.fsum(discounted) / len(discounted)
            run.tell()
        result.status = PolicyResult.STATUS_DONE

    async def _publish_values(self, made: Made) -> None:
        """Give option_server what it needs to arbitrate by a plan, unless it has that."""
        if self._published == made.plan_id:
            return
        plan = made.plan

        def work() -> OptionValues:
            values = option_values(plan) if isinstance(plan, Plan) else plan.option_values()
            return option_values_to_message(values, made.plan_id, made.participant)

        message = await self._in_thread(work)
        if self._published != made.plan_id:
            self._values.publish(message)
            self._published = made.plan_id

    def _say(self, run: PolicyRun, previous: str = '', *, canceled: bool = False) -> None:
        """Publish how the run is carried out."""
        self._executions.publish(
            ExecutionState(
                run_id=run.result.run_id,
                plan_id=run.made.plan_id,
                execution=run.execution,
                previous=previous,
                canceled=canceled,
            )
        )
        if not canceled:
            run.execution_sequence = self._executions.sequence

    def _on_cancel(self, handle: ServerGoalHandle) -> None:
        """End the option or the modules that run, so that it need not be waited for."""
        run = self._run
        if run is not None and run.handle is handle:
            run.canceled = True
            self._say(run, canceled=True)

    async def _on_set(
        self, request: SetExecution.Request, response: SetExecution.Response
    ) -> SetExecution.Response:
        try:
            response.status, response.detail, response.previous = await self._change(request)
        except Exception as error:  # such as no memory for the values of so many states
            response.status, response.detail = response.STATUS_FAILED, repr(error)
        return response

    async def _change(self, request: SetExecution.Request) -> tuple[int, str, str]:
        """Change how the run is carried out; return status, detail and what it was before."""
        answer, run = SetExecution.Response, self._run
        try:
            if not request.execution:
                raise RunError('execution is empty')
            execution = execution_named(request.execution)
        except RunError as error:
            return answer.STATUS_BAD_REQUEST, str(error), ''
        if run is not None and execution is not Execution.RUN_TO_END:
            await self._publish_values(run.made)
        if run is None or self._run is not run:
            text = 'no policy runs: name the execution in the goal of run_policy'
            return answer.STATUS_NO_RUN, text, ''
        previous, run.execution = run.execution, execution
        if previous is not execution:
            run.result.execution_changes += 1
            self._say(run, previous)
        return answer.STATUS_OK, '', previous
