"""The action servers of ``planner``: common base, planning, and search for options."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
import math
import time
from typing import Any, TypeVar
import uuid

from humanopts_env.domains.base import ActableDomain, DomainError
from humanopts_env.domains.described import can_simulate, simulated
from humanopts_interfaces.action import ExtractOptions, Plan
from humanopts_interfaces.msg import (
    ExtractionGoal,
    ExtractionResult,
    PlanGoal,
    PlanResult,
)
from humanopts_learner.automatic.extract import (
    AutomaticOptions,
    check_participant,
    find_options,
    to_learned_options,
)
from humanopts_learner.automatic.subgoals import Extraction, USUAL
from humanopts_learner.demonstrations import MACHINE
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.exact_plan import ExactPlan, find_coverage
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan
from humanopts_learner.planning.recorded_plan import (
    check_learning,
    make_recorded_plan,
    MIN_SAMPLES,
    OptionLearner,
)
from humanopts_learner.planning.request import (
    NoOptionsError,
    OF_MACHINES,
    OPTIONS_ONLY,
    PlanCanceled,
    PlanError,
    PlanRequest,
    Q,
    Sampling,
    select_options,
)
from humanopts_learner.planning.sampled_plan import SampledPlan
from humanopts_learner.planning.stuck import Trial, try_plan
from humanopts_learner.ros.convert import PLAN_RESULT, plan_to_message
from humanopts_learner.ros.learned_options import OptionPublisher
from humanopts_learner.ros.run_recorder import RunRecorder
from humanopts_learner.summary import PlanSummary
from humanopts_ros.node_base import end_goal, NodeBase
from rclpy.action.server import ServerGoalHandle

_OPTIONS_SECONDS = 5.0  # s to wait for the options of a request
_FEEDBACK_PERIOD = 0.1  # s between feedback messages
T = TypeVar('T')


@dataclass(frozen=True)
class MadePlan:
    """A plan, and the options from which it was made."""

    plan: AnyPlan
    plan_id: str
    participant: str  # as requested
    known_options: list[LearnedOption]


@dataclass
class PlannerState:
    """The state of the planner; lists of options are replaced, never modified."""

    recorder: RunRecorder
    unstick: bool  # as in ``PlanRequest``
    domain: ActableDomain | None = None
    taught: list[LearnedOption] = field(default_factory=list)
    taught_sequence: int = 0  # sequence of the message that completed the taught options
    automatic: list[LearnedOption] = field(default_factory=list)
    plans: dict[tuple[str, str], MadePlan] = field(default_factory=dict)  # by set and participant
    pool: ThreadPoolExecutor = field(default_factory=ThreadPoolExecutor)  # for long computations
    stopping: bool = False  # set on shutdown

    def options(self, action_set: str) -> list[LearnedOption]:
        """Return the options of an action set, in a new list whenever they change."""
        return self.automatic if action_set in OF_MACHINES else self.taught


async def in_thread(node: NodeBase, pool: ThreadPoolExecutor, work: Callable[[], T]) -> T:
    """Run a function in a worker thread, and return its result or raise its exception."""
    executor, task = node.executor, pool.submit(work)
    assert executor is not None, 'a callback of the node waits for this'
    task.add_done_callback(lambda _: executor.create_task(node.waiting.check))
    await node.waiting.until(task.done, math.inf)
    return task.result()


class GoalError(Exception):
    """A goal ended early; ``status`` is the name of a STATUS constant of the result."""

    def __init__(self, status: str, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class GoalServer(ABC):
    """
    An action server for one goal at a time; publishes goals, and results even if refused.

    :ivar busy: whether a goal is being executed.
    """

    kind: Any  # type of the action
    name: str  # name of the action
    topics: str  # common prefix of the topics for goals and results
    goal_kind: Any  # message type of the topic for goals
    result_kind: Any  # message type of the topic for results
    occupation: str  # noun in "the planner is at work on another ..."

    def __init__(self, node: NodeBase, state: PlannerState) -> None:
        self.busy = False
        self._node, self._state = node, state
        self._goals = node.stamped_publisher(self.goal_kind, f'{self.topics}_goals')
        self._results = node.stamped_publisher(self.result_kind, f'{self.topics}_results')
        node.recorded_action(self.kind, self.name, self._execute, self.on_cancel)

    @abstractmethod
    def blank(self, goal: Any) -> Any:
        """Return an empty result for a refused goal."""

    @abstractmethod
    async def work(self, handle: ServerGoalHandle, domain: ActableDomain, result: Any) -> Any:
        """
        Execute a goal, and return its result.

        :param result: result of ``blank``, to be filled in; also used if an error is raised.
        :raises GoalError: the goal ends early. PlanError, DomainError: it cannot be executed.
        """

    def on_cancel(self, handle: ServerGoalHandle) -> None:  # noqa: B027 - an optional hook
        """Handle a cancel request, just before the goal state becomes canceling."""

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        result, status = self.blank(handle.request), ''
        try:
            result = await self._carry_out(handle, result)
        except GoalError as error:
            status, result.detail = error.status, str(error)
        except NoOptionsError as error:
            status = 'NO_OPTIONS' if hasattr(result, 'STATUS_NO_OPTIONS') else 'BAD_REQUEST'
            result.detail = str(error)
        except (PlanError, DomainError) as error:
            status, result.detail = 'BAD_REQUEST', str(error)
        except PlanCanceled:
            status, result.detail = 'CANCELED', 'canceled by the client'
            if self._state.stopping:
                status, result.detail = 'FAILED', 'the planner is stopping'
        except Exception as error:  # such as insufficient memory for the tables
            status, result.detail = 'FAILED', repr(error)
        if status:
            result.status = getattr(result, f'STATUS_{status}')
        self._results.publish(result)
        self._node.get_logger().info(f'{self.occupation}: {result.detail or "done"}')
        end_goal(handle, not status, status == 'CANCELED')
        return self.kind.Result(result=result)

    async def _carry_out(self, handle: ServerGoalHandle, result: Any) -> Any:
        await self._node.provided()
        if self.busy:
            raise GoalError('BUSY', f'the planner is at work on another {self.occupation}')
        if self._state.domain is None:
            raise GoalError('FAILED', 'game has not announced itself')
        self.busy = True
        try:
            return await self.work(handle, self._state.domain, result)
        finally:
            self.busy = False

    def progress(self, handle: ServerGoalHandle, *measured: str) -> Callable[..., None]:
        """
        Return a function that publishes feedback at the start of a stage and periodically.

        :param measured: feedback fields that follow the stage.
        """
        known, due = '', 0.0

        def progress(stage: str, *numbers: Any) -> None:
            nonlocal known, due
            if handle.is_cancel_requested or self._state.stopping:
                raise PlanCanceled
            now = time.monotonic()
            if stage != known or now >= due:
                known, due = stage, now + _FEEDBACK_PERIOD
                values = dict(zip(measured, numbers, strict=True))
                handle.publish_feedback(self.kind.Feedback(stage=stage, **values))

        return progress


class PlanServer(GoalServer):
    """Plans with an action set, and evaluates the plan if the goal has episodes."""

    kind, name, topics = Plan, 'plan', 'plan'
    goal_kind, result_kind, occupation = PlanGoal, PlanResult, 'plan'

    def blank(self, goal: Plan.Goal) -> PlanResult:
        return PLAN_RESULT.encode(PlanSummary(goal.action_set))

    async def work(
        self, handle: ServerGoalHandle, domain: ActableDomain, result: PlanResult
    ) -> PlanResult:
        goal, state = handle.request, self._state
        sequence, recorded = goal.options_sequence, not can_simulate(domain)
        await self._node.waiting.until(lambda: state.taught_sequence >= sequence, _OPTIONS_SECONDS)
        if state.taught_sequence < sequence:
            raise PlanError(
                f'learned_options {sequence} did not arrive, only {state.taught_sequence}'
            )
        check_learning(goal.learning, domain)
        known = state.options(goal.action_set)
        options = select_options(known, goal.action_set, goal.participant, goal.options)
        runs = list(state.recorder.runs)
        game_steps = 0 if recorded else goal.game_steps
        numbers = goal.gamma, goal.tolerance, goal.max_sweeps, game_steps, goal.seed
        least = goal.min_samples or (MIN_SAMPLES if recorded else 1)
        request = PlanRequest(
            goal.action_set,
            *numbers,
            sampling=Sampling(min_samples=least),
            columns=tuple(goal.columns),
            unstick=state.unstick,
        )
        request = request.resolved(domain, options, sampled=True if recorded else None)
        if recorded:
            request = replace(request, game_steps=sum(len(run.actions) for run in runs))
        result.plan_id = plan_id = str(uuid.uuid4())
        self._goals.publish(
            PlanGoal(
                plan_id=plan_id,
                action_set=request.action_set,
                participant=goal.participant,
                options=[option.name for option in options],
                gamma=request.gamma,
                tolerance=request.tol,
                max_sweeps=request.max_sweeps,
                game_steps=request.game_steps,
                columns=request.columns,
                min_samples=least if request.game_steps else 0,
                learning=goal.learning,
                evaluation_episodes=0 if recorded else goal.evaluation_episodes,
                seed=request.seed,
            )
        )
        progress = self.progress(handle, 'progress', 'sweeps', 'residual')

        def compute() -> tuple[AnyPlan, PlanResult]:
            performance, coverage, trial = None, None, Trial()
            if can_simulate(domain):
                plan = make_plan(domain, options, request, progress)
            else:
                q = goal.learning == Q
                learner = OptionLearner.of(domain, options, runs, request) if q else None
                plan = make_recorded_plan(domain, options, runs, request, learner, progress)
            if goal.evaluation_episodes and not recorded:
                performance = judge_plan(plan, goal.seed, goal.evaluation_episodes, progress)
            if isinstance(plan, ExactPlan) and goal.action_set in OPTIONS_ONLY:
                coverage = find_coverage(plan) if domain.max_steps else None
            if isinstance(plan, SampledPlan) and can_simulate(domain):
                trial = try_plan(plan, goal.seed, progress)
            parts = plan_id, goal.participant, performance, coverage, trial
            return plan, plan_to_message(plan, *parts)

        plan, answer = await in_thread(self._node, state.pool, compute)
        made = MadePlan(plan, plan_id, goal.participant, known)
        state.plans[goal.action_set, goal.participant] = made
        return answer


class ExtractionServer(GoalServer):
    """Searches for options; new options replace older ones of the same participant."""

    kind, name, topics = ExtractOptions, 'extract_options', 'extraction'
    goal_kind, result_kind = ExtractionGoal, ExtractionResult
    occupation = 'search for options'

    def __init__(self, node: NodeBase, state: PlannerState) -> None:
        super().__init__(node, state)
        self._found = OptionPublisher(node, 'automatic_options')

    def blank(self, goal: ExtractOptions.Goal) -> ExtractionResult:
        return ExtractionResult(participant=goal.participant or f'{MACHINE}1')

    async def work(
        self, handle: ServerGoalHandle, domain: ActableDomain, result: ExtractionResult
    ) -> ExtractionResult:
        rules = simulated(domain, f'a {self.occupation}')
        goal, participant = handle.request, result.participant
        how = Extraction(
            options=goal.max_options or USUAL.options,
            tasks=goal.tasks or USUAL.tasks,
            train_episodes=goal.task_episodes or USUAL.train_episodes,
            option_episodes=goal.option_episodes or USUAL.option_episodes,
        )
        check_participant(participant)
        result.extraction_id = str(uuid.uuid4())
        self._goals.publish(
            ExtractionGoal(
                extraction_id=result.extraction_id,
                participant=participant,
                max_options=how.options,
                tasks=how.tasks,
                task_episodes=how.train_episodes,
                option_episodes=how.option_episodes,
                seed=goal.seed,
            )
        )
        progress = self.progress(handle, 'progress', 'game_steps')

        def search() -> tuple[AutomaticOptions, list[LearnedOption]]:
            found = find_options(rules, goal.seed, how, progress)
            return found, to_learned_options(rules, found, participant)

        found, options = await in_thread(self._node, self._state.pool, search)
        others = [o for o in self._state.automatic if o.participant != participant]
        self._state.automatic = known = [*others, *options]
        self._found.publish({(o.participant, o.name): option_to_json(o) for o in known})
        result.status = result.STATUS_DONE
        result.option_names = [option.name for option in options]
        result.reaches = [option.reaches for option in found.options]
        result.seconds, result.game_steps = found.seconds, found.game_steps
        result.episodes, result.solved = found.episodes, found.solved
        return result
