"""The common parts of the planner's actions: its state, worker threads, and one goal at a time."""

from abc import ABC, abstractmethod
from collections.abc import Callable
import concurrent.futures
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
import time
from typing import Any, Generic, TypeVar

from humanopts_env.domains.base import Domain, DomainError
from humanopts_interfaces.msg import ExtractionResult, PlanResult
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.plan import AnyPlan
from humanopts_learner.planning.request import NoOptionsError, OF_MACHINES, PlanCanceled, PlanError
from humanopts_ros.node_base import end_goal, NodeBase
from humanopts_ros.publisher import StampedPublisher
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.task import Future

STOPS = 'the planner stops'
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

    domain: Domain[Any] | None = None
    taught: list[LearnedOption] = field(default_factory=list)
    taught_sequence: int = 0  # of the LearnedOptions with these options
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

    goal_noun: str  # of "the planner is at work on another ..."
    good: tuple[int, ...]  # statuses with which a goal succeeds

    def __init__(
        self,
        node: NodeBase,
        group: CallbackGroup,
        kind: Any,
        name: str,
        results: StampedPublisher[ResultT],
        state: PlannerState,
    ) -> None:
        """
        Serve the action.

        :param kind: its type.
        :param results: publisher of the result of every goal, also of refused ones.
        """
        self.busy = False
        self._results: StampedPublisher[ResultT] = results
        self._node, self._kind, self._state = node, kind, state
        node.recorded_action(kind, name, self._execute, group)

    @abstractmethod
    def blank(self, goal: Any) -> ResultT:
        """Return an empty result; status and detail are left to the caller."""

    @abstractmethod
    def feedback(self, stage: str, *numbers: Any) -> Any:
        """Return the feedback with the progress."""

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
        :param progress: called with the arguments of ``feedback``; raises PlanCanceled.
        :raises NoOptionsError: there are no options to plan with.
        :raises PlanError: or DomainError: the request is invalid.
        """

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        result = await self._carry_out(handle, self.blank(handle.request))
        self._results.publish(result)
        end_goal(handle, result.status in self.good, result.status == result.STATUS_CANCELED)
        return self._kind.Result(result=result)

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
                handle.publish_feedback(self.feedback(stage, *numbers))

        return progress
