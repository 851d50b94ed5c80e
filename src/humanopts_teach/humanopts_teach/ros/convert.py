"""Messages to teaching values and back: the only module of this package that knows both."""

from dataclasses import asdict, fields
from typing import Any

from humanopts_interfaces.msg import LessonState, OptionStatus
from humanopts_interfaces.srv import EndDemonstration
from humanopts_teach.dialogue.answers import Answer, LessonView, Phase, Progress, Verdict

_PHASES = {phase: int(getattr(LessonState, f'PHASE_{phase.name}')) for phase in Phase}
_LISTS = ('chosen_features', 'earlier_features')  # of LessonState
_VERDICTS = {
    verdict: int(getattr(EndDemonstration.Request, f'VERDICT_{verdict.name}'))
    for verdict in Verdict
}


def view_to_message(view: LessonView) -> LessonState:
    """Encode where the lesson stands; header, publisher_id and sequence are left to the sender."""
    values = asdict(view)
    values['phase'] = _PHASES[view.phase]
    for name in _LISTS:
        values[name] = list(values[name])
    return LessonState(**values)


def view_from_message(message: LessonState) -> LessonView:
    """
    Decode where the lesson stands.

    :raises ValueError: its phase is none that is ever sent.
    """
    phases = {number: phase for phase, number in _PHASES.items()}
    if message.phase not in phases:
        raise ValueError(f'the lesson is in unknown phase {message.phase}')
    values = {field.name: getattr(message, field.name) for field in fields(LessonView)}
    values['phase'] = phases[message.phase]
    for name in _LISTS:
        values[name] = tuple(values[name])
    return LessonView(**values)


def progress_from_message(status: OptionStatus) -> Progress:
    """Decode what the lesson needs of how far an option is learned."""
    return Progress(
        status.participant,
        status.option_name,
        tuple(status.features),
        status.last_uuid,
        status.criteria_met,
    )


def verdict_to_number(verdict: Verdict) -> int:
    """Encode what becomes of a demonstration."""
    return _VERDICTS[verdict]


def verdict_from_number(number: int) -> Verdict | None:
    """Decode what becomes of a demonstration; None: there is no such verdict."""
    return next((verdict for verdict, known in _VERDICTS.items() if known == number), None)


def answered(response: Any, answer: Answer) -> Any:
    """Fill in the status and the text of a service's response, and return it."""
    response.status = getattr(type(response), f'STATUS_{answer.status.name}')
    response.detail = answer.detail
    return response
