"""Dataclasses and messages that do not fit fail where their codec is made."""

from dataclasses import dataclass
from enum import Enum
import math

from humanopts_interfaces.msg import ActionInfo, Criterion, LessonState
from humanopts_ros.codec import Codec
import pytest


class Word(Enum):
    KNOWN = 'known'


@dataclass
class Named:
    name: str


@dataclass
class Measured:
    name: str
    value: float | None
    met: bool = True


MEASURED = ['threshold', 'limit', 'count', 'possible', 'obstacle', 'measurable']  # not in it


@dataclass
class Phased:
    phase: Word


@pytest.mark.parametrize(
    ('kind', 'message', 'options', 'lacks'),
    [
        (Named, ActionInfo, {}, 'do not share .*description'),
        (Measured, Criterion, {'of_message': MEASURED[:-1]}, "{'measurable'}"),
        (Named, ActionInfo, {'of_message': ['key', 'description'], 'of_value': ['name']}, 'name'),
        (Phased, LessonState, {'subset': True}, 'do not share'),
    ],
)
def test_a_field_that_is_missing_on_either_side_is_named(
    kind: type, message: type, options: dict[str, object], lacks: str
) -> None:
    with pytest.raises(TypeError, match=lacks):
        Codec(kind, message, **options)  # type: ignore[arg-type]


def test_a_constant_without_a_member_is_an_error() -> None:
    others = set(LessonState.get_fields_and_field_types()) - {'phase'}
    with pytest.raises(TypeError, match='Word and the PHASE_ of LessonState differ'):
        Codec(Phased, LessonState, of_message=others)


def test_none_is_nan_and_what_only_the_message_has_is_given() -> None:
    codec = Codec(Measured, Criterion, of_message=MEASURED)
    message = codec.encode(Measured('return', None), threshold=2.0)
    assert (message.name, message.threshold, message.met) == ('return', 2.0, True)
    assert math.isnan(message.value)
    assert codec.decode(message) == Measured('return', None)


def test_a_number_that_is_no_constant_is_refused() -> None:
    from humanopts_teach.ros.convert import LESSON_STATE

    with pytest.raises(ValueError, match='phase is 0, which is not a PHASE_ constant'):
        LESSON_STATE.decode(LessonState())
