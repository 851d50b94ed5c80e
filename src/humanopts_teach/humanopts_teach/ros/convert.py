"""Messages to teaching values and back: the only module of this package that knows both."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from humanopts_interfaces import msg, srv
from humanopts_learner.options.criteria import Criterion
from humanopts_teach.lesson import requests
from humanopts_teach.lesson.requests import (
    Answer,
    LessonRequest,
    LessonView,
    OptionStatus,
    Phase,
    RequestStatus,
    Verdict,
)

# By kind of request: the type of its service, and the name.
LESSON_SERVICES: Mapping[type, tuple[Any, str]] = {
    requests.OpenSession: (srv.OpenSession, 'lesson/open_session'),
    requests.DefineOption: (srv.DefineOption, 'lesson/define_option'),
    requests.AnswerQuestion: (srv.AnswerQuestion, 'lesson/answer_question'),
    requests.BeginDemonstration: (srv.BeginDemonstration, 'lesson/begin_demonstration'),
    requests.EndDemonstration: (srv.EndDemonstration, 'lesson/end_demonstration'),
    requests.WithdrawDemonstration: (srv.WithdrawDemonstration, 'lesson/withdraw_demonstration'),
}
_PHASES = {phase: int(getattr(msg.LessonState, f'PHASE_{phase.name}')) for phase in Phase}
_VERDICTS = {
    verdict: int(getattr(srv.EndDemonstration.Request, f'VERDICT_{verdict.name}'))
    for verdict in Verdict
}


def request_to_message(request: LessonRequest) -> Any:
    """Encode a request of the lesson."""
    values = {field.name: getattr(request, field.name) for field in fields(request)}
    if isinstance(request, requests.EndDemonstration):
        values['verdict'] = _VERDICTS[request.verdict] if request.verdict is not None else 0
    return LESSON_SERVICES[type(request)][0].Request(**values)


def request_from_message(kind: type, message: Any) -> LessonRequest:
    """
    Decode a request of the lesson; the lesson itself judges what is in it.

    :param kind: one of ``LESSON_SERVICES``.
    """
    values = {field.name: getattr(message, field.name) for field in fields(kind)}
    if kind is requests.EndDemonstration:
        verdicts = {number: verdict for verdict, number in _VERDICTS.items()}
        values['verdict'] = verdicts.get(message.verdict)
    request: LessonRequest = kind(**values)
    return request


def answer_to_response(answer: Answer, response: Any) -> Any:
    """Fill in the response of a service, and return it."""
    for name in response.get_fields_and_field_types():
        if name != 'status':
            value = getattr(answer, name)
            setattr(response, name, list(value) if isinstance(value, tuple) else value)
    response.status = getattr(type(response), f'STATUS_{answer.status.name}')
    return response


def answer_from_response(response: Any) -> Answer:
    """
    Decode the response of a service of the lesson, or of ``set_control``.

    :raises ValueError: its status is none that is ever sent.
    """
    values = {name: getattr(response, name) for name in response.get_fields_and_field_types()}
    kind = type(response)
    known = {getattr(kind, f'STATUS_{status.name}', None): status for status in RequestStatus}
    if response.status not in known:
        raise ValueError(f'{kind.__name__} has unknown status {response.status}')
    values['status'] = known[response.status]
    if 'known_options' in values:
        values['known_options'] = tuple(response.known_options)
    return Answer(**values)


def view_to_message(view: LessonView) -> msg.LessonState:
    """Encode where the lesson stands; header, publisher_id and sequence are left to the sender."""
    values = asdict(view)
    values['phase'] = _PHASES[view.phase]
    for name in ('chosen_features', 'earlier_features'):
        values[name] = list(values[name])
    return msg.LessonState(**values)


def view_from_message(message: msg.LessonState) -> LessonView:
    """
    Decode where the lesson stands.

    :raises ValueError: its phase is none that is ever sent.
    """
    phases = {number: phase for phase, number in _PHASES.items()}
    if message.phase not in phases:
        raise ValueError(f'the lesson is in unknown phase {message.phase}')
    values = {field.name: getattr(message, field.name) for field in fields(LessonView)}
    values['phase'] = phases[message.phase]
    for name in ('chosen_features', 'earlier_features'):
        values[name] = tuple(values[name])
    return LessonView(**values)


def option_status_from_message(message: msg.OptionStatus) -> OptionStatus:
    """Decode how far an option is learned."""
    values = {field.name: getattr(message, field.name) for field in fields(OptionStatus)}
    for name in ('features', 'conflicts'):
        values[name] = tuple(values[name])
    values['criteria'] = tuple(
        Criterion(found.name, found.value if found.measurable else None, found.threshold)
        for found in message.criteria
    )
    return OptionStatus(**values)
