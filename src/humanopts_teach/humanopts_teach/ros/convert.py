"""Messages to teaching values and back: the only module of this package that knows both."""

from collections.abc import Mapping
from dataclasses import fields
from enum import Enum
from typing import Any, TypeVar

from humanopts_interfaces import srv
from humanopts_learner.demonstrations import Demonstration, demonstration_from_message
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.lesson import requests
from humanopts_teach.lesson.requests import Phase, RequestStatus, Verdict

V = TypeVar('V')

# By kind of request: the type of its service, and the name.
LESSON_SERVICES: Mapping[type, tuple[Any, str]] = {
    requests.OpenSession: (srv.OpenSession, 'lesson/open_session'),
    requests.DefineOption: (srv.DefineOption, 'lesson/define_option'),
    requests.AnswerQuestion: (srv.AnswerQuestion, 'lesson/answer_question'),
    requests.BeginDemonstration: (srv.BeginDemonstration, 'lesson/begin_demonstration'),
    requests.EndDemonstration: (srv.EndDemonstration, 'lesson/end_demonstration'),
    requests.WithdrawDemonstration: (srv.WithdrawDemonstration, 'lesson/withdraw_demonstration'),
    requests.ListDemonstrations: (srv.ListDemonstrations, 'lesson/list_demonstrations'),
    requests.ChangeOption: (srv.ChangeOption, 'lesson/change_option'),
}
CONTROL_SERVICES: Mapping[type, tuple[Any, str]] = {
    requests.SetControl: (srv.SetControl, 'set_control')
}
TERMINAL_SERVICES: Mapping[type, tuple[Any, str]] = {
    requests.SetPace: (srv.SetPace, 'set_pace'),
    requests.NewEpisode: (srv.ResetGame, 'reset_game'),
    requests.ListOptions: (srv.ListOptions, 'list_options'),
    requests.SetExecution: (srv.SetExecution, 'set_execution'),
}
# Fields that are constants in messages: PHASE_READY is Phase.READY.
_ENUMS: Mapping[str, type[Enum]] = {
    'phase': Phase,
    'status': RequestStatus,
    'verdict': Verdict,
}


def encode(value: Any, message: Any) -> Any:
    """Copy the fields that a value and a message have in common, and return the message."""
    for name in message.get_fields_and_field_types():
        found = getattr(value, name, None)
        if isinstance(found, Enum) and name in _ENUMS:
            found = getattr(type(message), f'{name.upper()}_{found.name}')
        elif isinstance(found, tuple):
            found = [
                demonstration_to_message(v) if isinstance(v, Demonstration) else v for v in found
            ]
        if found is not None:
            setattr(message, name, found)
    return message


def decode(kind: type[V], message: Any) -> V:
    """
    Build a value from the fields that it has in common with a message.

    A verdict that does not exist is None, and a status that the lesson does not know REFUSED.

    :param kind: one of the dataclasses of ``lesson.requests``.
    :raises ValueError: the lesson is in a phase that does not exist.
    """
    found: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if not hasattr(message, field.name):
            continue
        value = getattr(message, field.name)
        if field.name in _ENUMS:
            value = _enum_value(field.name, message)
        elif field.name == 'demonstrations':
            value = list(map(demonstration_from_message, value))
        found[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**found)


def _enum_value(name: str, message: Any) -> Enum | None:
    number = getattr(message, name)
    for member in _ENUMS[name]:
        if getattr(type(message), f'{name.upper()}_{member.name}', None) == number:
            return member
    if name == 'phase':
        raise ValueError(f'the lesson is in unknown phase {number}')
    return RequestStatus.REFUSED if name == 'status' else None
