"""Q-learning over options: it comes to the values of planning, and options speed it up."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from humanopts_env.domains.base import Action, Transitions
from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import OptionTable, TabularOption
from humanopts_learner.planning.exact_plan import build_model, option_table
from humanopts_learner.planning.request import NoOptionsError, PlanError
from humanopts_learner.planning.solve import solve_smdp
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

TAXI = Taxi()
FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
WILD = Rates(learning_rate=1.0, explore=1.0)  # exact, and tries everything, without chance
MIXED = 'human+primitive'


def learn(
    domain: Any, options: OptionTable, rates: Sequence[Rates], settings: Settings, seed: int
) -> Learning:
    """Have learners with the same options learn."""
    return learn_in_step(domain, [Learners(options, rates)], settings, seed)[0]


@dataclass(frozen=True)
class RandomWorld:
    """Random rules over a few states; what learning and planning ask of a domain."""

    seed: int
    n_states: int = 5
    outcomes: int = 1
    gamma: float = 0.7
    max_steps: int = 10_000
    actions: tuple[Action, ...] = tuple(Action(name, name, '') for name in 'abc')

    @cached_property
    def rules(self) -> Transitions:
        """Drawn once; the task is over in the last state, and action c leads a state nearer."""
        rng, shape = generator(self.seed, 'world'), (self.n_states, 3, self.outcomes)
        successor = rng.integers(self.n_states, size=shape).astype(np.int32)
        successor[:-1, 2, 0] = np.arange(1, self.n_states)
        share = rng.random(shape) + 0.2
        share /= share.sum(axis=2, keepdims=True)
        return Transitions(successor, share, rng.normal(size=shape), self.over()[successor])

    def transitions(self) -> Transitions:
        """Return the rules."""
        return self.rules

    def over(self) -> NDArray[np.bool_]:
        """Return where the task is over."""
        return np.arange(self.n_states) == self.n_states - 1

    def start_states(self) -> NDArray[np.int32]:
        """Begin anywhere else."""
        return np.arange(self.n_states - 1, dtype=np.int32)

    def options(self) -> list[TabularOption]:
        """Draw three options; one of them can start in one state only."""
        rng, count = generator(self.seed, 'options'), self.n_states
        options = [
            TabularOption(
                f'option {n}', 50, rng.integers(3, size=count), rng.random(count) < 0.7, ends
            )
            for n, ends in enumerate(rng.random((3, count)) < 0.4)
        ]
        options[2].initiation[:] = np.arange(count) == 0
        return options


def planned(
    world: Any, options: list[TabularOption], action_set: str = MIXED, models: Any = None
) -> NDArray[np.float64]:
    """
    Return the value of every choice (S, O) by SMDP value iteration; NaN where unavailable.

    :param models: options to model instead, with what follows them valued as in the plan.
    """
    values = solve_smdp(build_model(world, action_set, options, world.gamma), 1e-12).values
    model = build_model(world, action_set, models or options, world.gamma)
    expected = (model.rows @ values).reshape(model.reward.T.shape).T
    return np.where(model.available, model.reward + expected, np.nan)


def learned(
    world: Any, action_set: str, rates: list[Rates], episodes: int, method: Method, seed: int = 0
) -> Learning:
    """Learn with the options of a random world."""
    choices = option_table(world, action_set, world.options())
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
    groups = [Learners(option_table(world, each, world.options()), [WILD] * 2) for each in sets]
    found = learn_in_step(world, groups, Settings(200, method), seed=0)
    again = learn_in_step(world, groups, Settings(200, method), seed=0)
    for action_set, learning, repeated in zip(sets, found, again, strict=True):
        exact = planned(world, world.options(), action_set)
        known = ~np.isnan(exact)
        for values in learning.values:
            assert values[known] == pytest.approx(exact[known], abs=1e-6)
        assert np.array_equal(learning.values, repeated.values)


@pytest.mark.heavy
@pytest.mark.parametrize('method', Method)
def test_with_chance_it_comes_to_the_values_of_planning_on_the_mean(method: Method) -> None:
    """Learners with a small rate, which is worth less than 5 % of the largest value."""
    world = RandomWorld(seed=1, outcomes=2)
    exact = planned(world, world.options())
    values = learned(world, MIXED, [Rates(0.1, 1.0)] * 40, 1200, method).values.mean(axis=0)
    known = ~np.isnan(exact)
    assert values[known] == pytest.approx(exact[known], abs=0.05 * np.abs(exact[known]).max())


@pytest.mark.heavy
def test_intra_option_learning_values_options_that_are_never_begun() -> None:
    """Option 2 can start in state 0 only; primitive steps that agree with it teach its value."""
    world = RandomWorld(seed=1)
    everywhere = world.options()
    everywhere[2].initiation[:] = True
    exact = planned(world, world.options(), models=everywhere)[:-1, 2]
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
    """Figure 4: with them every episode is about as short as the best; 13 steps on the mean."""
    human, primitive = (
        learn(TAXI, option_table(TAXI, s, taxi_options()), [Rates()] * 10, Settings(20), 0).steps
        for s in ('human', 'primitive')
    )
    assert human.mean() < 16 < 150 < primitive.mean()


def test_returns_are_the_sum_of_the_rewards() -> None:
    """A delivered passenger: 0 for the pickup, 1 for the delivery, -1 for all other steps."""
    choices = option_table(TAXI, 'human', taxi_options())
    learning = learn(TAXI, choices, [Rates()] * 3, Settings(10), 0)
    assert (learning.returns == 3 - learning.steps).all()


def test_episodes_are_cut_off() -> None:
    choices = option_table(TAXI, 'primitive', ())
    assert learn(TAXI, choices, [Rates()], Settings(5, max_steps=7), 0).steps.max() == 7
    assert learn(TAXI, choices, [Rates()], Settings(3), 0).steps.max() <= 200


def test_the_set_human_has_primitive_actions_where_no_option_can_start() -> None:
    choices = option_table(TAXI, 'human', taxi_options()[:1])
    option, primitive = choices.available[:, 0], choices.available[:, 1:]
    assert (primitive.all(axis=1) == (~option & ~TAXI.over())).all()
    assert choices.names[:2] == (FETCH, 'action:south')
    world = RandomWorld(0)
    assert not option_table(world, 'human', world.options()).available[-1].any()


@pytest.mark.heavy
def test_the_search_finds_the_rates_that_learn_faster() -> None:
    slow, fast = Rates(0.1, 1.0), Rates(0.8, 0.02)
    choices = option_table(TAXI, 'human', taxi_options()[:1])
    assert best_rates_of_each(TAXI, [choices], [slow, fast], 4, Settings(40), 0) == [fast]


def test_rates_to_try_begin_with_the_usual_ones() -> None:
    drawn = drawn_rates(3, 8)
    assert (len(drawn), drawn[0]) == (8, Rates(0.1, 0.1))
    assert drawn == drawn_rates(3, 8)
    assert drawn[1:] != drawn_rates(4, 8)[1:]


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
