"""The game's plain values are those of the messages that carry them."""

from dataclasses import fields
from enum import IntEnum
from typing import Any

from humanopts_env import game
from humanopts_interfaces.msg import ActionCommand, ActionRefusal, ControlState, GameState
from humanopts_interfaces.srv import ResetGame, SetControl
import pytest

ENVELOPE = {'header', 'publisher_id', 'sequence'}
PACE = {'step_period', 'paused_by'}  # of ``Pacing``, told with who holds control


@pytest.mark.parametrize(
    ('values', 'prefix', 'message'),
    [
        (game.Source, 'SOURCE_', GameState),
        (game.Reason, 'REASON_', ActionRefusal),
        (game.Holder, 'HOLDER_', ControlState),
        (game.ResetStatus, 'STATUS_', ResetGame.Response),
        (game.ControlStatus, 'STATUS_', SetControl.Response),
    ],
)
def test_numbers_are_those_of_the_message(
    values: type[IntEnum], prefix: str, message: Any
) -> None:
    """Every constant has its member, and the other way round; UNKNOWN is never sent."""
    constants = {
        name.removeprefix(prefix): getattr(message, name)
        for name in dir(message)
        if name.startswith(prefix) and not name.endswith('_UNKNOWN')
    }
    assert {member.name: member.value for member in values} == constants


@pytest.mark.parametrize('message', [ActionCommand, ResetGame.Request])
def test_sources_of_requests_are_those_of_the_game(message: Any) -> None:
    """The same number means the same source everywhere."""
    assert message.SOURCE_PERSON == game.Source.PERSON
    assert message.SOURCE_MACHINE == game.Source.MACHINE


@pytest.mark.parametrize(
    ('value', 'message', 'envelope'),
    [
        (game.Transition, GameState, ENVELOPE),
        (game.Control, ControlState, ENVELOPE | PACE),
        (game.Command, ActionCommand, {'header', 'option_name'}),  # which is for the bag
    ],
)
def test_fields_are_those_of_the_message(value: Any, message: Any, envelope: set[str]) -> None:
    """Nothing is lost on the way."""
    names = {field.name for field in fields(value)}
    assert names == message.get_fields_and_field_types().keys() - envelope
