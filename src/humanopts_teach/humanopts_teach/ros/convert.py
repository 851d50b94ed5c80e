"""Conversions between teaching values and the services, actions and messages of the graph."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from humanopts_interfaces import action, msg, srv
from humanopts_learner.demonstrations import demonstration_from_message
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_ros.codec import Codec
from humanopts_teach.lesson import requests
from humanopts_teach.lesson.requests import Answer, Drive, LessonView, Progress

LESSON_STATE = Codec(LessonView, msg.LessonState)
PROGRESS = Codec(Progress, msg.ActionProgress)

_DEMONSTRATIONS = {'demonstrations': (demonstration_to_message, demonstration_from_message)}


@dataclass(frozen=True)
class Endpoint:
    """A service, an action or a topic of commands, and the codecs of its messages."""

    kind: Any
    name: str
    request: Codec[Any, Any]  # codec of requests, goals or commands
    answer: Codec[Answer, Any] | None = None  # codec of responses; None: no service


def _service(
    request: type, name: str, *more: str, answers: tuple[str, ...] = (), kind: Any = None
) -> tuple[type, Endpoint]:
    """
    Return a request type and its service.

    :param more: fields that exist only in the request message.
    :param answers: fields that exist only in the response message.
    :param kind: service type; None: the type named like the request.
    """
    service = kind or getattr(srv, request.__name__)
    asked: Codec[Any, Any] = Codec(
        request, service.Request, of_message=more, parts=_DEMONSTRATIONS
    )
    answer: Codec[Answer, Any] = Codec(
        Answer, service.Response, of_message=answers, subset=True, parts=_DEMONSTRATIONS
    )
    return request, Endpoint(service, name, asked, answer)


LESSON_SERVICES: Mapping[type, Endpoint] = dict(
    _service(request, f'lesson/{name}')
    for request, name in (
        (requests.OpenSession, 'open_session'),
        (requests.DefineOption, 'define_option'),
        (requests.AnswerQuestion, 'answer_question'),
        (requests.BeginDemonstration, 'begin_demonstration'),
        (requests.EndDemonstration, 'end_demonstration'),
        (requests.AddDemonstrations, 'add_demonstrations'),
        (requests.WithdrawDemonstration, 'withdraw_demonstration'),
        (requests.ListDemonstrations, 'list_demonstrations'),
        (requests.ChangeOption, 'change_option'),
    )
)
_DRIVE = Codec(Drive, msg.ActionCommand, of_message=['source', 'option_name'])
TEACHING: Mapping[type, Endpoint] = {
    **LESSON_SERVICES,
    **dict([_service(requests.SetControl, 'set_control', 'holder_id')]),
    Drive: Endpoint(msg.ActionCommand, 'action', _DRIVE),
}
TERMINAL_SERVICES = dict(
    [
        _service(requests.SetPace, 'set_pace', 'holder_id'),
        _service(requests.NewEpisode, 'reset_game', 'source', 'start_state', kind=srv.ResetGame),
        _service(
            requests.ListOptions,
            'list_options',
            answers=('participants', 'n_demonstrations', 'primitive_actions'),
        ),
        _service(requests.SetExecution, 'set_execution', answers=('previous',)),
    ]
)
_OF_RUNS = 'max_steps', 'episode', 'step', 'options_sequence', 'execution', 'plan_id', 'preempt'
_OF_PLANS = 'options', 'gamma', 'tolerance', 'max_sweeps', 'min_samples', 'learning'
_OF_POLICIES = 'max_decisions', 'explore', 'learning_rate', 'options'
ACTIONS: Mapping[type, Endpoint] = {
    request: Endpoint(kind, name, Codec(request, kind.Goal, of_message=more))
    for request, kind, name, more in (
        (requests.RunOption, action.ExecuteOption, 'execute_option', _OF_RUNS),
        (requests.PlanOptions, action.Plan, 'plan', _OF_PLANS),
        (requests.PlayEpisodes, action.RunPolicy, 'run_policy', _OF_POLICIES),
    )
}
