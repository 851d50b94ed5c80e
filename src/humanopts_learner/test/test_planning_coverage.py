"""What the options of a plan do not cover, against a walk of the plan one step at a time."""

from dataclasses import replace

from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.learned_option import TabularOption
from humanopts_learner.planning.evaluate import find_coverage
from humanopts_learner.planning.exact_plan import ExactPlan, make_exact_plan
from humanopts_learner.planning.request import PlanError, PlanRequest
import numpy as np
import pytest

TAXI = Taxi()
PICKUP, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'


def option(name: str) -> TabularOption:
    """Return a reference option as tables."""
    return TabularOption.of_reference(reference_options(TAXI)[name])


def planned(*options: TabularOption, action_set: str = 'human') -> ExactPlan:
    """Plan with options."""
    return make_exact_plan(TAXI, options, PlanRequest(action_set))


def decisions(plan: ExactPlan) -> dict[int, str]:
    """Walk from every start, and return what was decided where."""
    found = {}
    rng = np.random.default_rng(0)
    names = [action.name for action in TAXI.actions]
    by_name = {option.name: option for option in plan.options}
    for start in TAXI.start_states().tolist():
        at, running, over = start, '', False
        for _ in range(TAXI.max_steps):
            if over:
                break
            if not running:
                found[at] = running = plan.choose(TAXI.state_at(at)).name
            table = by_name.get(running)
            action = (
                names.index(running.removeprefix('action:')) if table is None else table.action[at]
            )
            outcome = TAXI.step(TAXI.state_at(at), int(action), rng)
            at, over = TAXI.index(outcome.state), outcome.terminated
            if table is None or table.termination[at]:
                running = ''
    return found


def test_options_that_cover_the_task_leave_nothing_to_teach() -> None:
    found = find_coverage(planned(option(PICKUP), option(DELIVER)))
    assert found.fallback.size == found.single_step.size == found.gain.size == 0


def test_where_no_option_can_start_the_plan_falls_back_and_these_states_are_told() -> None:
    plan = planned(option(PICKUP))
    found = find_coverage(plan, most=10_000)
    walked = {at for at, name in decisions(plan).items() if name.startswith('action:')}
    assert set(found.fallback.tolist()) == walked
    aboard = TAXI.feature_table()[found.fallback]
    assert len(walked) > 10
    column = [feature.name for feature in TAXI.features].index('passenger_in_taxi')
    assert set(aboard[:, column].tolist()) == {1}
    first = find_coverage(plan, most=3).fallback.tolist()
    assert first == found.fallback.tolist()[:3]


def test_a_detour_of_an_option_is_worth_less_than_a_single_step_by_what_it_costs() -> None:
    """An option that first goes once around loses the reward of these steps."""
    pickup = option(PICKUP)
    start = TAXI.decode('taxi 2,0 passenger R destination G')
    at = TAXI.index(start)
    away = next(
        action
        for action in range(len(TAXI.actions))
        if TAXI.transitions().successor[at, action, 0]
        == TAXI.index(TAXI.decode('taxi 3,0 passenger R destination G'))
    )
    action = pickup.action.copy()
    action[at] = away  # south, from where the right way leads back to it: it walks in a circle
    plan = planned(replace(pickup, action=action, max_steps=3), option(DELIVER))
    found = find_coverage(plan, most=10_000)
    walked = decisions(plan)
    assert at in found.single_step
    assert set(found.single_step.tolist()) <= set(walked)
    assert (np.diff(found.gain) <= 0).all()
    transitions, values = TAXI.transitions(), plan.solution.values
    for state, gain in zip(found.single_step.tolist(), found.gain.tolist()):
        ahead = [
            transitions.reward[state, a, 0]
            + (not transitions.terminated[state, a, 0])
            * plan.gamma
            * values[transitions.successor[state, a, 0]]
            for a in range(len(TAXI.actions))
        ]
        assert gain == pytest.approx(max(ahead) - values[state])
        assert gain > 0


@pytest.mark.parametrize('action_set', ['primitive', 'human+primitive'])
def test_of_plans_with_single_steps_it_is_not_known(action_set: str) -> None:
    with pytest.raises(PlanError, match='options only'):
        find_coverage(planned(option(PICKUP), action_set=action_set))


def test_it_is_found_in_a_game_with_chance_too() -> None:
    rooms = Rooms()
    wanders = TabularOption(
        'nowhere',
        5,
        np.zeros(rooms.n_states, dtype=np.intp),
        np.arange(rooms.n_states) % 2 == 0,
        np.zeros(rooms.n_states, dtype=np.bool_),
    )
    found = find_coverage(make_exact_plan(rooms, [wanders], PlanRequest('human')))
    assert found.fallback.size > 0
    assert (found.fallback % 2 == 1).all()
