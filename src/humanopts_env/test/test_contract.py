"""Our domains and reference options keep their contracts, and breaches of a promise are found."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import itertools
from pathlib import Path
import time
from typing import Any

from humanopts_env import testing
from humanopts_env.board import Board
from humanopts_env.domains import check
from humanopts_env.domains.base import (
    Action,
    Domain,
    Feature,
    FeatureKind,
    is_enumerable,
    Outcome,
)
from humanopts_env.domains.check import check_domain, ContractError, Evidence
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.testing import DomainContract, ReferenceContract
import numpy as np
import pytest

FOUR_GHOSTS = str(Path(__file__).with_name('four_ghosts.lay'))
NO_GHOST = '%%%%%\n%P..%\n%%%%%'


OURS: dict[str, Any] = {
    'Taxi': Taxi,
    'WiderTaxi': partial(Taxi, 6, 7),
    'Rooms': Rooms,
    'RoomsWithTheGoalInARoom': partial(Rooms, 'G2'),
    'LonelyPacMan': partial(PacMan, NO_GHOST),
}
PACMANS: dict[str, Any] = {
    'PacMan': PacMan,
    'ChasedPacMan': partial(PacMan, 'yard', ghosts='chase', lives=1, max_steps=100),
    'PacManWithThePapersFeatures': partial(PacMan, 'yard', features='paper'),
    'CrowdedPacMan': partial(PacMan, FOUR_GHOSTS),
}
for _name, _make in {**OURS, **PACMANS}.items():
    _suite = type(f'Test{_name}', (DomainContract,), {'make': staticmethod(_make)})
    globals()[f'Test{_name}'] = pytest.mark.heavy(_suite) if _name in PACMANS else _suite


def broken(**methods: Any) -> type[Taxi]:
    """Return Taxi with other methods."""
    return type('Broken', (Taxi,), methods)


def step_with(change: Callable[[Outcome[TaxiState]], Outcome[TaxiState]]) -> Any:
    """Return a ``step`` whose outcome is changed."""
    return lambda self, state, action, rng: change(Taxi.step(self, state, action, rng))


def with_features(*features: Feature, instead_of: int) -> type[Taxi]:
    """Return Taxi with another feature."""

    def __init__(self: Any, rows: int = 5, cols: int = 5) -> None:  # noqa: N807
        Taxi.__init__(self, rows, cols)
        kept = list(self.features)
        kept[instead_of : instead_of + 1] = features
        self.features = kept

    return broken(__init__=__init__)


def with_two_keys(self: Taxi) -> None:
    """Repeat an action under another name."""
    Taxi.__init__(self)
    self.actions = [*self.actions[:5], Action('souther', 'down', 'again')]


CALLS = itertools.count()
ROW = Feature('taxi_row', 'the row', FeatureKind.ORDINAL, ('0', '1', '2', '3'))
DICE = broken(  # chance that does not come from the generator
    step=lambda self, state, action, rng: Taxi.step(
        self, state, (action + next(CALLS) % 7) % 6 if 0 <= action < 6 else action, rng
    )
)
ENDLESS = broken(
    step=lambda self, state, action, rng: (
        Outcome(state, 0, True) if self.is_over(state) else Taxi.step(self, state, action, rng)
    )
)
OBLIGING = broken(  # takes actions that are not there
    step=lambda self, state, action, rng: Taxi.step(self, state, min(max(action, 0), 5), rng)
)
TORN = broken(  # tables of another game than the one played
    feature_values=lambda self, state: self.feature_table()[self.index(state) - 1]
)
READER = broken(
    decode=lambda self, text: (
        Taxi.decode(self, text) if text.startswith('taxi') else self.state_at(0)
    )
)
UNNAMED = with_features(Feature('taxi_row', 'a', FeatureKind.NOMINAL, ('b',)), instead_of=9)
NARROW = with_features(ROW, instead_of=0)
TWO_KEYS = broken(__init__=with_two_keys)
LENIENT = broken(decode=lambda self, text: Taxi.decode(self, text.strip()))
CREDULOUS = broken(can_follow=lambda self, state, action, successor: True)
JUMPY = broken(can_follow=lambda self, state, action, successor: False)
TELLTALE = broken(board=lambda self, state, shown=None: Taxi.board(self, state))
BLIND = broken(board=lambda self, state, shown=None: Taxi.board(self, state, ()))
SILENT = broken(board=lambda self, state, shown=None: Board())
OUTSIDE = broken(board=lambda self, state, shown=None: replace(Taxi.board(self, state), rows=1))
MUTABLE = broken(over=lambda self: Taxi.over(self).copy())
SUDDEN = broken(step=step_with(lambda outcome: replace(outcome, terminated=True)))
RAISING = broken(feature_values=lambda self, state: 1 / 0)
WORTHLESS = broken(step=step_with(lambda outcome: replace(outcome, reward=float('nan'))))


@pytest.mark.parametrize(
    ('breach', 'claim', 'text'),
    [
        (DICE, check.the_same_generator_gives_the_same_step, 'result with the same generator'),
        (DICE, testing.tables_agree_with_states_and_steps, 'is not in the transitions'),
        (ENDLESS, check.no_step_is_taken_after_the_end, 'it takes a step after the end'),
        (UNNAMED, check.names_and_numbers_are_usable, 'two features have one name'),
        (TWO_KEYS, check.names_and_numbers_are_usable, 'two actions have one key'),
        (
            NARROW,
            check.a_state_has_a_text_features_and_a_board,
            r'taxi_row is 4 in .* out of its range 0\.\.3',
        ),
        (READER, check.other_actions_and_texts_are_refused, ' as a state'),
        (LENIENT, check.other_actions_and_texts_are_refused, ' as a state'),
        (OBLIGING, check.other_actions_and_texts_are_refused, 'it takes the action -1, of 6'),
        (JUMPY, check.a_step_can_follow_and_says_whether_the_task_is_over, 'can_follow denies'),
        (CREDULOUS, testing.not_every_state_can_follow, 'any state can follow'),
        (SUDDEN, check.a_step_can_follow_and_says_whether_the_task_is_over, 'is_over disagree'),
        (WORTHLESS, check.a_step_can_follow_and_says_whether_the_task_is_over, 'reward nan'),
        (TELLTALE, testing.a_board_shows_the_chosen_features_and_nothing_else, 'shows more'),
        (BLIND, testing.a_board_shows_the_chosen_features_and_nothing_else, 'cannot be seen'),
        (OUTSIDE, check.a_state_has_a_text_features_and_a_board, 'is drawn outside the board'),
        (SILENT, check.a_state_has_a_text_features_and_a_board, 'is drawn as nothing'),
        (MUTABLE, testing.tables_agree_with_states_and_steps, 'over can be written to'),
        (TORN, testing.tables_agree_with_states_and_steps, 'feature_table differs'),
    ],
)
def test_a_broken_promise_is_found(
    breach: Callable[[], Domain], claim: check.Claim, text: str
) -> None:
    """Each by the claim that is named for it, in words; a domain with a gross one is refused."""
    with pytest.raises(AssertionError, match=text):
        claim(Evidence(breach(), testing.STEPS, testing.SAMPLES))
    if claim in check.CLAIMS:
        with pytest.raises(ContractError, match=f'^taxi breaks the contract of domains: .*{text}'):
            check_domain(breach(), 'taxi')


def test_a_domain_that_raises_is_refused() -> None:
    with pytest.raises(ContractError, match='it raised ZeroDivisionError: division by zero'):
        check_domain(RAISING(), 'taxi')


def test_a_thing_that_is_no_domain_is_refused() -> None:
    with pytest.raises(
        ContractError, match=r'it has no name, parameters, features, .*sample_states'
    ):
        check_domain(object(), 'thing')  # type: ignore[arg-type]


@pytest.mark.parametrize('domain', [Taxi(), Rooms()], ids=lambda domain: domain.name)
def test_a_good_domain_is_checked_in_the_blink_of_an_eye(domain: Any) -> None:
    times = []
    for _ in range(3):
        began = time.process_time()
        check_domain(domain, domain.name)
        times.append(time.process_time() - began)
    assert is_enumerable(domain)
    assert min(times) < 0.05


PICKUP = reference_options(Taxi())['go to passenger and pickup']
ONLY_SOUTH = np.arange(6) == 0


REFERENCES: dict[str, Any] = {
    'Taxi': Taxi,
    'LargerTaxi': partial(Taxi, 14, 9),
    'RoomsWithTheGoalInARoom': partial(Rooms, 'G2'),
    'PacMan': PacMan,
    'ChasedPacMan': partial(PacMan, 'yard', ghosts='chase'),
    'PacManWithThePapersFeatures': partial(PacMan, 'yard', features='paper'),
}
for _name, _make in REFERENCES.items():
    _suite = type(f'TestReferencesOf{_name}', (ReferenceContract,), {'make': staticmethod(_make)})
    globals()[f'TestReferencesOf{_name}'] = pytest.mark.heavy(_suite)


NOWHERE, NEVER = np.zeros(500, dtype=np.bool_), np.zeros((500, 6), dtype=np.bool_)


@pytest.mark.parametrize(
    ('claim', 'change'),
    [
        (testing.each_has_a_name_a_definition_and_features_in_order, {'definition': ''}),
        (
            testing.each_has_a_name_a_definition_and_features_in_order,
            {'features': PICKUP.features[::-1]},
        ),
        (testing.each_has_a_name_a_definition_and_features_in_order, {'name': 'Pickup'}),
        (testing.each_acts_where_it_can_start_and_has_ended_elsewhere, {'initiation': NOWHERE}),
        (testing.each_acts_where_it_can_start_and_has_ended_elsewhere, {'optimal': NEVER}),
        (testing.each_acts_where_it_can_start_and_has_ended_elsewhere, {'termination': NOWHERE}),
        (testing.its_features_determine_where_each_starts_and_ends, {'features': ('taxi_row',)}),
        (
            testing.every_run_comes_to_its_end,
            {'optimal': PICKUP.initiation[:, None] & ONLY_SOUTH},
        ),
    ],
)
def test_what_breaks_the_contract_of_options_is_found(
    claim: Callable[[testing.OptionEvidence], None], change: dict[str, Any]
) -> None:
    broken = replace(PICKUP, **change)
    with pytest.raises(AssertionError):
        claim(testing.OptionEvidence(Taxi(), {broken.name: broken}))
