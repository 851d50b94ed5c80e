"""What can be asked of planning, and plans of both kinds: action sets, play, what is covered."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
import itertools
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
from humanopts_learner import judge_plan, LearnedOption
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import options_from_references, TabularOption
from humanopts_learner.planning.exact_plan import (
    Decision,
    episode_starts,
    ExactPlan,
    find_coverage,
    make_exact_plan,
    play_plan,
)
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import (
    NoOptionsError,
    PlanCanceled,
    PlanError,
    PlanRequest,
    Progress,
    Sampling,
    select_options,
)
from humanopts_learner.planning.sampled_plan import SampledPlan
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI = Taxi()
ROOMS, YARD = Rooms(), PacMan('yard', max_steps=60)
HALLWAYS = options_from_references(ROOMS, rooms_reference.reference_options(ROOMS).values())
SEED = 3
T_4 = 2.7764451051977987  # 97.5 % quantile of Student's t with 4 degrees of freedom
PICKUP = 'go to passenger and pickup'
DROPOFF = 'go to destination and dropoff'


@cache
def tabled(name: str, max_steps: int = 200) -> TabularOption:
    """Return a reference option as tables."""
    return TabularOption.of_reference(reference_options(TAXI)[name], max_steps)


def planned(*options: TabularOption, action_set: str = 'human') -> ExactPlan:
    """Plan with options."""
    return make_exact_plan(TAXI, options, PlanRequest(action_set))


EXACT = tabled(PICKUP), tabled(DROPOFF)


@pytest.mark.parametrize('action_set', ['human', 'primitive', 'human+primitive'])
def test_every_action_set_reaches_the_optimum_of_taxi(action_set: str) -> None:
    found = planned(*EXACT, action_set=action_set)
    assert found.solution.converged
    assert found.solution.values == pytest.approx(shortest_way_values(), abs=1e-7)
    returns = play_plan(found, TAXI.start_states())
    assert returns.successes.all()
    assert returns.fallbacks.sum() == 0
    assert returns.discounted == pytest.approx(found.solution.values[TAXI.start_states()])
    with pytest.raises(PlanError, match='the task is over'):
        found.choose(TAXI.state_at(int(np.flatnonzero(TAXI.over())[0])))


def shortest_way_values() -> NDArray[np.float64]:
    """Return the discounted return of fetching and delivering by shortest ways, (S,)."""
    values = np.zeros(TAXI.n_states)
    for state in np.flatnonzero(~TAXI.over()).tolist():
        rewards, at = [], state
        while not TAXI.over()[at]:
            step = at, EXACT[0 if EXACT[0].initiation[at] else 1].action[at], 0
            rewards.append(TAXI.transitions().reward[step])
            at = TAXI.transitions().successor[step]
        values[state] = sum(TAXI.gamma**i * reward for i, reward in enumerate(rewards))
    return values


def test_play_equals_single_episodes_in_the_rules_of_the_game() -> None:
    options = [tabled(PICKUP, 4), tabled(DROPOFF, 3), tabled('move away from obstacles', 2)]
    found = planned(*options)
    starts = episode_starts(TAXI, seed=8, episodes=40)
    assert starts[:3].tolist() == episode_starts(TAXI, 8, 3).tolist()
    returns = play_plan(found, starts, max_steps=15)
    for episode, start in enumerate(starts.tolist()):
        expected = play_one(found, start, limit=15)
        assert returns.total[episode] == expected.total
        assert returns.discounted[episode] == pytest.approx(expected.discounted)
        assert returns.steps[episode] == expected.steps
        assert returns.decisions[episode] == len(expected.decided)
        assert returns.successes[episode] == expected.success


def play_one(found: ExactPlan, start: int, limit: int) -> Any:
    """Play one episode, the slow and obvious way."""
    rng, state = np.random.default_rng(0), TAXI.state_at(start)
    result = SimpleNamespace(total=0.0, discounted=0.0, steps=0, decided=[], success=False)
    primitives = [f'action:{action.name}' for action in TAXI.actions]
    while result.steps < limit and not result.success:
        decision = found.choose(state)
        result.decided.append((TAXI.index(state), decision))
        option = next((each for each in found.options if each.name == decision.name), None)
        for _ in range(option.max_steps if option else 1):
            at = TAXI.index(state)
            action = option.action[at] if option else primitives.index(decision.name)
            outcome = TAXI.step(state, int(action), rng)
            state = outcome.state
            result.total += outcome.reward
            result.discounted += TAXI.gamma**result.steps * outcome.reward
            result.steps += 1
            result.success = outcome.terminated
            ends = option is None or option.termination[TAXI.index(state)]
            if result.success or ends or result.steps == limit:
                break
    return result


def decided_from_every_start(plan: ExactPlan) -> dict[int, Decision]:
    """Return what was decided where, in an episode from every start."""
    episodes = [play_one(plan, start, TAXI.max_steps) for start in TAXI.start_states().tolist()]
    return dict(each for episode in episodes for each in episode.decided)


def test_options_that_cover_the_task_leave_nothing_to_teach() -> None:
    found = find_coverage(planned(*EXACT))
    assert found.fallback.size == found.single_step.size == found.gain.size == 0
    for action_set in ('primitive', 'human+primitive'):
        with pytest.raises(PlanError, match='options only'):
            find_coverage(planned(*EXACT, action_set=action_set))


def test_where_no_option_can_start_the_best_action_is_a_counted_fallback() -> None:
    plan = planned(EXACT[1])
    walked = decided_from_every_start(plan)
    fetching = np.array([at for at, decision in walked.items() if decision.fallback])
    assert not EXACT[1].initiation[fetching].any()
    assert set(find_coverage(plan, most=10_000).fallback.tolist()) == {*fetching.tolist()}
    assert len(find_coverage(plan, most=3).fallback) == 3
    assert all(d.name.startswith('action:') == d.fallback for d in walked.values())
    rules, values = TAXI.transitions(), plan.solution.values
    ahead = rules.reward[fetching, :, 0] + TAXI.gamma * values[rules.successor[fetching, :, 0]]
    best = plan.solution.best[fetching] - len(plan.options)
    assert ahead[np.arange(len(fetching)), best] == pytest.approx(ahead.max(axis=1))
    starts = TAXI.start_states()
    returns, distance = play_plan(plan, starts), reference_options(TAXI)[PICKUP].distance[starts]
    assert (returns.fallbacks == distance).all()
    assert (returns.decisions == distance + 1).all()


def test_a_detour_of_an_option_is_worth_less_than_a_single_step_by_what_it_costs() -> None:
    """South at 2,0, from where the right way leads back to it: the option walks in a circle."""
    at = TAXI.index(TAXI.decode('taxi 2,0 passenger R destination G'))
    south = next(n for n, action in enumerate(TAXI.actions) if action.name == 'south')
    action = np.where(np.arange(TAXI.n_states) == at, south, EXACT[0].action)
    plan = planned(replace(EXACT[0], action=action, max_steps=3), EXACT[1])
    found = find_coverage(plan, most=10_000)
    assert at in found.single_step
    assert set(found.single_step.tolist()) <= set(decided_from_every_start(plan))
    assert (np.diff(found.gain) <= 0).all()
    rules, values, states = TAXI.transitions(), plan.solution.values, found.single_step
    ahead = values[rules.successor[states, :, 0]] * ~rules.terminated[states, :, 0]
    best = (rules.reward[states, :, 0] + plan.gamma * ahead).max(axis=1)
    assert found.gain == pytest.approx(best - values[states])
    assert (found.gain > 0).all()


def test_progress_goes_through_every_stage_and_can_cancel_in_each() -> None:
    """Seconds are those of the clock."""
    seen: list[tuple[str, float, int, float]] = []
    ticks, request = itertools.count(), PlanRequest('human+primitive')

    def plan(progress: Progress) -> ExactPlan:
        return make_exact_plan(TAXI, EXACT, request, progress, lambda: float(next(ticks)))

    found = plan(lambda *now: seen.append(now))
    assert (found.table_seconds, found.model_seconds, found.sweep_seconds) == (1.0, 1.0, 1.0)
    stages = ['tables', 'models', 'sweeps']
    assert list(dict.fromkeys(stage for stage, *_ in seen)) == stages
    for stage in stages:
        fractions = [fraction for name, fraction, *_ in seen if name == stage]
        assert fractions == sorted(fractions)
        assert 0.0 <= fractions[0] <= fractions[-1] <= 1.0

        def cancel(now: str, *_: Any, stage: str = stage) -> None:
            if now == stage:
                raise PlanCanceled

        with pytest.raises(PlanCanceled):
            plan(cancel)
    assert math.isnan(seen[0][3])
    assert seen[-1] == ('sweeps', 1.0, found.solution.sweeps, found.solution.residual)


def test_an_exact_plan_is_judged_by_the_starts_of_the_seed() -> None:
    """The interval by hand: of five episodes, 2.776 standard errors of the returns each side."""
    plan = make_plan(ROOMS, HALLWAYS[:2], PlanRequest('human'))
    found = judge_plan(plan, SEED, 5)
    returns = play_plan(plan, episode_starts(ROOMS, SEED, 5), seed=SEED)
    error = T_4 * returns.discounted.std(ddof=1) / math.sqrt(5)
    mean = returns.discounted.mean()
    assert (found.episodes, found.total.mean) == (5, returns.total.mean())
    assert found.discounted == Interval(mean, *(pytest.approx(mean + d) for d in (-error, error)))
    assert found.fallbacks == returns.fallbacks.sum() > 0
    assert found.outcomes == {}
    with pytest.raises(PlanError, match='0 episodes'):
        judge_plan(plan, SEED, 0)


@pytest.mark.heavy
@pytest.mark.parametrize('domain', [ROOMS, YARD], ids=['exact', 'sampled'])
def test_judging_reports_progress_changes_nothing_by_it_and_can_be_canceled(
    domain: Domain,
) -> None:
    plan = make_plan(domain, [], PlanRequest('primitive', game_steps=4_000, seed=SEED))
    seen: list[float] = []

    def stop(stage: str, fraction: float, sweeps: int, residual: float) -> None:
        assert (stage, sweeps) == ('evaluation', 0)
        seen.append(fraction)
        if fraction >= share:
            raise PlanCanceled

    share = math.inf
    found = judge_plan(plan, SEED, 10, stop)
    assert found == judge_plan(plan, SEED, 10)
    if isinstance(plan, SampledPlan):
        returns = plan.play(SEED, 10)
        assert found.total == Interval.of(returns.total)
        assert found.outcomes['cleared'] == Interval.of(returns.outcomes['cleared'])
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


def test_defaults_fit_the_models() -> None:
    """Exact models need no game steps, and sampled ones no tolerance finer than themselves."""
    asked = PlanRequest('primitive')
    assert asked.resolved(ROOMS, []) == PlanRequest('primitive', 0.9, 1e-8, 10_000, 0)
    assert asked.resolved(YARD, []) == PlanRequest('primitive', 0.985, 1e-3, 10_000, 800_000)
    own = PlanRequest('primitive', 0.5, 0.1, 7, 500, 9)
    assert own.resolved(YARD, []) == own
    assert own.resolved(ROOMS, []) == replace(own, game_steps=0)
    with pytest.raises(PlanError, match='game_steps is 399, but must be at least 400'):
        PlanRequest('primitive', game_steps=399).resolved(YARD, [])


@pytest.mark.parametrize(
    ('kind', 'settings', 'text'),
    [
        (PlanRequest, {'action_set': 'robot'}, 'human, primitive'),
        (PlanRequest, {'action_set': 'primitive', 'gamma': -0.5}, 'gamma'),
        (PlanRequest, {'action_set': 'primitive', 'gamma': 1.01}, 'gamma'),
        (PlanRequest, {'action_set': 'primitive', 'gamma': math.nan}, 'gamma'),
        (PlanRequest, {'action_set': 'primitive', 'tol': math.nan}, 'tol'),
        (PlanRequest, {'action_set': 'primitive', 'max_sweeps': -1}, 'max_sweeps'),
        (Sampling, {'rounds': 1}, 'two rounds'),
        (Sampling, {'game_steps': 7}, 'one step of each game in every round'),
        (Sampling, {'explore': 1.5}, 'explore from 0 to 1'),
    ],
)
def test_settings_out_of_range_are_refused(
    kind: type, settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(PlanError, match=text):
        kind(**settings)


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
        PlanRequest('human').resolved(ROOMS, options)
    with pytest.raises(NoOptionsError, match='extract them'):
        PlanRequest('automatic').resolved(ROOMS, [])


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
    with pytest.raises(PlanError, match="no option 'b', 'fly'; choose from 'a'"):
        select_options([a, b, c], 'human', 'bob', ['b', 'a', 'fly'])
