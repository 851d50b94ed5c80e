"""Questions about runs: what is asked, and that answers are evidence."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from graph_support.scripted import show
from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.replayed_domain import ReplayedDomain, World
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner import Demonstration, learn_option, LearnedOption
from humanopts_learner.demonstrations import check_demonstration, GOAL, Kind, version_of
from humanopts_learner.options.checks import Check, CheckKind, MAX_CHECKS, next_check
from humanopts_learner.options.rollout import rollouts
import numpy as np
import pytest

TAXI = Taxi()
END = 40  # the last cell of a street
FETCH, EITHER = 'go to passenger and pickup', 'pickup/dropoff'
LOCATIONS = (0, 0), (0, 4), (4, 0), (4, 3)  # of passengers and destinations 0..3
Shown = Sequence[Demonstration]


def answered(check: Check, demos: Shown, domain: Any = TAXI, *, right: bool) -> Demonstration:
    """Return the judged run of a question, which must be one by the rules."""
    number = 1 + sum(demo.kind is Kind.JUDGED for demo in demos)
    newest = [demo for demo in demos if demo.kind is not Kind.JUDGED][-1]
    run = replace(
        newest,
        kind=Kind.JUDGED,
        uuid=f'00000000-0000-4000-8000-{number:012}',
        number=number,
        states=check.states,
        features=check.features,
        actions=check.actions,
        rewards=check.rewards,
        terminated=check.terminated,
        can_start_at_end=False,
        right=right,
        option_version=version_of(demos),
    )
    check_demonstration(run, domain)
    return run


def ask(demos: Shown, domain: Any = TAXI, seed: int = 0) -> Check | None:
    return next_check(learn_option(demos, TAXI, 0), domain, demos, np.random.default_rng(seed))


def ask_all(demos: Shown, right: Callable[[Check], bool]) -> list[Check]:
    """Return all questions about one version; none is asked after a no."""
    found: list[Check] = []
    everything = [*demos]
    while (check := ask(everything)) is not None:
        found.append(check)
        everything.append(answered(check, everything, right=right(check)))
        if not everything[-1].right:
            break
    return found


def by_goal(demos: Shown) -> list[Demonstration]:
    return [replace(demo, method=GOAL) for demo in demos]


def at(passenger: int, row: int = 2, col: int = 2, destination: int = 1) -> TaxiState:
    return TaxiState(row, col, passenger, destination)


def ends_of(option: LearnedOption) -> dict[int, tuple[int, int, int]]:
    """Return taxi and passenger where the run from each start ends, step by step."""
    found = {}
    rows, rng = TAXI.feature_table(), np.random.default_rng(0)
    for start in np.flatnonzero(option.can_start(rows) & ~TAXI.over()).tolist():
        state = TAXI.state_at(start)
        for _ in range(200):
            action = option.action(TAXI.feature_values(state)[None])[0]
            state = TAXI.step(state, int(action), rng).state
            if TAXI.is_over(state) or option.ends(TAXI.feature_values(state)[None])[0]:
                break
        found[start] = state.row, state.col, state.passenger
    return found


def test_ends_that_were_never_shown_are_asked_about_until_few_starts_lead_there(
    person: Any,
) -> None:
    ann = person()
    for row in (1, 2, 3):
        ann.show(at(0, row))  # always at the same place
    demos = by_goal(ann.shown)
    first = ask(demos)
    assert first is not None
    assert first.kind is CheckKind.END
    steps = f'{len(first.actions)} step{"s"[: len(first.actions) != 1]}'
    assert first.text == f'Here it would stop after {steps}, where you never stopped. Right?'
    found = ask_all(demos, lambda check: True)
    ends = [TAXI.decode(c.states[-1]) for c in found if c.kind is CheckKind.END]
    assert len(ends) == len({(end.row, end.col) for end in ends})  # each once
    of_start = ends_of(learn_option(demos, TAXI, 0))
    known = {(0, 0, 4), *((end.row, end.col, end.passenger) for end in ends)}
    assert np.mean([end in known for end in of_start.values()]) >= 0.95


def test_a_question_shows_what_the_option_would_do(person: Any, plain_taxi: Any) -> None:
    """In a world with tables and in one without, from starts of many lessons."""
    for seed in range(6):
        demos = person(seed=seed).show_random(3)
        option = learn_option(demos, TAXI, 0)
        for domain in (TAXI, plain_taxi):
            check = next_check(option, domain, demos, np.random.default_rng(seed))
            assert check is not None
            states = [TAXI.decode(text) for text in check.states]
            rows = np.array([TAXI.feature_values(state) for state in states])
            assert rows.tolist() == [list(row) for row in check.features]
            if check.kind is CheckKind.OUTSIDE:
                assert not option.can_start(rows).any()
                assert not check.actions
                continue
            assert option.can_start(rows[:1]).all()
            acts = [TAXI.actions[a].name for a in option.action(rows[:-1])]
            assert list(check.actions) == acts
            (expected,) = rollouts(option, TAXI, states[:1]).steps
            assert len(check.actions) == expected
            assert sum(check.rewards) == rollouts(option, TAXI, states[:1]).total_reward[0]


def test_the_same_question_comes_again_until_it_is_answered(person: Any) -> None:
    demos = person().show_random(3)
    first = ask(demos, seed=3)
    assert first is not None
    assert ask(demos, seed=3) == first
    after = ask([*demos, answered(first, demos, right=True)], seed=3)
    assert after is None or after.states[0] != first.states[0]


def test_a_value_that_was_never_shown_is_asked_about(person: Any) -> None:
    ann = person()
    for passenger, col in ((0, 1), (1, 3), (2, 1), (3, 2)):
        ann.show(at(passenger, 2, col))
    found = ask_all(by_goal(ann.shown), lambda check: True)
    values = [check for check in found if check.kind is CheckKind.VALUE]
    seen = {col for demo in ann.shown for col in demo.feature_rows[:, 1].tolist()}
    missing = sorted({0.0, 1.0, 2.0, 3.0, 4.0} - seen)
    asked = sorted({col for c in values for col in (c.features[0][1],) if col in missing})
    assert [bool(missing), asked] == [bool(values), missing]


class Walk:
    """A street with a red sign at one of its cells; west of it begins every other walk."""

    def reset(self, seed: int) -> None:
        self.cell = int(np.random.default_rng(seed).integers(END))

    def step(self, action: int) -> tuple[float, bool]:
        self.cell = min(max(self.cell + 2 * action - 1, 0), END)
        return -1.0, False

    def features(self) -> Sequence[float]:
        return [self.cell == END // 2, self.cell == END]


class Street(ReplayedDomain):
    name, gamma, max_steps = 'street', 0.9, 100
    parameters: dict[str, int] = {}
    features = (
        Feature.nominal('sign', 'what the sign is', ('plain', 'red')),
        Feature.nominal('end', 'whether the street ends', ('no', 'yes')),
    )
    actions = (Action('west', 'w', 'west'), Action('east', 'e', 'east'))

    def make_world(self) -> World:
        return Walk()


def test_a_run_through_a_value_that_was_never_shown_is_asked_about() -> None:
    """As a start it is rare."""
    street, demos, rng = Street(), list[Demonstration](), generator(0, 'street')
    fields: dict[str, Any] = {'option_name': 'walk', 'chosen_features': ('sign', 'end')}
    for seed in range(20):
        start = street.decode(f'seed {seed} actions -')
        walk = show(street, start, lambda _, at: None if at.features[1] else 'east', rng, **fields)
        if len(walk.actions) < END // 2:
            demos.append(replace(walk, number=len(demos) + 1))
    option = learn_option(demos, street, 0)
    check = next_check(option, street, demos, rng)
    assert check is not None
    assert check.kind is CheckKind.VALUE
    assert 'You never showed it with sign red.' in check.text
    signs = [row[0] for row in check.features]
    assert (signs[0], signs[-1], sum(signs)) == (0, 0, 1)
    yes = answered(check, demos, street, right=True)
    assert next_check(option, street, [*demos, yes], rng) is None


def test_a_start_that_differs_in_what_was_always_the_same_is_asked_about(person: Any) -> None:
    ann = person()
    for passenger, row, col in ((0, 4, 4), (1, 4, 0), (2, 0, 4), (3, 0, 0)):
        ann.show(at(passenger, row, col, destination=1))
    found = ask_all(by_goal(ann.shown), lambda check: True)
    constant = [check for check in found if check.kind is CheckKind.CONSTANT]
    assert constant
    assert all(TAXI.decode(check.states[0]).destination != 1 for check in constant)
    assert 'You never showed a start with destination' in constant[0].text


def test_states_outside_i_are_asked_about_until_there_is_evidence(person: Any) -> None:
    ann = person()
    for passenger, (row, col) in enumerate(LOCATIONS):
        ann.show(at(passenger, 4 - row, 4 - col))
    reference = reference_options(TAXI)[FETCH]

    def right(check: Check) -> bool:
        return reference.can_start(TAXI.decode(check.states[0])) == bool(check.actions)

    found = ask_all(by_goal(ann.shown), right)
    outside = [check for check in found if check.kind is CheckKind.OUTSIDE]
    assert {check.text for check in outside} == {'It would not start here. Right?'}
    assert 1 <= len(outside) <= 4
    option = learn_option(by_goal(ann.shown), TAXI, 0)
    starts = option.can_start(TAXI.feature_table())
    wrong = (starts != reference.initiation) & reference.judged & ~TAXI.over()
    assert right(found[-1]) != wrong.any()  # if I is wrong anywhere, an answer is no


def test_the_half_that_was_never_shown_is_found(person: Any) -> None:
    """Only picking up was shown, with needless features; the person means dropping off, too."""
    bob, reference = person(EITHER), reference_options(TAXI)[EITHER]
    bob.features = (*bob.features, 'taxi_row', 'passenger_row')
    for passenger, (row, col) in enumerate(LOCATIONS):
        bob.show(TaxiState(row, col, passenger, (passenger + 1) % 4))

    def right(check: Check) -> bool:
        start, end = (TAXI.decode(check.states[n]) for n in (0, -1))
        return reference.can_start(start) == bool(check.actions) and (
            start.passenger != end.passenger or not check.actions
        )

    found = ask_all(by_goal(bob.shown), right)
    assert not right(found[-1])


def test_a_plan_that_is_shorter_than_the_demonstrations_is_asked_about(person: Any) -> None:
    ann = person()
    ann.walk(at(0, 1, 0), *['east', 'west'] * 2, 'north', 'pickup')
    ann.walk(at(0, 2, 0), *['east', 'west'] * 2, 'north', 'north', 'pickup')
    ann.walk(at(0, 0, 1), *['east', 'west'] * 2, 'west', 'pickup')
    demos = by_goal(ann.shown)
    found = ask_all(demos, lambda check: True)
    shorter = [check for check in found if check.kind is CheckKind.SHORTER]
    assert len(shorter) == 1  # all are longer by as much
    took, takes = len(shorter[0].compared) - 1, len(shorter[0].actions)
    assert took - takes == 4
    words = f'You took {took} steps here; it takes {takes}. Is the shorter way right?'
    assert shorter[0].text == words
    assert shorter[0].compared[0] == shorter[0].states[0]
    direct = by_goal(person().show_random(3))
    kinds = {check.kind for check in ask_all(direct, lambda check: True)}
    assert CheckKind.SHORTER not in kinds


def test_a_detour_is_asked_about_though_it_was_shown_often(person: Any) -> None:
    ann = person()
    ann.show_random(8)
    for _ in range(4):
        ann.walk(at(0, 1, 0), 'east', 'north', 'west', 'pickup')
    kinds = {}
    for check in ask_all(ann.shown, lambda check: True):
        kinds[check.kind] = check
    option = learn_option(ann.shown, TAXI, 0)
    assert rollouts(option, TAXI, [at(0, 1, 0)]).steps.tolist() == [4]
    assert 'Is the detour intended?' in kinds[CheckKind.DETOUR].text


def test_questions_end_after_a_no_in_number_and_where_nothing_can_be_run(person: Any) -> None:
    demos = person().show_random(3)
    described = DescribedDomain(
        TAXI.name, TAXI.parameters, TAXI.features, TAXI.actions, TAXI.gamma, TAXI.max_steps
    )
    option = learn_option(demos, TAXI, 0)
    assert next_check(option, described, demos, np.random.default_rng(0)) is None
    names = tuple(feature.name for feature in TAXI.features)
    needless = by_goal([replace(demo, chosen_features=names) for demo in demos])
    assert len(ask_all(needless, lambda check: True)) <= MAX_CHECKS
    newer = replace(needless[-1], uuid='00000000-0000-4000-8000-000000000000', number=4)
    assert ask([*needless, newer]) is not None


@pytest.mark.parametrize('answer', [True, False])
def test_an_answer_counts_for_the_option_and_is_never_learned_from(
    person: Any, answer: bool
) -> None:
    demos = by_goal(person().show_random(3))
    check = ask(demos)
    assert check is not None
    run = answered(check, demos, right=answer)
    assert learn_option([*demos, run], TAXI, 0) == learn_option(demos, TAXI, 0)
