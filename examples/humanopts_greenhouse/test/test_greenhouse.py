"""The greenhouse satisfies the contract of every domain and follows its rules."""

from typing import Any

from humanopts_env.board import board_text
from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.capabilities import StepEffect
from humanopts_env.seeding import generator
from humanopts_env.testing import DomainContract, ReferenceContract
from humanopts_greenhouse.greenhouse import Greenhouse
from humanopts_greenhouse.reference import reference_options
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.automatic.subgoals import Extraction
from humanopts_learner.options.learned_option import options_from_references
from humanopts_learner.planning.request import HUMAN, PlanRequest, PRIMITIVE
from humanopts_teach.evaluation.games import Baseline, PLAN, play_baseline, RANDOM, RULE
import pytest

HOUSE = Greenhouse()
NORTH, SOUTH, WEST, EAST, FILL, POUR = range(6)


class TestGreenhouse(DomainContract):
    """The default house."""

    def make(self) -> Domain:
        """Return a new one."""
        return Greenhouse()


class TestSmallGreenhouse(DomainContract):
    """The smallest house."""

    def make(self) -> Domain:
        """Return a new one."""
        return Greenhouse(3)


class TestItsOptions(ReferenceContract):
    """The options of the greenhouse, even if the package is not installed."""

    def make(self) -> Domain:
        """Return a new one."""
        return Greenhouse()

    def options(self, domain: Domain) -> dict[str, Any]:
        """Return the options of the entry point."""
        return dict(reference_options(domain))


def after(text: str, action: int) -> tuple[str, float, bool]:
    """Take one step from an encoded state."""
    outcome = HOUSE.step(HOUSE.decode(text), action, generator(0, 'test'))
    return HOUSE.encode(outcome.state), outcome.reward, outcome.terminated


@pytest.mark.parametrize(
    ('state', 'action', 'expected'),
    [
        ('cell 3,0 can empty dry beans', FILL, ('cell 3,0 can full dry beans', -1, False)),
        ('cell 2,0 can empty dry beans', FILL, ('cell 2,0 can empty dry beans', -1, False)),
        ('cell 0,3 can full dry beans', POUR, ('cell 0,3 can empty dry none', 9, True)),
        ('cell 0,0 can full dry beans', POUR, ('cell 0,0 can full dry beans', -1, False)),
        ('cell 0,1 can full dry beans', POUR, ('cell 0,1 can full dry beans', -1, False)),
        ('cell 0,3 can empty dry beans', POUR, ('cell 0,3 can empty dry beans', -1, False)),
        ('cell 0,0 can full dry beans', NORTH, ('cell 0,0 can full dry beans', -1, False)),
        ('cell 0,0 can full dry beans', EAST, ('cell 0,1 can full dry beans', -1, False)),
    ],
)
def test_steps(state: str, action: int, expected: tuple[str, float, bool]) -> None:
    """Expected results are computed by hand."""
    assert after(state, action) == expected


def test_the_board() -> None:
    """The gardener is drawn in front of the cell's content; hidden features are unknown."""
    state = HOUSE.decode('cell 3,0 can full dry tomatoes basil')
    lines = board_text(HOUSE.board(state)).splitlines()
    assert lines[1:5:3] == ['┃ * · · ♣┃', '┃☻T · · *┃']
    assert lines[-1].endswith('can full: yes')
    assert board_text(HOUSE.board(state, ['beans_dry'])).splitlines()[1] == '┃ ? · · ♣┃'


@pytest.mark.parametrize(
    ('name', 'state', 'distance', 'actions'),
    [
        ('fill the can', 'cell 3,0 can empty dry beans', 1, {'fill'}),
        ('fill the can', 'cell 1,1 can empty dry beans', 4, {'south', 'west'}),
        ('water the nearest dry bed', 'cell 3,0 can full dry beans', 7, {'north', 'east'}),
        ('water the nearest dry bed', 'cell 3,0 can full dry tomatoes beans', 4, {'north'}),
        ('water the nearest dry bed', 'cell 0,3 can full dry beans', 1, {'pour'}),
    ],
)
def test_reference_options(name: str, state: str, distance: int, actions: set[str]) -> None:
    """Distances are counted on the board."""
    option, start = reference_options(HOUSE)[name], HOUSE.decode(state)
    assert option.distance[HOUSE.index(start)] == distance
    assert {HOUSE.actions[a].name for a in option.optimal_actions(start)} == actions


@pytest.mark.parametrize('size', [2, 10, 4.0, True, '4'])
def test_sizes_that_are_none_are_refused(size: Any) -> None:
    """The error names the valid sizes."""
    with pytest.raises(DomainError, match='from 3 to 9'):
        Greenhouse(size)


def test_subgoals_are_events_at_the_tap_and_the_beds() -> None:
    """Automatic options fill the can and pour, as defined by the search space."""
    config = Extraction(options=4, tasks=40, train_episodes=60, test_runs=3, option_episodes=60)
    found = find_options(HOUSE, 1, config)
    assert {option.target.event for option in found.options} <= {'fill', 'pour', ''}
    assert 'fill at cell 3,0' in [option.name for option in found.options]


def test_a_plan_with_options_plays_like_the_rule_written_by_hand() -> None:
    """Both play many games at once; random moves score less."""
    options = options_from_references(HOUSE, reference_options(HOUSE).values())
    baselines = [
        Baseline('planned', PLAN, options, PlanRequest(HUMAN, game_steps=4000)),
        Baseline('rule', RULE),
        Baseline('moves', RANDOM, request=PlanRequest(PRIMITIVE)),
    ]
    planned, rule, moves = (play_baseline(HOUSE, each, seed=1, games=60) for each in baselines)
    assert planned['score'] == pytest.approx(rule['score'], abs=2.0)
    assert moves['score_high'] < rule['score_low']


@pytest.mark.parametrize(
    ('before', 'action', 'after', 'text'),
    [
        ('1,1 can empty dry beans', 'east', '1,2 can empty dry beans', 'went east'),
        ('0,1 can empty dry beans', 'north', '0,1 can empty dry beans', 'wall: nothing moved'),
        ('3,0 can empty dry beans', 'fill', '3,0 can full dry beans', 'filled the can'),
        ('3,0 can full dry beans', 'fill', '3,0 can full dry beans', 'the can is full already'),
        ('1,1 can empty dry beans', 'fill', '1,1 can empty dry beans', 'no tap here'),
        ('0,3 can full dry beans', 'pour', '0,3 can empty dry none', 'watered the beans'),
        ('0,3 can empty dry beans', 'pour', '0,3 can empty dry beans', 'the can is empty'),
        ('0,0 can full dry beans', 'pour', '0,0 can full dry beans', 'no dry bed here'),
    ],
)
def test_a_step_says_what_it_did(before: str, action: str, after: str, text: str) -> None:
    """An action without effect is described as such."""
    states = [HOUSE.decode(f'cell {state}') for state in (before, after)]
    index = [each.name for each in HOUSE.actions].index(action)
    assert HOUSE.can_follow(states[0], index, states[1])
    assert HOUSE.step_effect(states[0], index, states[1]) == StepEffect(text, before != after)
