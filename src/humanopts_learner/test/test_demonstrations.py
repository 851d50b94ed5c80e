"""Demonstrations: whatever the game could not have shown is refused, with the reason."""

from collections.abc import Callable
from dataclasses import fields, replace
import json
from types import SimpleNamespace
from typing import Any
import uuid

from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
    each_once,
    group_by_option,
    Kind,
)
import numpy as np
import pytest

TAXI = Taxi()
START = TaxiState(row=0, col=2, passenger=0, destination=3)
ABOARD = TaxiState(row=2, col=2, passenger=4, destination=3)


@pytest.fixture
def demo(person: Callable[..., Any]) -> Demonstration:
    """Return one good demonstration, from START."""
    shown: Demonstration = person().show(START)
    return shown


@pytest.fixture
def not_here(person: Callable[..., Any]) -> Demonstration:
    """Return one good "not here" answer."""
    shown: Demonstration = person().show(ABOARD)
    return shown


def test_what_the_game_can_show_is_accepted(demo: Demonstration, not_here: Demonstration) -> None:
    check_demonstration(demo, TAXI)
    check_demonstration(not_here, TAXI)
    assert (demo.kind, not_here.kind) == (Kind.TRAJECTORY, Kind.NOT_HERE)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'uuid': 'first'}, 'not a UUID'),
        ({'domain': 'rooms'}, 'of domain rooms'),
        ({'domain_parameters': '{"rows": 8, "cols": 5}'}, 'and the game is taxi'),
        ({'domain_parameters': '{'}, 'not JSON'),
        ({'option_name': ' '}, 'no option'),
        ({'chosen_features': ()}, 'no feature'),
        ({'chosen_features': ('ghost_row',)}, 'ghost_row'),
        ({'feature_names': ('ghost_row',)}, 'not those of taxi'),
        ({'actions': (), 'rewards': ()}, 'no steps'),
        ({'kind': Kind.NOT_HERE}, 'one state and no steps'),
        ({'rewards': (1.0,)}, 'rewards'),
        ({'seconds': float('inf')}, 'not finite'),
        ({'features': ()}, 'rows of features'),
        ({'features': ((0,),) * 6}, 'features'),
    ],
)
def test_a_wrong_field_is_refused(
    demo: Demonstration, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(DemonstrationError, match=message):
        check_demonstration(replace(demo, **change), TAXI)


def changed(values: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
    """Return the tuple with one element replaced."""
    return (*values[:place], value, *values[place + 1 :])


@pytest.mark.parametrize(
    ('field', 'place', 'value', 'message'),
    [
        ('rewards', 1, float('nan'), 'not finite'),
        ('actions', 0, 'jump', 'jump'),
        ('actions', 0, 'pickup', 'pickup does not lead from state 0'),
        ('states', 1, 'taxi 9,9 passenger R destination B', '9'),
        ('states', 1, 'nowhere', 'nowhere'),
        ('features', 1, (0,) * 10, 'features of state 1'),
        ('features', 1, (2**40,) * 10, 'features of state 1'),
        ('features', 1, (0, 1), 'not 10 wide'),
    ],
)
def test_a_wrong_step_is_refused(
    demo: Demonstration, field: str, place: int, value: Any, message: str
) -> None:
    values = changed(getattr(demo, field), place, value)
    with pytest.raises(DemonstrationError, match=message):
        check_demonstration(replace(demo, **{field: values}), TAXI)


def test_a_step_that_is_missing_is_noticed(demo: Demonstration) -> None:
    cut = replace(
        demo,
        states=(demo.states[0], *demo.states[2:]),
        features=(demo.features[0], *demo.features[2:]),
        actions=demo.actions[1:],
        rewards=demo.rewards[1:],
    )
    with pytest.raises(DemonstrationError, match='does not lead from state 0'):
        check_demonstration(cut, TAXI)


def test_nothing_follows_the_end_of_the_task(person: Callable[..., Any]) -> None:
    demo = person('go to destination and dropoff').show(ABOARD)
    assert demo.terminated
    longer = replace(
        demo,
        states=(*demo.states, demo.states[-1]),
        features=(*demo.features, demo.features[-1]),
        actions=(*demo.actions, 'north'),
        rewards=(*demo.rewards, -1.0),
    )
    with pytest.raises(DemonstrationError, match='after the task was over'):
        check_demonstration(longer, TAXI)


def test_a_demonstration_comes_back_from_its_line(
    demo: Demonstration, not_here: Demonstration
) -> None:
    for one in (demo, not_here):
        assert '\n' not in one.to_json()
        assert Demonstration.from_json(one.to_json()) == one


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'kind': 'dream'}, 'dream'),
        ({'number': 'many'}, 'many'),
        ({'number': float('inf')}, 'infinity'),
        ({'rewards': None}, 'field'),
        ({'features': 3}, 'field'),
    ],
)
def test_a_field_of_the_wrong_form_is_refused(
    demo: Demonstration, change: dict[str, Any], message: str
) -> None:
    values = {**json.loads(demo.to_json()), **change}
    with pytest.raises(DemonstrationError, match=message):
        Demonstration.from_fields(values)


@pytest.mark.parametrize('text', ['', '3', '[]', 'null', '{}', '"kind"'])
def test_text_that_is_no_demonstration_is_refused(text: str) -> None:
    with pytest.raises(DemonstrationError):
        Demonstration.from_json(text)


def test_return_is_the_undiscounted_sum(demo: Demonstration) -> None:
    assert demo.total_reward == -(len(demo.actions) - 1)  # 0 for the pickup
    assert demo.feature_rows.shape == (len(demo.actions) + 1, len(TAXI.features))
    assert demo.feature_rows.dtype == np.int32


def test_groups_keep_people_apart_and_count_repeats_once(demo: Demonstration) -> None:
    later = replace(demo, number=2, uuid=str(uuid.UUID(int=2)))
    other = replace(demo, participant='bob', uuid=str(uuid.UUID(int=3)))
    groups = group_by_option([later, other, demo, later, demo])
    assert list(groups) == [(demo.participant, demo.option_name), ('bob', demo.option_name)]
    assert groups[demo.participant, demo.option_name] == [demo, later]


@pytest.mark.parametrize('order', [(0, 1, 2), (1, 0, 2), (1, 2, 0), (0, 2, 0, 1, 0)])
def test_a_demonstration_that_was_withdrawn_before_or_after_counts_no_more(
    demo: Demonstration, order: tuple[int, ...]
) -> None:
    other = replace(demo, uuid=str(uuid.uuid4()), number=2)
    said = (demo, replace(demo, withdrawn=True), other)
    told = [said[n] for n in order]
    assert group_by_option(told) == {(demo.participant, demo.option_name): [other]}
    assert {d.uuid: d.withdrawn for d in each_once(told)} == {demo.uuid: True, other.uuid: False}


def test_only_what_was_withdrawn_says_so_in_json(demo: Demonstration) -> None:
    withdrawn = replace(demo, withdrawn=True)
    assert 'withdrawn' not in demo.to_json()
    assert Demonstration.from_json(withdrawn.to_json()) == withdrawn


def test_a_message_of_an_older_version_is_not_withdrawn(demo: Demonstration) -> None:
    values = {field.name: getattr(demo, field.name) for field in fields(Demonstration)}
    del values['withdrawn']
    flat = [value for row in demo.features for value in row]
    older = SimpleNamespace(**values | {'kind': 1, 'features': flat})
    assert demonstration_from_message(older) == demo
