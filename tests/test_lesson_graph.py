"""The lesson over the real graph, with game, learner and teacher; the test is the person."""

import copy
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from typing import Any

from graph_support.live import (
    GAME,
    Graph,
    LEARNER,
    LESSON,
    module_of,
    OPTION_SERVER,
    RECORDER,
    TEACHER,
)
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
    PlanResult,
)
from humanopts_interfaces.srv import (
    AddDemonstrations,
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
from humanopts_learner.ros.convert import summary_to_message
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_teach.bags.contents import read_demonstrations, read_domain, read_episodes
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.bag_evaluation import evaluate_bag
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


def test_the_lesson_offers_the_states_in_which_a_plan_got_stuck(person: Person) -> None:
    graph = person.graph
    start_learner(graph)
    person.start_lesson()
    graph.ready('/game', '/learner')
    person.get_ready()
    person.show()
    person.give_back()
    planner = graph.node.create_publisher(PlanResult, 'plan_results', STREAM)
    graph.until(lambda: planner.get_subscription_count() > 0, 'the lesson to listen')
    stuck = 'taxi 4,4 passenger R destination B'
    states, names = [stuck, stuck, 'nowhere'], [PICKUP, '', PICKUP]
    for count in (3, 2):  # the first message is refused
        planner.publish(
            PlanResult(
                publisher_id='/planner#test',
                trial_games=50,
                stuck_options=names[:count],
                stuck_states=states[:count],
            )
        )
    graph.until(lambda: person.lesson.trial_games == 50, 'the offer')
    assert (list(person.lesson.stuck_options), list(person.lesson.stuck_games)) == ([PICKUP], [2])
    assert 'The plan got stuck in 2 of 50 games' in person.lesson.text
    assert person.ask(BeginDemonstration).state == stuck


@pytest.fixture(scope='module')
def played(shared: Graph) -> Graph:
    """A game that many nodes refuse to join."""
    shared.start(GAME)
    return shared


def start_learner(graph: Graph, folder: str = 'options') -> Any:
    """Start a learner with a folder of its own, and return it."""
    return graph.start(LEARNER, directory=graph.folder / folder)


def test_the_simulated_teacher_teaches_until_the_criteria_hold_whatever_comes_in_between(
    graph: Graph, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another participant takes the lesson over once, and the game is away for a while."""
    monkeypatch.setattr('humanopts_teach.ros.lesson_node._GAME_DEADLINE', 0.05)
    carry_out, not_begun = Lesson.carry_out, Lesson.not_begun
    taken_over: list[Answer] = []
    refused: list[str] = []

    def come_in_between(lesson: Lesson, request: LessonRequest) -> Answer:
        answer = carry_out(lesson, request)
        if isinstance(request, DefineOption) and not taken_over:
            taken_over.append(carry_out(lesson, OpenSession('anna', 'hers')))
        return answer

    def refuse(lesson: Lesson, status: RequestStatus, cause: str) -> Answer:
        refused.append(cause)
        return not_begun(lesson, status, cause)

    monkeypatch.setattr(Lesson, 'carry_out', come_in_between)
    monkeypatch.setattr(Lesson, 'not_begun', refuse)
    start_learner(graph)
    lesson = person.start_lesson(strategy='failures', until_no_failures=True, learn=GOAL)
    graph.start(OPTION_SERVER)
    graph.ready('/game', '/learner', '/option_server')
    graph.start(TEACHER, error_rate=0.05, options=[PICKUP])
    graph.until(lambda: person.shown, 'a demonstration')
    graph.stop(graph.node_called('/game'))
    graph.until(lambda: len(refused) > 3, 'refusals')
    graph.start(GAME)
    graph.until(
        lambda: graph.statuses.get('/simulated_teacher', [NodeStatus()])[-1].text,
        'the teacher to finish',
        90.0,
    )
    status = graph.statuses['/simulated_teacher'][-1]
    assert (status.state, status.text) == (NodeStatus.STATE_READY, 'finished')
    assert person.lesson.phase == LessonState.PHASE_FINISHED
    assert 'Learned: 5 of 5 runs' in person.lesson.text
    (learned,) = person.latest[LearningStatus].options
    assert (learned.option_name, learned.criteria_met, learned.learned) == (PICKUP, True, True)
    assert person.latest[ControlState].holder == ControlState.HOLDER_NOBODY
    assert [answer.ok for answer in taken_over] == [True]
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
    graph.until(lambda: len(person.shown) > 1, 'the demonstration to be sent again')
    again = person.shown[-1]
    assert (again.uuid, again.states, again.rewards) == (first.uuid, first.states, first.rewards)
    person.demonstrate()
    graph.until(lambda: person.shown[-1].number == 2, 'demonstration 2')


def test_demonstrations_from_elsewhere_are_numbered_kept_and_learned(
    graph: Graph, person: Person
) -> None:
    start_learner(graph)
    person.start_lesson()
    person.get_ready()
    person.demonstrate()
    graph.until(lambda: bool(person.shown), 'the demonstration')
    other = copy.deepcopy(person.shown[0])
    other.participant, other.option_name, other.number, other.uuid = 'p9', 'a segment', 7, ''
    answer = person.ask(AddDemonstrations, demonstrations=[other, other])
    assert answer.status == AddDemonstrations.Response.STATUS_OK
    graph.until(lambda: person.lesson.n_demonstrations == 3, 'three demonstrations')
    graph.until(lambda: {each.number for each in person.shown} == {1, 2, 3}, 'the others')
    assert {(each.participant, each.option_name) for each in person.shown} == {('p1', PICKUP)}
    graph.until(
        lambda: [each.n_demonstrations for each in person.latest[LearningStatus].options] == [3],
        'the learner',
    )
    other.states = [*other.states[:-1], other.states[0]]
    refused = person.ask(AddDemonstrations, demonstrations=[other])
    assert refused.status == AddDemonstrations.Response.STATUS_REFUSED
    assert person.lesson.n_demonstrations == 3


def test_a_late_learner_gets_all_and_what_is_taken_back_is_unlearned_and_run_no_more(
    graph: Graph, person: Person
) -> None:
    lesson = person.start_lesson()
    graph.start(OPTION_SERVER)
    person.get_ready()
    lesson.set_parameters([Parameter('learner_deadline', value=0.2)])
    first = person.demonstrate()
    graph.until(lambda: 'learner is not responding' in person.lesson.text, 'the lesson to go on')
    lesson.set_parameters([Parameter('learner_deadline', value=30.0)])
    learner = start_learner(graph)

    def learned() -> list[tuple[str, int, str]]:
        status = person.latest.get(LearningStatus)
        options = status.options if status is not None else ()
        return [(o.option_name, o.n_demonstrations, o.last_uuid) for o in options]

    def until_learned(*options: tuple[str, int, str]) -> None:
        graph.until(lambda: learned() == list(options), f'the learner to know {options}')
        person.phase(LessonState.PHASE_READY)

    until_learned((PICKUP, 1, first))
    second = person.show()
    response = WithdrawDemonstration.Response
    unknown = person.ask(WithdrawDemonstration, uuid='unknown')
    assert unknown.status == response.STATUS_NO_DEMONSTRATION
    for uuid, left in ((first, [(PICKUP, 1, second)]), (second, [])):
        taken = person.ask(WithdrawDemonstration, uuid=uuid)
        assert (taken.status, taken.uuid) == (response.STATUS_OK, uuid)
        until_learned(*left)
    graph.until(
        lambda: not graph.ask(ListOptions, 'list_options').option_names, 'the option to be gone'
    )
    # Each is published once, and perhaps again because the learner is new.
    both = {first, second}
    graph.until(lambda: {m.uuid for m in person.shown if m.withdrawn} == both, 'both withdrawals')
    assert person.ask(WithdrawDemonstration).status == response.STATUS_NO_DEMONSTRATION

    graph.stop(learner)
    person.latest.pop(LearningStatus)
    start_learner(graph, 'forgot everything')
    graph.until(lambda: LearningStatus in person.latest, 'the new learner')
    third = person.demonstrate()
    until_learned((PICKUP, 1, third))
    listed = person.ask(ListDemonstrations).demonstrations
    found = [(demo.uuid, demo.withdrawn) for demo in listed]
    assert found == [(first, True), (second, True), (third, False)]
    assert person.ask(ChangeOption, name=PICKUP, new_name='fetch').status == 1
    graph.until(lambda: [o[:2] for o in learned()] == [('fetch', 1)], 'the new name alone')
    graph.until(lambda: person.lesson.option_name == 'fetch', 'the lesson to show it')


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


def test_what_becomes_of_the_game_reaches_the_person_and_the_lesson_stays_ready(
    graph: Graph, person: Person
) -> None:
    person.start_lesson()
    person.get_ready()
    episode = person.begin()
    graph.ask(ResetGame, 'reset_game', source=ResetGame.Request.SOURCE_PERSON)
    another = 'another client reset the game'
    graph.until(lambda: another in person.lesson.text, 'the lesson to notice')
    assert person.end(episode, 0).status == EndDemonstration.Response.STATUS_WRONG_PHASE
    graph.stop(graph.node_called('/game'))
    with graph.hurried():
        answer = person.ask(BeginDemonstration)
    assert answer.status == BeginDemonstration.Response.STATUS_NO_GAME
    assert person.lesson.phase == LessonState.PHASE_READY
    graph.start(GAME, domain='rooms')  # which has no start state of Taxi
    answer = person.ask(BeginDemonstration)
    assert answer.status == BeginDemonstration.Response.STATUS_BAD_STATE
    assert 'rooms' in answer.detail
    assert person.lesson.phase == LessonState.PHASE_READY
    graph.stop(graph.node_called('/game'))
    graph.start(GAME)
    person.begin()


@pytest.mark.parametrize(
    ('node', 'parameters', 'says'),
    [
        (LESSON, {'strategy': 'guess'}, "'guess' is not one of random"),
        (LESSON, {'budget': 0}, 'budget'),
        (LESSON, {'participant': 'no code', 'directory': 'DIRECTORY'}, 'is not a valid code'),
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


def uuids(bag: Path) -> list[str]:
    """Return the demonstrations in a bag, each once."""
    return list(dict.fromkeys(demo.uuid for demo in read_demonstrations(open_bag(bag))))


def test_a_recording_that_stops_pauses_the_lesson_until_the_next_one_has_all_that_was_shown(
    live: Graph,
) -> None:
    folder, person = live.folder, Person(live)

    def record(name: str) -> Any:
        """Start a recorder, which begins a file again and again."""
        return live.start(RECORDER, path=folder / name, max_seconds=0.2)

    def paused() -> str:
        """Wait until the lesson is paused, and return the cause."""
        live.until(lambda: person.lesson.paused, 'the pause')
        live.until(lambda: live.state('/lesson') == NodeStatus.STATE_PAUSED, 'the status')
        return str(person.lesson.paused)

    recorders = [record('first')]
    live.start(GAME, expect_recorder=True)
    person.start_lesson(expect_recorder=True, participant='p1', session='s1', learner_deadline=0.2)
    live.ready('/game')
    person.name_and_answer()
    shown = [person.demonstrate()]
    live.until(lambda: uuids(folder / 'first') == shown, 'the first in the bag')
    episode = person.begin()
    person.drive(episode, 'west')
    (folder / 'first' / 'metadata.yaml.new').mkdir()  # the recording stops
    cause = paused()
    person.drive(episode, 'pickup')
    ended = person.end(episode, 2)
    assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
    shown.append(ended.uuid)
    assert 'recording stopped: cannot write in' in cause
    assert 'Everything taught so far is on disk' in cause
    assert 'not in this recording; the next recording will contain it' in ended.detail
    for kind in SERVICES.keys() - {EndDemonstration, ListDemonstrations}:
        refused = person.ask(kind)
        assert refused.status == kind.Response.STATUS_PAUSED
        assert cause in refused.detail

    recorders.append(record('second'))
    live.until(lambda: not person.lesson.paused, 'the end of the pause')
    live.ready('/lesson')
    person.begin()
    for recorder in recorders:
        live.stop(recorder)
    with live.hurried():
        assert 'the recorder is no longer responding' in paused()
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

    for steps in (1, 2):  # of the machine, which the person watches
        person.give_back()
        begun = person.ask(BeginDemonstration, start_state=START, watch=True)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        run = {'option_name': PICKUP, 'episode': begun.episode, 'max_steps': steps}
        live.act(ExecuteOption, 'execute_option', **run).result()
        live.until(lambda n=steps: person.lesson.machine_steps == n, "the machine's steps")
        person.drive(begun.episode, *['pickup'][steps - 1 :])
        ended = person.end(begun.episode, 2, count_machine_steps=True)
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        live.until(lambda u=ended.uuid: person.lesson.last_uuid == u, 'the lesson to keep it')
        person.phase(LessonState.PHASE_READY)
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


def test_an_exam_goes_on_after_a_restart_and_the_bag_has_its_status(live: Graph) -> None:
    """The simulated teacher leaves in the middle of the exam, and a person goes on."""
    recorder = live.start(RECORDER, path=live.folder / 'bag')
    live.start(GAME)
    live.start(LEARNER, directory=live.folder / 'options')
    live.start(OPTION_SERVER)
    person = Person(live)
    lesson = person.start_lesson(strategy='failures', until_no_failures=True, learn=GOAL)
    live.ready('/game', '/learner', '/option_server', '/recorder')
    words = ['-m', module_of(TEACHER), '--ros-args', '-p', f'options:=["{PICKUP}"]']
    teacher = live.run(words, 'teacher')
    live.until(lambda: LessonState in person.latest and person.lesson.exam_runs > 0, 'a run', 90.0)
    teacher.kill(signal.SIGKILL)
    live.stop(lesson)
    person.latest.pop(LessonState)
    person.start_lesson(learn=GOAL, participant='simulated', session='simulated')
    person.phase(LessonState.PHASE_EXAM)
    known = person.lesson.exam_runs
    assert 0 < known < person.lesson.exam_needed == 5

    def watch(steps: int = 0) -> Any:
        """Begin a run of the exam, and let the machine move; return its last state."""
        person.phase(LessonState.PHASE_EXAM)
        begun = person.ask(BeginDemonstration, exam=True)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        run = {'option_name': PICKUP, 'episode': begun.episode, 'max_steps': steps}
        _, result = live.act(ExecuteOption, 'execute_option', **run).result()
        return result

    def judge(verdict: int, step: int, **fields: Any) -> Any:
        said = {'verdict': verdict, 'episode': person.lesson.episode, 'step': step}
        return person.ask(EndDemonstration, **said, **fields)

    ends = EndDemonstration.Request
    run = watch()
    answer = judge(ends.VERDICT_DONE, run.step_count)
    assert answer.status == EndDemonstration.Response.STATUS_BAD_VERDICT
    assert (
        judge(ends.VERDICT_RIGHT, run.step_count).detail == f'run {known + 1} of the exam is right'
    )
    live.until(lambda: person.lesson.exam_runs == known + 1, 'the run to count')
    watch(3)
    assert judge(ends.VERDICT_WRONG, 2, stopped=True).status == EndDemonstration.Response.STATUS_OK
    person.phase(LessonState.PHASE_READY)
    live.until(lambda: person.shown[-1].exam and not person.shown[-1].right, 'the wrong run')
    wrong = person.shown[-1]
    assert (len(wrong.states), wrong.stopped) == (3, True)
    assert person.ask(BeginDemonstration).state == wrong.states[-1]
    (status,) = person.latest[LearningStatus].options
    assert status.status == f'not learned: {known + 1} of {known + 2} runs in the exam were right'
    live.stop(recorder)
    (option,) = evaluate_bag(live.folder / 'bag').options
    assert repr(summary_to_message(option.summary)) == repr(status)


PAGE = Path(__file__).parents[1] / 'docs' / 'how-to' / 'call-the-services.md'
# What is refused before the program of the documentation runs, and after it.
BEFORE = """
from humanopts_teach.lesson.requests import BeginDemonstration, OpenSession, RequestStatus
from humanopts_teach.ros.graph_client import RefusedError, run_with_lesson


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
    print(client.world.lesson.participant, client.world.lesson.session)


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
    assert 'the exam' in output
    status, said, errors = run(lesson, BEFORE + program + AFTER)
    assert said.endswith(output), errors
    first, second, third = said.removesuffix(output).splitlines()
    assert first == 'WRONG_PHASE lesson/begin_demonstration was refused: Open a session to begin.'
    assert second.startswith('action fly was refused: ')
    assert third == 'p1 s1'
    assert status == 1
    assert 'Traceback' in errors
    assert "RefusedError: lesson/open_session was refused: participant 'no code'" in errors
