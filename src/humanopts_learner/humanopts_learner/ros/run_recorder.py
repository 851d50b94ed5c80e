"""Recording of option runs in a world that cannot be simulated."""

from pathlib import Path

from humanopts_env.domains.base import ActableDomain
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_interfaces.msg import OptionGoal, OptionResult
from humanopts_learner.option_runs import (
    OptionRun,
    result_from_message,
    RunCollector,
    RunLog,
    uuid_of,
)
from humanopts_learner.run import RunResult
from humanopts_ros.guarded_node import StartError
from humanopts_ros.node_base import NodeBase


class RunRecorder:
    """
    Follows a world that cannot be simulated, and records each run of an option.

    :ivar newest: newest state of the world; None: no state has arrived.
    """

    def __init__(self, node: NodeBase, game: GameSubscriber, directory: str) -> None:
        """
        Prepare for recording; ``begin`` starts it.

        :param directory: folder of the runs; empty: they are kept in memory only.
        """
        self._node, self._game = node, game
        self._directory = Path(directory) if directory else None
        self._log: RunLog | None = None
        self.newest: Observed | None = None

    @property
    def runs(self) -> list[OptionRun]:
        """All recorded runs, oldest first; a live list."""
        return [] if self._log is None else self._log.runs

    def begin(self, domain: ActableDomain) -> None:
        """
        Read the recorded runs of the world, and follow its states.

        :raises StartError: the folder cannot be used.
        """
        try:
            self._log = RunLog(self._directory, domain)
        except OSError as error:
            raise StartError(
                f'cannot use the folder {self._directory}: {error.strerror}'
            ) from error
        for problem in self._log.problems:
            self._node.get_logger().warning(problem)
        collector = RunCollector(domain)

        def on_goal(goal: OptionGoal) -> None:
            collector.on_goal(uuid_of(goal.run_id), goal.participant)

        def on_state(observed: Observed) -> None:
            self.newest = observed
            self._add(collector.on_state(observed.publisher_id, observed.transition))

        def on_result(result: RunResult) -> None:
            self._add(collector.on_result(result))

        self._node.subscribe(OptionGoal, 'option_goals', lambda goal: goal, on_goal)
        self._node.subscribe(OptionResult, 'option_results', result_from_message, on_result)
        self._game.follow('game_state', on_state)

    def _add(self, runs: list[OptionRun]) -> None:
        assert self._log is not None
        for run in runs:
            try:
                self._log.add(run)
            except OSError as error:
                text = f'the run {run.run_id} is not on disk: {error.strerror}'
                self._node.get_logger().error(text)
        self._node.waiting.check()
