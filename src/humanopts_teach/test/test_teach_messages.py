"""Teaching values survive the way through messages, and every status has its number."""

from collections.abc import Callable, Iterator
import math
from pathlib import Path
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_env.ros.convert import transition_to_message
from humanopts_interfaces import msg, srv
from humanopts_interfaces.action import RunPolicy
from humanopts_interfaces.msg import Criterion, LessonState, NodeStatus
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.planning.request import Execution
from humanopts_learner.ros.convert import summary_from_message
from humanopts_ros.publisher import PublishError
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    LessonView,
    OpenSession,
    Phase,
    PlayEpisodes,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.ros.convert import (
    decode,
    encode,
    LESSON_SERVICES,
)
from humanopts_teach.ros.lesson_node import LessonNode
import pytest
import rclpy

SERVICES = [service for service, _ in LESSON_SERVICES.values()]
VIEW = LessonView(
    phase=Phase.ASKING,
    participant='p1',
    session='s1',
    option_name='go',
    question_id=3,
    question='Does it?',
    question_feature='row',
    questions_total=10,
    chosen_features=('col',),
    n_demonstrations=4,
    n_not_here=1,
    budget=9,
    strategy='failures',
    start_state='here',
    episode=7,
    criteria_met=True,
    paused='No space.',
    text='Answer.',
)


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
def test_where_the_lesson_stands_survives_the_way_through_a_message(phase: Phase) -> None:
    view = LessonView(phase)
    assert decode(LessonView, encode(view, LessonState())) == view
    assert decode(LessonView, encode(VIEW, LessonState())) == VIEW


def test_an_unknown_phase_is_refused() -> None:
    with pytest.raises(ValueError, match='unknown phase 0'):
        decode(LessonView, LessonState())


def test_a_moment_of_the_game_survives_the_way_through_a_message() -> None:
    moment = Transition(
        2, 5, 'here', (1, 0, 3), 'east', Source.PERSON, '/p#1', 9, -1.0, True, False
    )
    assert transition_from_message(transition_to_message(moment)) == moment


@pytest.mark.parametrize(
    'request_value',
    [
        OpenSession('p1', 's1'),
        DefineOption('go', ask_again=True),
        AnswerQuestion(3, yes=True),
        BeginDemonstration('here'),
        *(EndDemonstration(verdict, 2, 5, can_start_at_end=True) for verdict in Verdict),
        EndDemonstration(None, 2, 5),
        WithdrawDemonstration('u'),
    ],
    ids=repr,
)
def test_a_request_survives_the_way_through_a_message(request_value: LessonRequest) -> None:
    message = LESSON_SERVICES[type(request_value)][0].Request()
    assert decode(type(request_value), encode(request_value, message)) == request_value


def test_a_run_becomes_the_goal_of_its_action() -> None:
    run = PlayEpisodes('human', 'p1', 5, 7, Execution.MODULAR_MASS)
    goal = encode(run, RunPolicy.Goal())
    assert (goal.action_set, goal.participant, goal.episodes) == ('human', 'p1', 5)
    assert (goal.seed, goal.execution) == (7, 'modular_mass')


def test_a_verdict_that_does_not_exist_is_none() -> None:
    message = srv.EndDemonstration.Request(verdict=9)
    assert decode(EndDemonstration, message) == EndDemonstration(None, 0, 0)


def test_what_the_learner_says_of_an_option_is_read_from_its_status() -> None:
    criteria = [
        Criterion(name='return', value=0.5, threshold=1.0, measurable=True, met=True),
        Criterion(name='return', value=0.5, threshold=1.0, measurable=True, met=False),
        Criterion(name='initiation', value=math.nan, threshold=0.05),
    ]
    message = msg.OptionStatus(
        participant='p1',
        option_name='go',
        features=['row'],
        last_uuid='u',
        criteria=criteria,
        criteria_met=True,
        more_needed=-1,
    )
    found = summary_from_message(message)
    assert (found.participant, found.option_name, found.features) == ('p1', 'go', ('row',))
    assert (found.last_uuid, found.criteria_met, found.more_needed) == ('u', False, -1)
    assert [(c.name, c.value, c.met, c.undecided) for c in found.criteria] == [
        ('return', 0.5, True, False),
        ('return', 0.5, False, True),
        ('initiation', None, False, False),
    ]


@pytest.mark.parametrize('service', SERVICES, ids=lambda service: service.__name__)
def test_every_status_of_a_service_survives_the_way_through_its_response(service: Any) -> None:
    names = {n for n in type(service.Response).__prepare__('', ()) if n.startswith('STATUS_')}
    assert len(names) > 2
    for name in names - {'STATUS_UNKNOWN'}:
        answer = Answer(RequestStatus[name.removeprefix('STATUS_')], 'because')
        response = encode(answer, service.Response())
        assert response.status == getattr(service.Response, name)
        assert decode(Answer, response) == answer


def test_the_fields_of_an_answer_survive_the_way_through_a_response() -> None:
    opened = Answer(RequestStatus.OK, '', session='s1', known_options=('go', 'stay'))
    begun = Answer(RequestStatus.OK, '', episode=3, state='here')
    for answer, service in ((opened, srv.OpenSession), (begun, srv.BeginDemonstration)):
        assert decode(Answer, encode(answer, service.Response())) == answer


def test_a_status_that_the_lesson_does_not_know_is_a_refusal() -> None:
    held = srv.ResetGame.Response(status=srv.ResetGame.Response.STATUS_HELD_BY_PERSON)
    for response in (srv.OpenSession.Response(), held):
        assert decode(Answer, response).status is RequestStatus.REFUSED


@pytest.fixture
def lesson_node(tmp_path: Path) -> Iterator[LessonNode]:
    arguments = ['--ros-args', '-p', f'directory:={tmp_path}', '-p', 'participant:=p1']
    rclpy.init(args=arguments, domain_id=122)
    node = LessonNode()
    try:
        node._on_domain(make_domain('taxi'))
        yield node
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


def test_a_lesson_that_cannot_publish_pauses_and_goes_on_when_it_can(
    lesson_node: LessonNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, str]] = []
    sent: list[LessonState] = []

    def blocked(message: LessonState) -> None:
        raise PublishError('cannot publish on /lesson_state: a reader has stopped')

    def publish_with(action: Callable[[LessonState], None]) -> None:
        monkeypatch.setattr(lesson_node._state_out, 'publish', action)
        lesson_node._tick()

    monkeypatch.setattr(
        lesson_node, 'set_status', lambda state, text='': told.append((state, text))
    )
    lesson_node.ready = True
    publish_with(blocked)
    publish_with(blocked)
    assert told == [
        (NodeStatus.STATE_PAUSED, 'cannot publish on /lesson_state: a reader has stopped')
    ]
    publish_with(sent.append)
    assert told[1:] == [(NodeStatus.STATE_READY, '')]
    assert [message.participant for message in sent] == ['p1']


def test_a_lesson_whose_demonstrations_cannot_be_sent_shows_why_it_is_paused(
    lesson_node: LessonNode, monkeypatch: pytest.MonkeyPatch, taxi_lesson: list[Demonstration]
) -> None:
    sent: list[LessonState] = []

    def blocked(message: object) -> None:
        raise PublishError('a reader has stopped')

    monkeypatch.setattr(lesson_node._state_out, 'publish', sent.append)
    monkeypatch.setattr(lesson_node._demonstrations_out, 'publish', blocked)
    lesson_node.ready = True
    lesson_node._unsent.append(taxi_lesson[0])
    lesson_node._tick()
    lesson_node._tick()
    assert [message.paused for message in sent] == ['a reader has stopped']
    monkeypatch.undo()
    lesson_node._tick()
    assert lesson_node._lesson is not None
    assert lesson_node._lesson.view.paused == ''
