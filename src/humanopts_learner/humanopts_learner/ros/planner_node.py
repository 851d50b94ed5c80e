"""The node ``planner``: SMDP value iteration, and execution of policies over options."""

from functools import partial
import sys
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate
from humanopts_env.ros.game_subscriber import GameSubscriber
from humanopts_interfaces import msg
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.ros import PLANNER
from humanopts_learner.ros.learned_options import OptionSubscriber
from humanopts_learner.ros.planner_actions import ExtractionServer, PlannerState, PlanServer
from humanopts_learner.ros.policy_server import PolicyServer
from humanopts_learner.ros.run_recorder import RunRecorder
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node

_FAREWELL = 1.0  # s to answer clients of current goals on shutdown


class PlannerNode(NodeBase):
    """Plans and searches for options in worker threads; plays via ``option_server``."""

    def __init__(self, **options: Any) -> None:
        super().__init__(PLANNER, **options)
        unstick = self.setting(
            'unstick',
            True,
            'whether sampled runs that repeat themselves take one to three random moves',
        )
        directory = self.setting(
            'directory',
            '',
            'folder of the recorded option runs of a world that cannot be simulated; empty: they '
            'are kept in memory',
        )
        recorder = RunRecorder(self, GameSubscriber(self, self._on_domain), directory)
        self._state = PlannerState(recorder, unstick)
        OptionSubscriber(self, 'learned_options', self._on_options)
        self._policies = PolicyServer(self, self._state)
        others = PlanServer(self, self._state), ExtractionServer(self, self._state)
        self._actions = self._policies, *others

    def waits_for(self) -> str | None:
        return None if self._state.domain is not None else 'domain_info'

    def close(self) -> None:
        """End the current goals, and answer their clients."""
        self._state.stopping = True
        self._policies.stop()
        self.finish(lambda: any(action.busy for action in self._actions), _FAREWELL)
        self._state.pool.shutdown()

    def _on_domain(self, domain: ActableDomain) -> None:
        if not can_simulate(domain):
            self._state.recorder.begin(domain)
        self._state.domain = domain

    def _on_options(self, options: list[LearnedOption], message: msg.LearnedOption) -> None:
        self._state.taught, self._state.taught_sequence = options, message.sequence
        self.waiting.check()


main = partial(run_node, PlannerNode, by_events=True)

if __name__ == '__main__':
    sys.exit(main())
