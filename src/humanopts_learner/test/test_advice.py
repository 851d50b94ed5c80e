"""Advice on the chosen features: from evidence in several demonstrations, and only from that."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from graph_support.scripted import show
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.seeding import generator
from humanopts_learner import Demonstration
from humanopts_learner.options.conflicts import (
    advise,
    contradiction,
    find_conflicts,
    find_needless,
    MIN_UNUSED,
    SAY_AGAIN,
    UNTOLD,
)
from humanopts_learner.options.learn import fit_leave_fold_out, fold_of, make_dataset
import numpy as np
import pytest

TAXI = Taxi()
PACMAN = make_domain('pacman')
FOOD, PILL = 'go to the closest food', 'go to the nearest power pellet'
ATE = 'Add "ate": it tells where the option ends.'


def eaten(seed: int, count: int, option: str, *features: str) -> list[Demonstration]:
    """Show how to eat something in Pac-Man; the option is never said to start at its end."""
    reference, rng = reference_options(PACMAN)[option], generator(seed, 'advice')
    found: list[Demonstration] = []
    while len(found) < count:
        (start,) = PACMAN.sample_states(rng, 1)

        def choose(taken: int, state: Any) -> str | None:
            done = taken and (reference.ends(state) or not reference.can_start(state))
            return None if done else PACMAN.actions[reference.optimal_actions(state)[0]].name

        if reference.can_start(start):
            number = len(found) + 1
            fields = {'option_name': option, 'chosen_features': features, 'number': number}
            found.append(show(PACMAN, start, choose, rng, **fields))
    return found


def advice(demos: Sequence[Demonstration]) -> list[tuple[str, ...]]:
    """Return the advice after each demonstration."""
    counts = range(1, len(demos) + 1)
    return [advise(make_dataset(demos[:count], PACMAN), PACMAN) for count in counts]


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_beginner_is_told_what_is_missing_and_nothing_wrong(seed: int) -> None:
    """Only the direction of the food is chosen, and nothing about where it can start again."""
    demos = eaten(seed, 12, FOOD, 'food_direction')
    found = advice(demos)
    assert found[0] == ()  # one demonstration is no evidence
    first = next(count for count, texts in enumerate(found, start=1) if texts)
    assert first <= 5
    for count, texts in enumerate(found[first - 1 :], start=first):
        assert set(texts) <= {UNTOLD, ATE, SAY_AGAIN}, count
        assert SAY_AGAIN in texts, count
        conflicts = find_conflicts(make_dataset(demos[:count], PACMAN))
        assert not any('start' in text for text in conflicts)  # nothing was said about starts
    assert found[-1] == (ATE, SAY_AGAIN)
    right = [
        replace(
            demo,
            chosen_features=('food_direction', 'ate'),
            can_start_at_end=not demo.terminated,
        )
        for demo in demos
    ]
    assert set(advice(right)) == {()}


def test_an_end_of_the_task_does_not_hide_that_the_option_can_start_again() -> None:
    demos = eaten(1, 12, FOOD, 'food_direction', 'ate')
    over = [replace(demos[0], terminated=True), *demos[1:]]
    assert advice(demos)[-1] == advice(over)[-1] == (SAY_AGAIN,)


def test_right_features_are_left_alone() -> None:
    for seed in range(3):
        for name, reference in reference_options(PACMAN).items():
            if name in (FOOD, PILL):
                demos = eaten(seed, 8, name, *reference.features)
                assert not [text for texts in advice(demos) for text in texts if 'Add' in text]


def test_what_tells_the_end_comes_before_what_separates_actions(person: Any) -> None:
    """Without it, the actions at the passenger differ, too."""
    ann = person()
    ann.features = 'taxi_row', 'taxi_col', 'passenger_row', 'passenger_col'
    texts = advise(make_dataset(ann.show_random(20), TAXI), TAXI)
    assert texts[0] == 'Add "passenger in taxi": it tells where the option ends.'
    assert not any('what you do' in text for text in texts)


def test_labels_without_a_reason_lead_to_no_advice(person: Any) -> None:
    """The chosen feature tells nothing, and neither does any other: ends are drawn by lot."""
    rng, found = np.random.default_rng(0), 0
    for _ in range(20):
        ann = person()
        ann.features = ('blocked_moves',)
        for start in rng.choice(np.flatnonzero(~TAXI.over()), 5).tolist():
            moves = rng.choice(['north', 'south', 'east', 'west'], rng.integers(2, 8)).tolist()
            ann.walk(TAXI.state_at(start), *moves)
        texts = advise(make_dataset(ann.shown, TAXI), TAXI)
        found += any('it tells where the option ends' in text for text in texts)
    assert found <= 3  # a level of 5 % for all features of a lesson


def test_a_needless_feature_is_named_if_as_much_is_learned_without_it(
    person: Any, fetching: Sequence[Demonstration]
) -> None:
    features = (*fetching[0].chosen_features, 'taxi_at_destination')
    demos = [replace(demo, chosen_features=features) for demo in fetching]

    def needless(some: Sequence[Demonstration]) -> tuple[str, ...]:
        data = make_dataset(some, TAXI)
        folds = fold_of(data, 0)
        return find_needless(fit_leave_fold_out(data, folds, TAXI, 0), data, folds, TAXI)

    (text,) = needless(demos)
    assert text.split('"')[1] == 'taxi at destination'
    assert f'from your {len(fetching)} demonstrations' in text
    assert not needless(fetching)  # all that is left is needed
    assert not needless(demos[: MIN_UNUSED - 1])


def test_an_end_does_not_contradict_a_start_that_looks_like_it(person: Any) -> None:
    """Nobody said that the option cannot start there."""
    ann = person()
    ann.features = ('taxi_row', 'taxi_col')
    first = ann.walk(TaxiState(0, 0, 1, 2), 'south')
    second = ann.walk(TaxiState(1, 0, 1, 2), 'south')
    assert contradiction(second, [first], TAXI) is None
