"""Teaching values survive the way through messages, and every status has its number."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_env.ros.convert import transition_to_message
from humanopts_interfaces.msg import LessonState, NodeStatus
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.planning.request import Arbitration
from humanopts_learner.ros.convert import summary_from_message, summary_to_message
from humanopts_learner.summary import Criterion, OptionSummary
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
from humanopts_teach.ros.convert import ACTIONS, LESSON_SERVICES, LESSON_STATE
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
    for view in (LessonView(phase), VIEW):
        assert LESSON_STATE.decode(LESSON_STATE.encode(view)) == view


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
    codec = LESSON_SERVICES[type(request_value)].request
    assert codec.decode(codec.encode(request_value)) == request_value


def test_a_run_becomes_the_goal_of_its_action() -> None:
    run = PlayEpisodes('human', 'p1', 5, 7, Arbitration.MODULAR_MASS)
    goal = ACTIONS[PlayEpisodes].request.encode(run)
    assert (goal.action_set, goal.participant, goal.episodes) == ('human', 'p1', 5)
    assert (goal.seed, goal.execution) == (7, 'modular_mass')


def test_how_far_an_option_is_survives_the_way_through_a_message() -> None:
    summary = OptionSummary(
        'go',
        'p1',
        ('row',),
        last_uuid='u',
        criteria=(
            Criterion('return', 0.5, 1.0, True),
            Criterion('return', 0.5, 1.0, False),
            Criterion('initiation', None, 0.05, False),
            Criterion('return', None, None, False, obstacle='no rules'),
        ),
        mean_return_demonstrations=1.0,
        mean_return_policy=2.0,
    )
    message = summary_to_message(summary)
    assert summary_from_message(message) == summary
    assert [criterion.measurable for criterion in message.criteria] == [True, True, False, False]
    assert not message.criteria_met


@pytest.mark.parametrize('kind', [OpenSession, BeginDemonstration, EndDemonstration])
def test_the_fields_of_an_answer_survive_the_way_through_a_response(kind: type) -> None:
    codec = LESSON_SERVICES[kind].answer
    assert codec is not None
    for answer in (
        Answer(RequestStatus.NOT_SAVED, 'because', session='s1', known_options=('go', 'stay')),
        Answer(RequestStatus.OK, '', episode=3, state='here'),
        Answer(RequestStatus.OK, '', uuid='u', contradiction='c', contradicts='v', situation='s'),
    ):
        with suppress(KeyError):  # a status of others
            message = codec.encode(answer)
            assert codec.encode(codec.decode(message)) == message
            shared = set(message.get_fields_and_field_types())
            assert all(getattr(codec.decode(message), n) == getattr(answer, n) for n in shared)


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
