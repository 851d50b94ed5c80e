"""A policy that is interrupted, or runs as modules: as the pure code plays; people change it."""

from itertools import pairwise
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import Graph
from graph_support.planning import Acting, START, start_acting
from graph_support.scripted import TAXI, TOUR, touring, USE
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import OptionResult, OptionValues, PolicyResult
from humanopts_interfaces.srv import RunOption, SetPace
from humanopts_learner.planning.exact_plan import episode_starts, play_plan
from humanopts_learner.planning.interruption import as_executed, option_values
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import Arbitration, PlanRequest
from humanopts_learner.ros.convert import option_values_to_message
from humanopts_ros.codec import uuid_from_message
from humanopts_ros.qos import LATCHED
import pytest

EPISODES, SEED = 2, 382
PACE = 0.02  # s between steps, for a person who watches
OPTIONS = touring()
PLAN = make_plan(TAXI, OPTIONS, PlanRequest('human'))
STARTS = episode_starts(TAXI, SEED, EPISODES)
PLAYED = {each: play_plan(as_executed(PLAN, each), STARTS) for each in Arbitration}


@pytest.fixture(scope='module')
def acting(shared: Graph) -> Acting:
    return start_acting(shared, episodes=EPISODES, seed=SEED)


@pytest.mark.parametrize('execution', list(Arbitration)[1:])
def test_what_is_played_is_the_vectorised_play_each_time(
    acting: Acting, execution: Arbitration
) -> None:
    """Options that run to the end are in test_planner_node.py."""
    expected, ends = PLAYED[execution], []
    for _ in range(2):
        result = acting.play(execution, max_decisions=0)
        assert result.status == PolicyResult.STATUS_DONE
        assert (result.execution, result.execution_changes) == (execution, 0)
        assert result.mean_return == expected.total.mean()
        assert result.mean_discounted_return == pytest.approx(expected.discounted.mean())
        assert result.decisions == expected.decisions.sum()
        assert result.fallbacks == expected.fallbacks.sum()
        assert (result.interruptions > 0) == (execution is Arbitration.INTERRUPTED)
        ends.append(
            [(r.status, r.option_name, r.step_count, list(r.acted_names)) for r in acting.runs]
        )
    assert ends[0] == ends[1]
    differ = {(*played.decisions, *played.total) for played in PLAYED.values()}
    assert len(differ) == len(PLAYED)  # so that the comparison shows something


def test_modules_of_an_episode_are_one_run(acting: Acting) -> None:
    result = acting.play(Arbitration.MODULAR_STRONGEST, max_decisions=0)
    acting.graph.until(lambda: len(acting.runs) == EPISODES, 'the runs')
    assert result.decisions == sum(run.step_count for run in acting.runs)
    assert {run.status for run in acting.runs} == {OptionResult.STATUS_EPISODE_OVER}
    for run in acting.runs:
        assert (run.option_name, run.execution) == ('', Arbitration.MODULAR_STRONGEST)
        assert sum(run.acted_steps) == run.step_count
        assert set(run.acted_names) <= set(PLAN.names)


def test_an_unknown_or_late_execution_is_refused(acting: Acting) -> None:
    result = acting.play('at_random')
    assert (result.status, uuid_from_message(result.run_id)) == (
        PolicyResult.STATUS_BAD_REQUEST,
        '',
    )
    known = 'run_to_end, interrupted, modular_mass, modular_strongest'
    assert result.detail == f"unknown execution 'at_random'; choose from {known}"
    answer = acting.change('at_random')
    assert (answer.status, answer.detail) == (answer.STATUS_BAD_REQUEST, result.detail)
    assert acting.change('').status == answer.STATUS_BAD_REQUEST
    late = acting.change('interrupted')
    assert (late.status, 'run_policy' in late.detail) == (late.STATUS_NO_RUN, True)


def test_a_plan_stops_an_option_of_any_client(acting: Acting) -> None:
    acting.play('interrupted', episodes=1)
    alone = acting.run(option_name=TOUR)
    assert (alone.status, alone.execution) == (OptionResult.STATUS_REACHED, 'run_to_end')
    stopped = acting.run(option_name=TOUR, execution='interrupted', plan_id=acting.plan_id)
    assert stopped.status == OptionResult.STATUS_STOPPED_BY_PLAN
    assert stopped.detail == 'another choice is worth more than continuing'
    assert stopped.final_state == 'taxi 0,4 passenger G destination B'
    assert stopped.step_count < alone.step_count


@pytest.mark.parametrize(
    ('fields', 'status', 'says'),
    [
        ({'execution': 'interrupted'}, 'BAD_REQUEST', 'give its plan_id'),
        ({'execution': 'later'}, 'BAD_REQUEST', "execution 'later'; choose from run_to_end"),
        (
            {'execution': 'modular_mass', 'plan_id': 'mine'},
            'BAD_REQUEST',
            'leave option_name empty',
        ),
        (
            {'execution': 'interrupted', 'plan_id': 'mine'},
            'NO_VALUES',
            'the option values of plan mine did not arrive; the newest are those of ',
        ),
    ],
)
def test_a_run_that_cannot_be_arbitrated_is_refused_in_words(
    acting: Acting, fields: dict[str, Any], status: str, says: str
) -> None:
    acting.play('interrupted', episodes=1)
    with acting.graph.hurried():
        result = acting.run(option_name=TOUR, **fields)
    assert result.status == getattr(OptionResult, f'STATUS_{status}')
    assert says in result.detail
    assert (uuid_from_message(result.run_id), result.execution) == ('', '')


def test_values_for_options_that_are_not_there_any_more_are_refused(acting: Acting) -> None:
    acting.play('interrupted', episodes=1)
    acting.teach([option for option in OPTIONS if option.name != USE])
    try:
        acting.graph.until(
            lambda: acting.run(option_name=USE).status == OptionResult.STATUS_UNKNOWN_OPTION,
            'the options',
        )
        result = acting.run(option_name=TOUR, execution='interrupted', plan_id=acting.plan_id)
        assert result.status == OptionResult.STATUS_UNKNOWN_OPTION
        assert repr(USE) in result.detail
    finally:
        acting.teach(OPTIONS)
        acting.plan_id = acting.plan('human').plan_id


def test_values_that_are_on_their_way_are_waited_for(acting: Acting) -> None:
    """They and the request come on different ways."""
    values = option_values_to_message(option_values(PLAN), 'mine', '')
    values.publisher_id = '/planner#test'
    planner = acting.graph.node.create_publisher(OptionValues, 'option_values', LATCHED)
    acting.graph.until(planner.get_subscription_count, 'option_server to listen')
    state = acting.player.fresh(START)
    asked = {'option_name': TOUR, 'execution': 'interrupted', 'plan_id': 'mine'}
    waiting = acting.graph.request(RunOption, 'run_option', episode=state.episode, **asked)
    busy = acting.graph.ask(RunOption, 'run_option', option_name=USE).result
    assert busy.status == OptionResult.STATUS_BUSY
    planner.publish(values)
    acting.graph.until(waiting.done, 'the run')
    assert waiting.result().result.status == OptionResult.STATUS_STOPPED_BY_PLAN
    acting.graph.node.destroy_publisher(planner)


@pytest.fixture(scope='module')
def paced(acting: Acting) -> Acting:
    """The same, at a pace for a person who watches."""
    acting.graph.ask(SetPace, 'set_pace', step_period=PACE)
    acting.episodes = 1
    return acting


@pytest.mark.parametrize('execution', ['interrupted', 'modular_mass'])
def test_a_change_takes_effect_within_the_episode(paced: Acting, execution: str) -> None:
    goal = paced.begin('run_to_end', episodes=200)
    paced.graph.until(lambda: len(paced.commands) > 3, 'some steps')
    answer = paced.change(execution)
    assert (answer.status, answer.previous) == (answer.STATUS_OK, 'run_to_end')
    episode = paced.player.state.episode
    paced.graph.until(
        lambda: paced.runs and paced.runs[-1].execution == execution, 'a run that knows it'
    )
    assert paced.runs[-1].episode == episode
    order = ['run_to_end', execution]
    for each in ('modular_strongest', 'interrupted', 'run_to_end', 'modular_mass'):
        paced.commands.clear()
        paced.graph.until(lambda: len(paced.commands) > 1, 'two steps')
        answer = paced.change(each)
        assert (answer.status, answer.previous) == (answer.STATUS_OK, order[-1])
        order.append(each)
    assert paced.change('modular_mass').previous == 'modular_mass'  # changes nothing
    goal.cancel()
    _, result = goal.result(5.0)
    assert (result.execution, result.execution_changes) == (order[-1], len(order) - 1)
    changes = [(e.previous, e.execution) for e in paced.executions if e.run_id == result.run_id]
    assert [each for each in changes if each[0]] == list(pairwise(order))
    changed = {r.detail for r in paced.runs if r.status == OptionResult.STATUS_EXECUTION_CHANGED}
    assert 'the execution was changed: from modular_strongest to interrupted' in changed
    assert result.interruptions == sum(
        r.status == OptionResult.STATUS_STOPPED_BY_PLAN for r in paced.runs
    )


@pytest.mark.parametrize('execution', ['modular_mass', 'interrupted'])
def test_a_policy_is_canceled_within_the_episode(paced: Acting, execution: str) -> None:
    goal = paced.begin(execution)
    paced.graph.until(lambda: len(paced.commands) > 2, 'some steps')
    if execution == 'modular_mass':  # modules are one run, also for others
        second = paced.graph.ask(RunOption, 'run_option', option_name='action:north').result
        assert second.status == OptionResult.STATUS_BUSY
        assert 'modular_mass' in second.detail
    goal.cancel()
    status, result = goal.result(2.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, PolicyResult.STATUS_CANCELED)
    assert result.episodes == 0
    paced.graph.until(lambda: paced.runs, 'the run')
    assert paced.runs[-1].status == OptionResult.STATUS_CANCELED


def test_running_modules_keep_their_options_when_others_are_learned(
    paced: Acting,
) -> None:
    goal = paced.begin('modular_mass')
    paced.graph.until(lambda: len(paced.commands) > 2, 'some steps')
    learned = paced.teach([])
    try:
        known = len(paced.commands)
        paced.graph.until(lambda: len(paced.commands) > known + 4, 'more steps')
        goal.cancel()
        _, result = goal.result(5.0)
        assert result.status == PolicyResult.STATUS_CANCELED
        again = paced.play('modular_mass')
        assert again.status == PolicyResult.STATUS_NO_PLAN
    finally:
        assert paced.teach(touring()) == learned + len(touring())
        paced.plan_id = paced.plan('human').plan_id


def test_modules_run_as_an_action_too_and_say_who_acts(paced: Acting) -> None:
    paced.play('modular_mass', max_decisions=1)
    state = paced.player.fresh(START)
    goal = paced.graph.act(
        ExecuteOption,
        'execute_option',
        execution='modular_mass',
        plan_id=paced.plan_id,
        max_steps=6,
        episode=state.episode,
    )
    _, result = goal.result(10.0)
    assert (result.status, result.step_count) == (OptionResult.STATUS_MAX_STEPS, 6)
    assert 0 < len(goal.feedback) <= 6
    assert {f.option_name for f in goal.feedback} <= set(result.acted_names)
    goal = paced.graph.act(
        ExecuteOption, 'execute_option', execution='modular_mass', plan_id=paced.plan_id
    )
    paced.graph.until(lambda: goal.feedback, 'feedback')
    goal.cancel()
    status, result = goal.result(2.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, OptionResult.STATUS_CANCELED)
