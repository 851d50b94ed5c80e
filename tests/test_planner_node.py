"""The node planner on the real graph: plans are those of the pure code, and so is playing them."""

from contextlib import nullcontext
import math
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import GAME, Goal, Graph, PLANNER
from graph_support.planning import Planning, start_planning
from graph_support.player import PERSON
from graph_support.scripted import FETCH, taught, TAXI
from humanopts_interfaces.action import Plan, RunPolicy
from humanopts_interfaces.msg import NodeStatus, PlanGoal, PlanResult, PolicyResult
from humanopts_learner.planning.exact_plan import episode_starts, find_coverage, play_plan
from humanopts_learner.planning.plan import judge_plan, make_plan
from humanopts_learner.planning.request import PlanRequest
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT
from humanopts_ros.waiting import drive
from humanopts_teach.lesson.requests import PlanOptions
from humanopts_teach.ros.convert import ACTIONS
from humanopts_teach.ros.graph_client import GraphClient
import pytest
from rclpy.action import ActionClient
from unique_identifier_msgs.msg import UUID

OPTIONS = taught()
FIRST_ONLY = [option for option in OPTIONS if option.name == FETCH]
EPISODES, SEED = 4, 16  # in the third, the options go round in circles
HUGE = '{"rows": 130, "cols": 130}'  # 338,000 states: sweeps take some ten seconds
CANCELED = GoalStatus.STATUS_CANCELED, PlanResult.STATUS_CANCELED


@pytest.fixture(scope='module')
def at_work(shared: Graph) -> Planning:
    return start_planning(shared, episodes=EPISODES, seed=SEED)


@pytest.fixture
def planning(at_work: Planning) -> Planning:
    """Have the options of the whole task known."""
    at_work.teach(OPTIONS)
    return at_work


@pytest.mark.parametrize('action_set', ['human', 'primitive', 'human+primitive'])
def test_a_plan_is_the_plan_of_the_pure_code(planning: Planning, action_set: str) -> None:
    result = planning.plan(action_set, evaluation_episodes=EPISODES)
    plan = make_plan(TAXI, OPTIONS, PlanRequest(action_set))
    returns = play_plan(plan, episode_starts(TAXI, SEED, EPISODES))
    assert result.status == PlanResult.STATUS_CONVERGED
    assert (result.action_set, tuple(result.option_names)) == (action_set, plan.names)
    assert (result.gamma, result.n_states) == (0.99, 500)
    assert (result.sweeps, result.residual) == (plan.solution.sweeps, plan.solution.residual)
    assert result.evaluation_episodes == EPISODES
    assert result.mean_return == returns.total.mean()
    assert result.mean_discounted_return == returns.discounted.mean()
    found = judge_plan(plan, SEED, EPISODES).total
    assert (result.mean_return_low, result.mean_return_high) == (found.low, found.high)
    assert found.low < found.mean < found.high
    assert (result.game_steps, result.fallbacks, result.outcome_names) == (0, 0, [])
    assert result.sweep_seconds > 0


def test_goals_and_results_of_plans_are_on_the_graph_also_of_those_that_are_not_judged(
    planning: Planning,
) -> None:
    result = planning.plan('human', max_sweeps=2, gamma=0.5)
    assert result.status == PlanResult.STATUS_NOT_CONVERGED
    assert (result.sweeps, result.converged) == (2, False)
    assert result.detail == 'not converged after 2 sweeps'
    assert (result.evaluation_episodes, math.isnan(result.mean_return)) == (0, True)
    found = planning.plan_results
    planning.graph.until(lambda: found and found[-1].plan_id == result.plan_id, 'the result')
    (goal,) = [goal for goal in planning.plan_goals if goal.plan_id == result.plan_id]
    assert (goal.action_set, goal.gamma, goal.tolerance) == ('human', 0.5, 1e-8)
    assert (goal.max_sweeps, goal.game_steps, goal.seed) == (2, 0, SEED)
    assert list(goal.options) == [option.name for option in OPTIONS]


def test_some_of_the_options_can_be_planned_with(planning: Planning) -> None:
    result = planning.plan('human', options=[FETCH], evaluation_episodes=3)
    alone = make_plan(TAXI, FIRST_ONLY, PlanRequest('human'))
    assert tuple(result.option_names) == alone.names
    returns = play_plan(alone, episode_starts(TAXI, SEED, 3))
    assert result.fallbacks == returns.fallbacks.sum() > 0
    missing = find_coverage(alone)
    assert result.coverage_known
    assert [TAXI.index(TAXI.decode(state)) for state in result.fallback_states] == list(
        missing.fallback
    )
    assert list(result.single_step_gains) == list(missing.gain)
    assert not planning.plan('human+primitive').coverage_known


def test_an_option_that_cannot_be_read_does_not_hide_the_others(planning: Planning) -> None:
    statuses = planning.graph.listen(NodeStatus, 'node_status', CURRENT)
    planning.teach(OPTIONS, spoilt=['spoilt'])
    result = planning.plan('human')
    assert tuple(result.option_names) == make_plan(TAXI, OPTIONS, PlanRequest('human')).names
    planning.graph.until(
        lambda: any(
            status.node == '/planner' and "'spoilt': " in status.text for status in statuses
        ),
        'the error',
    )


def test_what_cannot_be_planned_is_refused_in_words(planning: Planning) -> None:
    bad, no_options = PlanResult.STATUS_BAD_REQUEST, PlanResult.STATUS_NO_OPTIONS

    def refused(status: int, says: str, action_set: str = 'human', **fields: Any) -> None:
        late = 'options_sequence' in fields
        with planning.graph.hurried() if late else nullcontext():
            result = planning.plan(action_set, **fields)
        assert (result.status, result.plan_id) == (status, '')
        assert says in result.detail

    refused(
        bad, "unknown action set 'robot'; choose from human, primitive, human+primitive", 'robot'
    )
    refused(bad, 'gamma is nan', gamma=math.nan)
    refused(bad, f"no option 'fly'; choose from {FETCH!r}", options=[FETCH, 'fly'])
    refused(bad, 'learned_options 10000 did not arrive', options_sequence=10_000)
    planning.teach([*OPTIONS, *taught('p2')])
    refused(bad, 'name one of p1, p2')
    refused(no_options, "'p3' taught no option; those who did: p1, p2", participant='p3')
    assert planning.plan('human', participant='p2').status == PlanResult.STATUS_CONVERGED
    planning.teach([])
    refused(no_options, 'teach one first')
    assert planning.plan('primitive').status == PlanResult.STATUS_CONVERGED


def test_judging_is_canceled_at_once(planning: Planning) -> None:
    goal = planning.begin_plan('primitive', evaluation_episodes=500_000)
    planning.graph.until(
        lambda: any(f.stage == 'evaluation' for f in goal.feedback), 'the evaluation'
    )
    goal.cancel()
    status, result = goal.result(5.0)
    assert (status, result.status) == CANCELED


@pytest.mark.parametrize('options', [OPTIONS, FIRST_ONLY], ids=['all', 'one'])
def test_playing_by_a_plan_is_what_the_pure_code_says(planning: Planning, options: Any) -> None:
    planning.teach(options)
    planned, count = planning.plan('human'), EPISODES if options is OPTIONS else 2
    runs = [planning.play('human', episodes=count) for _ in range(2 if count == EPISODES else 1)]
    plan = make_plan(TAXI, options, PlanRequest('human'))
    returns = play_plan(plan, episode_starts(TAXI, SEED, count))
    for result in runs:
        assert result.status == PolicyResult.STATUS_DONE
        assert (result.episodes, result.successes) == (count, returns.successes.sum())
        assert result.decisions == returns.decisions.sum()
        assert result.fallbacks == returns.fallbacks.sum()
        assert result.mean_return == returns.total.mean()
        assert result.mean_discounted_return == pytest.approx(returns.discounted.mean(), abs=1e-9)
    assert (result.fallbacks > 0) == (options is FIRST_ONLY)
    goals = planning.policy_goals[-len(runs) :]
    assert [goal.run_id for goal in goals] == [result.run_id for result in runs]
    assert {goal.plan_id for goal in goals} == {planned.plan_id}
    short = planning.play('human', episodes=2, max_decisions=1)
    assert (short.episodes, short.successes, short.decisions) == (2, 0, 2)


def test_what_cannot_be_played_is_refused_in_words(planning: Planning) -> None:
    def refused(status: int, says: str, **fields: Any) -> None:
        result = planning.play('human', **fields)
        assert (result.status, result.run_id, result.episodes) == (status, UUID(), 0)
        assert says in result.detail

    for action_set in ('human', 'primitive'):
        planning.plan(action_set)
    refused(PolicyResult.STATUS_NO_PLAN, 'plan it first', participant='nobody')
    refused(PolicyResult.STATUS_BAD_REQUEST, 'episodes is 0', episodes=0)
    sequence = planning.teach(FIRST_ONLY)
    planning.plan('primitive', options_sequence=sequence)
    refused(PolicyResult.STATUS_NO_PLAN, 'the options have changed')
    assert planning.play('primitive', episodes=1).status == PolicyResult.STATUS_DONE


def test_a_second_policy_is_answered_busy_and_playing_is_canceled(planning: Planning) -> None:
    planning.plan('human')
    goal = planning.begin('human', episodes=5000)
    planning.graph.until(lambda: goal.feedback, 'an episode')
    _, second = planning.graph.act(
        RunPolicy, 'run_policy', action_set='human', episodes=1
    ).result()
    assert second.status == PolicyResult.STATUS_BUSY
    goal.cancel()
    status, result = goal.result(5.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, PolicyResult.STATUS_CANCELED)
    assert result.episodes == goal.feedback[-1].episodes
    assert result.mean_return == goal.feedback[-1].mean_return


def test_a_person_takes_over_from_a_policy_and_keeps_the_game(planning: Planning) -> None:
    planning.plan('human')
    goal = planning.begin('human', episodes=5000)
    planning.graph.until(lambda: goal.feedback, 'an episode')
    planning.player.hold(True)
    status, result = goal.result(5.0)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.status == PolicyResult.STATUS_INTERRUPTED
    assert 'held by the person' in result.detail
    assert planning.player.do('north', PERSON).action_source == PERSON
    again = planning.graph.act(RunPolicy, 'run_policy', action_set='human', episodes=1)
    _, result = again.result()
    assert (result.status, result.episodes) == (PolicyResult.STATUS_INTERRUPTED, 0)
    assert math.isnan(result.mean_return)


def test_a_goal_that_comes_before_the_game_waits_for_it_a_while(live: Graph) -> None:
    live.start(PLANNER)
    first = live.act(Plan, 'plan', action_set='primitive')
    with live.hurried():
        _, refused = first.result()
    assert refused.status == PlanResult.STATUS_FAILED
    assert refused.detail == 'game has not announced itself'
    second = live.act(Plan, 'plan', action_set='primitive')
    live.start(GAME)
    assert second.result()[1].status == PlanResult.STATUS_CONVERGED


CUSTOMER = f'{__name__}:Customer'


class Customer(NodeBase):
    """Asks for plans."""

    def __init__(self, **options: Any) -> None:
        super().__init__('customer', **options)
        self.client = GraphClient(self, {PlanOptions: ACTIONS[PlanOptions]})
        self.answers: list[Any] = []

    def plan(self) -> None:
        goal = PlanOptions('primitive', participant='', seed=SEED)
        drive(self.client.run(goal, 60.0), self.answers.append)


def test_a_goal_to_a_restarted_planner_is_sent_when_that_is_ready(live: Graph) -> None:
    live.start(GAME)
    live.start(PLANNER)
    customer = live.start(CUSTOMER)
    peers = customer.peers
    live.until(lambda: peers.state('planner') == NodeStatus.STATE_READY, 'the planner')
    for node in '/planner', '/game':
        live.stop(live.node_called(node))
    goals = live.listen(PlanGoal, 'plan_goals')
    live.start(PLANNER)
    live.until(lambda: peers.restarts['planner'], 'the restart to be seen')
    live.until(ActionClient(live.node, Plan, 'plan').server_is_ready, 'its server')
    customer.plan()
    live.start(GAME)
    live.until(lambda: customer.answers, 'the plan')
    (answer,) = customer.answers
    assert (answer.status, len(goals)) == (PlanResult.STATUS_CONVERGED, 1)


def test_planning_says_how_far_it_is_is_canceled_at_once_and_ends_with_the_node(
    live: Graph,
) -> None:
    def begin() -> Goal:
        goal = live.act(Plan, 'plan', action_set='primitive', gamma=0.999)
        live.until(lambda: any(f.sweeps for f in goal.feedback), 'a sweep', 60.0)
        return goal

    live.start(GAME, domain_parameters=HUGE)
    live.start(PLANNER)
    live.ready('/game', '/planner')
    goal = begin()
    _, busy = live.act(Plan, 'plan', action_set='primitive').result()
    assert busy.status == PlanResult.STATUS_BUSY
    goal.cancel()
    status, result = goal.result(5.0)
    assert (status, result.status) == CANCELED
    assert result.plan_id != ''
    sweeps = [f for f in goal.feedback if f.stage == 'sweeps']
    assert [f.sweeps for f in sweeps] == sorted(f.sweeps for f in sweeps)
    assert all(0.0 <= f.progress < 1.0 and f.residual > 0 for f in sweeps)
    goal = begin()
    live.stop(live.node_called('/planner'))
    status, result = goal.result()
    assert (status, result.status) == (GoalStatus.STATUS_ABORTED, PlanResult.STATUS_FAILED)
    assert result.detail == 'the planner is stopping'
