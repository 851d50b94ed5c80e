"""The criteria: of every start or held out, whatever the order, honest when unmeasurable."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
import itertools
import math
from typing import Any

from graph_support.scripted import show
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.rooms import RoomsState
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.seeding import generator
from humanopts_learner import Demonstration, judge, learn_option, Thresholds
from humanopts_learner.demonstrations import GOAL, Kind, version_of
from humanopts_learner.intervals import Interval, level_of_look, runs_needed
from humanopts_learner.options.conflicts import advise, find_conflicts
from humanopts_learner.options.failures import find_failures, KnownEnds, repeats
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.judge import (
    held_out_ends,
    HeldOut,
    MIN_HELD_OUT,
    more_needed,
    return_range,
)
from humanopts_learner.options.learn import (
    fit_leave_fold_out,
    fold_of,
    make_dataset,
    NotLearnableError,
)
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.rollout import rollouts
from humanopts_learner.summary import (
    Criterion,
    EVERY_START,
    IMITATION,
    INITIATION,
    NO_REFUSAL,
    OptionSummary,
    RETURN,
    SAMPLED_STARTS,
    SUCCESS,
    TERMINATION,
)
import numpy as np
import pytest
from scipy.special import stdtrit

TAXI = Taxi()
HELD_OUT = RETURN, INITIATION, TERMINATION
FETCH = 'go to passenger and pickup'
ABOARD = TaxiState(row=1, col=0, passenger=4, destination=1)
Shown = Sequence[Demonstration]


def named(judgement: OptionSummary) -> dict[str, Criterion]:
    """Return the criteria by name."""
    return {criterion.name: criterion for criterion in judgement.criteria}


def values(shown: Shown) -> dict[str, float | None]:
    """Return the value of each criterion by name."""
    found = named(judge(shown, TAXI, Thresholds(), 0))
    return {name: criterion.value for name, criterion in found.items()}


def span(shown: Shown, domain: Any = TAXI) -> float:
    """Return the range of returns from random actions to the demonstrations."""
    found = return_range(make_dataset(shown, domain), domain, learn_option(shown, domain, 0), 0)
    assert found is not None
    return found


def test_too_few_demonstrations_are_not_measurable_and_not_met(
    fetching: Shown, person: Any
) -> None:
    judgement = judge(fetching[: MIN_HELD_OUT - 1], TAXI, Thresholds(), 0)
    held_out = judgement.criteria[2:]
    assert [(c.name, c.value) for c in held_out] == [(n, None) for n in HELD_OUT]
    assert not any(c.measurable or c.met for c in held_out)
    assert (judgement.criteria_met, judgement.more_needed) == (False, -1)
    ann = person()
    refused = [ann.show(ABOARD) for _ in range(12)]
    assert None not in values([*refused, *ann.show_random(MIN_HELD_OUT)]).values()
    with pytest.raises(NotLearnableError):
        judge(refused, TAXI, Thresholds(), 0)


def test_i_of_an_option_that_starts_wherever_it_ends_cannot_be_measured(fetching: Shown) -> None:
    """No tree could be wrong there, so it is no evidence; it does not keep the lesson going."""
    always = [replace(demo, can_start_at_end=True) for demo in fetching]
    for shown, obstacle in ((always, NO_REFUSAL), (always[: MIN_HELD_OUT - 1], '')):
        found = named(judge(shown, TAXI, Thresholds(), 0))[INITIATION]
        assert (found.value, found.met, found.obstacle) == (None, False, obstacle)
    assert values([*always[1:], fetching[0]])[INITIATION] not in (None, 0.0)


def test_the_same_trajectory_shown_often_leaves_no_shortfall(fetching: Shown) -> None:
    again = [replace(fetching[0], uuid=demo.uuid, number=demo.number) for demo in fetching]
    found = values(again)
    assert [found.pop(name) for name in (*HELD_OUT, IMITATION)] == [0.0] * 4
    assert found == {SUCCESS: pytest.approx(0.14)}  # of all starts


def test_a_held_out_demonstration_is_not_learned_from(person: Any) -> None:
    """Nine say north and pickup at 0,0; none of them knows of west and pickup at 4,3."""
    ann = person()
    shown = [ann.show(TaxiState(1, 0, 0, 1)) for _ in range(9)] + [ann.show(TaxiState(4, 4, 3, 1))]
    judgement = judge(shown, TAXI, Thresholds(), 0)
    assert judgement.mean_return_policy == judgement.mean_return_demonstrations == -1
    value = named(judgement)[RETURN].value
    assert value == pytest.approx((4 - 1) / 10 / span(shown))  # twice the 2 steps, at -1


def test_coming_to_another_end_counts_as_not_coming_to_the_end(person: Any) -> None:
    """Nine deliver to R, one to Y; without it the policy lets the passenger out at R for Y."""
    bob = person('go to destination and dropoff')
    shown = [bob.show(TaxiState(1, 0, 4, destination)) for destination in [0] * 9 + [2]]
    assert [demo.total_reward for demo in shown] == [0] * 9 + [-2]
    value = values(shown)[RETURN]  # twice the 4 steps at -1, though it ended after 2
    assert value == pytest.approx((8 - 2) / 10 / span(shown))


@pytest.fixture(scope='module')
def from_everywhere(person: Any) -> Shown:
    """Return one demonstration from every cell to every passenger; from one cell a longer way."""
    ann = person()
    for cell, place in itertools.product(range(25), range(4)):
        ann.show(TaxiState(*divmod(cell, 5), place, (place + 1) % 4))
    around = TaxiState(1, 1, 0, 1)  # two cells from R, which is at 0,0
    for _ in range(40):
        ann.walk(around, 'south', 'west', 'north', 'north', 'pickup')
    return ann.shown


def test_what_is_known_of_every_start_takes_the_place_of_the_held_out_return(
    from_everywhere: Shown,
) -> None:
    """The longer way is worth two less; with a threshold below that, it is not good enough."""
    option, reference = learn_option(from_everywhere, TAXI, 0), reference_options(TAXI)[FETCH]
    starts = np.flatnonzero(reference.initiation & ~TAXI.over())
    runs = rollouts(option, TAXI, [TAXI.state_at(int(start)) for start in starts])
    assert runs.reached.all()
    worst = (1 - reference.distance[starts] - runs.total_reward).max()  # the pickup costs nothing
    assert worst == 2
    share = 2 / span(from_everywhere)
    found, strict = (
        named(judge(from_everywhere, TAXI, Thresholds(return_share=limit), 0, option))
        for limit in (share, 0.95 * share)
    )
    assert found[RETURN] == Criterion(RETURN, share, share, met=True, count=len(from_everywhere))
    assert strict.pop(RETURN).value not in (share, None)  # that of the held-out runs
    assert all(found[name] == criterion for name, criterion in strict.items())


def test_a_start_from_which_it_does_not_end_is_no_known_return(from_everywhere: Shown) -> None:
    """Without what was shown in one corner, it walks into the wall there."""
    shown = [demo for demo in from_everywhere if 'taxi 4,4' not in ' '.join(demo.states)]
    starts = np.flatnonzero(reference_options(TAXI)[FETCH].initiation & ~TAXI.over())
    states = [TAXI.state_at(int(start)) for start in starts]
    assert not rollouts(learn_option(shown, TAXI, 0), TAXI, states).reached.all()
    judged = judge(shown, TAXI, Thresholds(return_share=0.0), 0)
    found = named(judged)
    assert not found[RETURN].met
    assert found[SUCCESS].value is not None
    assert found[SUCCESS].value < 1
    assert judged.more_needed == -1  # no law says when it will be known


def test_the_limit_is_that_of_differences_paired_by_demonstration(
    fetching: Shown, plain_taxi: Any
) -> None:
    """
    Of 12 of them, with Student's t of 11 degrees of freedom; without chance, there is none.

    With an exam, only what is below the lower limit counts.
    """
    data = make_dataset(fetching[:12], TAXI)
    folds, differences = fold_of(data, 0), []
    for demo, fold in zip(data.demonstrations, folds):
        others = [other for other, at in zip(data.demonstrations, folds) if at != fold]
        start, limit = TAXI.decode(demo.states[0]), 2 * len(demo.actions)
        run = rollouts(learn_option(others, TAXI, 0), TAXI, [start], max_steps=limit)
        differences.append(demo.total_reward - run.total_reward[0])
    mean, error = np.mean(differences), np.std(differences, ddof=1) / math.sqrt(12)
    exact = judge(fetching[:12], TAXI, Thresholds(), 0)
    of_range = span(fetching[:12])
    found = named(exact)
    assert (found[RETURN].value, found[RETURN].limit) == (pytest.approx(mean / of_range), None)
    stepwise = judge(fetching[:12], plain_taxi, Thresholds(exam=0), 0)
    t = float(stdtrit(11, 1 - 0.05 / (12 * 13)))  # the twelfth look
    limited = named(stepwise)
    of_range = span(fetching[:12], plain_taxi)
    assert limited[RETURN].value == pytest.approx(mean / of_range)
    assert limited[RETURN].limit == pytest.approx((mean + t * error) / of_range)
    examined = named(judge(fetching[:12], plain_taxi, Thresholds(), 0))[RETURN]
    certain = max(mean - float(stdtrit(11, 0.95)) * error, 0.0)
    assert (examined.value, examined.limit) == (pytest.approx(certain / of_range), None)
    assert all(limited[name] == found[name] for name in (INITIATION, TERMINATION))
    assert stepwise.mean_return_policy == exact.mean_return_policy
    assert stepwise.conflicts == exact.conflicts


def test_a_run_has_the_luck_of_its_demonstration_as_long_as_it_does_the_same() -> None:
    """In a room where some slip out by the wrong doorway, and get no reward at the goal."""
    rooms = make_domain('rooms')
    reference = reference_options(rooms)['north-east room to east doorway']
    rng, start = generator(1, 'test'), RoomsState(2, 6)  # beside the wrong doorway

    def choose(taken: int, here: RoomsState) -> str | None:
        done = taken and reference.ends(here)
        return None if done else rooms.actions[reference.optimal_actions(here)[0]].name

    chosen = {'option_name': reference.name, 'chosen_features': ('row', 'col', 'room')}
    shown = [show(rooms, start, choose, rng, number=n + 1, **chosen) for n in range(40)]
    folds = fold_of(make_dataset(shown, rooms), 0)
    assert 0 < sum(not demo.terminated for demo in shown) < 20
    places = [{*demo.states} for demo in shown]
    known = [set[str]().union(*(p for p, at in zip(places, folds) if at != f)) for f in folds]
    alone = sum(not own <= others for own, others in zip(places, known))
    value = named(judge(shown, rooms, Thresholds(), 0))[RETURN].value
    assert value is not None
    # A run differs only after a cell that no other shows.
    assert abs(value) * span(shown, rooms) <= alone / 40 < 0.2


@pytest.mark.parametrize('picked', [('taxi_row', 'taxi_col'), ('passenger_in_taxi',)])
def test_what_is_held_out_has_no_part_in_what_is_learned(
    fetching: Shown, picked: tuple[str, ...]
) -> None:
    """Though some begin where only a held-out one ends, and one alone can start again there."""
    again = replace(fetching[0], can_start_at_end=True)
    shown = [
        replace(demo, chosen_features=picked, terminated=demo.number % 2 == 0)
        for demo in (again, *fetching[1:])
    ]
    data = make_dataset(shown, TAXI)
    folds = fold_of(data, 0)
    for fold, found in enumerate(fit_leave_fold_out(data, folds, TAXI, 0)):
        others = [demo for demo, at in zip(data.demonstrations, folds) if at != fold]
        assert option_to_json(found, []) == option_to_json(learn_option(others, TAXI, 0), [])


def test_fewer_starts_may_fail_if_all_are_known_and_more_by_chance(
    fetching: Shown, plain_taxi: Any
) -> None:
    """A world that is replayed and the frozen lake, which has both, are in other modules."""
    for domain, share in ((TAXI, 0.975), (plain_taxi, 0.925)):
        success = named(judge(fetching[:3], domain, Thresholds(), 0))[SUCCESS]
        assert success.threshold == pytest.approx(share)
    without = named(judge(fetching[:3], plain_taxi, Thresholds(0.0), 0))[SUCCESS]
    assert (without.threshold, without.met) == (0.0, True)
    assert without.value is not None
    assert without.value > 0  # measured all the same


def test_thresholds_decide_what_is_met_and_order_does_not_matter(fetching: Shown) -> None:
    lax = judge(fetching, TAXI, Thresholds(0.0, 1e6, 1.0, 1.0), 0)
    assert (lax.criteria_met, lax.more_needed) == (True, 0)
    assert lax.mean_return_policy == lax.mean_return_demonstrations  # in-sample
    assert judge(fetching[::-1], TAXI, Thresholds(0.0, 1e6, 1.0, 1.0), 0) == lax
    strict = judge(fetching, TAXI, Thresholds(0.0, 0.0, 0.0, 0.0), 0)
    assert (strict.criteria_met, strict.more_needed) == (False, -1)  # 1 / n is never zero
    shortfall = named(strict)[RETURN].value
    assert shortfall is not None
    assert shortfall > 0


@pytest.mark.parametrize(
    'wrong',
    [
        {'return_share': float('nan')},
        {'success': 1.5},
        {'initiation_error': 2.0},
        {'termination_error': -1},
    ],
)
def test_senseless_thresholds_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match='thresholds are'):
        Thresholds(**wrong)


@pytest.mark.parametrize(('value', 'high'), [(0.5, 3.0), (-2.0, 9.0), (0.0, 1.5), (2.5, 4.0)])
def test_a_criterion_is_met_when_its_limit_is_low_enough(value: float, high: float) -> None:
    """Until then it takes so many more that the limit falls to it, by 1 / n and 1 / sqrt(n)."""
    criterion = Criterion.of(RETURN, value, 1.0, high)
    assert (criterion.met, criterion.undecided) == (False, value <= 1.0)
    assert Criterion.of(RETURN, value, high, high).met
    share = 10 / (10 + more_needed([criterion], 10) - np.arange(2))  # with so many, with one less
    limit = np.maximum(value, 0.0) * share + min(value, 0.0) + (high - value) * np.sqrt(share)
    assert limit[0] <= 1.0 < limit[1]
    other = Criterion.of(INITIATION, 0.0, 0.1)
    for exact, needed in ((1.0, 0), (2.0, 10), (1.01, 1), (5.0, 40), (None, -1)):
        assert more_needed([Criterion.of(RETURN, exact, 1.0), other], 10) == needed


def by_goal(person: Any, *places: int) -> list[Demonstration]:
    """Return demonstrations of fetching passengers, to be planned, and one "not here"."""
    ann = person()
    shown = [ann.show(TaxiState(2, 2, place, (place + 1) % 4)) for place in places]
    return [replace(demo, method=GOAL) for demo in (*shown, ann.show(ABOARD))]


def called(right: bool, person: Any, place: int, shown: Shown, **fields: Any) -> Demonstration:
    """Return a run of the machine, as it should be, that the person judged."""
    run = person(seed=place + 10).show(TaxiState(3, 2, place, (place + 1) % 4))
    version = version_of(shown)
    return replace(
        run, kind=Kind.JUDGED, participant=shown[0].participant, method=GOAL, right=right,
        option_version=version, **fields,
    )  # fmt: skip


def test_ends_of_a_plan_are_right_where_they_were_shown_or_called_right(person: Any) -> None:
    """From each quarter of the starts, the passenger waits at another place."""
    shown = by_goal(person, 0, 1, 2)
    found = judge(shown, TAXI, Thresholds(), 0)
    success = named(found)[SUCCESS]
    assert (success.value, success.possible, success.count) == (0.75, 1.0, 300)
    assert (success.met, success.unanswered, found.evidence) == (False, True, EVERY_START)
    assert (found.settled, found.criteria_met) == (True, False)
    assert 'Of all 300 starts, it reaches an end like yours from 225' in found.reach
    assert 'from 75 it reaches one that you have not judged' in found.reach
    right = judge([*shown, called(True, person, 3, shown)], TAXI, Thresholds(), 0)
    assert named(right)[SUCCESS].value == 1.0
    assert right.criteria_met
    wrong = judge([*shown, called(False, person, 3, shown)], TAXI, Thresholds(), 0)
    success = named(wrong)[SUCCESS]
    assert (success.value, success.possible) == (0.75, 0.75)
    assert not wrong.settled
    option = learn_option(shown, TAXI, 0)
    failures = find_failures(option, TAXI, [*shown, called(False, person, 3, shown)])
    assert failures.stuck.sum() == 75  # where it is to be shown


def test_an_option_that_would_repeat_a_wrong_run_has_not_learned_from_it(person: Any) -> None:
    shown = by_goal(person, 0, 1, 2, 3)
    option = learn_option(shown, TAXI, 0)
    run = called(False, person, 3, shown)
    start = TAXI.decode(run.states[0])
    steps = [TAXI.actions[int(option.action(TAXI.feature_values(start)[None])[0])].name]
    stopped = person().walk(start, *steps)
    judged_run = replace(
        stopped, kind=Kind.JUDGED, right=False, stopped=True, option_version=version_of(shown)
    )
    assert repeats(option, TAXI, judged_run)
    found = judge([*shown, judged_run], TAXI, Thresholds(), 0)
    assert (named(found)[IMITATION].value, found.settled) == (1.0, False)
    other = next(action.name for action in TAXI.actions if action.name not in steps)
    elsewhere = replace(judged_run, actions=(other,))
    assert not repeats(option, TAXI, elsewhere)
    assert judge([*shown, elsewhere], TAXI, Thresholds(), 0).criteria_met


def test_from_the_start_of_a_demonstration_its_own_end_must_be_reached(person: Any) -> None:
    """Two cells north of each start: the planned way goes to the nearest of all those cells."""
    ann = person()
    ann.features = ('taxi_row', 'taxi_col')
    for row in (4, 3, 2):
        ann.walk(TaxiState(row, 2, 0, 1), 'north', 'north')
    shown = [replace(demo, method=GOAL) for demo in ann.shown]
    found = named(judge(shown, TAXI, Thresholds(), 0))[IMITATION]
    assert found.value is not None
    assert found.value > 0.2
    assert not found.met


def test_fresh_starts_decide_where_states_cannot_be_listed(
    fetching: Shown, plain_taxi: Any
) -> None:
    """The share agrees with that of all starts, and more looks need more runs."""
    for count in (6, 30):
        shown = fetching[:count]
        exact = named(judge(shown, TAXI, Thresholds(), 0))[SUCCESS]
        found = judge(shown, plain_taxi, Thresholds(), 0)
        success = named(found)[SUCCESS]
        assert found.evidence == SAMPLED_STARTS
        assert success.value == pytest.approx(exact.value, abs=0.1)
        interval = Interval.of_share(
            np.arange(success.count) < round(success.value * success.count),
            level_of_look(count),
        )
        assert success.limit == pytest.approx(interval.low)
    assert runs_needed(0.95, level_of_look(3)) == 156
    assert runs_needed(0.95, level_of_look(20)) == 282
    assert sum(1 - level_of_look(k) for k in range(1, 10_000)) == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(
    ('ends', 'counts'),
    [
        ({(1, 0), (0, 0)}, (1, 0, 0)),
        ({(0, 0)}, (0, 0, 0)),
        (set(), (0, 0, 1)),
        ({(0, 1)}, (0, 1, 0)),
    ],
)
def test_beta_counts_demonstrations_that_end_early_late_or_never(
    person: Any, ends: set[tuple[int, int]], counts: tuple[int, int, int]
) -> None:
    """A demonstration of two steps north, tried with options that end in given cells."""
    demo = person().walk(TaxiState(2, 0, 1, 2), 'north', 'north')
    data = make_dataset([demo], TAXI)

    @dataclass(frozen=True)
    class Ends(LearnedOption):
        def ends(self, rows: Any) -> Any:
            return np.array([tuple(row[:2].astype(int)) in ends for row in rows])

        def action(self, rows: Any) -> Any:
            return np.full(len(rows), 2)  # east

    learned = learn_option([demo], TAXI, 0)
    option = Ends(**{field.name: getattr(learned, field.name) for field in fields(learned)})
    held_out = HeldOut(data, np.zeros(1, dtype=int), [option])
    assert held_out_ends(held_out, TAXI, 0) == counts


@pytest.mark.parametrize('missing', ['passenger_in_taxi', 'passenger_col'])
def test_a_missing_feature_is_found_and_suggested(
    person: Any, fetching: Shown, missing: str
) -> None:
    ann = person()
    every = 'taxi_row', 'taxi_col', 'passenger_row', 'passenger_col', 'passenger_in_taxi'
    ann.features = tuple(name for name in every if name != missing)
    data = make_dataset(ann.show_random(40), TAXI)
    assert f'Add "{missing.replace("_", " ")}"' in advise(data, TAXI)[0]
    assert 'taxi row' in find_conflicts(data)[0]
    data = make_dataset(fetching, TAXI)  # with the right features
    assert (find_conflicts(data), advise(data, TAXI)) == ((), ())


def test_a_slip_is_reported_but_suggests_no_feature(person: Any) -> None:
    ann = person()
    for destination in (1, 2, 3):
        ann.show(TaxiState(1, 0, 0, destination))
    ann.walk(TaxiState(1, 0, 0, 1), 'west', 'north', 'pickup')
    data = make_dataset(ann.shown, TAXI)
    (text,) = find_conflicts(data)
    assert advise(data, TAXI) == ()
    assert 'north (4x), west (1x)' in text


def test_with_chance_another_end_counts_once_it_was_repeated() -> None:
    """A fruit is eaten, and sometimes it is gone before."""
    pacman = make_domain('pacman')
    rng = generator(3, 'fruit')
    features = 'fruit_direction', 'ate'
    fields = {'option_name': 'go to the fruit', 'chosen_features': features}
    (start,) = pacman.sample_states(rng, 1)
    step = show(pacman, start, lambda taken, here: None if taken else 'north', rng, **fields)
    direction, ate = (step.feature_names.index(name) for name in features)

    def ending(*values: float) -> Demonstration:
        row = list(step.features[-1])
        row[direction], row[ate] = values
        return replace(step, features=(step.features[0], tuple(row)))

    eaten, gone = ending(5.0, 5.0), ending(5.0, 0.0)
    rows, over = gone.feature_rows[-1:], np.array([False])
    assert not step.terminated
    for times, counts in enumerate([False, False, True]):
        known = KnownEnds(pacman, features, [eaten] * 8 + [gone] * times)
        assert known.like_shown(eaten.feature_rows[-1:], over).all()
        assert known.like_shown(rows, over).all() == counts
        assert not known.like_shown(rows, ~over).any()
