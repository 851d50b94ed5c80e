"""Who watches changes how a policy is carried out, ends it, or takes over: at once."""

from action_msgs.msg import GoalStatus
from graph_support.live import Graph
from graph_support.planning import Acting, START, start_acting
from graph_support.player import PERSON
from graph_support.scripted import touring
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import OptionResult, PolicyResult
from humanopts_interfaces.srv import RunOption
import pytest

SEED, PACE = 12, 0.02  # s between steps, so that there is time


@pytest.fixture(scope='module')
def paced(shared: Graph) -> Acting:
    return start_acting(shared, episodes=1, seed=SEED, step_period=PACE)


@pytest.mark.parametrize('execution', ['interrupted', 'modular_mass', 'modular_strongest'])
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
    goal.cancel()
    _, result = goal.result(5.0)
    assert (result.execution, result.execution_changes) == (execution, 1)
    (said,) = [s for s in paced.executions if s.run_id == result.run_id and s.previous]
    assert (said.previous, said.execution) == ('run_to_end', execution)


def test_modules_give_way_to_options_and_other_modules(paced: Acting) -> None:
    goal = paced.begin('modular_mass', episodes=200)
    order = ('modular_strongest', 'interrupted', 'run_to_end', 'modular_mass')
    for execution in order:
        paced.commands.clear()
        paced.graph.until(lambda: len(paced.commands) > 1, 'two steps')
        answer = paced.change(execution)
        assert answer.status == answer.STATUS_OK
    again = paced.change('modular_mass')
    assert (again.status, again.previous) == (again.STATUS_OK, 'modular_mass')
    goal.cancel()
    _, result = goal.result(5.0)
    assert result.execution_changes == len(order)
    changed = [r for r in paced.runs if r.status == OptionResult.STATUS_EXECUTION_CHANGED]
    assert changed[0].detail == 'the execution was changed: from modular_mass to modular_strongest'
    assert result.interruptions == sum(
        r.status == OptionResult.STATUS_STOPPED_BY_PLAN for r in paced.runs
    )


@pytest.mark.parametrize('execution', ['modular_mass', 'interrupted'])
def test_a_policy_is_canceled_within_the_episode(paced: Acting, execution: str) -> None:
    goal = paced.begin(execution)
    paced.graph.until(lambda: len(paced.commands) > 2, 'some steps')
    goal.cancel()
    status, result = goal.result(2.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, PolicyResult.STATUS_CANCELED)
    assert result.episodes == 0
    paced.graph.until(lambda: paced.runs, 'the run')
    assert paced.runs[-1].status == OptionResult.STATUS_CANCELED


def test_modules_that_were_begun_are_not_changed_by_what_is_learned_meanwhile(
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
        assert paced.teach(touring()) == learned + 1
        paced.plan_id = paced.plan('human').plan_id


def test_a_person_takes_over_from_modules(paced: Acting) -> None:
    goal = paced.begin('modular_strongest')
    paced.graph.until(lambda: len(paced.commands) > 2, 'some steps')
    paced.player.do('north', PERSON)
    _, result = goal.result(5.0)
    assert result.status == PolicyResult.STATUS_INTERRUPTED
    paced.graph.until(lambda: paced.runs, 'the run')
    assert paced.runs[-1].status == OptionResult.STATUS_INTERRUPTED


def test_modules_are_one_run_and_a_second_one_is_answered_busy(paced: Acting) -> None:
    goal = paced.begin('modular_mass')
    paced.graph.until(lambda: len(paced.commands) > 2, 'some steps')
    second = paced.graph.ask(RunOption, 'run_option', option_name='action:north').result
    assert second.status == OptionResult.STATUS_BUSY
    assert 'modular_mass' in second.detail
    goal.cancel()
    goal.result(5.0)


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
    assert len(goal.feedback) == 6
    assert {f.option_name for f in goal.feedback} == set(result.acted_names)
    goal = paced.graph.act(
        ExecuteOption, 'execute_option', execution='modular_mass', plan_id=paced.plan_id
    )
    paced.graph.until(lambda: goal.feedback, 'feedback')
    goal.cancel()
    status, result = goal.result(2.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, OptionResult.STATUS_CANCELED)
