"""The node planner where states cannot all be listed: sampled plans on the real graph."""

from collections.abc import Callable
from functools import cache
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import Graph
from graph_support.planning import Planning, start_planning
from graph_support.scripted import taught_pacman
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_interfaces.msg import PlanResult, PolicyResult
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan
from humanopts_learner.planning.request import Arbitration, PlanRequest
import pytest

MAZE = make_domain('pacman', {'maze': 'yard', 'max_steps': 80})
EPISODES, SEED, STEPS = 20, 11, 20_000
STOPS = 3  # seed of an episode in which options are stopped


Pure = Callable[..., AnyPlan]  # names of options, an action set


@pytest.fixture(scope='module')
def options() -> list[LearnedOption]:
    return taught_pacman(MAZE)


@pytest.fixture(scope='module')
def pure(options: list[LearnedOption]) -> Pure:
    """Plan by the pure code, once with the same options."""

    @cache
    def plan(*names: str, action_set: str = 'human') -> AnyPlan:
        chosen = [option for option in options if not names or option.name in names]
        return make_plan(MAZE, chosen, PlanRequest(action_set, game_steps=STEPS, seed=SEED))

    return plan


@pytest.fixture(scope='module')
def planning(shared: Graph, options: list[LearnedOption]) -> Planning:
    parameters = {'domain': MAZE.name, 'domain_parameters': parameters_json(MAZE)}
    opened = start_planning(shared, episodes=1, seed=SEED, **parameters)
    opened.teach(options)
    return opened


def numbers(result: PlanResult) -> dict[str, Any]:
    """Return all that a plan and its judgement came to, without what tells two runs apart."""
    apart = {'_header', '_publisher_id', '_sequence', '_plan_id', '_check_fields'}
    fields = [slot for slot in result.__slots__ if slot not in apart]
    return {field: getattr(result, field) for field in fields if not field.endswith('_seconds')}


@pytest.mark.parametrize('action_set', ['human', 'primitive'])
def test_the_same_seed_gives_the_numbers_of_the_pure_code_each_time(
    planning: Planning, pure: Pure, action_set: str
) -> None:
    asked = {'game_steps': STEPS, 'evaluation_episodes': EPISODES}
    first, again = (planning.plan(action_set, **asked) for _ in range(2))
    plan = pure(action_set=action_set)
    found = judge_plan(plan, SEED, EPISODES)
    assert first.status == PlanResult.STATUS_CONVERGED
    assert numbers(again) == numbers(first)
    assert tuple(first.option_names) == plan.names
    assert (first.n_states, first.game_steps) == (len(plan.solution.values), plan.game_steps)
    assert (first.sweeps, first.residual) == (plan.solution.sweeps, plan.solution.residual)
    interval = (first.mean_return_low, first.mean_return, first.mean_return_high)
    assert interval == (found.total.low, found.total.mean, found.total.high)
    assert first.mean_discounted_return == found.discounted.mean
    assert first.fallbacks == found.fallbacks
    assert list(first.outcome_names) == ['cleared', 'lives left']
    for part in ('mean', 'low', 'high'):
        sent = first.outcome_means if part == 'mean' else getattr(first, f'outcome_{part}')
        assert list(sent) == [getattr(outcome, part) for outcome in found.outcomes.values()]


@pytest.fixture(scope='module')
def planned(planning: Planning) -> Planning:
    """With a plan of all options, by which the tests that follow play."""
    planning.plan('human', game_steps=STEPS)
    return planning


@pytest.mark.parametrize('execution', Arbitration)
def test_an_episode_is_the_same_each_time(planned: Planning, execution: Arbitration) -> None:
    """That it is what the pure code plays is in test_planning_interruption.py of the learner."""
    first, again = (planned.play('human', execution=execution, seed=STOPS) for _ in range(2))
    assert first.status == PolicyResult.STATUS_DONE
    assert (execution is Arbitration.INTERRUPTED) == (first.interruptions > 0)
    for field in ('mean_return', 'decisions', 'interruptions', 'fallbacks'):
        assert getattr(again, field) == getattr(first, field)


def test_sampling_is_canceled_at_once(planning: Planning) -> None:
    goal = planning.begin_plan('human', game_steps=10**9)
    planning.graph.until(
        lambda: any(f.stage == 'models' and f.progress > 0 for f in goal.feedback), 'samples'
    )
    goal.cancel()
    status, result = goal.result(5.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, PlanResult.STATUS_CANCELED)
    progress = [f.progress for f in goal.feedback if f.stage == 'models']
    assert progress == sorted(progress)
    assert progress[-1] < 1.0
