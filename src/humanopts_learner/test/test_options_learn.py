"""Learning an option, by trees or by its end, running it, and what an expert means by it."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any
import uuid

from graph_support.scripted import expert
from humanopts_env.arrays import Flags
from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms, RoomsState
from humanopts_env.domains.rooms_reference import reference_options as hallways
from humanopts_env.domains.rooms_reference import reference_options as rooms_options
from humanopts_env.domains.tabular import best_paths, distance_to
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner import (
    Demonstration,
    judge,
    learn_option,
    make_demonstration,
    policy_accuracy,
    Thresholds,
)
from humanopts_learner.demonstrations import (
    check_demonstration,
    DemonstrationError,
    FOREST,
    GOAL,
    TREES,
)
from humanopts_learner.option import DrawnOption
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.judge import MIN_HELD_OUT
from humanopts_learner.options.learn import N_TREES, NotLearnableError
from humanopts_learner.options.learned_option import (
    OptionError,
    options_from_references,
    tabulate,
)
from humanopts_learner.options.rollout import rollouts, rollouts_from_everywhere
import numpy as np
import pytest

TAXI = Taxi()
FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
NEAR = TaxiState(row=1, col=0, passenger=0, destination=1)  # north, then pickup
ABOARD = TaxiState(row=1, col=0, passenger=4, destination=1)
Shown = Sequence[Demonstration]


def row(state: TaxiState) -> Any:
    """Return the features of one state as one row."""
    return TAXI.feature_values(state)[None]


def test_visited_states_are_in_i_and_end_states_are_in_beta(person: Any) -> None:
    """An end is in I where the person says that the option can start again there."""
    one = person().show(NEAR)
    option = learn_option([one], TAXI, 0)
    assert option.can_start(one.feature_rows).tolist() == [True, True, False]
    assert option.ends(one.feature_rows).tolist() == [False, False, True]
    assert option.action(one.feature_rows[:2]).tolist() == [1, 4]
    again = learn_option([replace(one, can_start_at_end=True)], TAXI, 0)
    assert again.can_start(one.feature_rows).all()


def test_not_here_states_are_outside_i_and_an_option_that_comes_there_ends(
    person: Any,
) -> None:
    ann = person()
    shown, refused = ann.show(NEAR), ann.show(ABOARD)
    option = learn_option([shown, refused], TAXI, 0)
    assert not option.can_start(row(ABOARD))[0]
    assert option.initiation.counts[0].tolist() == [2, 2]
    assert option.ends(row(ABOARD))[0]
    assert option.termination.counts[0].tolist() == [2, 2]
    assert (option.n_demonstrations, option.n_not_here) == (1, 1)
    assert option.uuids == (shown.uuid, refused.uuid)


def test_a_start_that_looks_like_an_end_is_no_example_against_it(
    person: Any,
) -> None:
    one = person().show(NEAR)
    again = replace(  # a lap: it begins where the first ends
        one,
        uuid=str(uuid.uuid4()),
        number=2,
        features=(one.features[-1], *one.features),
        states=(one.states[-1], *one.states),
        actions=('south', *one.actions),
        rewards=(-1.0, *one.rewards),
    )
    option = learn_option([one, again], TAXI, 0)
    assert option.termination.counts[0].tolist() == [4, 2]
    assert option.ends(one.feature_rows).tolist() == [False, False, True]
    option = learn_option([replace(one, can_start_at_end=True)], TAXI, 0)
    assert option.termination.counts[0].tolist() == [2, 1]  # nothing at its start only ends have


@pytest.mark.parametrize(('again', 'members'), [(True, [0, 5]), (False, [2, 4])])
def test_where_the_task_is_over_nobody_said_that_the_option_cannot_start_again(
    person: Any, again: bool, members: list[int]
) -> None:
    ann = person()
    first = replace(ann.show(NEAR), can_start_at_end=again)
    last = replace(ann.show(NEAR), terminated=True)
    option = learn_option([first, last], TAXI, 0)
    assert option.initiation.counts[0].tolist() == members


def test_only_chosen_features_are_learned_from_and_the_newest_choice_counts(
    person: Any,
) -> None:
    ann = person()
    first = ann.show(NEAR)
    ann.features = ('passenger_in_taxi', 'taxi_row')
    option = learn_option([first, ann.show(NEAR)], TAXI, 0)
    assert option.features == ('taxi_row', 'passenger_in_taxi')  # the domain's order
    assert {encoded.feature for encoded in option.encoding} == set(option.features)
    assert learn_option([ann.shown[1], first, first], TAXI, 0) == option


def test_nothing_is_learned_without_a_trajectory_or_from_two_people(
    person: Any,
) -> None:
    with pytest.raises(NotLearnableError, match='1 "not here" and no demonstration'):
        learn_option([person().show(ABOARD)], TAXI, 0)
    with pytest.raises(NotLearnableError, match='several options or people'):
        learn_option([person(seed=seed).show(NEAR) for seed in (1, 2)], TAXI, 0)


def test_a_walk_in_a_circle_is_cut_off_at_max_steps(person: Any) -> None:
    """Of two actions shown equally often the first is taken, unless they are drawn."""
    option = learn_option([person().walk(NEAR, 'west', 'north', 'pickup')], TAXI, 0)
    assert option.action_probabilities(row(NEAR))[0].tolist() == [0, 0.5, 0, 0.5, 0, 0]
    assert option.action(row(NEAR)).tolist() == [1]
    drawn = DrawnOption(option, np.random.default_rng(0))
    assert {int(drawn.action(row(NEAR))[0]) for _ in range(20)} == {1, 3}
    lost = TaxiState(row=0, col=4, passenger=3, destination=1)  # north or pickup, for ever
    result = rollouts(option, TAXI, [lost], max_steps=17)
    assert (result.steps.tolist(), result.reached.tolist()) == ([17], [False])
    assert rollouts(option, TAXI, [lost]).steps.tolist() == [TAXI.max_steps]
    over = TAXI.state_at(int(np.flatnonzero(TAXI.over())[0]))
    with pytest.raises(DomainError, match='over'):
        rollouts(option, TAXI, [lost, over])


@pytest.mark.parametrize('name', [FETCH, DELIVER])
def test_stepwise_and_vectorised_rollouts_agree(
    person: Any, plain_taxi: Domain, name: str
) -> None:
    option = learn_option(person(name).show_random(12), TAXI, 0)
    states = [TAXI.state_at(int(i)) for i in reference_options(TAXI)[name].initiation.nonzero()[0]]
    fast, slow = (rollouts(option, game, states, max_steps=30) for game in (TAXI, plain_taxi))
    assert slow.total_reward.tolist() == fast.total_reward.tolist()
    assert slow.steps.tolist() == fast.steps.tolist()
    assert slow.reached.tolist() == fast.reached.tolist()
    assert not fast.reached.all()


@pytest.mark.parametrize('max_steps', [1, 3, 8, 200])
@pytest.mark.parametrize('count', [1, 12])
def test_runs_from_everywhere_are_the_runs_one_by_one(
    person: Any, count: int, max_steps: int
) -> None:
    """Some end at once, some late, and some go round in a circle or into a wall."""
    option = learn_option(person(DELIVER).show_random(count), TAXI, 0)
    table = replace(tabulate(option, TAXI), max_steps=max_steps)
    live = np.flatnonzero(~TAXI.over())
    found = rollouts_from_everywhere(TAXI, table)
    each = rollouts(option, TAXI, [TAXI.state_at(int(n)) for n in live], max_steps=max_steps)
    assert found.reached[live].tolist() == each.reached.tolist()
    assert 0 < each.reached.sum() < len(live)
    ended = live[each.reached]
    for name in ('total_reward', 'steps', 'over'):
        assert getattr(found, name)[ended].tolist() == getattr(each, name)[each.reached].tolist()


def test_runs_with_chance_depend_on_their_keys_and_not_on_each_other() -> None:
    rooms = Rooms()
    option = options_from_references(rooms, rooms_options(rooms).values())[0]
    states = [RoomsState(0, 0), RoomsState(4, 4), RoomsState(2, 2)]
    keys = ['a', 'b', 'c']
    together = rollouts(option, rooms, states, 3, keys)
    turned = rollouts(option, rooms, states[::-1], 3, keys[::-1])
    assert together.steps.tolist() == turned.steps[::-1].tolist()
    other = rollouts(option, rooms, [states[1]] * 8, 3, list('stuvwxyz'))
    assert len(set(other.steps.tolist())) > 1


def test_an_option_is_refused_by_another_game(fetching: Shown) -> None:
    """And trees that do not fit each other are not an option."""
    option = learn_option(fetching, TAXI, 0)
    with pytest.raises(OptionError, match='learned in taxi'):
        tabulate(option, Taxi(rows=6, cols=6))
    with pytest.raises(OptionError, match='features or actions'):
        replace(option, actions=option.actions[::-1]).check_domain(TAXI)
    (first, *rest) = option.encoding
    unknown = replace(option, encoding=(replace(first, feature='fuel'), *rest))
    with pytest.raises(OptionError, match=r"cannot be used: .*'fuel'"):
        unknown.check_domain(TAXI)
    changes: dict[str, dict[str, Any]] = {
        'among its actions': {'policy': option.initiation},
        'not yes or no': {'initiation': option.policy},
        'other features': {'encoding': option.encoding[:2]},
        'max_steps 0': {'max_steps': 0},
    }
    for message, change in changes.items():
        with pytest.raises(OptionError, match=message):
            replace(option, **change)


REFERENCES = reference_options(TAXI)


class EndlessTaxi(Taxi):
    """Taxi in which the task is never over, so that there may be no way to an end."""

    def over(self) -> Flags:
        """Return (S,): False everywhere."""
        return np.zeros(self.n_states, dtype=np.bool_)


def planned(demonstrations: Shown) -> list[Demonstration]:
    """Return the demonstrations with the wish that the policy is planned."""
    return [replace(demo, method=GOAL) for demo in demonstrations]


@pytest.mark.parametrize('option', [FETCH, DELIVER])
@pytest.mark.parametrize('seed', range(3))
def test_one_demonstration_is_enough(person: Any, option: str, seed: int) -> None:
    shown = person(option, seed=seed).show_random(1)
    by_goal, by_trees = (learn_option(each, TAXI, 0) for each in (planned(shown), shown))
    assert policy_accuracy(by_goal, TAXI, REFERENCES[option]) == 1.0
    assert policy_accuracy(by_trees, TAXI, REFERENCES[option]) < 0.9


@pytest.mark.parametrize('option', [name for name in REFERENCES if name != 'pickup/dropoff'])
def test_five_demonstrations_with_slips_are_enough(person: Any, option: str) -> None:
    accuracy = []
    for seed in range(5):
        shown = person(option, seed=seed, error_rate=0.05).show_random(5)
        learned = learn_option(planned(shown), TAXI, 0)
        accuracy.append(policy_accuracy(learned, TAXI, REFERENCES[option]))
    assert np.median(accuracy) == 1.0
    assert min(accuracy) > 0.8


def test_a_passenger_is_never_let_out_at_another_landmark(person: Any) -> None:
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
            action = int(option.action(TAXI.feature_values(at)[None])[0])
            at, taken = TAXI.step(at, action, generator(0, 'none')).state, taken + 1
        assert at == states[-1]


def test_of_equal_ways_the_shown_one_is_taken(person: Any) -> None:
    for seed in range(4):
        shown = person(FETCH, seed=seed).show_random(6)
        option = learn_option(planned(shown), TAXI, 0)
        rows = np.concatenate([demo.feature_rows[:-1] for demo in shown])
        names = [name for demo in shown for name in demo.actions]
        assert [TAXI.actions[a].name for a in option.action(rows)] == names


def test_with_chance_the_way_is_the_one_that_best_arrives() -> None:
    """In Rooms moves slip; the reference options know the best ways."""
    rooms = Rooms()
    for name, reference in hallways(rooms).items():
        option = learn_option(planned(expert(name, 16, rooms)), rooms, 0)
        assert option.n_demonstrations <= 4  # most starts are in other rooms
        assert policy_accuracy(option, rooms, reference) == 1.0


def test_criteria_are_measured_from_three_demonstrations_on(person: Any) -> None:
    shown = planned(person(FETCH).show_random(MIN_HELD_OUT))
    before = judge(shown[:-1], TAXI, Thresholds(), 0)
    assert [criterion.value for criterion in before.criteria[2:]] == [None] * 3
    assert judge(shown, TAXI, Thresholds(), 0).settled


def test_the_newest_demonstration_says_how_to_learn(person: Any) -> None:
    shown = person(FETCH).show_random(3)
    by_trees = learn_option(shown, TAXI, 0)
    assert learn_option([*shown[:2], *planned(shown[2:])], TAXI, 0).method == GOAL
    assert learn_option([*planned(shown[:2]), shown[2]], TAXI, 0) == by_trees
    text = option_to_json(by_trees, shown)
    assert 'method' not in text
    assert option_from_json(text)[0].method == TREES


def test_a_planned_policy_comes_back_from_its_file(person: Any) -> None:
    shown = planned(person(FETCH).show_random(2))
    option = learn_option(shown, TAXI, 0)
    text = option_to_json(option, shown)
    assert option_from_json(text) == (option, shown)
    assert option.policy.n_features > option.initiation.n_features
    with pytest.raises(OptionError, match="'maps'"):
        option_from_json(text.replace('"method": "goal"', '"method": "maps"', 1))


def test_a_forest_comes_back_from_its_file(person: Any) -> None:
    shown = [replace(demo, method=FOREST) for demo in person(FETCH).show_random(5)]
    option = learn_option(shown, TAXI, 0)
    assert (option.method, len(option.policy.roots), len(option.termination.roots)) == (
        FOREST,
        N_TREES,
        N_TREES,
    )
    text = option_to_json(option, shown)
    assert option_from_json(text) == (option, shown)
    with pytest.raises(OptionError, match='child of exactly one'):
        option_from_json(text.replace('"roots": [0, ', '"roots": [1, ', 1))


def test_features_that_do_not_tell_an_end_still_give_an_option(
    person: Any,
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


def test_where_states_cannot_be_listed_nothing_is_planned() -> None:
    game = PacMan()
    (demo,) = expert('go to the closest food', 1, game)
    with pytest.raises(DemonstrationError, match='the states of pacman cannot be listed'):
        check_demonstration(replace(demo, method=GOAL), game)
    with pytest.raises(
        DemonstrationError, match="unknown learning method 'maps'; choose from trees, forest, goal"
    ):
        check_demonstration(replace(demo, method='maps'), game)


@pytest.mark.parametrize('seed', range(3))
def test_without_chance_best_ways_are_the_shortest(seed: int) -> None:
    """An independent search backwards from the goal finds the same."""
    rng, table = generator(seed, 'goals'), TAXI.transitions()
    goal = rng.random(table.successor.shape) < 0.01
    allowed = rng.random(TAXI.n_states) < 0.9
    value, optimal = best_paths(table, goal, allowed, 0.99)
    distance, shortest = distance_to(table, goal[:, :, 0], allowed)
    there = distance > 0
    assert value[allowed & ~there].tolist() == [0.0] * int((allowed & ~there).sum())
    assert np.allclose(value[there], 0.99 ** distance[there], atol=1e-14)
    assert (optimal[there] == shortest[there]).all()
