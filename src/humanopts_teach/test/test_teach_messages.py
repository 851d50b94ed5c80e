"""Teaching values survive the way through messages, and every status has its number."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import moment_from_message, Source, Transition
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_interfaces.msg import LessonState, NodeStatus, OptionStatus
from humanopts_interfaces.srv import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
)
from humanopts_learner.demonstrations import Demonstration
from humanopts_ros.publisher import PublishError
from humanopts_teach.dialogue.answers import (
    Answer,
    LessonView,
    Phase,
    Progress,
    Status,
    Verdict,
)
from humanopts_teach.ros.convert import (
    answered,
    progress_from_message,
    verdict_from_number,
    verdict_to_number,
    view_from_message,
    view_to_message,
)
from humanopts_teach.ros.lesson_node import LessonNode
import pytest
import rclpy

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
    assert view_from_message(view_to_message(view)) == view
    assert view_from_message(view_to_message(VIEW)) == VIEW


def test_an_unknown_phase_is_refused() -> None:
    with pytest.raises(ValueError, match='unknown phase 0'):
        view_from_message(LessonState())


def test_a_moment_of_the_game_survives_the_way_through_a_message() -> None:
    moment = Transition(
        2, 5, 'here', (1, 0, 3), 'east', Source.PERSON, '/p#1', 9, -1.0, True, False
    )
    assert moment_from_message(transition_to_message(moment)) == moment


def test_verdicts_have_numbers_of_their_own_and_no_others() -> None:
    assert {verdict_from_number(verdict_to_number(verdict)) for verdict in Verdict} == set(Verdict)
    assert verdict_from_number(0) is verdict_from_number(9) is None


def test_progress_is_read_from_the_learners_status() -> None:
    status = OptionStatus(
        participant='p1', option_name='go', features=['row'], last_uuid='u', criteria_met=True
    )
    assert progress_from_message(status) == Progress('p1', 'go', ('row',), 'u', True)


ANSWERS = [
    (OpenSession, 'OK BAD_NAME WRONG_PHASE NOT_SAVED PAUSED'),
    (DefineOption, 'OK BAD_NAME WRONG_PHASE NOT_SAVED PAUSED'),
    (AnswerQuestion, 'OK NOT_ASKED NO_FEATURE NOT_SAVED PAUSED'),
    (BeginDemonstration, 'OK WRONG_PHASE BAD_STATE NO_GAME BUDGET_SPENT PAUSED'),
    (
        EndDemonstration,
        'OK WRONG_PHASE NO_STEPS STEPS_TAKEN NOT_CURRENT REFUSED NOT_SAVED BAD_VERDICT',
    ),
]


@pytest.mark.parametrize(
    ('service', 'names'), ANSWERS, ids=lambda value: getattr(value, '__name__', '')
)
def test_every_answer_of_the_lesson_has_a_number_and_a_text(service: Any, names: str) -> None:
    numbers = set()
    for name in names.split():
        response = answered(service.Response(), Answer(Status[name], 'because'))
        assert response.detail == 'because'
        numbers.add(response.status)
    assert len(numbers) == len(names.split())
    assert 0 not in numbers


@pytest.fixture
def lesson_node(tmp_path: Path) -> Iterator[LessonNode]:
    arguments = ['--ros-args', '-p', f'directory:={tmp_path}', '-p', 'participant:=p1']
    rclpy.init(args=arguments, domain_id=122)
    node = LessonNode()
    try:
        node._on_domain(domain_to_info(make_domain('taxi')))
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
