"""A planner at work, with the test in the learner's place, and what its policies do."""

from collections.abc import Sequence
from typing import Any

from humanopts_interfaces.action import Plan, RunPolicy
from humanopts_interfaces.msg import (
    ActionCommand,
    ExecutionState,
    OptionResult,
    PlanGoal,
    PlanResult,
    PolicyGoal,
    PolicyResult,
)
from humanopts_interfaces.msg import (
    LearnedOption as OptionMessage,
)
from humanopts_interfaces.srv import ListOptions, RunOption, SetExecution
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_ros.qos import CURRENT, STREAM

from graph_support.live import GAME, Goal, Graph, OPTION_SERVER, PLANNER
from graph_support.player import Player
from graph_support.scripted import touring

LEARNERS = '/learner#test'  # how the publisher_id of the test in the learner's place begins
LIMIT = 60  # decisions in an episode of Acting
START = 'taxi 2,2 passenger G destination B'


class Planning:
    """A game with everything that plays it, and the test in the learner's place."""

    def __init__(self, graph: Graph, *, episodes: int, seed: int) -> None:
        """
        Set up the topics.

        :param episodes: to play where a test does not say.
        :param seed: of plans and episodes where a test does not say.
        """
        self.graph, self._sequence, self._lives = graph, 0, 0
        self.episodes, self.seed = episodes, seed
        self._options = graph.node.create_publisher(OptionMessage, 'learned_options', STREAM)
        self.plan_goals = graph.listen(PlanGoal, 'plan_goals')
        self.plan_results = graph.listen(PlanResult, 'plan_results')
        self.policy_goals = graph.listen(PolicyGoal, 'policy_goals')
        self.policy_results = graph.listen(PolicyResult, 'policy_results')
        self.player = Player(graph)

    def teach(self, options: Sequence[LearnedOption], spoilt: Sequence[str] = ()) -> int:
        """Publish what was learned, and some that cannot be read; return the sequence."""
        self._lives += 1
        self.graph.until(
            lambda: (
                self._options.get_subscription_count()
                == self.graph.node.count_subscribers('learned_options')
                > 0
            ),
            'the readers of options',
        )
        models = [(o.participant, o.name, option_to_json(o)) for o in options]
        models += [('', name, 'not JSON') for name in spoilt]
        for participant, name, model in models or [('', '', '')]:
            self._sequence += 1
            self._options.publish(
                OptionMessage(
                    publisher_id=f'{LEARNERS}{self._lives}',
                    sequence=self._sequence,
                    name=name,
                    participant=participant,
                    model=model,
                    n_options=len(models),
                )
            )
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
        """Begin to play by a plan, with control free."""
        self.player.fresh()
        fields = {'episodes': self.episodes, 'seed': self.seed, **fields}
        return self.graph.act(RunPolicy, 'run_policy', action_set=action_set, **fields)

    def play(self, action_set: str, **fields: Any) -> PolicyResult:
        """Play by a plan."""
        _, result = self.begin(action_set, **fields).result()
        return result


class Acting(Planning):
    """One that has a plan of the tour, and what its policies do."""

    def __init__(self, graph: Graph, *, episodes: int, seed: int) -> None:
        """Listen, and plan."""
        super().__init__(graph, episodes=episodes, seed=seed)
        self.commands: list[ActionCommand] = graph.listen(ActionCommand, 'action')
        self.runs: list[OptionResult] = graph.listen(OptionResult, 'option_results')
        self.executions = graph.listen(ExecutionState, 'execution', CURRENT)
        graph.ask(ListOptions, 'list_options')  # who answers has found the readers made before
        self.teach(touring())
        self.plan_id = self.plan('human').plan_id

    def play(self, execution: str, **fields: Any) -> PolicyResult:
        """Play to the end, and until the result of every run has come as well."""
        _, result = self.begin(execution, **fields).result(60.0)

        def decided() -> tuple[int, int]:
            return len(self.runs), sum(run.step_count for run in self.runs)  # the one of modules

        self.graph.until(lambda: result.decisions in decided(), 'the runs')
        return result

    def begin(self, execution: str, **fields: Any) -> Goal:
        """Begin to play."""
        fields = {'max_decisions': LIMIT, 'execution': execution, **fields}
        goal = super().begin('human', **fields)
        self.commands.clear(), self.runs.clear(), self.player.states.clear()
        return goal

    def change(self, execution: str) -> SetExecution.Response:
        """Have the policy that runs carried out otherwise."""
        return self.graph.ask(SetExecution, 'set_execution', execution=execution)

    def run(self, **fields: Any) -> OptionResult:
        """Run an option by itself, from the first state of a new episode."""
        state = self.player.fresh(START)
        fields = {'episode': state.episode, 'step': 0, **fields}
        result: OptionResult = self.graph.ask(RunOption, 'run_option', **fields).result
        return result


def start_planning(graph: Graph, *, episodes: int, seed: int, **game_parameters: Any) -> Planning:
    """Start a game with everything that plays it; return it once it is ready."""
    _start_nodes(graph, game_parameters)
    return Planning(graph, episodes=episodes, seed=seed)


def start_acting(graph: Graph, *, episodes: int, seed: int, **game_parameters: Any) -> Acting:
    """Start a game with everything that plays it; return it once there is a plan."""
    _start_nodes(graph, game_parameters)
    return Acting(graph, episodes=episodes, seed=seed)


def _start_nodes(graph: Graph, game_parameters: dict[str, Any]) -> None:
    graph.start(GAME, **game_parameters)
    for module in (OPTION_SERVER, PLANNER):
        graph.start(module)
    graph.ready('/game', '/option_server', '/planner')
