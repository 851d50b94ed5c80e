"""Running the policies of plans: the action run_policy, and changes of its execution."""

from dataclasses import dataclass
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import (
    ExecutionState,
    OptionResult,
    OptionValues,
    PolicyGoal,
    PolicyResult,
)
from humanopts_interfaces.srv import ResetGame, RunOption, SetExecution
from humanopts_learner.planning.exact_plan import episode_start, ExactPlan
from humanopts_learner.planning.interruption import option_values
from humanopts_learner.planning.request import Arbitration, MODULAR, PlanCanceled, PRIMITIVE
from humanopts_learner.ros.convert import option_values_to_message
from humanopts_learner.ros.planner_actions import (
    GoalError,
    GoalServer,
    in_thread,
    MadePlan,
    PlannerState,
)
from humanopts_learner.run import execution_named, RefusedError, RunStatus
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED
from rclpy.action.server import ServerGoalHandle

_RESET_SECONDS = 5.0  # s to wait for an answer
# Timeout of a run: modules may run for a whole paced episode. The server itself uses a short
# timeout for the game.
_RUN_SECONDS = 86_400.0
_CONTINUES = (
    OptionResult.STATUS_REACHED,
    OptionResult.STATUS_EPISODE_OVER,
    OptionResult.STATUS_MAX_STEPS,
    OptionResult.STATUS_STOPPED_BY_PLAN,
    OptionResult.STATUS_EXECUTION_CHANGED,
)


@dataclass
class _PolicyRun:
    """The current policy run."""

    handle: ServerGoalHandle
    made: MadePlan
    execution: Arbitration
    result: PolicyResult
    limit: int  # maximum number of decisions per episode
    execution_sequence: int = 0  # of the current ExecutionState


class PolicyServer(GoalServer):
    """
    Plays episodes by the newest plans, one policy at a time.

    ``game`` begins the episodes, and ``option_server`` runs the options. Option values are sent to
    ``option_server`` when a policy needs them, so that it can decide which option acts. The
    execution can be changed at any time, and takes effect with the next action.
    """

    kind, name, topics = RunPolicy, 'run_policy', 'policy'
    goal_kind, result_kind, occupation = PolicyGoal, PolicyResult, 'policy run'

    def __init__(self, node: NodeBase, state: PlannerState) -> None:
        super().__init__(node, state)
        self._run: _PolicyRun | None = None
        self._published = ''  # plan_id of the newest OptionValues
        self._values = node.stamped_publisher(OptionValues, 'option_values', LATCHED)
        self._executions = node.stamped_publisher(ExecutionState, 'execution', LATCHED)
        self._peers = node.peers
        self._reset_client = node.recorded_client(ResetGame, 'reset_game')
        self._run_client = node.recorded_client(RunOption, 'run_option')
        node.recorded_service(SetExecution, 'set_execution', self._on_set)

    def stop(self) -> None:
        """End the run on shutdown."""
        if self._run is not None:
            self._publish_execution(self._run, canceled=True)

    def blank(self, goal: RunPolicy.Goal) -> PolicyResult:
        return PolicyResult(
            action_set=goal.action_set, mean_return=math.nan, mean_discounted_return=math.nan
        )

    async def work(
        self, handle: ServerGoalHandle, domain: Domain, result: PolicyResult
    ) -> PolicyResult:
        goal = handle.request
        execution = execution_named(goal.execution)
        made = self._state.plans.get((goal.action_set, goal.participant))
        if made is None:
            raise GoalError('NO_PLAN', f'no {goal.action_set!r} plan exists yet: plan it first')
        known = self._state.options(goal.action_set)
        if made.known_options is not known and goal.action_set != PRIMITIVE:
            text = 'the options changed since they were planned with: plan again'
            raise GoalError('NO_PLAN', text)
        limit = goal.max_decisions or domain.max_steps
        if not (goal.episodes and limit):
            text = f'{domain.name} never cuts an episode off: give max_decisions'
            raise GoalError('BAD_REQUEST', text if goal.episodes else 'episodes is 0')
        self._run = run = _PolicyRun(handle, made, execution, result, limit)
        log, policy = self._node.get_logger(), f'the policy over {goal.action_set}'
        log.info(f'{policy} begins: episodes 1 to {goal.episodes}, {execution}')
        try:
            await self._play(run, goal)
        finally:
            self._run, result.execution = None, run.execution
            log.info(f'{policy} ended after {result.episodes} of {goal.episodes} episodes')
        result.status = result.STATUS_DONE
        return result

    async def _play(self, run: _PolicyRun, goal: RunPolicy.Goal) -> None:
        """
        Play all episodes.

        :raises GoalError: the run ends early.
        """
        result = run.result
        result.run_id = run.handle.goal_id
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
            run.handle.publish_feedback(
                RunPolicy.Feedback(
                    episodes=result.episodes,
                    successes=result.successes,
                    fallbacks=result.fallbacks,
                    mean_return=result.mean_return,
                    interruptions=result.interruptions,
                    execution=run.execution,
                )
            )

    async def _play_episode(self, run: _PolicyRun, start: Any, seed: int) -> tuple[float, float]:
        """
        Play an episode, and return its undiscounted and discounted return.

        :raises GoalError: or PlanCanceled: the run ends before the episode.
        """
        plan, result = run.made.plan, run.result
        begin = ResetGame.Request(
            source=ResetGame.Request.SOURCE_MACHINE,
            start_state=plan.domain.encode(start),
            seed=seed,
        )
        begun = await self._node.waiting.answer(self._reset_client, begin, _RESET_SECONDS)
        if begun is None:
            raise GoalError('FAILED', 'game did not answer reset_game')
        if begun.status == begun.STATUS_HELD_BY_PERSON:
            raise GoalError('INTERRUPTED', begun.detail)
        if begun.status != begun.STATUS_OK:
            raise GoalError('FAILED', f'game refused to begin an episode: {begun.detail}')
        state, step, decided, total, discounted = start, 0, 0, 0.0, 0.0
        while decided < run.limit:
            self._check_request(run)
            modular = run.execution in MODULAR
            name = '' if modular else plan.choose(state).name
            ran = await self._run_option(
                RunOption.Request(
                    option_name=name,
                    participant=run.made.participant if name else '',
                    max_steps=0 if name else run.limit - decided,
                    episode=begun.episode,
                    step=step,
                    execution=run.execution,
                    plan_id=run.made.plan_id,
                    execution_sequence=run.execution_sequence,
                )
            )
            decisions = ran.step_count if modular else min(ran.step_count, 1)
            decided += decisions
            result.decisions += decisions
            fallback, acted = (
                plan.names[plan.first_fallback :],
                zip(ran.acted_names, ran.acted_steps),
            )
            result.fallbacks += sum(steps for each, steps in acted if each in fallback)
            result.random_moves += ran.random_moves
            result.interruptions += ran.status == ran.STATUS_STOPPED_BY_PLAN
            total += ran.total_reward
            discounted += plan.gamma**step * ran.discounted_return
            step += ran.step_count
            if ran.status == ran.STATUS_INTERRUPTED:
                raise GoalError('INTERRUPTED', ran.detail)
            if ran.status not in _CONTINUES:
                self._check_request(run)
                what = repr(name) if name else run.execution
                raise GoalError('FAILED', f'{what} in {ran.final_state!r}: {ran.detail}')
            if ran.terminated or ran.truncated:
                result.successes += ran.terminated
                break
            state = plan.domain.decode(ran.final_state)
        return total, discounted

    async def _run_option(self, request: RunOption.Request) -> OptionResult:
        """
        Run an option, or all of them as modules.

        :raises GoalError: option_server does not answer.
        """
        counts, server = self._peers.restarts, 'option_server'
        before = counts[server]
        answer = await self._node.waiting.answer(
            self._run_client, request, _RUN_SECONDS, lambda: counts[server] != before
        )
        if answer is None:
            what = 'was started again' if counts[server] != before else 'did not answer run_option'
            raise GoalError('FAILED', f'{server} {what}')
        result: OptionResult = answer.result
        return result

    def _check_request(self, run: _PolicyRun) -> None:
        """
        Check that the run should continue.

        :raises PlanCanceled: the client has canceled it, or the node is shutting down.
        """
        if run.handle.is_cancel_requested or self._state.stopping:
            raise PlanCanceled

    async def _publish_values(self, made: MadePlan) -> None:
        """Send the values for arbitration to ``option_server``, unless it has them."""
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
        """Publish the execution of the run, or its cancellation."""
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

    def on_cancel(self, handle: ServerGoalHandle) -> None:
        """Stop the running option or modules, so that the policy run ends immediately."""
        if self._run is not None and self._run.handle is handle:
            self._publish_execution(self._run, canceled=True)

    async def _on_set(
        self, request: SetExecution.Request, response: SetExecution.Response
    ) -> SetExecution.Response:
        """Change the execution of the run."""
        run = self._run
        try:
            if not request.execution:
                raise RefusedError(RunStatus.BAD_REQUEST, 'execution is empty')
            execution = execution_named(request.execution)
            if run is not None and execution is not Arbitration.RUN_TO_END:
                await self._publish_values(run.made)
        except RefusedError as error:
            response.status, response.detail = response.STATUS_BAD_REQUEST, str(error)
            return response
        except Exception as error:  # such as insufficient memory for the values
            response.status, response.detail = response.STATUS_FAILED, repr(error)
            return response
        if run is None or self._run is not run:
            response.status = response.STATUS_NO_RUN
            response.detail = 'no policy runs: name the execution in the goal of run_policy'
            return response
        response.status, response.previous = response.STATUS_OK, run.execution
        if run.execution is not execution:
            run.execution = execution
            run.result.execution_changes += 1
            self._publish_execution(run, response.previous)
        return response
