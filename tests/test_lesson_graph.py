"""The lesson over the real graph, with game, learner and teacher; the test is the person."""

from pathlib import Path
import shutil
from typing import Any

from graph_support.live import GAME, Graph, LEARNER, LESSON, OPTION_SERVER, TEACHER
from graph_support.teaching import CHOSEN, Person, PICKUP
from humanopts_interfaces.msg import (
    ControlState,
    DemonstrationReceipt,
    LearningStatus,
    LessonState,
    NodeStatus,
)
from humanopts_interfaces.srv import (
    BeginDemonstration,
    ChangeOption,
    EndDemonstration,
    ListDemonstrations,
    ListOptions,
    ResetGame,
    WithdrawDemonstration,
)
from humanopts_learner.demonstrations import GOAL
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
from rclpy.parameter import Parameter

DROPOFF = 'go to destination and dropoff'


@pytest.fixture
def graph(live: Graph) -> Graph:
    """A game."""
    live.start(GAME)
    return live


@pytest.fixture
def person(graph: Graph) -> Person:
    return Person(graph)


@pytest.fixture(scope='module')
def played(shared: Graph) -> Graph:
    """A game that many nodes refuse to join."""
    shared.start(GAME)
    return shared


def start_learner(graph: Graph, folder: str = 'options') -> Any:
    """Start a learner with a folder of its own, and return it."""
    return graph.start(LEARNER, directory=graph.folder / folder)


def test_the_simulated_teacher_teaches_until_the_criteria_hold(
    graph: Graph, person: Person
) -> None:
    start_learner(graph)
    lesson = person.start_lesson(strategy='failures', until_no_failures=True, learn=GOAL)
    graph.ready('/game', '/learner')
    graph.start(TEACHER, error_rate=0.05, options=[PICKUP])
    graph.until(
        lambda: bool(graph.statuses.get('/simulated_teacher', [NodeStatus()])[-1].text),
        'the teacher to finish',
        90.0,
    )
    status = graph.statuses['/simulated_teacher'][-1]
    assert (status.state, status.text) == (NodeStatus.STATE_READY, 'finished')
    assert person.lesson.phase == LessonState.PHASE_FINISHED
    assert 'All criteria hold' in person.lesson.text
    learned = {option.option_name: option for option in person.latest[LearningStatus].options}
    assert [*learned] == [PICKUP]
    assert learned[PICKUP].criteria_met
    assert person.latest[ControlState].holder == ControlState.HOLDER_NOBODY
    graph.stop(lesson)
    with DemonstrationStore(graph.folder / 'demonstrations') as store:
        kept = [entry.uuid for entry in store.entries('simulated') if hasattr(entry, 'uuid')]
    # Each once: a learner that is found late gets them again.
    assert kept == list(dict.fromkeys(message.uuid for message in person.shown))
    numbers = [message.sequence for message in person.shown]
    assert numbers == list(range(1, len(numbers) + 1))


def test_a_lesson_that_was_killed_goes_on_where_it_was(graph: Graph, person: Person) -> None:
    start_learner(graph)
    lesson = person.start_lesson()
    person.get_ready()
    uuid = person.show()
    graph.until(lambda: bool(person.shown), 'the demonstration')
    first = person.shown[0]
    assert first.uuid == uuid
    person.begin()
    # All that a process leaves that is killed now; test_node_deaths.py kills one.
    left = Path(shutil.copytree(person.folder, graph.folder / 'left'))
    graph.stop(lesson)
    shutil.rmtree(person.folder)
    left.rename(person.folder)

    person.latest.pop(LessonState)
    person.start_lesson(participant='p1', session='s1')
    person.phase(LessonState.PHASE_READY)
    assert person.lesson.option_name == PICKUP
    assert tuple(person.lesson.chosen_features) == CHOSEN
    assert person.lesson.n_demonstrations == 1
    graph.until(
        lambda: person.shown[-1].publisher_id != first.publisher_id,
        'the demonstration to be sent again',
    )
    again = person.shown[-1]
    assert (again.uuid, again.states, again.rewards) == (first.uuid, first.states, first.rewards)
    episode = person.begin()
    person.drive(episode, 'pickup')
    person.end(episode, 1)
    graph.until(lambda: person.shown[-1].number == 2, 'demonstration 2')


def test_a_learner_that_comes_late_gets_every_demonstration(graph: Graph, person: Person) -> None:
    lesson = person.start_lesson()
    person.get_ready()
    lesson.set_parameters([Parameter('learner_deadline', value=0.2)])
    person.demonstrate()
    graph.until(lambda: 'learner does not answer' in person.lesson.text, 'the lesson to go on')
    assert person.lesson.phase == LessonState.PHASE_READY
    start_learner(graph)
    graph.until(
        lambda: LearningStatus in person.latest and bool(person.latest[LearningStatus].options),
        'the learner to know of it',
    )
    assert person.latest[LearningStatus].options[0].last_uuid == person.shown[0].uuid


def test_what_is_taken_back_is_unlearned_and_run_no_more(graph: Graph, person: Person) -> None:
    learner = start_learner(graph)
    graph.start(OPTION_SERVER)
    person.start_lesson()
    person.get_ready()
    first, second = person.show(), person.show()

    def learned() -> list[tuple[int, str]]:
        status = person.latest.get(LearningStatus)
        options = status.options if status is not None else ()
        return [(option.n_demonstrations, option.last_uuid) for option in options]

    def served() -> list[str]:
        return list(graph.ask(ListOptions, 'list_options').option_names)

    unknown = person.ask(WithdrawDemonstration, uuid='unknown')
    assert unknown.status == WithdrawDemonstration.Response.STATUS_NO_DEMONSTRATION
    for uuid, left in ((first, [(1, second)]), (second, [])):
        taken = person.ask(WithdrawDemonstration, uuid=uuid)
        assert (taken.status, taken.uuid) == (WithdrawDemonstration.Response.STATUS_OK, uuid)
        graph.until(lambda left=left: learned() == left, 'the learner to count it out')
        newest = left[0][1] if left else ''
        graph.until(lambda uuid=newest: person.lesson.last_uuid == uuid, 'the lesson to say so')
        person.phase(LessonState.PHASE_READY)
    graph.until(lambda: not served(), 'the option to be gone')
    # Each is published once, and perhaps again because the learner is new.
    both = {first, second}
    graph.until(lambda: {m.uuid for m in person.shown if m.withdrawn} == both, 'both withdrawals')
    none = person.ask(WithdrawDemonstration)
    assert none.status == WithdrawDemonstration.Response.STATUS_NO_DEMONSTRATION

    graph.stop(learner)
    person.latest.pop(LearningStatus)
    start_learner(graph, 'forgot everything')
    graph.until(lambda: LearningStatus in person.latest, 'the new learner')
    third = person.demonstrate()
    graph.until(lambda: learned() == [(1, third)], 'the new learner to know what counts')
    person.phase(LessonState.PHASE_READY)

    listed = person.ask(ListDemonstrations).demonstrations
    assert [(demo.uuid, demo.withdrawn) for demo in listed] == [
        (first, True),
        (second, True),
        (third, False),
    ]
    assert person.ask(ChangeOption, name=person.lesson.option_name, new_name='fetch').status == 1
    graph.until(
        lambda: [o.option_name for o in person.latest[LearningStatus].options] == ['fetch'],
        'the learner to know the option by its new name only',
    )
    assert person.latest[LearningStatus].options[0].n_demonstrations == 1
    graph.until(lambda: person.lesson.option_name == 'fetch', 'the lesson to say so')
    person.phase(LessonState.PHASE_READY)


@pytest.mark.parametrize('refuses', [False, True])
def test_a_learner_that_missed_something_gets_it_once_it_is_heard_again(
    graph: Graph, person: Person, refuses: bool
) -> None:
    person.start_lesson(learner_deadline=5.0 if refuses else 0.2)
    says = graph.node.create_publisher(LearningStatus, 'learning_status', LATCHED)
    answers = graph.node.create_publisher(DemonstrationReceipt, 'demonstration_receipts', STREAM)
    graph.until(lambda: says.get_subscription_count() > 1, 'the lesson to listen')
    graph.until(lambda: answers.get_subscription_count() > 0, 'the lesson to listen')
    says.publish(LearningStatus(publisher_id='/learner#1'))
    person.get_ready()
    uuid = person.demonstrate()
    if refuses:
        status = DemonstrationReceipt.STATUS_REFUSED
        answers.publish(DemonstrationReceipt(uuid=uuid, status=status, detail='a full disk'))
        words = 'refused the demonstration: a full disk'
    else:
        words = 'learner does not answer'
    graph.until(lambda: words in person.lesson.text, words)
    known = len(person.shown)
    says.publish(LearningStatus(publisher_id='/learner#1'))
    graph.until(lambda: len(person.shown) > known, 'the demonstration again')
    assert person.shown[-1].uuid == uuid


def test_a_reset_by_somebody_else_ends_the_demonstration(graph: Graph, person: Person) -> None:
    person.start_lesson()
    person.get_ready()
    episode = person.begin()
    graph.ask(ResetGame, 'reset_game', source=ResetGame.Request.SOURCE_PERSON)
    graph.until(lambda: 'reset by somebody else' in person.lesson.text, 'the lesson to notice')
    assert person.lesson.phase == LessonState.PHASE_READY
    assert person.end(episode, 0).status == EndDemonstration.Response.STATUS_WRONG_PHASE
    assert person.begin() == episode + 2


def test_without_a_game_the_lesson_says_so_and_stays_ready(graph: Graph, person: Person) -> None:
    person.start_lesson()
    person.get_ready()
    graph.stop(graph.node_called('/game'))
    with graph.hurried():
        answer = person.ask(BeginDemonstration)
    assert answer.status == BeginDemonstration.Response.STATUS_NO_GAME
    assert 'ame' in answer.detail
    assert person.lesson.phase == LessonState.PHASE_READY
    graph.start(GAME)
    person.begin()


@pytest.mark.parametrize(
    ('node', 'parameters', 'says'),
    [
        (LESSON, {'strategy': 'guess'}, "'guess' is none of random"),
        (LESSON, {'budget': 0}, 'budget'),
        (LESSON, {'participant': 'no code', 'directory': 'DIRECTORY'}, 'not a code'),
        (TEACHER, {'options': ['fly']}, "no reference option 'fly'"),
        (TEACHER, {'error_rate': 2.0}, 'error_rate'),
        (TEACHER, {'options': ['']}, 'no option'),
    ],
)
def test_a_node_that_cannot_start_says_why(
    played: Graph, node: str, parameters: dict[str, Any], says: str
) -> None:
    given = {
        name: played.folder if value == 'DIRECTORY' else value
        for name, value in parameters.items()
    }
    assert says in played.refused(node, **given)


def test_two_lessons_cannot_share_a_folder(played: Graph) -> None:
    folder = played.folder / 'demonstrations'
    with DemonstrationStore(folder):
        assert 'another lesson has it open' in played.refused(LESSON, directory=folder)
