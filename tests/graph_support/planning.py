"""A planner at work, with the test in the learner's place."""

from collections.abc import Sequence
from typing import Any

from humanopts_interfaces.action import Plan, RunPolicy
from humanopts_interfaces.msg import (
    LearnedOptions,
    OptionFile,
    PlanGoal,
    PlanResult,
    PolicyGoal,
    PolicyResult,
)
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.option import LearnedOption
from humanopts_ros.qos import LATCHED

from graph_support.live import GAME, Goal, Graph, OPTION_SERVER, PLANNER
from graph_support.player import Player


class Planning:
    """A game with everything that plays it, and the test in the learner's place."""

    def __init__(self, graph: Graph, *, episodes: int, seed: int) -> None:
        """
        Set up the topics.

        :param episodes: to play where a test does not say.
        :param seed: of plans and episodes where a test does not say.
        """
        self.graph, self._sequence = graph, 0
        self.episodes, self.seed = episodes, seed
        self._options = graph.node.create_publisher(LearnedOptions, 'learned_options', LATCHED)
        self.plan_goals = graph.listen(PlanGoal, 'plan_goals')
        self.plan_results = graph.listen(PlanResult, 'plan_results')
        self.policy_goals = graph.listen(PolicyGoal, 'policy_goals')
        self.policy_results = graph.listen(PolicyResult, 'policy_results')
        self.player = Player(graph)

    def teach(self, options: list[LearnedOption], spoilt: Sequence[str] = ()) -> int:
        """Publish what was learned, and some that cannot be read; return the sequence."""
        self._sequence += 1
        models = [
            OptionFile(name=o.name, participant=o.participant, model=option_to_json(o))
            for o in options
        ]
        models += [OptionFile(name=name, model='not JSON') for name in spoilt]
        self._options.publish(LearnedOptions(sequence=self._sequence, options=models))
        return self._sequence

    def plan(self, action_set: str, **fields: Any) -> PlanResult:
        """Plan with the newest options."""
        _, result = self.begin_plan(action_set, **fields).result()
        return result

    def begin_plan(self, action_set: str, **fields: Any) -> Goal:
        """Begin to plan with the newest options."""
        fields = {'options_sequence': self._sequence, 'seed': self.seed, **fields}
        return self.graph.act(Plan, 'plan', action_set=action_set, **fields)

    def begin(self, action_set: str, **fields: Any) -> Goal:
        """Begin to play by a plan; nobody holds control."""
        self.player.fresh()
        fields = {'episodes': self.episodes, 'seed': self.seed, **fields}
        return self.graph.act(RunPolicy, 'run_policy', action_set=action_set, **fields)

    def play(self, action_set: str, **fields: Any) -> PolicyResult:
        """Play by a plan."""
        _, result = self.begin(action_set, **fields).result()
        return result


def start_planning(graph: Graph, *, episodes: int, seed: int, **game_parameters: Any) -> Planning:
    """Start a game with everything that plays it; return it once it is ready."""
    graph.start(GAME, **game_parameters)
    for module in (OPTION_SERVER, PLANNER):
        graph.start(module)
    graph.ready('/game', '/option_server', '/planner')
    return Planning(graph, episodes=episodes, seed=seed)
