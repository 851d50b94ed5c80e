"""What can be asked of planning: defaults, what is refused, and the options to plan with."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_learner.options.option import LearnedOption, options_from_references
from humanopts_learner.planning.request import (
    NoOptionsError,
    PlanError,
    PlanRequest,
    Sampling,
    select_options,
)
import pytest

ROOMS, YARD = Rooms(), PacMan('yard', max_steps=60)
OPTIONS = options_from_references(ROOMS, reference_options(ROOMS).values())


def test_defaults_fit_the_models() -> None:
    """Exact models need no game steps, and sampled ones no tolerance finer than themselves."""
    asked = PlanRequest('primitive')
    assert asked.in_force(ROOMS, []) == PlanRequest('primitive', 0.9, 1e-8, 10_000, 0)
    assert asked.in_force(YARD, []) == PlanRequest('primitive', 0.97, 1e-3, 10_000, 800_000)
    own = PlanRequest('primitive', 0.5, 0.1, 7, 500, 9)
    assert own.in_force(YARD, []) == own
    assert own.in_force(ROOMS, []) == replace(own, game_steps=0)


@pytest.mark.parametrize(
    ('settings', 'text'),
    [
        ({'action_set': 'robot'}, 'human, primitive'),
        ({'gamma': -0.5}, 'gamma'),
        ({'gamma': 1.01}, 'gamma'),
        ({'gamma': math.nan}, 'gamma'),
        ({'tol': math.nan}, 'tol'),
        ({'max_sweeps': -1}, 'max_sweeps'),
    ],
)
def test_settings_that_make_no_sense_anywhere_are_refused(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(PlanError, match=text):
        PlanRequest(**{'action_set': 'primitive', **settings})


@pytest.mark.parametrize(
    ('numbers', 'text'),
    [
        ({'rounds': 1}, 'two rounds'),
        ({'game_steps': 0}, 'one step of each game in every round'),
        ({'game_steps': 7}, 'one step of each game in every round'),  # of eight rounds
        ({'explore': 1.5}, 'explore from 0 to 1'),
    ],
)
def test_sampling_out_of_range_is_refused(numbers: dict[str, Any], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        Sampling(**numbers)


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        ([], 'teach one'),
        ([OPTIONS[0], OPTIONS[0]], f'more than one option is called {OPTIONS[0].name}'),
        ([replace(OPTIONS[0], domain_parameters='{"goal": "G2"}')], '"G2"'),
    ],
)
def test_options_that_do_not_fit_are_refused(options: Sequence[LearnedOption], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        PlanRequest('human').in_force(ROOMS, options)
    with pytest.raises(NoOptionsError, match='extract them'):
        PlanRequest('automatic').in_force(ROOMS, [])


def test_a_domain_that_cannot_be_planned_in_so_is_refused(plain_taxi: Any) -> None:
    """Too few game steps are refused only where models are sampled."""
    few = PlanRequest('primitive', game_steps=399)
    assert few.in_force(ROOMS, []).game_steps == 0
    with pytest.raises(PlanError, match='game_steps is 399, and must be at least 400'):
        few.in_force(YARD, [])
    with pytest.raises(PlanError, match=r'no exact models; .* no method batch_games'):
        PlanRequest('primitive').in_force(plain_taxi, [])


def named(name: str, participant: str) -> LearnedOption:
    """Return an option that a participant taught."""
    return replace(OPTIONS[0], name=name, participant=participant)


def test_options_are_chosen_by_person_and_name_in_the_order_they_have() -> None:
    """No option is chosen for primitive actions; that there are none is no error yet."""
    a, b, c = named('a', 'ann'), named('b', 'ann'), named('a', 'bob')
    assert select_options([a, b], 'human') == [a, b]
    assert select_options([a, b], 'human', names=['b', 'a']) == [a, b]
    assert select_options([a, b, c], 'human', 'ann', ['b']) == [b]
    assert select_options([a, b, c], 'human', 'bob') == [c]
    assert select_options([a, b, c], 'primitive', names=['fly']) == []
    assert select_options([], 'human', 'eve', ['a']) == []
    with pytest.raises(PlanError, match='name one of ann, bob'):
        select_options([a, b, c], 'human')
    with pytest.raises(NoOptionsError, match="'eve' taught no option; those who did: ann, bob"):
        select_options([a, b, c], 'human', 'eve', ['a'])
    with pytest.raises(PlanError, match="no option 'b', 'fly'; there is 'a'"):
        select_options([a, b, c], 'human', 'bob', ['b', 'a', 'fly'])
