"""Automatic options: the action extract_options, and the options that it found."""

from collections.abc import Callable
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_interfaces.action import ExtractOptions
from humanopts_interfaces.msg import ExtractionGoal, ExtractionResult, LearnedOptions
from humanopts_learner.automatic.config import Extraction, USUAL
from humanopts_learner.automatic.extract import (
    AutomaticOptions,
    check_participant,
    find_options,
    to_learned_options,
)
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import MACHINE
from humanopts_learner.ros.convert import options_to_message
from humanopts_learner.ros.planner_actions import in_thread, LongAction, PlannerState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED
from rclpy.callback_groups import CallbackGroup


class ExtractionAction(LongAction[ExtractionResult]):
    """Searches for options; those of a participant replace the participant's older ones."""

    goal_noun = 'search for options'
    good = (ExtractionResult.STATUS_DONE,)

    def __init__(self, node: NodeBase, group: CallbackGroup, state: PlannerState) -> None:
        self._goals = node.stamped_publisher(ExtractionGoal, 'extraction_goals')
        results = node.stamped_publisher(ExtractionResult, 'extraction_results')
        self._found = node.stamped_publisher(LearnedOptions, 'automatic_options', LATCHED)
        super().__init__(node, group, ExtractOptions, 'extract_options', results, state)

    def blank(self, goal: ExtractOptions.Goal) -> ExtractionResult:
        """Return a result without options."""
        return ExtractionResult(participant=goal.participant or MACHINE)

    def feedback(self, stage: str, *numbers: Any) -> ExtractOptions.Feedback:
        """Encode the progress of the search."""
        progress, steps = numbers
        return ExtractOptions.Feedback(stage=stage, progress=progress, game_steps=steps)

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
        self._found.publish(options_to_message(self._state.automatic))
        result.status = result.STATUS_DONE
        result.option_names = [option.name for option in options]
        result.reaches = [option.reaches for option in found.options]
        result.seconds, result.game_steps = found.seconds, found.game_steps
        result.episodes, result.solved = found.episodes, found.solved
        return result
