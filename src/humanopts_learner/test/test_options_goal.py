"""Learning where an option ends, and planning the ways there."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from graph_support.scripted import expert
from humanopts_env.arrays import Flags
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options as hallways
from humanopts_env.domains.tabular import best_ways, distance_to
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    GOAL,
    make_demonstration,
    TREES,
)
from humanopts_learner.options.accuracy import policy_accuracy
from humanopts_learner.options.criteria import FEWEST_TO_A_GOAL, judge, Thresholds
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import OptionError
from humanopts_learner.options.rollout import rollouts
import numpy as np
import pytest

TAXI = Taxi()
REFERENCES = reference_options(TAXI)
FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
Shown = Sequence[Demonstration]


class EndlessTaxi(Taxi):
    """Taxi in which the task is never over, so that there may be no way to an end."""

    def over(self) -> Flags:
        """Return (S,): False everywhere."""
        return np.zeros(self.n_states, dtype=np.bool_)


def planned(demonstrations: Shown) -> list[Demonstration]:
    """Return the demonstrations with the wish that the policy is planned."""
    return [replace(demo, method=GOAL) for demo in demonstrations]


@pytest.mark.parametrize('option', [FETCH, DELIVER])
@pytest.mark.parametrize('seed', range(5))
def test_one_demonstration_is_enough(person: Callable[..., Any], option: str, seed: int) -> None:
    shown = person(option, seed=seed).show_random(1)
    assert policy_accuracy(learn_option(planned(shown), TAXI, 0), TAXI, REFERENCES[option]) == 1.0
    by_trees = policy_accuracy(learn_option(shown, TAXI, 0), TAXI, REFERENCES[option])
    assert by_trees < 0.9


@pytest.mark.parametrize('option', [name for name in REFERENCES if name != 'pickup/dropoff'])
def test_five_demonstrations_with_slips_are_enough(
    person: Callable[..., Any], option: str
) -> None:
    accuracy = []
    for seed in range(5):
        shown = person(option, seed=seed, error_rate=0.05).show_random(5)
        learned = learn_option(planned(shown), TAXI, 0)
        accuracy.append(policy_accuracy(learned, TAXI, REFERENCES[option]))
    assert np.median(accuracy) == 1.0
    assert min(accuracy) > 0.8


def test_a_passenger_is_never_let_out_at_another_landmark(person: Callable[..., Any]) -> None:
    """Beta holds there too: nobody is aboard."""
    option = learn_option(planned(person(DELIVER).show_random(1)), TAXI, 0)
    aboard = np.flatnonzero(REFERENCES[DELIVER].initiation)
    runs = rollouts(option, TAXI, [TAXI.state_at(int(state)) for state in aboard])
    assert runs.over.all()
    assert (runs.steps == REFERENCES[DELIVER].distance[aboard]).all()


def test_an_end_that_was_passed_by_is_not_meant() -> None:
    """Who could let out at the first landmark and drives to another means that one."""
    rows = [4, 3, 2, 1, 0]
    states = [*(TaxiState(row, 0, 4, 1) for row in rows), TaxiState(0, 0, 0, 1)]
    shown = make_demonstration(
        TAXI,
        'let out at the red one',
        states,
        ['north'] * 4 + ['dropoff'],
        features=('taxi_row', 'taxi_col', 'passenger_in_taxi'),
        method=GOAL,
    )
    option = learn_option([shown], TAXI, 0)
    for row, col in product(range(5), range(5)):
        at, taken = TaxiState(row, col, 4, 1), 0
        while at.passenger == 4 and taken < 20:
            action = int(option.greedy_action(TAXI.feature_values(at)[None])[0])
            at, taken = TAXI.step(at, action, generator(0, 'none')).state, taken + 1
        assert at == states[-1]


def test_of_equal_ways_the_shown_one_is_taken(person: Callable[..., Any]) -> None:
    for seed in range(4):
        shown = person(FETCH, seed=seed).show_random(6)
        option = learn_option(planned(shown), TAXI, 0)
        rows = np.concatenate([demo.feature_rows[:-1] for demo in shown])
        names = [name for demo in shown for name in demo.actions]
        assert [TAXI.actions[a].name for a in option.greedy_action(rows)] == names


def test_with_chance_the_way_is_the_one_that_best_arrives() -> None:
    """In Rooms moves slip; the reference options know the best ways."""
    rooms = Rooms()
    for name, reference in hallways(rooms).items():
        option = learn_option(planned(expert(name, 16, rooms)), rooms, 0)
        assert option.n_demonstrations <= 4  # most starts are in other rooms
        assert policy_accuracy(option, rooms, reference) == 1.0


def test_criteria_are_measured_from_three_demonstrations_on(person: Callable[..., Any]) -> None:
    shown = planned(person(FETCH).show_random(FEWEST_TO_A_GOAL))
    before = judge(shown[:-1], TAXI, Thresholds(), 0)
    assert [criterion.value for criterion in before.criteria] == [None] * 3
    assert judge(shown, TAXI, Thresholds(), 0).criteria_met


def test_the_newest_demonstration_says_how_to_learn(person: Callable[..., Any]) -> None:
    shown = person(FETCH).show_random(3)
    assert learn_option([*shown[:2], *planned(shown[2:])], TAXI, 0).method == GOAL
    assert learn_option([*planned(shown[:2]), shown[2]], TAXI, 0) == learn_option(shown, TAXI, 0)


def test_a_planned_policy_comes_back_from_its_file(person: Callable[..., Any]) -> None:
    shown = planned(person(FETCH).show_random(2))
    option = learn_option(shown, TAXI, 0)
    assert option_from_json(option_to_json(option, shown)) == (option, shown)
    assert option.policy.n_features > option.initiation.n_features


def test_features_that_do_not_tell_an_end_still_give_an_option(
    person: Callable[..., Any],
) -> None:
    """It ends nowhere, so its criteria do not hold; also where no task is ever over."""
    shown = [
        replace(demo, chosen_features=('destination_row',))
        for demo in planned(person(FETCH).show_random(4))
    ]
    option = learn_option(shown, TAXI, 0)
    assert not option.ends(TAXI.feature_table()).any()
    assert not judge(shown, TAXI, Thresholds(), 0, option).criteria_met
    assert learn_option(shown, EndlessTaxi(), 0).termination == option.termination


def test_a_file_with_an_unknown_method_is_refused(person: Callable[..., Any]) -> None:
    shown = planned(person(FETCH).show_random(1))
    text = option_to_json(learn_option(shown, TAXI, 0), shown)
    with pytest.raises(OptionError, match="learned by 'maps', which is no method"):
        option_from_json(text.replace('"method": "goal"', '"method": "maps"', 1))


def test_a_file_of_an_option_by_trees_is_as_before(person: Callable[..., Any]) -> None:
    shown = person(FETCH).show_random(2)
    text = option_to_json(learn_option(shown, TAXI, 0), shown)
    assert 'method' not in text
    assert option_from_json(text)[0].method == TREES


def test_where_states_cannot_be_listed_nothing_is_planned() -> None:
    game = PacMan()
    (demo,) = expert('go to the closest food', 1, game)
    with pytest.raises(DemonstrationError, match='the states of pacman cannot be listed'):
        check_demonstration(replace(demo, method=GOAL), game)
    with pytest.raises(
        DemonstrationError, match="'maps' is no way to learn; there is trees, goal"
    ):
        check_demonstration(replace(demo, method='maps'), game)


@pytest.mark.parametrize('seed', range(10))
def test_without_chance_best_ways_are_the_shortest(seed: int) -> None:
    """An independent search backwards from the goal finds the same."""
    rng, table = generator(seed, 'goals'), TAXI.transitions()
    goal = rng.random(table.successor.shape) < 0.01
    allowed = rng.random(TAXI.n_states) < 0.9
    value, optimal = best_ways(table, goal, allowed, 0.99)
    distance, shortest = distance_to(table, goal[:, :, 0], allowed)
    there = distance > 0
    assert value[allowed & ~there].tolist() == [0.0] * int((allowed & ~there).sum())
    assert np.allclose(value[there], 0.99 ** distance[there], atol=1e-14)
    assert (optimal[there] == shortest[there]).all()
