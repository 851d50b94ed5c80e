"""Q-learning over options: it comes to the values of planning, and options speed it up."""

from collections.abc import Sequence
from typing import Any

from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner import solve_smdp
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import OptionTable, TabularOption
from humanopts_learner.planning.exact_plan import build_model, option_table
from humanopts_learner.planning.models import look_ahead
from humanopts_learner.planning.request import NoOptionsError, PlanError
from humanopts_learner.qlearning import (
    best_rates_of_each,
    drawn_rates,
    learn_in_step,
    Learners,
    Learning,
    Method,
    Rates,
    Settings,
)
import numpy as np
from numpy.typing import NDArray
import pytest
from random_rules import RandomWorld

TAXI = Taxi()
FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
WILD = Rates(learning_rate=1.0, explore=1.0)  # exact, and tries everything, without chance
MIXED = 'human+primitive'


def learn(
    domain: Any, options: OptionTable, rates: Sequence[Rates], settings: Settings, seed: int
) -> Learning:
    """Have learners with the same options learn."""
    return learn_in_step(domain, [Learners(options, rates)], settings, seed)[0]


def options_of(world: RandomWorld) -> list[TabularOption]:
    """Draw three options; one of them can start in one state only."""
    rng, count = generator(world.seed, 'options'), world.n_states
    starts = np.array([*(rng.random((2, count)) < 0.7), np.arange(count) == 0])
    ends = rng.random((3, count)) < 0.4
    return [
        TabularOption(f'option {n}', 50, rng.integers(3, size=count), starts[n], ends[n])
        for n in range(3)
    ]


def planned(
    world: Any, options: list[TabularOption], action_set: str = MIXED, models: Any = None
) -> NDArray[np.float64]:
    """
    Return the value of every choice (S, O) by SMDP value iteration; NaN where unavailable.

    :param models: options to model instead, with what follows them valued as in the plan.
    """
    values = solve_smdp(build_model(world, action_set, options, world.gamma), 1e-12).values
    ahead = look_ahead(build_model(world, action_set, models or options, world.gamma), values)
    return np.where(np.isfinite(ahead), ahead, np.nan)


def learned(
    world: Any, action_set: str, rates: list[Rates], episodes: int, method: Method, seed: int = 0
) -> Learning:
    """Learn with the options of a random world."""
    choices = option_table(world, action_set, options_of(world))
    return learn(world, choices, rates, Settings(episodes, method), seed)


def taxi_options() -> list[TabularOption]:
    """Return the two options that the participants of the paper taught."""
    found = reference_options(TAXI)
    return [TabularOption.of_reference(found[name]) for name in (FETCH, DELIVER)]


@pytest.mark.heavy
@pytest.mark.parametrize('method', Method)
def test_groups_of_learners_come_to_the_values_of_planning(method: Method) -> None:
    """Without chance and with everything tried often, a rate of 1 comes to them exactly."""
    world = RandomWorld(0)
    sets = 'primitive', MIXED, 'human'
    groups = [Learners(option_table(world, each, options_of(world)), [WILD] * 2) for each in sets]
    found = learn_in_step(world, groups, Settings(200, method), seed=0)
    again = learn_in_step(world, groups, Settings(200, method), seed=0)
    for action_set, learning, repeated in zip(sets, found, again, strict=True):
        exact = planned(world, options_of(world), action_set)
        known = ~np.isnan(exact)
        for values in learning.values:
            assert values[known] == pytest.approx(exact[known], abs=1e-6)
        assert np.array_equal(learning.values, repeated.values)


@pytest.mark.heavy
@pytest.mark.parametrize('method', Method)
def test_with_chance_it_comes_to_the_values_of_planning_on_the_mean(method: Method) -> None:
    """Learners with a small rate, which is worth less than 5 % of the largest value."""
    world = RandomWorld(seed=1, outcomes=2)
    exact = planned(world, options_of(world))
    values = learned(world, MIXED, [Rates(0.1, 1.0)] * 40, 1200, method).values.mean(axis=0)
    known = ~np.isnan(exact)
    assert values[known] == pytest.approx(exact[known], abs=0.05 * np.abs(exact[known]).max())


@pytest.mark.heavy
def test_intra_option_learning_values_options_that_are_never_begun() -> None:
    """Option 2 can start in state 0 only; primitive steps that agree with it teach its value."""
    world = RandomWorld(seed=1)
    everywhere = options_of(world)
    everywhere[2].initiation[:] = True
    exact = planned(world, options_of(world), models=everywhere)[:-1, 2]
    steps, runs = (
        learned(world, MIXED, [WILD], 200, method).values[0, :-1, 2]
        for method in (Method.INTRA_OPTION, Method.SMDP)
    )
    assert steps == pytest.approx(exact, abs=1e-6)
    assert runs[0] == pytest.approx(exact[0], abs=1e-6)
    assert (runs[1:] == 0.0).all()


@pytest.mark.heavy
def test_hallway_options_need_fewer_steps_early_on() -> None:
    """Sutton, Precup and Singh (1999), figure 5: the first ten episodes, intervals apart."""
    rooms = Rooms('G1')
    options = [TabularOption.of_reference(o) for o in reference_options(rooms).values()]
    some, none = (
        learn(rooms, option_table(rooms, s, options), [Rates()] * 20, Settings(10), 0).steps
        for s in (MIXED, 'primitive')
    )
    assert Interval.of(some.mean(axis=1)).high < 0.8 * Interval.of(none.mean(axis=1)).low


@pytest.mark.heavy
def test_taxi_is_learned_at_once_with_the_options_that_people_taught() -> None:
    """Figure 4: with them every episode is about as short as the best; 13 steps on average."""
    human, primitive = (
        learn(TAXI, option_table(TAXI, s, taxi_options()), [Rates()] * 10, Settings(20), 0).steps
        for s in ('human', 'primitive')
    )
    assert human.mean() < 16 < 150 < primitive.mean()


def test_returns_are_the_sum_of_the_rewards_until_an_episode_is_cut_off() -> None:
    """A delivered passenger: 0 for the pickup, 1 for the delivery, -1 for all other steps."""
    choices = option_table(TAXI, 'human', taxi_options())
    learning = learn(TAXI, choices, [Rates()] * 3, Settings(10), 0)
    assert (learning.returns == 3 - learning.steps).all()
    choices = option_table(TAXI, 'primitive', ())
    assert learn(TAXI, choices, [Rates()], Settings(5, max_steps=7), 0).steps.max() == 7
    assert learn(TAXI, choices, [Rates()], Settings(3), 0).steps.max() == TAXI.max_steps


@pytest.mark.heavy
def test_the_search_finds_the_rates_that_learn_faster() -> None:
    slow, fast = Rates(0.1, 1.0), Rates(0.8, 0.02)
    choices = option_table(TAXI, 'human', taxi_options()[:1])
    assert best_rates_of_each(TAXI, [choices], [slow, fast], 4, Settings(40), 0) == [fast]
    drawn = drawn_rates(3, 8)
    assert (len(drawn), drawn[0]) == (8, Rates(0.1, 0.1))
    assert drawn == drawn_rates(3, 8) != drawn_rates(4, 8)


def test_requests_that_make_no_sense_are_refused() -> None:
    choices = option_table(TAXI, 'primitive', ())
    with pytest.raises(PlanError, match='0 episodes'):
        learn(TAXI, choices, [Rates()], Settings(0), 0)
    with pytest.raises(PlanError, match='0 learners'):
        learn(TAXI, choices, [], Settings(1), 0)
    with pytest.raises(PlanError, match='rate must be above 0'):
        Rates(0.0)
    with pytest.raises(NoOptionsError):
        option_table(TAXI, 'human', ())
