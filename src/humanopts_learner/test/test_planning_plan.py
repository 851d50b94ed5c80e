"""Plans on Taxi: action sets, fallback, progress, and what is refused."""

from dataclasses import replace
from functools import cache
import math
from types import SimpleNamespace
from typing import Any, cast

from humanopts_env.domains.base import Domain
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.option import (
    LearnedOption,
    option_from_table,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.evaluate import episode_starts, play
from humanopts_learner.planning.exact import ExactPlan, make_exact_plan
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import NoOptionsError, PlanCanceled, PlanError, PlanRequest
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI = Taxi()
PICKUP = 'go to passenger and pickup'
DROPOFF = 'go to destination and dropoff'


@cache
def tabled(name: str, max_steps: int = 200) -> TabularOption:
    """Return a reference option as tables."""
    return TabularOption.of_reference(reference_options(TAXI)[name], max_steps)


@cache
def learned(name: str, domain: Taxi = TAXI) -> LearnedOption:
    """Return a reference option as trees that say the same in every state."""
    names = [feature.name for feature in domain.features]
    table = TabularOption.of_reference(reference_options(domain)[name])
    return option_from_table(domain, table, names, domain.feature_table())


@cache
def plan(action_set: str) -> ExactPlan:
    """Return a plan with the two exact options."""
    return make_plan(TAXI, [learned(PICKUP), learned(DROPOFF)], PlanRequest(action_set))


@pytest.mark.parametrize('action_set', ['human', 'primitive', 'human+primitive'])
def test_every_action_set_reaches_the_optimum_of_taxi(action_set: str) -> None:
    found = plan(action_set)
    assert found.solution.converged
    assert found.solution.values == pytest.approx(shortest_way_values(), abs=1e-7)
    returns = play(found, TAXI.start_states())
    assert returns.successes.all()
    assert returns.fallbacks.sum() == 0


def shortest_way_values() -> NDArray[np.float64]:
    """Return the discounted return of fetching and delivering by shortest ways, (S,)."""
    options = reference_options(TAXI)
    fetch, deliver = options[PICKUP], options[DROPOFF]
    values = np.zeros(TAXI.n_states)
    for state in np.flatnonzero(~TAXI.over()):
        rewards, at = [], int(state)
        while not TAXI.over()[at]:
            option = fetch if fetch.initiation[at] else deliver
            action = int(np.flatnonzero(option.optimal[at])[0])
            rewards.append(float(TAXI.transitions().reward[at, action, 0]))
            at = int(TAXI.transitions().successor[at, action, 0])
        values[state] = sum(TAXI.gamma**i * reward for i, reward in enumerate(rewards))
    return values


@pytest.mark.parametrize('action_set', ['human', 'primitive', 'human+primitive'])
def test_mean_discounted_return_equals_the_planned_values(action_set: str) -> None:
    starts = episode_starts(TAXI, seed=3, episodes=100)
    found = plan(action_set)
    returns = play(found, starts)
    assert returns.discounted == pytest.approx(found.solution.values[starts], abs=1e-7)


def test_columns_are_named_and_a_plan_of_full_options_has_no_primitive_actions() -> None:
    primitives = tuple(f'action:{action.name}' for action in TAXI.actions)
    assert plan('human').names == (PICKUP, DROPOFF)
    assert plan('primitive').names == primitives
    assert plan('human+primitive').names == (PICKUP, DROPOFF, *primitives)


def test_where_no_option_is_available_the_best_primitive_action_is_a_counted_fallback() -> None:
    found = make_plan(TAXI, [learned(DROPOFF)], PlanRequest('human'))
    aboard, over = learned_tables(DROPOFF).initiation, TAXI.over()
    for state in np.flatnonzero(~over).tolist():
        decision = found.choose(TAXI.state_at(state))
        assert decision.fallback == (not aboard[state])
        assert decision.name.startswith('action:') == decision.fallback
    stuck = np.flatnonzero(~over & ~aboard)
    rules, values = TAXI.transitions(), found.solution.values
    ahead = rules.reward[stuck, :, 0] + TAXI.gamma * values[rules.successor[stuck, :, 0]]
    best = found.solution.best[stuck] - len(found.options)
    assert ahead[np.arange(len(stuck)), best] == pytest.approx(ahead.max(axis=1))
    starts = TAXI.start_states()
    returns = play(found, starts)
    fetch = reference_options(TAXI)[PICKUP]
    assert (returns.fallbacks == fetch.distance[starts]).all()
    assert (returns.decisions == fetch.distance[starts] + 1).all()


def learned_tables(name: str) -> TabularOption:
    """Return what the trees say in every state."""
    return tabulate(learned(name), TAXI)


@pytest.mark.parametrize('max_steps', [1, 2, 3, 5])
def test_options_cut_off_by_max_steps_are_planned_and_played_alike(max_steps: int) -> None:
    options = [tabled(PICKUP, max_steps), tabled(DROPOFF, max_steps)]
    found = make_exact_plan(TAXI, options, PlanRequest('human'))
    returns = play(found, TAXI.start_states())
    assert returns.discounted == pytest.approx(found.solution.values[TAXI.start_states()])
    fetch, deliver = (reference_options(TAXI)[name] for name in (PICKUP, DROPOFF))
    runs = -(-fetch.distance[TAXI.start_states()] // max_steps)
    assert (returns.decisions > runs).all()
    assert returns.successes.all()
    assert deliver.initiation.any()


def test_play_equals_single_episodes_in_the_rules_of_the_game() -> None:
    options = [tabled(PICKUP, 4), tabled(DROPOFF, 3), tabled('move away from obstacles', 2)]
    found = make_exact_plan(TAXI, options, PlanRequest('human'))
    starts = episode_starts(TAXI, seed=8, episodes=40)
    returns = play(found, starts, max_steps=15)
    by_name = {option.name: option for option in options}
    for episode, start in enumerate(starts.tolist()):
        expected = play_one(found, by_name, start, limit=15)
        assert returns.total[episode] == expected.total
        assert returns.discounted[episode] == pytest.approx(expected.discounted)
        assert returns.steps[episode] == expected.steps
        assert returns.decisions[episode] == expected.decisions
        assert returns.successes[episode] == expected.success


def play_one(found: ExactPlan, options: dict[str, TabularOption], start: int, limit: int) -> Any:
    """Play one episode, the slow and obvious way."""
    rng = np.random.default_rng(0)
    state = TAXI.state_at(start)
    result = SimpleNamespace(total=0.0, discounted=0.0, steps=0, decisions=0, success=False)
    while result.steps < limit and not result.success:
        option = options[found.choose(state).name]
        result.decisions += 1
        for _ in range(option.max_steps):
            outcome = TAXI.step(state, int(option.action[TAXI.index(state)]), rng)
            state = outcome.state
            result.total += outcome.reward
            result.discounted += TAXI.gamma**result.steps * outcome.reward
            result.steps += 1
            result.success = outcome.terminated
            ends = option.termination[TAXI.index(state)]
            if result.success or ends or result.steps == limit:
                break
    return result


def test_an_episode_start_does_not_depend_on_how_many_are_drawn() -> None:
    few, many = episode_starts(TAXI, 5, 3), episode_starts(TAXI, 5, 30)
    assert many[:3].tolist() == few.tolist()
    assert len(set(many.tolist())) > 10
    assert set(many.tolist()) <= set(TAXI.start_states().tolist())
    assert episode_starts(TAXI, 6, 30).tolist() != many.tolist()


def test_play_refuses_starts_that_are_no_states() -> None:
    with pytest.raises(PlanError, match=r'0\.\.499'):
        play(plan('human'), np.array([500]))
    endless = Taxi()
    endless.max_steps = 0
    with pytest.raises(PlanError, match='max_steps'):
        play(replace(plan('human'), domain=endless), np.array([1]))


def test_no_episodes_are_played_without_complaint() -> None:
    assert len(play(plan('human'), episode_starts(TAXI, 0, 0)).total) == 0


def test_choose_refuses_states_in_which_nothing_is_to_be_done() -> None:
    over = TAXI.state_at(int(np.flatnonzero(TAXI.over())[0]))
    with pytest.raises(PlanError, match='the task is over'):
        plan('human').choose(over)


def test_progress_goes_through_every_stage_and_only_forward() -> None:
    seen: list[tuple[str, float, int, float]] = []
    options, request = [learned(PICKUP), learned(DROPOFF)], PlanRequest('human+primitive')
    found = make_plan(TAXI, options, request, progress=lambda *now: seen.append(now))
    assert list(dict.fromkeys(stage for stage, *_ in seen)) == ['tables', 'models', 'sweeps']
    for stage in ('tables', 'models', 'sweeps'):
        fractions = [fraction for name, fraction, *_ in seen if name == stage]
        assert fractions == sorted(fractions)
        assert 0.0 <= fractions[0] <= fractions[-1] <= 1.0
    assert math.isnan(seen[0][3])
    assert seen[-1] == ('sweeps', 1.0, found.solution.sweeps, found.solution.residual)


@pytest.mark.parametrize('stage', ['tables', 'models', 'sweeps'])
def test_planning_can_be_canceled_in_every_stage(stage: str) -> None:
    def cancel(now: str, fraction: float, sweeps: int, residual: float) -> None:
        if now == stage:
            raise PlanCanceled

    with pytest.raises(PlanCanceled):
        make_plan(TAXI, [learned(PICKUP)], PlanRequest('human'), progress=cancel)


def test_seconds_are_those_of_the_clock() -> None:
    ticks = iter(range(100))
    clock = lambda: float(next(ticks))  # noqa: E731
    found = make_plan(TAXI, [learned(PICKUP)], PlanRequest('human'), clock=clock)
    assert (found.table_seconds, found.model_seconds, found.sweep_seconds) == (1.0, 1.0, 1.0)


def test_a_request_that_makes_no_sense_is_refused_by_name() -> None:
    option = learned(PICKUP)
    with pytest.raises(PlanError, match='human, primitive'):
        make_plan(TAXI, [option], PlanRequest('robot'))
    with pytest.raises(NoOptionsError, match='teach one'):
        make_plan(TAXI, [], PlanRequest('human'))
    with pytest.raises(PlanError, match=PICKUP):
        make_plan(TAXI, [option, option], PlanRequest('human'))
    with pytest.raises(PlanError, match='"rows": 6'):
        make_plan(TAXI, [learned(PICKUP, Taxi(6, 6))], PlanRequest('human'))
    with pytest.raises(PlanError, match='max_sweeps'):
        make_plan(TAXI, [option], PlanRequest('human', max_sweeps=-1))
    for gamma in (-0.5, 1.01, math.nan):
        with pytest.raises(PlanError, match='gamma'):
            make_plan(TAXI, [option], PlanRequest('human', gamma=gamma))


def test_a_domain_whose_states_cannot_be_listed_is_refused() -> None:
    unlisted = SimpleNamespace(name='fog', gamma=0.9)
    with pytest.raises(PlanError, match='fog'):
        make_plan(cast(Domain[Any], unlisted), [], PlanRequest('primitive'))
