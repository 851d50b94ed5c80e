"""Start states: what is asked for next, and that what fails is asked for until nothing does."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner import (
    choose_start_state,
    Demonstration,
    judge,
    learn_option,
    LearnedOption,
    policy_accuracy,
    Thresholds,
)
from humanopts_learner.options.failures import find_failures
from humanopts_learner.options.rollout import rollouts
from humanopts_learner.options.starts import (
    committee_disagrees,
    nothing_fails,
    sample_failures,
    STRATEGIES,
    UnknownStrategyError,
)
import numpy as np
import pytest

TAXI = Taxi()
FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
NEAR = TaxiState(row=1, col=0, passenger=0, destination=1)
Shown = Sequence[Demonstration]


def teach(
    someone: Any, strategy: str, done: Callable[[LearnedOption, int], bool]
) -> LearnedOption:
    """Let the strategy choose start states until ``done`` of the option and its number."""
    option = None
    while option is None or not done(option, option.n_demonstrations):
        rng = generator(someone.seed, 'start_state', someone.option, len(someone.shown))
        someone.show(choose_start_state(strategy, TAXI, option, someone.shown, rng))
        if any(demo.actions for demo in someone.shown):
            option = learn_option(someone.shown, TAXI, 0)
        assert len(someone.shown) < 90
    return option


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_a_state_is_chosen_whatever_was_shown_and_an_open_one(person: Any, strategy: str) -> None:
    """The first by the generator alone; after "not here" alone, and when all was taken back."""

    def choose(option: LearnedOption | None, shown: Shown, seed: int = 0) -> TaxiState:
        state = choose_start_state(strategy, TAXI, option, shown, np.random.default_rng(seed))
        assert not TAXI.is_over(state)
        return state

    assert choose(None, [], 1) == choose(None, [], 1) != choose(None, [], 2)
    ann = person()
    choose(None, [ann.show(replace(NEAR, passenger=4))])
    choose(learn_option([ann.show(NEAR)], TAXI, 0), [])
    with pytest.raises(UnknownStrategyError, match='random, coverage, failures'):
        choose_start_state('clever', TAXI, None, [], np.random.default_rng(0))


def test_coverage_asks_for_what_is_unlike_anything_shown(person: Any) -> None:
    ann = person()
    ann.show(NEAR)
    option = learn_option(ann.shown, TAXI, 0)
    state = choose_start_state('coverage', TAXI, option, ann.shown, np.random.default_rng(0))
    assert (state.row, state.col) == (4, 4)  # NEAR and the passenger are at 1,0 and 0,0
    assert state.passenger in (3, 4)  # at 4,3 or aboard


def test_failures_asks_for_a_state_from_which_no_end_is_reached(
    person: Any,
) -> None:
    shown = person().show_random(8)
    option = learn_option(shown, TAXI, 0)
    found = find_failures(option, TAXI, shown)
    candidates = np.flatnonzero(found.candidate).tolist()
    runs = rollouts(option, TAXI, [TAXI.state_at(index) for index in candidates])
    assert found.stuck[candidates].tolist() == (~runs.reached).tolist()
    assert 0 < found.stuck.sum() < len(candidates)
    assert not nothing_fails(option, TAXI, shown, np.random.default_rng(0))
    for seed in range(5):
        state = choose_start_state('failures', TAXI, option, shown, np.random.default_rng(seed))
        assert found.stuck[TAXI.index(state)]
        assert found.times_shown[TAXI.index(state)] == 0


def test_letting_out_at_the_wrong_place_is_no_end_that_was_shown(
    person: Any,
) -> None:
    bob = person(DELIVER)
    bob.show(TaxiState(1, 0, 4, 0))  # to R, which is at 0,0
    option = learn_option(bob.shown, TAXI, 0)
    elsewhere = TaxiState(1, 0, 4, 1)
    wrong = rollouts(option, TAXI, [elsewhere])
    assert wrong.reached.tolist() == [True]  # it lets the passenger out at R, bound for G
    assert find_failures(option, TAXI, bob.shown).stuck[TAXI.index(elsewhere)]


def test_an_end_by_a_slip_is_no_end(person: Any) -> None:
    """One demonstration in which the passenger was let out at the wrong place."""
    bob, at = person(DELIVER), TaxiState(0, 0, 4, 1)
    bob.show_random(4)
    bob.walk(at, 'dropoff')
    option = learn_option(bob.shown, TAXI, 0)
    assert find_failures(option, TAXI, bob.shown).stuck[TAXI.index(at)]


def test_a_longer_way_counts_until_it_was_shown_three_times(person: Any) -> None:
    ann = person()
    for counts in (True, True, False):
        ann.walk(NEAR, 'east', 'north', 'west', 'pickup')
        found = find_failures(learn_option(ann.shown, TAXI, 0), TAXI, ann.shown)
        assert not found.stuck[TAXI.index(NEAR)]
        assert bool(found.detour[TAXI.index(NEAR)]) is counts


@pytest.mark.parametrize('name', [FETCH, DELIVER])
def test_failures_teaches_every_state_within_thirty_demonstrations(person: Any, name: str) -> None:
    someone = person(name, seed=3)
    reference = reference_options(TAXI)[name]
    curve: list[float] = []
    met: list[int] = []

    def perfect(option: LearnedOption, number: int) -> bool:
        curve.append(policy_accuracy(option, TAXI, reference))
        if not met and judge(someone.shown, TAXI, Thresholds(), 0, option).criteria_met:
            met.append(number)
        return curve[-1] == 1.0

    option = teach(someone, 'failures', perfect)
    assert option.n_demonstrations <= 30
    assert met[0] <= 25  # at the latest when every action is one of the best
    assert sum(accuracy < 0.95 for accuracy in curve) <= 24
    found = find_failures(option, TAXI, someone.shown)
    assert not (found.stuck[reference.initiation] | found.detour[reference.initiation]).any()


@pytest.mark.heavy
@pytest.mark.parametrize('name', [FETCH, DELIVER])
def test_once_nothing_fails_and_the_criteria_hold_every_start_is_driven_in_spite_of_slips(
    person: Any, name: str
) -> None:
    """Then what was shown least is asked for."""
    someone = person(name, seed=1, error_rate=0.02)

    def good_enough(option: LearnedOption, number: int) -> bool:
        if not nothing_fails(option, TAXI, someone.shown, np.random.default_rng(0)):
            return False
        return judge(someone.shown, TAXI, Thresholds(), 0, option).criteria_met

    option = teach(someone, 'failures', good_enough)
    reference = reference_options(TAXI)[name]
    indices = np.flatnonzero(reference.initiation)
    runs = rollouts(option, TAXI, [TAXI.state_at(int(index)) for index in indices])
    assert runs.reached.all()
    assert runs.steps.tolist() == reference.distance[indices].tolist()
    assert option.n_demonstrations <= 50
    found = find_failures(option, TAXI, someone.shown)
    rng = np.random.default_rng(0)
    state = TAXI.index(choose_start_state('failures', TAXI, option, someone.shown, rng))
    assert found.candidate[state]
    assert found.times_shown[state] <= np.median(found.times_shown[found.candidate])


@pytest.mark.heavy
def test_where_states_cannot_be_enumerated_a_sample_that_fails_is_asked_for(
    person: Any, plain_taxi: Any
) -> None:
    shown = person().show_random(12)
    option = learn_option(shown, plain_taxi, 0)
    found = find_failures(option, TAXI, shown)
    for seed in range(5):
        state = choose_start_state(
            'failures', plain_taxi, option, shown, np.random.default_rng(seed)
        )
        some = sample_failures(option, plain_taxi, shown, np.random.default_rng(seed))
        failing = [TAXI.index(s) for s, fails in zip(some.states, some.failing) if fails]
        assert TAXI.index(state) in failing
        assert 0.1 < some.share == len(failing) / (some.member | some.failing).sum()
        stuck = [TAXI.index(s) for s in some.states if (found.stuck | found.doubt)[TAXI.index(s)]]
        assert set(stuck) & set(failing)
    assert not nothing_fails(option, plain_taxi, shown, np.random.default_rng(0))


def test_what_one_demonstration_alone_shows_is_unsettled_until_others_show_it(
    person: Any, plain_taxi: Any
) -> None:
    ann = person()
    there = TaxiState(4, 0, 2, 1)  # at the passenger
    row, rows = TAXI.feature_values(there)[None], TAXI.feature_table()
    once = [*(ann.show(NEAR) for _ in range(12)), ann.show(there)]
    often = [*once, *(ann.show(there) for _ in range(11))]
    for demos, expected in ((once, True), (often, False)):
        option = learn_option(demos, plain_taxi, 0)
        assert committee_disagrees(option, plain_taxi, demos, row, 0)[0] == expected
    option = learn_option(once[:1], plain_taxi, 0)
    alone = committee_disagrees(option, plain_taxi, once[:1], rows, 0)
    assert alone.tolist() == option.can_start(rows).tolist()


def test_a_region_outside_i_is_in_doubt_until_three_different_answers(
    person: Any,
) -> None:
    ann = person()
    shown = ann.show_random(4)
    for row in (1, 1, 2, 3):  # the first answer is given twice
        found = find_failures(learn_option(shown, TAXI, 0), TAXI, shown)
        assert found.doubt[TAXI.index(TaxiState(4, 4, 4, 1))]
        shown = [*shown, ann.show(TaxiState(row, 2, 4, 1))]
    assert not find_failures(learn_option(shown, TAXI, 0), TAXI, shown).doubt.any()


def test_both_halves_of_an_option_are_found(person: Any) -> None:
    """Pickup/dropoff shown for one of them alone looks complete: I excludes the other by guess."""
    someone = person('pickup/dropoff')

    def done(option: LearnedOption, number: int) -> bool:
        return nothing_fails(option, TAXI, someone.shown, np.random.default_rng(0))

    option = teach(someone, 'failures', done)
    assert policy_accuracy(option, TAXI, reference_options(TAXI)['pickup/dropoff']) == 1.0
    assert len(someone.shown) <= 12
