"""Planning in Gymnasium's own tables, with and without chance, to their known optima."""

from humanopts_env.domains.gymnasium_domain import gymnasium_domain
from humanopts_learner.planning.evaluate import episode_starts, play
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest
import pytest


def test_the_slippery_lake_is_crossed_as_often_as_it_can_be() -> None:
    """Gymnasium gives 0.74 as the optimum within its 100 steps; 20,000 games, error 0.003."""
    lake = gymnasium_domain('FrozenLake-v1')()
    plan = make_plan(lake, [], PlanRequest('primitive'))
    assert plan.solution.values[0] == pytest.approx(0.5420, abs=5e-5)  # at gamma 0.99
    returns = play(plan, episode_starts(lake, seed=0, episodes=20_000))
    assert returns.total.mean() == pytest.approx(0.74, abs=0.015)


def test_the_cliff_is_passed_in_thirteen_steps() -> None:
    """Along its edge, since nothing slips."""
    cliff = gymnasium_domain('CliffWalking-v1')()
    returns = play(make_plan(cliff, [], PlanRequest('primitive')), cliff.start_states())
    assert returns.total.tolist() == [-13.0]
    assert returns.successes.all()


def test_on_a_slippery_cliff_the_way_is_longer() -> None:
    """And no game falls for ever."""
    cliff = gymnasium_domain('CliffWalkingSlippery-v1')()
    returns = play(
        make_plan(cliff, [], PlanRequest('primitive')), episode_starts(cliff, 0, 500), seed=1
    )
    assert returns.successes.all()
    assert returns.steps.mean() > 13


def test_a_taxi_of_gymnasium_delivers_every_passenger() -> None:
    """With its own rewards: 20 for the delivery, -1 for every other step."""
    taxi = gymnasium_domain('Taxi-v4')()
    returns = play(make_plan(taxi, [], PlanRequest('primitive')), taxi.start_states())
    assert returns.successes.all()
    assert (returns.total == 21 - returns.steps).all()
