"""Finding options without a person: the action extract_options, and all that it found."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any
import uuid

from humanopts_env.domains.base import Domain, DomainError
from humanopts_interfaces.action import ExtractOptions
from humanopts_interfaces.msg import (
    ExtractionGoal,
    ExtractionResult,
    LearnedOptions,
    OptionFile,
)
from humanopts_learner.automatic.as_learned import check_participant, learned_options
from humanopts_learner.automatic.extract import AutomaticOptions, find_options
from humanopts_learner.automatic.how import Extraction, USUAL
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import MACHINE
from humanopts_learner.planning.errors import PlanCanceled, PlanError
from humanopts_learner.ros.goals import end_goal, Feedback
from humanopts_learner.ros.player import STOPS
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup


@dataclass(frozen=True)
class _Request:
    """A goal with its defaults filled in."""

    domain: Domain[Any]
    participant: str
    how: Extraction
    seed: int


class ExtractionServer:
    """Looks for options, one search at a time; those of a participant replace older ones."""

    def __init__(
        self,
        node: NodeBase,
        group: CallbackGroup,
        domain: Callable[[], Domain[Any] | None],
        in_thread: Callable[[Callable[[], Any]], Awaitable[Any]],
        stopping: Callable[[], bool],
    ) -> None:
        """
        Serve.

        :param domain: returns the game; None: it is not known yet.
        :param in_thread: does long work beside the executor.
        :param stopping: tells whether the node ends.
        """
        self.options: list[LearnedOption] = []  # a new list whenever they change
        self.busy = False
        self._domain, self._in_thread, self._stopping = domain, in_thread, stopping
        self._node = node
        self._goals = node.stamped_publisher(ExtractionGoal, 'extraction_goals')
        self._results = node.stamped_publisher(ExtractionResult, 'extraction_results')
        self._found = node.stamped_publisher(LearnedOptions, 'automatic_options', LATCHED)
        node.recorded_action(ExtractOptions, 'extract_options', self._execute, group)

    async def _execute(self, handle: ServerGoalHandle) -> ExtractOptions.Result:
        result = await self._extract(handle)
        self._results.publish(result)
        canceled = result.status == ExtractionResult.STATUS_CANCELED
        end_goal(handle, result.status == ExtractionResult.STATUS_DONE, canceled)
        return ExtractOptions.Result(result=result)

    async def _extract(self, handle: ServerGoalHandle) -> ExtractionResult:
        result = ExtractionResult(participant=handle.request.participant or MACHINE)
        await self._node.provided()
        domain = self._domain()
        if self.busy:
            result.status = result.STATUS_BUSY
            result.detail = 'the planner is at work on another search for options'
            return result
        if domain is None:
            result.status, result.detail = result.STATUS_FAILED, 'game has not announced itself'
            return result
        self.busy = True
        try:
            request = _in_force(handle.request, domain)
            result.extraction_id = str(uuid.uuid4())  # from here on it is accepted
            await self._search(handle, request, result)
        except (PlanError, DomainError) as error:
            result.status, result.detail = result.STATUS_BAD_REQUEST, str(error)
        except PlanCanceled:
            result.status, result.detail = result.STATUS_CANCELED, 'canceled by the client'
            if self._stopping():
                result.status, result.detail = result.STATUS_FAILED, STOPS
        except Exception as error:  # such as no memory for so many tables
            result.status, result.detail = result.STATUS_FAILED, repr(error)
        finally:
            self.busy = False
        return result

    async def _search(
        self, handle: ServerGoalHandle, request: _Request, result: ExtractionResult
    ) -> None:
        """Look for options, publish them, and fill the result."""
        self._goals.publish(_goal_message(request, result.extraction_id))
        progress = Feedback(
            handle,
            self._stopping,
            lambda stage, fraction, steps: ExtractOptions.Feedback(
                stage=stage, progress=fraction, game_steps=steps
            ),
        )

        def work() -> tuple[AutomaticOptions, list[LearnedOption]]:
            found = find_options(request.domain, request.seed, request.how, progress)
            return found, learned_options(request.domain, found, request.participant)

        found, options = await self._in_thread(work)
        others = [option for option in self.options if option.participant != request.participant]
        self.options = [*others, *options]
        self._found.publish(_options_message(self.options))
        result.status = result.STATUS_DONE
        result.option_names = [option.name for option in options]
        result.reaches = [option.reaches for option in found.options]
        result.seconds, result.game_steps = found.seconds, found.game_steps
        result.episodes, result.solved = found.episodes, found.solved


def _in_force(request: Any, domain: Domain[Any]) -> _Request:
    how = Extraction(
        options=request.max_options or USUAL.options,
        tasks=request.tasks or USUAL.tasks,
        train_episodes=request.task_episodes or USUAL.train_episodes,
        option_episodes=request.option_episodes or USUAL.option_episodes,
    )
    participant = request.participant or MACHINE
    check_participant(participant)
    return _Request(domain, participant, how, request.seed)


def _goal_message(request: _Request, extraction_id: str) -> ExtractionGoal:
    return ExtractionGoal(
        extraction_id=extraction_id,
        participant=request.participant,
        max_options=request.how.options,
        tasks=request.how.tasks,
        task_episodes=request.how.train_episodes,
        option_episodes=request.how.option_episodes,
        seed=request.seed,
    )


def _options_message(options: Sequence[LearnedOption]) -> LearnedOptions:
    return LearnedOptions(
        options=[
            OptionFile(name=o.name, participant=o.participant, model=option_to_json(o))
            for o in options
        ]
    )
