"""Plans and learning over the graph, in a world that cannot be simulated."""

from collections.abc import Iterator
from pathlib import Path
import signal
from typing import Any

from graph_support.live import Graph, LEARNER, open_graph, OPTION_SERVER, PLANNER, RECORDER
from humanopts_interfaces.action import Plan, RunPolicy
from humanopts_interfaces.msg import (
    LearnedOption,
    PlanResult,
    PolicyGoal,
    PolicyResult,
    RecorderStatus,
)
from humanopts_learner.option_runs import OPTION_RUNS
from humanopts_ros.qos import CURRENT
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.export.option_runs import write_option_runs
import pytest

from experiments.battery import CHARGE, DELIVER, demonstrate

COURIER = Path(__file__).parents[1] / 'examples/own_robot/courier.py'
COLUMN = 'battery:20,30,40,50,60'
HUMAN = {'action_set': 'human'}
EPISODES = 3


@pytest.fixture(scope='module')
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A courier, whose two options are taught."""
    with open_graph(tmp_path_factory.mktemp('courier')) as graph:
        options = graph.folder / 'options'
        options.mkdir()
        lines = [
            demonstrate(name, n, 1).to_json() for name in (DELIVER, CHARGE) for n in range(1, 9)
        ]
        (options / 'demonstrations.jsonl').write_text('\n'.join(lines) + '\n')
        learned = graph.listen(LearnedOption, 'learned_options')
        courier = graph.run([str(COURIER)], 'courier')
        graph.start(RECORDER, path=graph.folder / 'bag')
        graph.start(LEARNER, directory=options)
        graph.start(OPTION_SERVER)
        graph.start(PLANNER, directory=graph.folder / 'runs')
        graph.ready('/recorder', '/learner', '/option_server', '/planner')
        graph.until(lambda: len({each.name for each in learned}) == 2, 'two options')
        said = graph.listen(RecorderStatus, 'recorder_status', CURRENT)
        graph.until(lambda: said and said[-1].complete, 'the recorder')
        yield graph
        courier.kill(signal.SIGKILL)  # as in test_own_robot


def plan(graph: Graph, **fields: Any) -> PlanResult:
    return graph.act(Plan, 'plan', **HUMAN, **fields).result()[1]


def run(graph: Graph, **fields: Any) -> PolicyResult:
    return graph.act(RunPolicy, 'run_policy', **HUMAN, **fields).result(120.0)[1]


def recorded(graph: Graph) -> int:
    return len((graph.folder / 'runs' / OPTION_RUNS).read_text().splitlines())


def test_nothing_can_be_planned_before_an_option_has_run(graph: Graph) -> None:
    result = plan(graph)
    assert result.status == result.STATUS_BAD_REQUEST
    assert result.detail == (
        "no recorded run of 'deliver', 'charge' in street counts: run them first, or let "
        'run_policy learn'
    )


def test_q_learning_drives_and_its_runs_are_kept(graph: Graph) -> None:
    goals = graph.listen(PolicyGoal, 'policy_goals')
    asked = {'learning': 'q', 'columns': [COLUMN], 'episodes': EPISODES, 'seed': 1}
    goal = graph.act(RunPolicy, 'run_policy', **HUMAN, **asked, explore=0.5)
    _, result = goal.result(120.0)
    assert (result.status, result.episodes) == (result.STATUS_DONE, EPISODES), result.detail
    assert result.learned_runs == result.decisions == recorded(graph)
    learned = [each.learned_runs for each in goal.feedback]
    assert learned == sorted(learned)
    assert learned[-1] == result.learned_runs
    assert (goals[-1].learning, goals[-1].explore, goals[-1].learning_rate) == ('q', 0.5, 0.1)
    assert [*goals[-1].options] == [DELIVER, CHARGE]


def test_the_learned_policy_is_played_afterwards(graph: Graph) -> None:
    before = recorded(graph)
    result = run(graph, episodes=1, seed=7)
    assert result.status == result.STATUS_DONE, result.detail
    assert recorded(graph) == before + result.decisions


def test_a_plan_says_how_many_runs_it_is_from_and_what_is_missing(graph: Graph) -> None:
    result = plan(graph, columns=[COLUMN])
    assert result.status == result.STATUS_CONVERGED, result.detail
    assert result.recorded_runs == recorded(graph)
    assert result.game_steps > result.recorded_runs
    assert set(result.missing_options) <= {DELIVER, CHARGE}
    assert all('battery' in state for state in result.missing_states)
    assert max(result.missing_samples, default=0) < 3
    assert run(graph, episodes=1, seed=8).status == PolicyResult.STATUS_DONE


def test_learning_can_be_canceled_and_loses_nothing(graph: Graph) -> None:
    before = recorded(graph)
    goal = graph.act(RunPolicy, 'run_policy', **HUMAN, learning='q', episodes=1000, seed=2)
    graph.until(lambda: recorded(graph) > before + 2, 'runs')
    goal.cancel()
    _, result = goal.result()
    assert result.status == result.STATUS_CANCELED
    assert recorded(graph) >= before + result.decisions
    assert run(graph, episodes=1, seed=9).status == PolicyResult.STATUS_DONE


def test_a_restarted_planner_learns_the_same_values_from_its_runs(graph: Graph) -> None:
    first = plan(graph, learning='q', columns=[COLUMN])
    graph.stop(graph.node_called('/planner'))
    graph.start(PLANNER, directory=graph.folder / 'runs')
    graph.ready('/planner')
    answers: list[PlanResult] = []

    def has_options() -> bool:
        answers.append(plan(graph, learning='q', columns=[COLUMN]))
        return answers[-1].status != PlanResult.STATUS_NO_OPTIONS

    graph.until(has_options, 'the options to arrive')
    again = answers[-1]
    assert again.status == again.STATUS_CONVERGED, again.detail
    assert (again.recorded_runs, again.n_states) == (first.recorded_runs, first.n_states)


def test_the_same_runs_are_read_from_the_recording(graph: Graph, tmp_path: Path) -> None:
    graph.stop(graph.node_called('/recorder'))
    path, added = write_option_runs(open_bag(graph.folder / 'bag'), tmp_path)
    live = (graph.folder / 'runs' / OPTION_RUNS).read_text()
    assert path.read_text() == live
    assert added == len(live.splitlines())
    assert write_option_runs(open_bag(graph.folder / 'bag'), tmp_path) == (path, 0)


@pytest.mark.parametrize(
    ('fields', 'detail'),
    [
        ({'learning': 'sarsa'}, "unknown learning 'sarsa'; choose 'q', or leave it empty"),
        ({'learning': 'q', 'execution': 'interrupted'}, 'learning needs the execution run_to_end'),
        ({'explore': 2.0}, 'explore is 2.0, not from 0 to 1'),
        ({'learning': 'q', 'columns': ['power']}, "column 'power':"),
        (
            {'learning': 'q', 'options': ['fly']},
            "no option 'fly'; choose from 'deliver', 'charge'",
        ),
    ],
)
def test_a_bad_goal_is_refused(graph: Graph, fields: dict[str, Any], detail: str) -> None:
    result = run(graph, episodes=1, **fields)
    assert result.status == result.STATUS_BAD_REQUEST
    assert result.detail.startswith(detail)
