"""One way to plan in any domain: exact and sampled plans asked for, made and judged alike."""

from dataclasses import replace
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_learner.options.option import LearnedOption, options_from_references
from humanopts_learner.planning.evaluate import (
    episode_start,
    episode_starts,
    Interval,
    NORMAL_95,
    play,
)
from humanopts_learner.planning.plan import judge_plan, make_plan
from humanopts_learner.planning.request import (
    NoOptionsError,
    PlanCanceled,
    PlanError,
    PlanRequest,
    select_options,
)
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan
import numpy as np
import pytest

ROOMS, YARD = Rooms(), PacMan('yard', max_steps=60)
BOTH: list[Any] = [ROOMS, YARD]
OPTIONS = options_from_references(ROOMS, reference_options(ROOMS).values())
STEPS, SEED = 4_000, 3


def request(**values: Any) -> PlanRequest:
    """Ask for primitive actions, from few samples."""
    return PlanRequest(**{'action_set': 'primitive', 'game_steps': STEPS, 'seed': SEED, **values})


def test_where_states_can_be_listed_the_plan_is_the_exact_one() -> None:
    """Whatever is asked of samples."""
    plan = make_plan(ROOMS, OPTIONS, request(action_set='human'))
    exact = make_plan(ROOMS, OPTIONS, PlanRequest('human'))
    assert (plan.names, plan.game_steps) == (exact.names, 0)
    assert np.array_equal(plan.solution.values, exact.solution.values)


def test_elsewhere_the_plan_is_the_sampled_one_of_the_seed() -> None:
    """With the number of game steps that were asked for."""
    plan, sampled = (
        make_plan(YARD, [], request()),
        make_sampled_plan(YARD, [], PlanRequest('primitive', game_steps=STEPS, seed=3)),
    )
    assert (plan.names, plan.game_steps) == (sampled.names, STEPS)
    assert np.array_equal(plan.solution.values, sampled.solution.values)
    other = make_plan(YARD, [], request(seed=4))
    assert not np.array_equal(other.solution.values, plan.solution.values)


def test_defaults_fit_the_models() -> None:
    """Exact models need no game steps, and sampled ones no tolerance finer than themselves."""
    asked = PlanRequest('primitive')
    assert asked.in_force(ROOMS, []) == PlanRequest('primitive', 0.9, 1e-8, 10_000, 0)
    assert asked.in_force(YARD, []) == PlanRequest('primitive', 0.97, 1e-3, 10_000, 800_000)
    own = PlanRequest('primitive', 0.5, 0.1, 7, 500, 9)
    assert own.in_force(YARD, []) == own
    assert own.in_force(ROOMS, []) == replace(own, game_steps=0)


def test_an_exact_plan_is_judged_by_the_starts_of_the_seed() -> None:
    """The interval by hand: 1.96 standard errors of the episodes' returns on each side."""
    plan = make_plan(ROOMS, OPTIONS[:2], PlanRequest('human'))
    found = judge_plan(plan, SEED, 40)
    returns = play(plan, episode_starts(ROOMS, SEED, 40), seed=SEED)
    error = returns.discounted.std(ddof=1) / math.sqrt(40)
    assert (found.episodes, found.total.mean) == (40, returns.total.mean())
    assert found.discounted.mean == returns.discounted.mean()
    assert found.discounted.high - found.discounted.mean == pytest.approx(NORMAL_95 * error)
    assert found.discounted.mean - found.discounted.low == pytest.approx(NORMAL_95 * error)
    assert found.fallbacks == returns.fallbacks.sum() > 0
    assert found.outcomes == {}


def test_a_sampled_plan_is_judged_as_it_plays() -> None:
    """Telling how far the games are changes nothing in them."""
    plan = make_plan(YARD, [], request())
    assert isinstance(plan, SampledPlan)
    returns, found = plan.play(SEED, 30), judge_plan(plan, SEED, 30)
    assert found.total == Interval.of(returns.total)
    assert found.discounted == Interval.of(returns.discounted)
    assert found.outcomes == {
        name: Interval.of(values) for name, values in returns.outcomes.items()
    }
    assert found == judge_plan(plan, SEED, 30)


@pytest.mark.parametrize('domain', BOTH, ids=['exact', 'sampled'])
def test_one_episode_has_a_mean_without_bounds(domain: Domain[Any]) -> None:
    """And none is refused."""
    plan = make_plan(domain, [], request())
    found = judge_plan(plan, SEED, 1).total
    assert math.isfinite(found.mean)
    assert math.isnan(found.low)
    assert math.isnan(found.high)
    with pytest.raises(PlanError, match='0 episodes'):
        judge_plan(plan, SEED, 0)


@pytest.mark.parametrize('domain', BOTH, ids=['exact', 'sampled'])
def test_judging_says_how_far_it_is_and_can_be_canceled(domain: Domain[Any]) -> None:
    """From its first start state to its last step."""
    plan, seen = make_plan(domain, [], request()), list[float]()

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


@pytest.mark.parametrize('domain', BOTH, ids=['exact', 'sampled'])
def test_a_plan_chooses_in_states_of_the_domain(domain: Domain[Any]) -> None:
    """A primitive action, never as a fallback where they are what is planned with."""
    plan = make_plan(domain, [], request())
    decision = plan.choose(episode_start(domain, SEED, 0))
    assert decision.name in plan.names
    assert not decision.fallback


def test_what_makes_no_sense_is_refused_before_planning(plain_taxi: Any) -> None:
    """Among it a domain that can be planned in neither way."""
    for domain in BOTH:
        with pytest.raises(PlanError, match='gamma'):
            request(gamma=-1.0).in_force(domain, [])
        with pytest.raises(PlanError, match='tol'):
            request(tol=math.nan).in_force(domain, [])
        with pytest.raises(NoOptionsError):
            request(action_set='human').in_force(domain, [])
    with pytest.raises(PlanError, match='game_steps is 399, and must be at least 400'):
        request(game_steps=399).in_force(YARD, [])
    with pytest.raises(PlanError, match=r'no exact models; .* no method batch_games'):
        request().in_force(plain_taxi, [])
    assert request(game_steps=1).in_force(ROOMS, []).game_steps == 0


def named(name: str, participant: str) -> LearnedOption:
    """Return an option by somebody."""
    return replace(OPTIONS[0], name=name, participant=participant)


def test_options_are_chosen_by_person_and_name_in_the_order_they_have() -> None:
    """Nothing is chosen for primitive actions, and nobody's options is no error yet."""
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
