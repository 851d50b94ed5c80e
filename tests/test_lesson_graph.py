"""The lesson over the real graph, with game, learner and teacher; the test is the person."""

import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from typing import Any

from graph_support.live import GAME, Graph, LEARNER, LESSON, OPTION_SERVER, RECORDER, TEACHER
from graph_support.teaching import CHOSEN, Person, PICKUP, SERVICES, START
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ControlState,
    DemonstrationReceipt,
    GameState,
    LearnedOption,
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
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.learn import learn_option
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_teach.bags.contents import read_demonstrations, read_domain, read_episodes
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    Answer,
    DefineOption,
    LessonRequest,
    OpenSession,
    RequestStatus,
)
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
    assert 'All criteria are met' in person.lesson.text
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


def test_the_simulated_teacher_waits_for_a_game_that_is_away(
    graph: Graph, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('humanopts_teach.ros.lesson_node._GAME_DEADLINE', 0.05)
    refused: list[str] = []
    not_begun = Lesson.not_begun

    def refuse(lesson: Lesson, status: RequestStatus, cause: str) -> Answer:
        refused.append(cause)
        return not_begun(lesson, status, cause)

    monkeypatch.setattr(Lesson, 'not_begun', refuse)
    start_learner(graph)
    person.start_lesson(strategy='failures', until_no_failures=True, learn=GOAL)
    graph.ready('/game', '/learner')
    graph.start(TEACHER, options=[PICKUP])
    graph.until(lambda: bool(person.shown), 'a demonstration')
    graph.stop(graph.node_called('/game'))
    graph.until(lambda: len(refused) > 3, 'refusals')
    graph.start(GAME)
    graph.until(lambda: person.lesson.phase == LessonState.PHASE_FINISHED, 'the end', 90.0)


def test_the_simulated_teacher_takes_the_lesson_back_from_somebody_who_came_in_between(
    graph: Graph, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    carry_out = Lesson.carry_out
    taken_over: list[Answer] = []

    def come_in_between(lesson: Lesson, request: LessonRequest) -> Answer:
        answer = carry_out(lesson, request)
        if isinstance(request, DefineOption) and not taken_over:
            taken_over.append(carry_out(lesson, OpenSession('anna', 'hers')))
        return answer

    monkeypatch.setattr(Lesson, 'carry_out', come_in_between)
    start_learner(graph)
    person.start_lesson()
    graph.ready('/game', '/learner')
    graph.start(TEACHER, options=[PICKUP])
    graph.until(lambda: bool(person.shown), 'a demonstration')
    assert [answer.ok for answer in taken_over] == [True]
    assert {message.participant for message in person.shown} == {'simulated'}


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


def test_a_learner_that_refused_something_gets_it_once_it_is_heard_again(
    graph: Graph, person: Person
) -> None:
    lesson = person.start_lesson()
    says = graph.node.create_publisher(LearningStatus, 'learning_status', LATCHED)
    answers = graph.node.create_publisher(DemonstrationReceipt, 'demonstration_receipts', STREAM)
    graph.until(lambda: says.get_subscription_count() > 1, 'the lesson to listen')
    graph.until(lambda: answers.get_subscription_count() > 0, 'the lesson to listen')
    says.publish(LearningStatus(publisher_id='/learner#1'))
    graph.until(lambda: not lesson._resend.is_canceled(), 'the learner to be known')
    graph.until(lesson._resend.is_canceled, 'all to be sent to it')
    person.get_ready()
    uuid = person.demonstrate()
    status = DemonstrationReceipt.STATUS_REFUSED
    by = {'publisher_id': '/learner#1', 'uuid': uuid}
    answers.publish(DemonstrationReceipt(**by, status=status, detail='a full disk'))
    words = 'refused the demonstration: a full disk'
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
    graph.until(
        lambda: 'another client reset the game' in person.lesson.text, 'the lesson to notice'
    )
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


def test_what_game_says_against_a_start_state_reaches_the_person(
    graph: Graph, person: Person
) -> None:
    person.start_lesson()
    person.get_ready()
    graph.stop(graph.node_called('/game'))
    graph.start(GAME, domain='rooms')  # where the start states of Taxi are none
    answer = person.ask(BeginDemonstration)
    assert answer.status == BeginDemonstration.Response.STATUS_BAD_STATE
    assert 'rooms' in answer.detail
    assert person.lesson.phase == LessonState.PHASE_READY


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


class Session(Person):
    """A game, a lesson, the recorders of the test, and a person."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.recorder = self.record('first')
        graph.start(GAME, expect_recorder=True)
        self.start_lesson(
            expect_recorder=True, participant='p1', session='s1', learner_deadline=0.2
        )
        graph.ready('/game')

    def record(self, name: str) -> Any:
        """Start a recorder, which begins a file again and again."""
        return self.graph.start(RECORDER, path=self.graph.folder / name, max_seconds=0.2)

    def paused(self) -> str:
        """Wait until the lesson is paused, and return the cause."""
        self.graph.until(lambda: self.lesson.paused, 'the pause')
        self.graph.until(self._in(NodeStatus.STATE_PAUSED), 'the status of the node')
        return str(self.lesson.paused)

    def goes_on(self) -> None:
        """Wait until the lesson goes on."""
        self.graph.until(lambda: not self.lesson.paused, 'the end of the pause')
        self.graph.until(self._in(NodeStatus.STATE_READY), 'the status of the node')

    def _in(self, state: int) -> Any:
        return lambda: self.graph.state('/lesson') == state


@pytest.fixture
def session(live: Graph) -> Session:
    return Session(live)


def uuids(bag: Path) -> list[str]:
    """Return the demonstrations in a bag, each once."""
    return list(dict.fromkeys(demo.uuid for demo in read_demonstrations(open_bag(bag))))


def test_a_recording_that_stops_pauses_the_lesson_until_the_next_one_has_all_that_was_shown(
    session: Session,
) -> None:
    folder = session.graph.folder
    session.name_and_answer()
    shown = []
    for _ in range(2):
        episode = session.begin()
        session.drive(episode, 'west')
        if shown:  # the recording stops in the middle of the second one
            session.graph.until(lambda: uuids(folder / 'first') == shown, 'the first in the bag')
            (folder / 'first' / 'metadata.yaml.new').mkdir()
            cause = session.paused()
        session.drive(episode, 'pickup')
        ended = session.end(episode, 2)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        shown.append(ended.uuid)
    assert 'recording stopped: cannot write in' in cause
    assert 'Everything taught so far is on disk' in cause
    assert 'not in this recording; the next recording will have it' in ended.detail
    for kind in SERVICES.keys() - {EndDemonstration, ListDemonstrations}:
        refused = session.ask(kind)
        assert refused.status == kind.Response.STATUS_PAUSED
        assert cause in refused.detail

    second = session.record('second')
    session.goes_on()
    session.begin()
    for recorder in (session.recorder, second):
        session.graph.stop(recorder)
    with session.graph.hurried():
        assert 'nothing is heard of the recorder any more' in session.paused()
    assert uuids(folder / 'first') == shown[:1]
    assert uuids(folder / 'second') == shown


def test_what_the_machine_showed_is_told_apart_and_the_bag_learns_the_same(live: Graph) -> None:
    recorder = live.start(RECORDER, path=live.folder / 'bag')
    live.start(GAME)
    live.start(LEARNER, directory=live.folder / 'options')
    live.start(OPTION_SERVER)
    person = Person(live)
    person.start_lesson()
    live.ready('/game', '/learner', '/option_server', '/recorder')
    person.get_ready()
    person.show()  # from START: west, pickup
    learned: list[LearnedOption] = live.listen(LearnedOption, 'learned_options')

    def watch(steps: int) -> int:
        person.give_back()
        begun = person.ask(BeginDemonstration, start_state=START, watch=True)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        live.act(
            ExecuteOption,
            'execute_option',
            option_name=PICKUP,
            episode=begun.episode,
            max_steps=steps,
        ).result()
        live.until(lambda: person.lesson.machine_steps == steps, "the machine's steps")
        return int(begun.episode)

    def end(episode: int, step: int, *, counts: bool) -> None:
        done = EndDemonstration.Request.VERDICT_DONE
        ended = person.ask(
            EndDemonstration,
            verdict=done,
            episode=episode,
            step=step,
            count_machine_steps=counts,
        )
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        live.until(lambda: person.lesson.last_uuid == ended.uuid, 'the lesson to keep it')
        person.phase(LessonState.PHASE_READY)

    episode = watch(1)
    person.drive(episode, 'pickup')
    end(episode, 2, counts=True)
    episode = watch(2)
    end(episode, 2, counts=True)
    newest = person.lesson.last_uuid
    live.until(lambda: learned and newest in learned[-1].model, 'the option')
    option, _ = option_from_json(learned[-1].model)
    live.stop(recorder)

    bag = open_bag(live.folder / 'bag')
    demos = {demo.uuid: demo for demo in read_demonstrations(bag)}
    assert [(d.actions, d.machine_steps) for d in demos.values()] == [
        (('west', 'pickup'), 0),
        (('west', 'pickup'), 1),
        (('west', 'pickup'), 2),
    ]
    sources = [
        [int(step.action_source) for step in found.transitions[1:]] for found in read_episodes(bag)
    ]
    person_, machine = GameState.SOURCE_PERSON, GameState.SOURCE_MACHINE
    assert sources[-3:] == [[person_] * 2, [machine, person_], [machine] * 2]
    assert learn_option(list(demos.values()), read_domain(bag), 0) == option


PAGE = Path(__file__).parents[1] / 'docs' / 'how-to' / 'call-the-services.md'
# What is refused before the program of the documentation runs, and after it.
BEFORE = """
from humanopts_teach.lesson.requests import BeginDemonstration, OpenSession, RequestStatus
from humanopts_teach.ros.lesson_client import RefusedError, run_with_lesson


async def teach(client):
    try:
        await client.ask(BeginDemonstration())
    except RefusedError as error:
        print(error.answer.status.name, error)
    try:
        await client.drive('fly')
    except RefusedError as error:
        print(error)
    await client.ask(OpenSession('p1', 's1'))
    print(client.lesson.participant, client.lesson.session)


run_with_lesson(teach)
"""
AFTER = "run_with_lesson(lambda client: client.ask(OpenSession('no code')))"


def run(graph: Graph, program: str) -> tuple[int | None, str, str]:
    """Run a program on the graph; return its exit status, its output and its errors."""
    process = subprocess.Popen(
        [sys.executable, '-c', program],
        env={**os.environ, 'ROS_DOMAIN_ID': str(graph.domain_id)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        graph.until(lambda: process.poll() is not None, 'the end of the program', 60.0)
        return process.returncode, *process.communicate()


@pytest.fixture
def lesson(live: Graph) -> Graph:
    """A game with a learner and a lesson, as the command ``up`` starts them."""
    live.start(GAME)
    live.start(LEARNER, directory=live.folder / 'options', seed=1)
    live.start(
        LESSON,
        directory=live.folder / 'demonstrations',
        strategy='failures',
        until_no_failures=True,
        seed=1,
    )
    live.ready('/game', '/learner', '/lesson')
    return live


def test_the_program_of_the_documentation_teaches_and_what_is_refused_is_raised_with_its_reason(
    lesson: Graph,
) -> None:
    section = PAGE.read_text('utf-8').partition('## Teach from a program')[2]
    program, output = re.findall(r'```(?:python|text)\n(.*?)```', section, re.DOTALL)
    assert 'All criteria are met.' in output
    status, said, errors = run(lesson, BEFORE + program + AFTER)
    assert said.endswith(output)
    first, second, third = said.removesuffix(output).splitlines()
    assert first == 'WRONG_PHASE lesson/begin_demonstration was refused: Open a session to begin.'
    assert second.startswith('action fly was refused: ')
    assert third == 'p1 s1'
    assert status == 1
    assert errors.startswith('Traceback')
    assert "RefusedError: lesson/open_session was refused: participant 'no code'" in errors
