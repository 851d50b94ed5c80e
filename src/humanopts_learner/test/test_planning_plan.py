"""What can be asked of planning, and plans of both kinds: action sets, progress, play, judging."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
import math
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains import rooms_reference
from humanopts_env.domains.base import Domain
from humanopts_env.domains.gymnasium_domain import gymnasium_domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import (
    LearnedOption,
    option_from_table,
    options_from_references,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.evaluate import episode_starts, play_plan
from humanopts_learner.planning.exact_plan import ExactPlan, make_exact_plan
from humanopts_learner.planning.plan import judge_plan, make_plan
from humanopts_learner.planning.request import (
    NoOptionsError,
    PlanCanceled,
    PlanError,
    PlanRequest,
    Sampling,
    select_options,
)
from humanopts_learner.planning.sampled_plan import SampledPlan
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI = Taxi()
ROOMS, YARD = Rooms(), PacMan('yard', max_steps=60)
BOTH: list[Any] = [ROOMS, YARD]
HALLWAYS = options_from_references(ROOMS, rooms_reference.reference_options(ROOMS).values())
STEPS, SEED = 4_000, 3
T_4 = 2.7764451051977987  # 97.5 % quantile of Student's t with 4 degrees of freedom
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
    returns = play_plan(found, TAXI.start_states())
    assert returns.successes.all()
    assert returns.fallbacks.sum() == 0
    assert returns.discounted == pytest.approx(found.solution.values[TAXI.start_states()])


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
    returns = play_plan(found, starts)
    fetch = reference_options(TAXI)[PICKUP]
    assert (returns.fallbacks == fetch.distance[starts]).all()
    assert (returns.decisions == fetch.distance[starts] + 1).all()


def learned_tables(name: str) -> TabularOption:
    """Return what the trees say in every state."""
    return tabulate(learned(name), TAXI)


def test_play_equals_single_episodes_in_the_rules_of_the_game() -> None:
    options = [tabled(PICKUP, 4), tabled(DROPOFF, 3), tabled('move away from obstacles', 2)]
    found = make_exact_plan(TAXI, options, PlanRequest('human'))
    starts = episode_starts(TAXI, seed=8, episodes=40)
    returns = play_plan(found, starts, max_steps=15)
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


def request(**values: Any) -> PlanRequest:
    """Ask for primitive actions, from few samples."""
    return PlanRequest(**{'action_set': 'primitive', 'game_steps': STEPS, 'seed': SEED, **values})


@cache
def planned(domain: Domain) -> Any:
    """Return a plan with primitive actions."""
    return make_plan(domain, [], request())


def test_where_states_can_be_listed_the_plan_is_the_exact_one() -> None:
    plan = make_plan(ROOMS, HALLWAYS, request(action_set='human'))
    exact = make_plan(ROOMS, HALLWAYS, PlanRequest('human'))
    assert (plan.names, plan.game_steps) == (exact.names, 0)
    assert np.array_equal(plan.solution.values, exact.solution.values)


def test_an_exact_plan_is_judged_by_the_starts_of_the_seed() -> None:
    """The interval by hand: of five episodes, 2.776 standard errors of the returns each side."""
    plan = make_plan(ROOMS, HALLWAYS[:2], PlanRequest('human'))
    found = judge_plan(plan, SEED, 5)
    returns = play_plan(plan, episode_starts(ROOMS, SEED, 5), seed=SEED)
    error = returns.discounted.std(ddof=1) / math.sqrt(5)
    assert (found.episodes, found.total.mean) == (5, returns.total.mean())
    assert found.discounted.mean == returns.discounted.mean()
    assert found.discounted.high - found.discounted.mean == pytest.approx(T_4 * error)
    assert found.discounted.mean - found.discounted.low == pytest.approx(T_4 * error)
    assert found.fallbacks == returns.fallbacks.sum() > 0
    assert found.outcomes == {}
    with pytest.raises(PlanError, match='0 episodes'):
        judge_plan(plan, SEED, 0)


@pytest.mark.heavy
def test_a_sampled_plan_is_judged_as_it_plays() -> None:
    """Telling how far the games are changes nothing in them."""
    plan = planned(YARD)
    assert isinstance(plan, SampledPlan)
    returns, found = plan.play(SEED, 30), judge_plan(plan, SEED, 30)
    assert found.total == Interval.of(returns.total)
    assert found.discounted == Interval.of(returns.discounted)
    assert found.outcomes == {
        name: Interval.of(values) for name, values in returns.outcomes.items()
    }
    assert found == judge_plan(plan, SEED, 30)


@pytest.mark.heavy
@pytest.mark.parametrize('domain', BOTH, ids=['exact', 'sampled'])
def test_judging_says_how_far_it_is_and_can_be_canceled(domain: Domain) -> None:
    plan, seen = planned(domain), list[float]()

    def note(stage: str, fraction: float, sweeps: int, residual: float) -> None:
        assert (stage, sweeps) == ('evaluation', 0)
        seen.append(fraction)

    def stop(stage: str, fraction: float, sweeps: int, residual: float) -> None:
        if fraction >= share:
            raise PlanCanceled

    judge_plan(plan, SEED, 10, note)
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (0.0, 1.0)
    assert len(set(seen)) > 10
    for share in (0.0, seen[-2]):  # noqa: B007 - stop reads it
        with pytest.raises(PlanCanceled):
            judge_plan(plan, SEED, 10, stop)


@pytest.mark.heavy
def test_the_slippery_lake_is_crossed_as_often_as_it_can_be() -> None:
    """Gymnasium gives 0.74 as the optimum within its 100 steps; 5,000 games, error 0.006."""
    lake = gymnasium_domain('FrozenLake-v1')()
    plan = make_plan(lake, [], PlanRequest('primitive'))
    assert plan.solution.values[0] == pytest.approx(0.5420, abs=5e-5)  # at gamma 0.99
    returns = play_plan(plan, episode_starts(lake, seed=0, episodes=5_000))
    assert returns.total.mean() == pytest.approx(0.74, abs=0.025)


def test_the_cliff_is_passed_in_thirteen_steps() -> None:
    """Along its edge, since nothing slips."""
    cliff = gymnasium_domain('CliffWalking-v1')()
    returns = play_plan(make_plan(cliff, [], PlanRequest('primitive')), cliff.start_states())
    assert returns.total.tolist() == [-13.0]
    assert returns.successes.all()


def test_defaults_fit_the_models() -> None:
    """Exact models need no game steps, and sampled ones no tolerance finer than themselves."""
    asked = PlanRequest('primitive')
    assert asked.in_force(ROOMS, []) == PlanRequest('primitive', 0.9, 1e-8, 10_000, 0)
    assert asked.in_force(YARD, []) == PlanRequest('primitive', 0.985, 1e-3, 10_000, 800_000)
    own = PlanRequest('primitive', 0.5, 0.1, 7, 500, 9)
    assert own.in_force(YARD, []) == own
    assert own.in_force(ROOMS, []) == replace(own, game_steps=0)


@pytest.mark.parametrize(
    ('settings', 'text'),
    [
        ({'action_set': 'robot'}, 'human, primitive'),
        ({'gamma': -0.5}, 'gamma'),
        ({'gamma': 1.01}, 'gamma'),
        ({'gamma': math.nan}, 'gamma'),
        ({'tol': math.nan}, 'tol'),
        ({'max_sweeps': -1}, 'max_sweeps'),
    ],
)
def test_settings_that_make_no_sense_anywhere_are_refused(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(PlanError, match=text):
        PlanRequest(**{'action_set': 'primitive', **settings})


@pytest.mark.parametrize(
    ('numbers', 'text'),
    [
        ({'rounds': 1}, 'two rounds'),
        ({'game_steps': 0}, 'one step of each game in every round'),
        ({'game_steps': 7}, 'one step of each game in every round'),  # of eight rounds
        ({'explore': 1.5}, 'explore from 0 to 1'),
    ],
)
def test_sampling_out_of_range_is_refused(numbers: dict[str, Any], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        Sampling(**numbers)


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        ([], 'teach one'),
        ([HALLWAYS[0], HALLWAYS[0]], f'more than one option is called {HALLWAYS[0].name}'),
        ([replace(HALLWAYS[0], domain_parameters='{"goal": "G2"}')], '"G2"'),
    ],
)
def test_options_that_do_not_fit_are_refused(options: Sequence[LearnedOption], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        PlanRequest('human').in_force(ROOMS, options)
    with pytest.raises(NoOptionsError, match='extract them'):
        PlanRequest('automatic').in_force(ROOMS, [])


def test_too_few_game_steps_are_refused() -> None:
    """Only where models are sampled."""
    few = PlanRequest('primitive', game_steps=399)
    assert few.in_force(ROOMS, []).game_steps == 0
    with pytest.raises(PlanError, match='game_steps is 399, and must be at least 400'):
        few.in_force(YARD, [])


def named(name: str, participant: str) -> LearnedOption:
    """Return an option that a participant taught."""
    return replace(HALLWAYS[0], name=name, participant=participant)


def test_options_are_chosen_by_person_and_name_in_the_order_they_have() -> None:
    """No option is chosen for primitive actions; that there are none is no error yet."""
    a, b, c = named('a', 'ann'), named('b', 'ann'), named('a', 'bob')
    assert select_options([a, b], 'human') == [a, b]
    assert select_options([a, b], 'human', names=['b', 'a']) == [a, b]
    assert select_options([a, b, c], 'human', 'ann', ['b']) == [b]
    assert select_options([a, b, c], 'human', 'bob') == [c]
    assert select_options([a, b, c], 'primitive', names=['fly']) == []
    assert select_options([], 'human', 'eve', ['a']) == []
    with pytest.raises(PlanError, match='name one of ann, bob'):
        select_options([a, b, c], 'human')
    with pytest.raises(NoOptionsError, match="'eve' taught no option; those who did: ann, bob"):
        select_options([a, b, c], 'human', 'eve', ['a'])
    with pytest.raises(PlanError, match="no option 'b', 'fly'; there is 'a'"):
        select_options([a, b, c], 'human', 'bob', ['b', 'a', 'fly'])
