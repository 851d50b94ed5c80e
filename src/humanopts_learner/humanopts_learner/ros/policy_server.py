"""Running the policies of plans: the action run_policy, and changes of its execution."""

from dataclasses import dataclass, field, replace
import math
import uuid

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate
from humanopts_env.seeding import generator
from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import (
    ExecutionState,
    OptionResult,
    OptionValues,
    PolicyGoal,
    PolicyResult,
)
from humanopts_interfaces.srv import ResetGame, RunOption, SetExecution
from humanopts_learner.option_runs import uuid_of
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.exact_plan import episode_start, ExactPlan
from humanopts_learner.planning.interruption import option_values
from humanopts_learner.planning.recorded_plan import (
    check_learning,
    DEFAULT_RATES,
    make_recorded_plan,
    OptionLearner,
    RecordedPlan,
)
from humanopts_learner.planning.request import (
    Arbitration,
    MODULAR,
    PlanCanceled,
    PlanRequest,
    PRIMITIVE,
    select_options,
)
from humanopts_learner.planning.sampled_plan import SampledPlan
from humanopts_learner.qlearning import Rates
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
import numpy as np
from rclpy.action.server import ServerGoalHandle

_RESET_SECONDS = 5.0  # s to wait for the answer of reset_game
# Timeout of a run: modules may run for a whole paced episode. The server itself uses a short
# timeout for the game.
_RUN_SECONDS = 86_400.0
_ARRIVAL = 5.0  # s to wait for a state and for a recorded run
_TO_THE_END = 'learning needs the execution run_to_end'
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
    explore: float  # share of random choices; unused while learning
    learning: '_Learning | None'  # chooses the options; None: the plan does
    execution_sequence: int = 0  # sequence of the current ExecutionState


@dataclass
class _Learning:
    """Q-learning in a policy run."""

    domain: ActableDomain
    options: list[LearnedOption]
    request: PlanRequest
    learner: OptionLearner
    rates: Rates
    plan_id: str  # id of the plan that follows the values
    participant: str
    known_options: list[LearnedOption]  # as in ``MadePlan``
    made: MadePlan = field(init=False)  # plan that follows the initial values


class PolicyServer(GoalServer):
    """
    Plays episodes with the newest plans, one policy at a time.

    ``game`` begins the episodes, and ``option_server`` runs the options. If a policy needs option
    values, they are sent to ``option_server``, which decides with them which option acts. The
    execution can be changed at any time; the change takes effect with the next action.
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
        self, handle: ServerGoalHandle, domain: ActableDomain, result: PolicyResult
    ) -> PolicyResult:
        goal = handle.request
        execution = execution_named(goal.execution)
        check_learning(goal.learning, domain)
        if goal.learning and execution is not Arbitration.RUN_TO_END:
            raise GoalError('BAD_REQUEST', _TO_THE_END)
        limit = goal.max_decisions or domain.max_steps
        if not (goal.episodes and limit):
            text = f'{domain.name} has no step limit: give max_decisions'
            raise GoalError('BAD_REQUEST', text if goal.episodes else 'episodes is 0')
        if not 0.0 <= goal.explore <= 1.0:
            raise GoalError('BAD_REQUEST', f'explore is {goal.explore}, not from 0 to 1')
        learning = await self._begin_learning(goal, domain) if goal.learning else None
        made = learning.made if learning else self._newest_plan(goal)
        if goal.explore and not isinstance(made.plan, SampledPlan):
            raise GoalError('BAD_REQUEST', 'explore needs a plan over abstract states')
        self._run = run = _PolicyRun(
            handle, made, execution, result, limit, goal.explore, learning
        )
        log, policy = self._node.get_logger(), f'the policy over {goal.action_set}'
        log.info(f'{policy} begins: episodes 1 to {goal.episodes}, {execution}')
        try:
            await self._play(run, goal)
        finally:
            self._run, result.execution = None, run.execution
            log.info(f'{policy} ended after {result.episodes} of {goal.episodes} episodes')
            if learning is not None and not self._state.stopping:
                made = await self._plan_of(learning)
                self._state.plans[goal.action_set, goal.participant] = made
                result.n_states = len(made.plan.solution.values)
        result.status = result.STATUS_DONE
        return result

    async def _begin_learning(self, goal: RunPolicy.Goal, domain: ActableDomain) -> '_Learning':
        """
        Return a learner trained on all recorded runs, and a plan by its values.

        :raises PlanError: the action set and the options do not fit, or a number is out of range.
        """
        known = self._state.options(goal.action_set)
        options = select_options(known, goal.action_set, goal.participant, goal.options)
        columns, unstick = tuple(goal.columns), self._state.unstick
        request = PlanRequest(goal.action_set, columns=columns, unstick=unstick)
        usual = DEFAULT_RATES
        rates = replace(
            usual,
            learning_rate=goal.learning_rate or usual.learning_rate,
            explore=goal.explore or usual.explore,
        )
        runs = list(self._state.recorder.runs)

        def replay() -> OptionLearner:
            return OptionLearner.of(domain, options, runs, request, rates)

        learner = await in_thread(self._node, self._state.pool, replay)
        parts = str(uuid.uuid4()), goal.participant, known
        learning = _Learning(domain, options, request, learner, rates, *parts)
        learning.made = await self._plan_of(learning)
        return learning

    async def _plan_of(self, learning: '_Learning') -> MadePlan:
        runs = list(self._state.recorder.runs)
        parts = learning.domain, learning.options, runs, learning.request, learning.learner

        def compute() -> RecordedPlan:
            return make_recorded_plan(*parts)

        plan = await in_thread(self._node, self._state.pool, compute)
        return MadePlan(plan, learning.plan_id, learning.participant, learning.known_options)

    def _newest_plan(self, goal: RunPolicy.Goal) -> MadePlan:
        """
        Return the plan to follow.

        :raises GoalError: there is no plan, or its options have changed.
        """
        made = self._state.plans.get((goal.action_set, goal.participant))
        if made is None:
            raise GoalError('NO_PLAN', f'no {goal.action_set!r} plan exists yet: plan it first')
        known = self._state.options(goal.action_set)
        if made.known_options is not known and goal.action_set != PRIMITIVE:
            text = 'the options have changed since the last planning: plan again'
            raise GoalError('NO_PLAN', text)
        return made

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
                learning=goal.learning,
                explore=run.learning.rates.explore if run.learning else goal.explore,
                learning_rate=run.learning.rates.learning_rate if run.learning else 0.0,
                options=[option.name for option in run.learning.options] if run.learning else [],
                columns=goal.columns,
            )
        )
        if run.execution is not Arbitration.RUN_TO_END:
            await self._publish_values(run.made)
        self._publish_execution(run)
        totals, discounted = [], []
        for number in range(goal.episodes):
            returns = await self._play_episode(run, goal, number)
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
                    learned_runs=result.learned_runs,
                    n_states=result.n_states,
                )
            )

    async def _play_episode(
        self, run: _PolicyRun, goal: RunPolicy.Goal, number: int
    ) -> tuple[float, float]:
        """
        Play an episode, and return its undiscounted and discounted return.

        :param number: number of the episode, from 0.
        :raises GoalError: or PlanCanceled: the run ends before the episode does.
        """
        plan, result, domain = run.made.plan, run.result, run.made.plan.domain
        start = episode_start(domain, goal.seed, number) if can_simulate(domain) else None
        rng = generator(goal.seed, 'explore', number)
        begin = ResetGame.Request(
            source=ResetGame.Request.SOURCE_MACHINE,
            start_state='' if start is None else domain.encode(start),
            seed=(goal.seed + number) % 2**64,
        )
        begun = await self._node.waiting.answer(self._reset_client, begin, _RESET_SECONDS)
        if begun is None:
            raise GoalError('FAILED', 'game did not answer reset_game')
        if begun.status == begun.STATUS_HELD_BY_PERSON:
            raise GoalError('INTERRUPTED', begun.detail)
        if begun.status != begun.STATUS_OK:
            raise GoalError('FAILED', f'game refused to begin an episode: {begun.detail}')
        state, step, decided, total, discounted = begun.state, 0, 0, 0.0, 0.0
        while decided < run.limit:
            self._check_request(run)
            modular = run.execution in MODULAR
            name = '' if modular else await self._choose(run, state, (begun.episode, step), rng)
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
            if run.learning is not None and ran.step_count:
                await self._learn(run.learning.learner, uuid_of(ran.run_id), result)
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
            state = ran.final_state
        return total, discounted

    async def _choose(
        self, run: _PolicyRun, text: str, here: tuple[int, int], rng: np.random.Generator
    ) -> str:
        """
        Return the name of the next option.

        :param text: state in the domain's notation.
        :param here: episode and step of the state.
        :raises GoalError: the state has not arrived.
        """
        plan, recorder = run.made.plan, self._state.recorder
        if can_simulate(plan.domain):
            state = plan.domain.decode(text)
        else:  # only the message of the state contains its features

            def has_arrived() -> bool:
                newest = recorder.newest
                return newest is not None and here <= (
                    newest.transition.episode,
                    newest.transition.step,
                )

            if not await self._node.waiting.until(has_arrived, _ARRIVAL):
                raise GoalError('FAILED', f'episode {here[0]} step {here[1]} did not arrive')
            assert recorder.newest is not None
            state = recorder.newest.state
        if run.learning is not None:
            return run.learning.learner.choose(state, rng).name
        if isinstance(plan, SampledPlan) and rng.random() < run.explore:
            return plan.names[int(plan.actions.observe_state(state).at_random(rng)[0])]
        return plan.choose(state).name

    async def _learn(self, learner: OptionLearner, run_id: str, result: PolicyResult) -> None:
        """Update the values with a run, once it is recorded."""
        recorder = self._state.recorder

        def is_recorded() -> bool:
            return bool(recorder.runs) and recorder.runs[-1].run_id == run_id

        if await self._node.waiting.until(is_recorded, _ARRIVAL):
            learner.learn(recorder.runs[-1])
            result.learned_runs, result.n_states = learner.runs, len(learner.table.visits)
        else:
            self._node.get_logger().warning(f'nothing is learned from run {run_id}: it was lost')

    async def _run_option(self, request: RunOption.Request) -> OptionResult:
        """
        Run an option, or all options as modules.

        :raises GoalError: ``option_server`` does not answer, or was restarted.
        """
        counts, server = self._peers.restarts, 'option_server'
        before = counts[server]
        answer = await self._node.waiting.answer(
            self._run_client, request, _RUN_SECONDS, lambda: counts[server] != before
        )
        if answer is None:
            what = 'was restarted' if counts[server] != before else 'did not answer run_option'
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
        """Send the values for arbitration to ``option_server``, unless it already has them."""
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
        if run is not None and run.learning is not None and execution is not run.execution:
            response.status, response.detail = response.STATUS_BAD_REQUEST, _TO_THE_END
            return response
        if run is None or self._run is not run:
            response.status = response.STATUS_NO_RUN
            response.detail = 'no policy is running: set the execution in the goal of run_policy'
            return response
        response.status, response.previous = response.STATUS_OK, run.execution
        if run.execution is not execution:
            run.execution = execution
            run.result.execution_changes += 1
            self._publish_execution(run, response.previous)
        return response
