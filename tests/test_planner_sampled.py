"""The node planner where states cannot all be listed: sampled plans on the real graph."""

from collections.abc import Callable
from functools import cache
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import Goal, Graph
from graph_support.planning import Planning, start_planning
from graph_support.scripted import taught_pacman
from humanopts_env.domains.pacman.reference import AVOID_GHOST
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import PlanResult, PolicyResult
from humanopts_learner.library import OptionLibrary
from humanopts_learner.options.option import LearnedOption, Mode
from humanopts_learner.planning.evaluate import episode_start
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan
from humanopts_learner.planning.request import Execution, PlanRequest
from humanopts_learner.planning.sampled.plan import SampledPlan
import numpy as np
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
        told = first.outcome_means if part == 'mean' else getattr(first, f'outcome_{part}')
        assert list(told) == [getattr(outcome, part) for outcome in found.outcomes.values()]


def test_another_seed_gives_another_plan(planning: Planning) -> None:
    one, other = (planning.plan('human', game_steps=STEPS, seed=seed) for seed in (1, 2))
    assert (one.n_states, one.residual) != (other.n_states, other.residual)


def test_the_goal_says_what_is_in_force(planning: Planning, options: list[LearnedOption]) -> None:
    result = planning.plan('human', evaluation_episodes=2, game_steps=STEPS)
    planning.graph.until(
        lambda: planning.plan_goals and planning.plan_goals[-1].plan_id == result.plan_id,
        'the goal',
    )
    goal = planning.plan_goals[-1]
    assert (goal.gamma, goal.tolerance, goal.max_sweeps) == (0.97, 1e-3, 10_000)
    assert (goal.game_steps, goal.evaluation_episodes, goal.seed) == (STEPS, 2, SEED)
    assert list(goal.options) == [option.name for option in options]


def test_some_of_the_options_can_be_planned_with(planning: Planning, pure: Pure) -> None:
    """Where no ghost is near nothing is left, and these fallbacks are counted."""
    result = planning.plan(
        'human', options=[AVOID_GHOST], game_steps=STEPS, evaluation_episodes=EPISODES
    )
    plan = pure(AVOID_GHOST)
    assert tuple(result.option_names) == plan.names
    assert result.fallbacks == judge_plan(plan, SEED, EPISODES).fallbacks > 0


@pytest.mark.parametrize(
    ('fields', 'says'),
    [
        ({'options': ['fly']}, "no option 'fly'; there is 'go to the closest food', "),
        ({'game_steps': 100}, 'game_steps is 100, and must be at least 400'),
        ({'tolerance': -1.0}, 'tol is -1.0'),
        ({'gamma': 2.0}, 'gamma is 2.0'),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_words(
    planning: Planning, fields: dict[str, Any], says: str
) -> None:
    result = planning.plan('human', **fields)
    assert (result.status, result.plan_id) == (PlanResult.STATUS_BAD_REQUEST, '')
    assert says in result.detail


def test_an_episode_is_what_the_pure_code_plays(
    planning: Planning, pure: Pure, options: list[LearnedOption]
) -> None:
    """By the rules, from the same start and with the same chance."""
    planning.plan('human', game_steps=STEPS)
    result = planning.play('human')
    assert result.status == PolicyResult.STATUS_DONE
    total, decisions, fallbacks = played(pure(), options)
    assert (result.episodes, result.mean_return) == (1, total)
    assert (result.decisions, result.fallbacks) == (decisions, fallbacks)


def test_fallbacks_in_an_episode_are_counted(
    planning: Planning, pure: Pure, options: list[LearnedOption]
) -> None:
    planning.plan('human', options=[AVOID_GHOST], game_steps=STEPS)
    result = planning.play('human')
    chosen = [option for option in options if option.name == AVOID_GHOST]
    total, decisions, fallbacks = played(pure(AVOID_GHOST), chosen)
    assert (result.mean_return, result.decisions) == (total, decisions)
    assert result.fallbacks == fallbacks > 0


@pytest.fixture(scope='module')
def planned(planning: Planning) -> Planning:
    """With a plan of all options, by which the tests that follow play."""
    planning.plan('human', game_steps=STEPS)
    return planning


@pytest.mark.parametrize('execution', [e for e in Execution if e is not Execution.RUN_TO_END])
def test_an_arbitrated_episode_is_what_the_pure_code_plays_each_time(
    planned: Planning, pure: Pure, options: list[LearnedOption], execution: Execution
) -> None:
    first, again = (planned.play('human', execution=execution, seed=STOPS) for _ in range(2))
    total, decisions, stopped = arbitrated(pure(), options, execution)
    assert (first.status, first.mean_return) == (PolicyResult.STATUS_DONE, total)
    assert (first.decisions, first.interruptions) == (decisions, stopped)
    assert (execution is Execution.INTERRUPTED) == (stopped > 0)
    assert (again.mean_return, again.decisions) == (total, decisions)
    assert (again.interruptions, again.fallbacks) == (stopped, first.fallbacks)


def arbitrated(
    plan: SampledPlan, options: list[LearnedOption], execution: Execution
) -> tuple[float, int, int]:
    """Play one episode by the policy of many games; return score, decisions and stops."""
    policy, library = plan.as_executed(execution), OptionLibrary(MAZE)
    library.replace(options)
    state = episode_start(MAZE, STOPS, 0)
    rng, column = generator(STOPS, 'episode', MAZE.name), -1
    total, decisions, stopped = 0.0, 0, 0
    for _ in range(MAZE.max_steps):
        if MAZE.is_over(state):
            break
        seen = plan.actions.observe_state(state)
        if column >= 0 and policy.stops(seen, np.array([column]), rng)[0]:
            stopped, column = stopped + 1, -1
        if column < 0:
            decisions, column = decisions + 1, int(policy(seen, rng).option[0])
        option = library.resolve(plan.names[column])
        action = option.choose_action(MAZE.feature_values(state), Mode.GREEDY, rng)
        outcome = MAZE.step(state, action, rng)
        state, total = outcome.state, total + outcome.reward
        modules = execution is not Execution.INTERRUPTED
        if modules or option.choose_end(MAZE.feature_values(state), Mode.GREEDY, rng):
            column = -1
    return total, decisions, stopped


def played(plan: AnyPlan, options: list[LearnedOption]) -> tuple[float, int, int]:
    """Play one episode, the slow and obvious way; return score, decisions and fallbacks."""
    library = OptionLibrary(MAZE)
    library.replace(options)
    state, rng = episode_start(MAZE, SEED, 0), generator(SEED, 'episode', MAZE.name)
    total, steps, decisions, fallbacks = 0.0, 0, 0, 0
    while steps < MAZE.max_steps and not MAZE.is_over(state):
        decision = plan.choose(state)
        decisions, fallbacks = decisions + 1, fallbacks + decision.fallback
        option, ended = library.resolve(decision.name), False
        while not ended and steps < MAZE.max_steps and not MAZE.is_over(state):
            action = option.choose_action(MAZE.feature_values(state), Mode.GREEDY, rng)
            outcome = MAZE.step(state, action, rng)
            state, total, steps = outcome.state, total + outcome.reward, steps + 1
            ended = option.choose_end(MAZE.feature_values(state), Mode.GREEDY, rng)
    return total, decisions, fallbacks


def canceled(planning: Planning, goal: Goal, stage: str) -> PlanResult:
    """Cancel a goal in a stage, and return the result."""
    planning.graph.until(
        lambda: any(f.stage == stage and f.progress > 0 for f in goal.feedback), stage
    )
    goal.cancel()
    status, result = goal.result(5.0)
    assert status == GoalStatus.STATUS_CANCELED
    progress = [f.progress for f in goal.feedback if f.stage == stage]
    assert progress == sorted(progress)
    assert progress[-1] < 1.0
    return result


def test_sampling_is_canceled_at_once(planning: Planning) -> None:
    goal = planning.begin_plan('human', game_steps=10**9)
    assert canceled(planning, goal, 'models').status == PlanResult.STATUS_CANCELED


def test_judging_is_canceled_at_once(planning: Planning) -> None:
    goal = planning.begin_plan('human', game_steps=STEPS, evaluation_episodes=20_000)
    assert canceled(planning, goal, 'evaluation').status == PlanResult.STATUS_CANCELED
