"""A planner that has a plan, and what its policies do on the graph."""

from typing import Any

from humanopts_interfaces.msg import ActionCommand, ExecutionState, OptionResult, PolicyResult
from humanopts_interfaces.srv import ListOptions, RunOption, SetExecution
from humanopts_ros.qos import LATCHED

from graph_support.live import Goal, Graph
from graph_support.planning import Planning, start_planning
from graph_support.tour import touring

LIMIT = 60  # decisions in an episode
START = 'taxi 2,2 passenger G destination B'
Step = tuple[str, str, str, float]  # state that it led to, action, whose it was, reward


class Acting:
    """A planner that has a plan of the tour, and what its policies do."""

    def __init__(self, planning: Planning) -> None:
        """Listen, and plan."""
        graph = planning.graph
        self.graph, self.planning, self.player = graph, planning, planning.player
        self.commands: list[ActionCommand] = graph.listen(ActionCommand, 'action')
        self.runs: list[OptionResult] = graph.listen(OptionResult, 'option_results')
        self.executions = graph.listen(ExecutionState, 'execution', LATCHED)
        graph.ask(ListOptions, 'list_options')  # who answers has found the readers made before
        planning.teach(touring())
        self.plan_id = planning.plan('human').plan_id

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
        goal = self.planning.begin('human', **fields)
        self.commands.clear(), self.runs.clear(), self.player.states.clear()
        return goal

    def stepped(self, count: int) -> list[Step]:
        """Return state, action, actor and reward of so many steps since play began."""

        def taken() -> list[Step]:
            actor = {(c.publisher_id, c.sequence): c.option_name for c in self.commands}
            made = [((s.action_publisher_id, s.action_sequence), s) for s in self.player.states]
            return [
                (s.state, s.previous_action, actor[command], s.reward)
                for command, s in made
                if command in actor
            ]

        self.graph.until(lambda: len(taken()) >= count, 'the steps')
        return taken()

    def change(self, execution: str) -> SetExecution.Response:
        """Have the policy that runs carried out otherwise."""
        return self.graph.ask(SetExecution, 'set_execution', execution=execution)

    def run(self, **fields: Any) -> OptionResult:
        """Run an option by itself, from the first state of a new episode."""
        state = self.player.fresh(START)
        fields = {'episode': state.episode, 'step': 0, **fields}
        result: OptionResult = self.graph.ask(RunOption, 'run_option', **fields).result
        return result


def start_acting(graph: Graph, *, episodes: int, seed: int, **game_parameters: Any) -> Acting:
    """Start a game with everything that plays it; return it once there is a plan."""
    return Acting(start_planning(graph, episodes=episodes, seed=seed, **game_parameters))
