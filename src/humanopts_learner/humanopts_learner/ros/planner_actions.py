"""The planner's actions with long computations, in worker threads: plan and extract_options."""

from abc import ABC, abstractmethod
from collections.abc import Callable
import concurrent.futures
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
import time
from typing import Any, Generic, TypeVar
import uuid

from humanopts_env.domains.base import ActableDomain, Domain, DomainError
from humanopts_env.domains.described import simulated
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
from humanopts_learner.planning.evaluate import Coverage, find_coverage
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan, Performance
from humanopts_learner.planning.request import (
    NoOptionsError,
    OF_MACHINES,
    OPTIONS_ONLY,
    PlanCanceled,
    PlanError,
    PlanRequest,
    select_options,
)
from humanopts_learner.ros.convert import (
    plan_goal_to_message,
    plan_to_message,
    refused_plan,
)
from humanopts_learner.ros.learned_options import OptionPublisher
from humanopts_ros.node_base import end_goal, NodeBase
from humanopts_ros.publisher import StampedPublisher
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.task import Future

STOPS = 'the planner stops'
_OPTIONS_SECONDS = 5.0  # s to wait for the options of a request
_FEEDBACK_PERIOD = 0.1  # s
T = TypeVar('T')
ResultT = TypeVar('ResultT', PlanResult, ExtractionResult)


@dataclass(frozen=True)
class MadePlan:
    """A plan, and the options from which it was made."""

    plan: AnyPlan
    plan_id: str
    participant: str  # the request that it answers
    known_options: list[LearnedOption]


@dataclass
class PlannerState:
    """The state of the planner; a list of options is replaced, never changed."""

    domain: ActableDomain | None = None
    taught: list[LearnedOption] = field(default_factory=list)
    taught_sequence: int = 0  # of the message that completed them
    automatic: list[LearnedOption] = field(default_factory=list)
    plans: dict[tuple[str, str], MadePlan] = field(default_factory=dict)  # set, participant
    pool: ThreadPoolExecutor = field(default_factory=ThreadPoolExecutor)  # for long work
    stopping: bool = False  # set when the node ends

    def options(self, action_set: str) -> list[LearnedOption]:
        """Return the options of an action set; a new list whenever they change."""
        return self.automatic if action_set in OF_MACHINES else self.taught


async def in_thread(node: NodeBase, pool: ThreadPoolExecutor, work: Callable[[], T]) -> T:
    """Run a function in a worker thread; return its result or raise its error."""
    executor = node.executor
    assert executor is not None, 'a callback of the node waits for this'
    done = Future(executor=executor)

    def wake(task: concurrent.futures.Future[T]) -> None:
        done.set_result(task)
        executor.wake()

    pool.submit(work).add_done_callback(wake)
    task: concurrent.futures.Future[T] = await done
    return task.result()


class LongAction(ABC, Generic[ResultT]):
    """
    An action with long computations, one goal at a time.

    :ivar busy: whether a goal is executed.
    """

    kind: Any  # type of the action
    name: str  # of the action
    topics: str  # how the names of its topics of goals and results begin
    goal_kind: Any  # type of the messages on these topics, as ``result_kind``
    result_kind: type[ResultT]
    measured: tuple[str, ...]  # fields of the feedback, after its stage
    goal_noun: str  # of "the planner is at work on another ..."
    good: tuple[int, ...]  # statuses with which a goal succeeds

    def __init__(self, node: NodeBase, group: CallbackGroup, state: PlannerState) -> None:
        """Serve the action; the results of all goals are published, also of refused ones."""
        self.busy = False
        self._node, self._state = node, state
        self._goals = node.stamped_publisher(self.goal_kind, f'{self.topics}_goals')
        results = node.stamped_publisher(self.result_kind, f'{self.topics}_results')
        self._results: StampedPublisher[ResultT] = results
        node.recorded_action(self.kind, self.name, self._execute, group)

    @abstractmethod
    def blank(self, goal: Any) -> ResultT:
        """Return an empty result; status and detail are left to the caller."""

    @abstractmethod
    async def work(
        self,
        domain: Domain[Any],
        goal: Any,
        result: ResultT,
        progress: Callable[..., None],
    ) -> ResultT:
        """
        Execute a goal, and return its result.

        :param result: the result of ``blank``; it is sent where an error is raised.
        :param progress: called with the stage and what is ``measured``; raises PlanCanceled.
        :raises NoOptionsError: there are no options to plan with.
        :raises PlanError: or DomainError: the request is invalid.
        """

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        result = await self._carry_out(handle, self.blank(handle.request))
        self._results.publish(result)
        end_goal(handle, result.status in self.good, result.status == result.STATUS_CANCELED)
        return self.kind.Result(result=result)

    async def _carry_out(self, handle: ServerGoalHandle, result: ResultT) -> ResultT:
        await self._node.provided()
        if self.busy:
            result.status = result.STATUS_BUSY
            result.detail = f'the planner is at work on another {self.goal_noun}'
            return result
        domain = self._state.domain
        if domain is None:
            result.status, result.detail = result.STATUS_FAILED, 'game has not announced itself'
            return result
        self.busy = True
        try:
            domain = simulated(domain, f'a {self.goal_noun}')
            return await self.work(domain, handle.request, result, self._progress(handle))
        except NoOptionsError as error:
            result.status, result.detail = PlanResult.STATUS_NO_OPTIONS, str(error)
        except (PlanError, DomainError) as error:
            result.status, result.detail = result.STATUS_BAD_REQUEST, str(error)
        except PlanCanceled:
            result.status, result.detail = result.STATUS_CANCELED, 'canceled by the client'
            if self._state.stopping:
                result.status, result.detail = result.STATUS_FAILED, STOPS
        except Exception as error:  # such as too little memory for the tables
            result.status, result.detail = result.STATUS_FAILED, repr(error)
        finally:
            self.busy = False
        return result

    def _progress(self, handle: ServerGoalHandle) -> Callable[..., None]:
        """Return a function that publishes feedback at the start of a stage and at intervals."""
        known, due = '', 0.0

        def progress(stage: str, *numbers: Any) -> None:
            nonlocal known, due
            if handle.is_cancel_requested or self._state.stopping:
                raise PlanCanceled
            now = time.monotonic()
            if stage != known or now >= due:
                known, due = stage, now + _FEEDBACK_PERIOD
                values = dict(zip(self.measured, numbers, strict=True))
                handle.publish_feedback(self.kind.Feedback(stage=stage, **values))

        return progress


class PlanAction(LongAction[PlanResult]):
    """Plans with an action set, and evaluates the plan if the goal has episodes."""

    kind, name, topics = Plan, 'plan', 'plan'
    goal_kind, result_kind = PlanGoal, PlanResult
    measured = ('progress', 'sweeps', 'residual')
    goal_noun = 'plan'
    good = (PlanResult.STATUS_CONVERGED, PlanResult.STATUS_NOT_CONVERGED)

    def blank(self, goal: Plan.Goal) -> PlanResult:
        return refused_plan(goal.action_set)

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
        numbers = goal.gamma, goal.tolerance, goal.max_sweeps, goal.game_steps, goal.seed
        request = PlanRequest(goal.action_set, *numbers).in_force(domain, options)
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


class ExtractionAction(LongAction[ExtractionResult]):
    """Searches for options; those of a participant replace the participant's older ones."""

    kind, name, topics = ExtractOptions, 'extract_options', 'extraction'
    goal_kind, result_kind = ExtractionGoal, ExtractionResult
    measured = ('progress', 'game_steps')
    goal_noun = 'search for options'
    good = (ExtractionResult.STATUS_DONE,)

    def __init__(self, node: NodeBase, group: CallbackGroup, state: PlannerState) -> None:
        super().__init__(node, group, state)
        self._found = OptionPublisher(node, 'automatic_options')

    def blank(self, goal: ExtractOptions.Goal) -> ExtractionResult:
        return ExtractionResult(participant=goal.participant or f'{MACHINE}1')

    async def work(
        self,
        domain: Domain[Any],
        goal: ExtractOptions.Goal,
        result: ExtractionResult,
        progress: Callable[..., None],
    ) -> ExtractionResult:
        """
        Search for options.

        :raises PlanError: the domain, or the participant's code, cannot be used for this.
        """
        how = Extraction(
            options=goal.max_options or USUAL.options,
            tasks=goal.tasks or USUAL.tasks,
            train_episodes=goal.task_episodes or USUAL.train_episodes,
            option_episodes=goal.option_episodes or USUAL.option_episodes,
        )
        participant = result.participant
        check_participant(participant)
        result.extraction_id = str(uuid.uuid4())  # the result from here on
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

        def search() -> tuple[AutomaticOptions, list[LearnedOption]]:
            found = find_options(domain, goal.seed, how, progress)
            return found, to_learned_options(domain, found, participant)

        found, options = await in_thread(self._node, self._state.pool, search)
        others = [o for o in self._state.automatic if o.participant != participant]
        self._state.automatic = [*others, *options]
        known = self._state.automatic
        self._found.publish({(o.participant, o.name): option_to_json(o) for o in known})
        result.status = result.STATUS_DONE
        result.option_names = [option.name for option in options]
        result.reaches = [option.reaches for option in found.options]
        result.seconds, result.game_steps = found.seconds, found.game_steps
        result.episodes, result.solved = found.episodes, found.solved
        return result
