"""Teaching values survive the way through messages, and a lesson that cannot publish pauses."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_env.ros.convert import transition_to_message
from humanopts_interfaces.msg import LessonState, NodeStatus
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.planning.request import Arbitration
from humanopts_learner.ros.convert import summary_from_message, summary_to_message
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_ros.limits import composed
from humanopts_ros.publisher import PublishError
from humanopts_teach.lesson.requests import (
    AddDemonstrations,
    Answer,
    LessonView,
    OpenSession,
    PlayEpisodes,
    RequestStatus,
)
from humanopts_teach.ros.convert import ACTIONS, LESSON_SERVICES, LESSON_STATE
from humanopts_teach.ros.lesson_node import LessonNode
from hypothesis import given
from hypothesis import strategies as st
import pytest
import rclpy

CODECS = {
    LessonView: LESSON_STATE,
    **{kind: service.request for kind, service in LESSON_SERVICES.items()},
}


@st.composite
def demonstrations(draw: st.DrawFn) -> Demonstration:
    """Draw a demonstration with consistent numbers of states, actions and features."""
    steps, names = draw(st.integers(0, 2)), draw(st.lists(st.text(), min_size=1, max_size=2))
    real, count = st.floats(allow_nan=False), st.integers(0, 2**31 - 1)

    def row(values: st.SearchStrategy[Any], length: int) -> st.SearchStrategy[Any]:
        return st.lists(values, min_size=length, max_size=length).map(tuple)

    return draw(
        st.builds(
            Demonstration,
            option_name=st.text().map(composed),
            number=count,
            feature_names=st.just(tuple(names)),
            features=row(row(real, len(names)), steps + 1),
            states=row(st.text(), steps + 1),
            actions=row(st.text(), steps),
            rewards=row(real, steps),
            seconds=real,
            machine_steps=count,
        )
    )


@st.composite
def values(draw: st.DrawFn) -> Any:
    """Draw a value that has a message."""
    kind = draw(st.sampled_from(list(CODECS)))
    whole = {
        f.name: st.integers(0, 2**31 - 1)
        for f in fields(kind)
        if get_type_hints(kind)[f.name] is int
    }
    if kind is AddDemonstrations:
        return kind(tuple(draw(st.lists(demonstrations(), max_size=2))))
    return draw(st.builds(kind, **whole))


@given(values())
def test_a_value_survives_the_way_through_a_message(value: Any) -> None:
    codec = CODECS[type(value)]
    assert codec.decode(codec.encode(value)) == value


def test_a_moment_of_the_game_survives_the_way_through_a_message() -> None:
    moment = Transition(
        2, 5, 'here', (1, 0, 3), 'east', Source.PERSON, '/p#1', 9, -1.0, True, False
    )
    assert transition_from_message(transition_to_message(moment)) == moment


def test_a_run_becomes_the_goal_of_its_action() -> None:
    run = PlayEpisodes('human', 'p1', 5, 7, Arbitration.MODULAR_MASS)
    goal = ACTIONS[PlayEpisodes].request.encode(run)
    assert (goal.action_set, goal.participant, goal.episodes) == ('human', 'p1', 5)
    assert (goal.seed, goal.execution) == (7, 'modular_mass')


def test_how_far_an_option_is_survives_the_way_through_a_message() -> None:
    criteria = (
        Criterion('return', 0.5, 1.0, True),
        Criterion('initiation', None, 0.05, False),
        Criterion('return', None, None, False, obstacle='no rules'),
    )
    summary = OptionSummary(
        'go', 'p1', ('row',), last_uuid='u', criteria=criteria, mean_return_demonstrations=1.0
    )
    message = summary_to_message(summary)
    assert summary_from_message(message) == summary
    assert [criterion.measurable for criterion in message.criteria] == [True, False, False]
    assert not message.criteria_met


def test_the_fields_of_an_answer_survive_the_way_through_a_response() -> None:
    codec = LESSON_SERVICES[OpenSession].answer
    assert codec is not None
    answer = Answer(RequestStatus.NOT_SAVED, 'why', session='s1', known_options=('go', 'stay'))
    assert codec.decode(codec.encode(answer)) == answer


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


def test_a_lesson_that_cannot_publish_pauses_says_why_and_goes_on_when_it_can(
    lesson_node: LessonNode, monkeypatch: pytest.MonkeyPatch, taxi_lesson: list[Demonstration]
) -> None:
    said: list[tuple[int, str]] = []
    shown: list[LessonState] = []
    why = 'cannot publish: a reader has stopped'

    def blocked(message: object) -> None:
        raise PublishError(why)

    monkeypatch.setattr(
        lesson_node, 'set_status', lambda state, text='': said.append((state, text))
    )
    monkeypatch.setattr(lesson_node._demonstrations_out, 'publish', blocked)
    lesson_node.ready = True
    lesson_node._unsent.append(taxi_lesson[0])
    for publish in (blocked, blocked, shown.append):
        monkeypatch.setattr(lesson_node._state_out, 'publish', publish)
        lesson_node._tick()
    assert [message.paused for message in shown] == [why]
    monkeypatch.setattr(lesson_node._demonstrations_out, 'publish', lambda message: None)
    lesson_node._tick()
    assert [message.paused for message in shown] == [why, '']
    assert said == [(NodeStatus.STATE_PAUSED, why), (NodeStatus.STATE_READY, '')]
