"""Acting by the policies of plans: the action run_policy, and changes of its execution."""

from dataclasses import dataclass
import math
from typing import Any
import uuid

from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import (
    ExecutionState,
    OptionResult,
    OptionValues,
    PolicyGoal,
    PolicyResult,
)
from humanopts_interfaces.srv import ResetGame, RunOption, SetExecution
from humanopts_learner.planning.evaluate import episode_start
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_learner.planning.interruption import option_values
from humanopts_learner.planning.plan import AnyPlan
from humanopts_learner.planning.request import Arbitration, MODULAR, PRIMITIVE
from humanopts_learner.ros.convert import option_values_to_message
from humanopts_learner.ros.planner_actions import in_thread, MadePlan, PlannerState, STOPS
from humanopts_learner.run import execution_named, RunError
from humanopts_ros.node_base import end_goal, NodeBase
from humanopts_ros.node_restarts import NodeRestarts
from humanopts_ros.qos import LATCHED
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup

_RESET_SECONDS = 5.0  # s to wait for an answer
# To wait for a run: modules may run for a whole episode that is paced; the server itself does not
# wait long for game.
_RUN_SECONDS = 86_400.0
_GO_ON = (
    OptionResult.STATUS_REACHED,
    OptionResult.STATUS_EPISODE_OVER,
    OptionResult.STATUS_MAX_STEPS,
    OptionResult.STATUS_STOPPED_BY_PLAN,
    OptionResult.STATUS_EXECUTION_CHANGED,
)


class _Ended(Exception):  # noqa: N818 - no error: the run is over before its last episode
    """The policy run has ended early, with a status of ``PolicyResult`` and the detail."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status, self.detail = status, detail


@dataclass
class _PolicyRun:
    """The policy run that is in progress."""

    handle: ServerGoalHandle
    made: MadePlan
    execution: Arbitration
    result: PolicyResult
    limit: int  # decisions in an episode
    execution_sequence: int = 0  # of the ExecutionState with the execution
    canceled: bool = False  # the client has canceled

    def publish_feedback(self) -> None:
        """Encode the progress of the run."""
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

    def count(self, ran: OptionResult, decisions: int) -> None:
        """Add the result of an option or of the modules."""
        plan = self.made.plan
        fallback = plan.names[plan.first_fallback :]
        acted = zip(ran.acted_names, ran.acted_steps)
        self.result.decisions += decisions
        self.result.fallbacks += sum(steps for name, steps in acted if name in fallback)
        self.result.interruptions += ran.status == OptionResult.STATUS_STOPPED_BY_PLAN


class PolicyServer:
    """
    Plays episodes by the newest plans, one policy at a time.

    Game begins the episodes, and option_server runs the options. Option values are sent to
    option_server when a policy needs them, and option_server decides which option acts. The
    execution can be changed here at any time, and takes effect from the next action on.
    """

    def __init__(self, node: NodeBase, group: CallbackGroup, state: PlannerState) -> None:
        self._node, self._state = node, state
        self._run: _PolicyRun | None = None
        self._published = ''  # plan_id of the newest OptionValues
        self._goals = node.stamped_publisher(PolicyGoal, 'policy_goals')
        self._results = node.stamped_publisher(PolicyResult, 'policy_results')
        self._values = node.stamped_publisher(OptionValues, 'option_values', LATCHED)
        self._executions = node.stamped_publisher(ExecutionState, 'execution', LATCHED)
        self._restarts = NodeRestarts(node)
        self._reset_client = node.recorded_client(ResetGame, 'reset_game', group)
        self._run_client = node.recorded_client(RunOption, 'run_option', group)
        node.recorded_action(RunPolicy, 'run_policy', self._execute, group, self._on_cancel)
        node.recorded_service(SetExecution, 'set_execution', self._on_set, group)

    @property
    def busy(self) -> bool:
        return self._run is not None

    def stop(self) -> None:
        """End the run, because the node ends."""
        if self._run is not None:
            self._publish_execution(self._run, canceled=True)

    async def _execute(self, handle: ServerGoalHandle) -> RunPolicy.Result:
        goal: RunPolicy.Goal = handle.request
        result = PolicyResult(
            action_set=goal.action_set, mean_return=math.nan, mean_discounted_return=math.nan
        )
        try:
            self._run = run = self._check(handle, goal, result)
            try:
                await self._play(run, goal)
                result.status = result.STATUS_DONE
            finally:
                self._run, result.execution = None, run.execution
        except _Ended as end:
            result.status, result.detail = end.status, end.detail
        except Exception as error:  # such as no memory for the values of so many states
            result.status, result.detail = result.STATUS_FAILED, repr(error)
        self._results.publish(result)
        canceled = result.status == PolicyResult.STATUS_CANCELED
        end_goal(handle, result.status == PolicyResult.STATUS_DONE, canceled)
        return RunPolicy.Result(result=result)

    def _check(
        self, handle: ServerGoalHandle, goal: RunPolicy.Goal, result: PolicyResult
    ) -> _PolicyRun:
        """
        Return the run of a goal.

        :raises _Ended: it cannot be played.
        """
        if self._run is not None:
            raise _Ended(result.STATUS_BUSY, 'a policy is running already')
        try:
            execution = execution_named(goal.execution)
        except RunError as error:
            raise _Ended(result.STATUS_BAD_REQUEST, str(error)) from error
        made = self._state.plans.get((goal.action_set, goal.participant))
        if made is None:
            text = f'there is no {goal.action_set!r} plan yet: plan it first'
            raise _Ended(result.STATUS_NO_PLAN, text)
        known = self._state.options(goal.action_set)
        if made.known_options is not known and goal.action_set != PRIMITIVE:
            text = 'the options changed since they were planned with: plan again'
            raise _Ended(result.STATUS_NO_PLAN, text)
        if goal.episodes == 0:
            raise _Ended(result.STATUS_BAD_REQUEST, 'episodes is 0')
        domain = made.plan.domain
        limit = goal.max_decisions or domain.max_steps
        if not limit:
            text = f'{domain.name} never cuts an episode off: give max_decisions'
            raise _Ended(result.STATUS_BAD_REQUEST, text)
        return _PolicyRun(handle, made, execution, result, limit)

    async def _play(self, run: _PolicyRun, goal: RunPolicy.Goal) -> None:
        """
        Play all episodes.

        :raises _Ended: the run ends before that.
        """
        result = run.result
        result.run_id = str(uuid.uuid4())
        self._goals.publish(
            PolicyGoal(
                run_id=result.run_id,
                plan_id=run.made.plan_id,
                action_set=goal.action_set,
                participant=goal.participant,
                episodes=goal.episodes,
                seed=goal.seed,
                max_decisions=run.limit,
                execution=run.execution,
            )
        )
        if run.execution is not Arbitration.RUN_TO_END:
            await self._publish_values(run.made)
        self._publish_execution(run)
        totals, discounted = [], []
        for number in range(goal.episodes):
            start = episode_start(run.made.plan.domain, goal.seed, number)
            returns = await self._play_episode(run, start, (goal.seed + number) % 2**64)
            totals.append(returns[0])
            discounted.append(returns[1])
            result.episodes += 1
            result.mean_return = math.fsum(totals) / len(totals)
            result.mean_discounted_return = math.fsum(discounted) / len(discounted)
            run.publish_feedback()

    async def _play_episode(self, run: _PolicyRun, start: Any, seed: int) -> tuple[float, float]:
        """
        Play an episode; return its return and its discounted return.

        :raises _Ended: the run ends before the episode does.
        """
        plan = run.made.plan
        episode = await self._reset(plan, start, seed)
        state, step, decided, total, discounted = start, 0, 0, 0.0, 0.0
        while decided < run.limit:
            self._check_wanted(run)
            modular = run.execution in MODULAR
            name = '' if modular else plan.choose(state).name
            ran = await self._run_option(run, name, run.limit - decided, episode, step)
            decisions = ran.step_count if modular else min(ran.step_count, 1)
            run.count(ran, decisions)
            decided += decisions
            total += ran.total_reward
            discounted += plan.gamma**step * ran.discounted_return
            step += ran.step_count
            if ran.status == OptionResult.STATUS_INTERRUPTED:
                raise _Ended(PolicyResult.STATUS_INTERRUPTED, ran.detail)
            if ran.status == OptionResult.STATUS_CANCELED:
                self._check_wanted(run)
            if ran.status not in _GO_ON:
                what = repr(name) if name else run.execution
                text = f'{what} in {ran.final_state!r}: {ran.detail}'
                raise _Ended(PolicyResult.STATUS_FAILED, text)
            if ran.terminated or ran.truncated:
                run.result.successes += ran.terminated
                break
            state = plan.domain.decode(ran.final_state)
        return total, discounted

    async def _reset(self, plan: AnyPlan, start: Any, seed: int) -> int:
        """
        Begin an episode; return its number.

        :raises _Ended: the game does not begin one.
        """
        request = ResetGame.Request(
            source=ResetGame.Request.SOURCE_MACHINE,
            start_state=plan.domain.encode(start),
            seed=seed,
        )
        answer = await self._node.answer(self._reset_client, request, _RESET_SECONDS)
        if answer is None:
            raise _Ended(PolicyResult.STATUS_FAILED, 'game did not answer reset_game')
        if answer.status == ResetGame.Response.STATUS_HELD_BY_PERSON:
            raise _Ended(PolicyResult.STATUS_INTERRUPTED, answer.detail)
        if answer.status != ResetGame.Response.STATUS_OK:
            text = f'game refused to begin an episode: {answer.detail}'
            raise _Ended(PolicyResult.STATUS_FAILED, text)
        return int(answer.episode)

    async def _run_option(
        self, run: _PolicyRun, name: str, left: int, episode: int, step: int
    ) -> OptionResult:
        """
        Run an option, or all of them as modules.

        :param name: of the option; empty: modules.
        :param left: largest number of steps of the modules.
        :raises _Ended: option_server does not answer.
        """
        request = RunOption.Request(
            option_name=name,
            participant=run.made.participant if name else '',
            max_steps=0 if name else left,
            episode=episode,
            step=step,
            execution=run.execution,
            plan_id=run.made.plan_id,
            execution_sequence=run.execution_sequence,
        )
        counts, server = self._restarts.counts, 'option_server'
        before = counts[server]
        answer = await self._node.answer(
            self._run_client, request, _RUN_SECONDS, lambda: counts[server] != before
        )
        if answer is None:
            what = 'was started again' if counts[server] != before else 'did not answer run_option'
            raise _Ended(PolicyResult.STATUS_FAILED, f'{server} {what}')
        result: OptionResult = answer.result
        return result

    def _check_wanted(self, run: _PolicyRun) -> None:
        """
        Check that the run is not canceled and the node goes on.

        :raises _Ended: it is canceled, or the node ends.
        """
        if run.canceled:
            raise _Ended(PolicyResult.STATUS_CANCELED, 'canceled by the client')
        if self._state.stopping:
            raise _Ended(PolicyResult.STATUS_FAILED, STOPS)

    async def _publish_values(self, made: MadePlan) -> None:
        """Send option_server the values for arbitration by a plan, unless it has them."""
        if self._published == made.plan_id:
            return
        plan = made.plan

        def compute() -> OptionValues:
            values = option_values(plan) if isinstance(plan, ExactPlan) else plan.policy.values
            return option_values_to_message(values, made.plan_id, made.participant)

        message = await in_thread(self._node, self._state.pool, compute)
        if self._published != made.plan_id:
            self._values.publish(message)
            self._published = made.plan_id

    def _publish_execution(
        self, run: _PolicyRun, previous: str = '', *, canceled: bool = False
    ) -> None:
        """Publish how the run is executed, or that it is to end at once."""
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
        """Stop the option or the modules that run, so that the run ends at once."""
        run = self._run
        if run is not None and run.handle is handle:
            run.canceled = True
            self._publish_execution(run, canceled=True)

    async def _on_set(
        self, request: SetExecution.Request, response: SetExecution.Response
    ) -> SetExecution.Response:
        """Change the execution of the run."""
        run = self._run
        try:
            if not request.execution:
                raise RunError('execution is empty')
            execution = execution_named(request.execution)
            if run is not None and execution is not Arbitration.RUN_TO_END:
                await self._publish_values(run.made)
        except RunError as error:
            response.status, response.detail = response.STATUS_BAD_REQUEST, str(error)
            return response
        except Exception as error:  # such as no memory for the values of so many states
            response.status, response.detail = response.STATUS_FAILED, repr(error)
            return response
        if run is None or self._run is not run:
            response.status = response.STATUS_NO_RUN
            response.detail = 'no policy runs: name the execution in the goal of run_policy'
            return response
        response.status, response.previous = response.STATUS_OK, run.execution
        if run.execution is not execution:
            previous, run.execution = run.execution, execution
            run.result.execution_changes += 1
            self._publish_execution(run, previous)
        return response
