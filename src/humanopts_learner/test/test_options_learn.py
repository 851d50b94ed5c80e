"""Learning an option, running it, and comparing it with what an expert means."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any
import uuid

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.capabilities import feature_rows, HasBatchGames
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.reference import CLOSEST_FOOD
from humanopts_env.domains.pacman.reference import reference_options as pacman_options
from humanopts_env.domains.reference import judge_states
from humanopts_env.domains.rooms import Rooms, RoomsState
from humanopts_env.domains.rooms_reference import reference_options as rooms_options
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.learn import learn_option, make_dataset, NotLearnableError
from humanopts_learner.options.option import (
    Mode,
    option_from_table,
    OptionError,
    options_from_references,
    TabularOption,
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


def test_visited_states_are_in_i_and_end_states_are_in_beta(person: Callable[..., Any]) -> None:
    one = person().show(NEAR)
    option = learn_option([one], TAXI, 0)
    assert option.can_start(one.feature_rows).tolist() == [True, True, False]
    assert option.ends(one.feature_rows).tolist() == [False, False, True]
    assert option.greedy_action(one.feature_rows[:2]).tolist() == [1, 4]


def test_an_option_that_can_start_again_keeps_its_end_in_i(person: Callable[..., Any]) -> None:
    one = replace(person().show(NEAR), can_start_at_end=True)
    option = learn_option([one], TAXI, 0)
    assert option.can_start(one.feature_rows).all()
    assert option.initiation.counts.tolist() == [[0, 3]]  # one class: one leaf


def test_not_here_states_are_outside_i_and_an_option_that_comes_there_ends(
    person: Callable[..., Any],
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
    person: Callable[..., Any],
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


@pytest.mark.parametrize(('again', 'members'), [(True, [0, 5]), (False, [2, 4])])
def test_where_the_task_is_over_nobody_said_that_the_option_cannot_start_again(
    person: Callable[..., Any], again: bool, members: list[int]
) -> None:
    ann = person()
    first = replace(ann.show(NEAR), can_start_at_end=again)
    last = replace(ann.show(NEAR), terminated=True)
    option = learn_option([first, last], TAXI, 0)
    assert option.initiation.counts[0].tolist() == members


def test_only_chosen_features_are_learned_from_and_the_newest_choice_counts(
    person: Callable[..., Any],
) -> None:
    ann = person()
    first = ann.show(NEAR)
    ann.features = ('passenger_in_taxi', 'taxi_row')
    option = learn_option([first, ann.show(NEAR)], TAXI, 0)
    assert option.features == ('taxi_row', 'passenger_in_taxi')  # the domain's order
    assert {encoded.feature for encoded in option.encoding} == set(option.features)


def test_order_and_repeats_of_demonstrations_do_not_matter(fetching: Shown) -> None:
    option = learn_option(fetching, TAXI, 5)
    assert learn_option([*reversed(fetching), *fetching[:3]], TAXI, 5) == option


@pytest.mark.parametrize('count', [0, 2])
def test_without_a_trajectory_nothing_is_learned(person: Callable[..., Any], count: int) -> None:
    ann = person()
    with pytest.raises(NotLearnableError, match=f'{count} "not here" and no demonstration'):
        learn_option([ann.show(ABOARD) for _ in range(count)], TAXI, 0)


def test_people_are_never_mixed(person: Callable[..., Any]) -> None:
    both = [person(seed=1).show(NEAR), person(seed=2).show(NEAR)]
    with pytest.raises(NotLearnableError, match='several options or people'):
        make_dataset(both, TAXI)


def test_equal_counts_go_to_the_first_action(person: Callable[..., Any]) -> None:
    ann = person()
    one = ann.show(NEAR)
    bump = {'states': (one.states[0], *one.states), 'features': (one.features[0], *one.features)}
    slip = replace(
        one,
        **bump,
        uuid=str(uuid.UUID(int=7)),
        actions=('west', *one.actions),
        rewards=(-1.0, *one.rewards),
    )
    option = learn_option([slip], TAXI, 0)
    assert option.action_probabilities(row(NEAR))[0].tolist() == [0, 0.5, 0, 0.5, 0, 0]
    assert option.greedy_action(row(NEAR)).tolist() == [1]
    drawn = {option.choose_action(row(NEAR)[0], Mode.SAMPLED, rng) for rng in generators(20)}
    assert drawn == {1, 3}


def generators(count: int) -> list[np.random.Generator]:
    """Return generators of different seeds."""
    return [np.random.default_rng(seed) for seed in range(count)]


def test_a_walk_in_a_circle_is_cut_off_at_max_steps(person: Callable[..., Any]) -> None:
    option = learn_option([person().show(NEAR)], TAXI, 0)
    lost = TaxiState(row=0, col=4, passenger=3, destination=1)  # north or pickup, for ever
    result = rollouts(option, TAXI, [lost], max_steps=17)
    assert (result.steps.tolist(), result.reached.tolist()) == ([17], [False])
    assert rollouts(option, TAXI, [lost]).steps.tolist() == [TAXI.max_steps]


@pytest.mark.parametrize('name', [FETCH, DELIVER])
def test_stepwise_and_vectorised_rollouts_agree(
    person: Callable[..., Any], plain_taxi: Domain[Any], name: str
) -> None:
    option = learn_option(person(name).show_random(12), TAXI, 0)
    states = [TAXI.state_at(int(i)) for i in reference_options(TAXI)[name].initiation.nonzero()[0]]
    fast, slow = (rollouts(option, game, states, max_steps=30) for game in (TAXI, plain_taxi))
    assert slow.total_reward.tolist() == fast.total_reward.tolist()
    assert slow.steps.tolist() == fast.steps.tolist()
    assert slow.reached.tolist() == fast.reached.tolist()
    assert not fast.reached.all()


@pytest.mark.parametrize('max_steps', [1, 2, 3, 7, 8, 200])
@pytest.mark.parametrize('count', [1, 5, 12])
def test_runs_from_everywhere_are_the_runs_one_by_one(
    person: Callable[..., Any], count: int, max_steps: int
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
    option = learn_option(fetching, TAXI, 0)
    with pytest.raises(OptionError, match='learned in taxi'):
        tabulate(option, Taxi(rows=6, cols=6))
    with pytest.raises(OptionError, match='features or actions'):
        replace(option, actions=option.actions[::-1]).check_domain(TAXI)


def test_trees_that_do_not_fit_make_no_option(fetching: Shown) -> None:
    option = learn_option(fetching, TAXI, 0)
    for change, message in [
        ({'policy': option.initiation}, 'among its actions'),
        ({'initiation': option.policy}, 'not yes or no'),
        ({'encoding': option.encoding[:2]}, 'other features'),
        ({'max_steps': 0}, 'max_steps 0'),
    ]:
        with pytest.raises(OptionError, match=message):
            replace(option, **change)


class OneByOne(PacMan):
    """Pac-Man without what plays many games at once."""

    batch_games = None  # type: ignore[assignment]


def test_runs_in_one_batch_are_those_of_single_steps() -> None:
    """Where a domain plays many games at once, every run keeps chance of its own."""
    domain, single = PacMan('yard', 'chase'), OneByOne('yard', 'chase')
    assert not isinstance(single, HasBatchGames)
    reference = pacman_options(domain)[CLOSEST_FOOD]
    states = domain.sample_states(generator(1, 'runs'), 80)
    rows = feature_rows(domain, states)
    said = judge_states(reference, states, len(domain.actions))
    action = said.optimal.argmax(axis=1)
    table = TabularOption(CLOSEST_FOOD, 200, action, said.initiation, said.termination)
    option = option_from_table(domain, table, reference.features, rows)
    ours, theirs = (rollouts(option, game, states, 5, max_steps=25) for game in (domain, single))
    for part in ('total_reward', 'steps', 'reached', 'over'):
        assert np.array_equal(getattr(ours, part), getattr(theirs, part))
    assert ours.steps.max() > 2
    assert len(set(ours.total_reward.tolist())) > 2


def test_no_run_starts_where_the_task_is_over() -> None:
    """One game in a batch that is over is refused, as a step from it is."""
    domain = PacMan('yard')
    states = domain.sample_states(generator(1, 'runs'), 2)
    nothing = np.zeros(2, np.bool_)
    table = TabularOption('stays', 200, np.zeros(2, np.intp), ~nothing, nothing)
    option = option_from_table(domain, table, ['pacman_row'], feature_rows(domain, states))
    with pytest.raises(DomainError, match='over'):
        rollouts(option, domain, [states[0], replace(states[1], lives=0)])
