"""Several graphs, other software and strangers in one ROS_DOMAIN_ID: each bag holds its own."""

from functools import partial
from pathlib import Path
import signal
from typing import Any

from graph_support.live import (
    GAME,
    Graph,
    LEARNER,
    LESSON,
    module_of,
    OPTION_SERVER,
    PLANNER,
    RECORDER,
    TEACHER,
)
from graph_support.player import Player
from graph_support.scripted import TAXI
from humanopts_env.domains.registry import make_domain
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.msg import (
    ControlState,
    Demonstration,
    DomainInfo,
    GameState,
    LearnedOption,
    LessonState,
    OptionResult,
)
from humanopts_interfaces.srv import RunOption
from humanopts_ros.peers import announced_ids, node_names
from humanopts_ros.qos import LATCHED
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.rosbag2 import profiles
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.cli import main
from humanopts_teach.lesson.simulated_teacher import FINISHED
from humanopts_teach.ros.graph_probe import probe_graph
import pytest

PICKUP, NORTH = 'go to passenger and pickup', 'north-west room to north doorway'
START = 'taxi 2,2 passenger aboard destination G'
FORGED = {  # that a stranger publishes in the place of the nodes
    'domain_info': domain_to_info(make_domain('rooms')),
    'game_state': GameState(episode=9, state='nowhere'),
    'control': ControlState(holder=ControlState.HOLDER_PERSON, holder_id='/stranger#1'),
    'lesson_state': LessonState(participant='somebody', session='s'),
    'learned_options': LearnedOption(),
    'option_results': OptionResult(status=OptionResult.STATUS_REACHED),
    'demonstrations': Demonstration(
        kind=Demonstration.KIND_TRAJECTORY,
        domain='rooms',
        domain_parameters='{}',
        participant='somebody',
        option_name='go on',
        method='trees',
    ),
}
READING = ('info', 'eval', 'table1', 'check', 'play', 'export')


def read(command: str, bag: Path, out: Path, *options: str) -> int:
    """Run a command that reads a bag."""
    more = ['--to', 'csv', '--out', str(out)] if command == 'export' else []
    return main(['bag', command, str(bag), *more, *options])


class Lesson:
    """A simulated person who teaches an option in a namespace, and the bag of it."""

    def __init__(self, graph: Graph, namespace: str, participant: str, **recording: Any) -> None:
        self.graph, self.bag = graph, graph.folder / participant / 'bag'
        self._teacher = f'{namespace.rstrip("/")}/simulated_teacher'
        self._recorder = graph.start(RECORDER, namespace, path=self.bag, **recording)
        self._start = partial(graph.start, expect_recorder=True)
        folder = self.bag.parent
        self._start(LEARNER, namespace, directory=folder / 'options')
        self._start(LESSON, namespace, directory=folder / 'lesson', budget=2)
        self._start(OPTION_SERVER, namespace)
        self._namespace, self._participant = namespace, participant

    def taught(self, option: str, game: str = GAME, **parameters: Any) -> Path:
        """Teach an option to the end; return the bag."""
        if game:
            self._start(game, self._namespace, **parameters)
        who = {'options': [option], 'participant': self._participant}
        self._start(TEACHER, self._namespace, **who)
        statuses = self.graph.statuses

        def finished() -> bool:
            found = statuses.get(self._teacher, [])
            return any(status.text.startswith(FINISHED) for status in found)

        self.graph.until(finished, 'the lesson', 60.0)
        self.graph.stop(self._recorder)
        return self.bag


def test_a_bag_with_forged_messages_is_read_as_the_nodes_saw_it_whatever_the_game_is_called(
    live: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The game is started again in the meantime."""
    forgers = '/stranger#1', '/game#1', '/simulator#1a2b3c4d'
    whys = (
        'from /stranger#1, not from /simulator',
        'from /game#1, not from /simulator',
        'from /simulator#1a2b3c4d, which was not the game',
    )
    for topic, message in FORGED.items():  # before the nodes are there
        for message.publisher_id in forgers:
            live.node.create_publisher(type(message), topic, LATCHED).publish(message)
    lesson = Lesson(live, '/', 'p1')
    live.start(PLANNER, expect_recorder=True)
    options = ['-r', '__node:=simulator', '-p', 'expect_recorder:=true']
    words = ['-m', module_of(GAME), '--ros-args', *options]
    first = live.run(words, 'simulator')
    live.ready('/simulator')
    assert first.kill(signal.SIGTERM) == 0
    live.run(words, 'simulator')
    bag = lesson.taught(PICKUP, game='')
    games = dict.fromkeys(s.publisher_id for s in live.statuses['/simulator'])
    assert open_bag(bag).game_ids == tuple(games)
    for command in READING:
        assert read(command, bag, tmp_path / 'out') == 0, capsys.readouterr().err
        said = capsys.readouterr()
        assert 'somebody' not in said.out
        assert 'rooms' not in said.out
        if command == 'eval':
            left_out = 'left out: 1 message on /domain_info: '
            assert [w for w in whys if left_out + w not in said.err] == [], said.err
    found = summarise(open_bag(bag))
    assert (found.participants, found.results['option runs']) == (['p1'], {})
    with live.hurried():
        for name in ('/learner', '/lesson', '/option_server', '/planner'):
            guard = live.node_called(name).guard
            live.until(lambda g=guard: g.refused, f'the refusal of {name}')


@pytest.mark.parametrize('name', ['simulator', 'game'])
def test_the_status_names_two_games_of_a_namespace(
    live: Graph, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(live.domain_id))
    first = live.start(GAME)
    live.ready('/game')
    assert probe_graph('/').games == [first.publisher_id]
    second = live.run(['-m', module_of(GAME), '--ros-args', '-r', f'__node:={name}'], name)
    live.until(lambda: len(announced_ids(live.node, 'game')) == 2, 'the other game')
    live.ready(f'/{name}')
    report = probe_graph('/')
    assert first.publisher_id in report.games
    assert report.faults[-1].endswith(' each run a game here; stop all but one')
    assert report.status == 1
    second.kill(signal.SIGKILL)
    assert len(announced_ids(live.node, 'game')) == 2  # until it is missed
    assert probe_graph('/').games == [first.publisher_id]


def test_a_node_that_announces_a_game_and_does_not_serve_it_is_named(
    live: Graph, tmp_path: Path
) -> None:
    learner = live.start(LEARNER, directory=tmp_path)
    info = domain_to_info(TAXI)
    info.publisher_id = '/person#1'
    live.node.create_publisher(DomainInfo, 'domain_info', LATCHED).publish(info)
    with live.hurried():
        live.until(lambda: learner.guard.refused, 'the refusal')
    assert 'from /person#1: no game on the graph has this publisher_id' in learner.guard.remark
    assert not learner.ready
    live.start(GAME)
    live.ready('/learner')


def test_another_node_may_take_the_place_of_a_game_that_has_ended(
    live: Graph, tmp_path: Path
) -> None:
    game, learner = live.start(GAME), live.start(LEARNER, directory=tmp_path)
    live.ready('/game', '/learner')
    live.stop(game)
    live.until(lambda: '/game' not in node_names(learner), 'its end')
    live.run(['-m', module_of(GAME), '--ros-args', '-r', '__node:=simulator'], 'simulator')
    player = Player(live)
    live.until(lambda: player.state.publisher_id.startswith('/simulator#'), 'its state')
    live.start(OPTION_SERVER)
    live.ready('/option_server')
    state = player.fresh(START)
    result = live.ask(
        RunOption, 'run_option', option_name='action:north', episode=state.episode, step=0
    ).result
    assert result.status == OptionResult.STATUS_REACHED, result.detail
    assert learner.guard.refused == 0


def check_people(bag: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each command finds p1 alone in the namespace /, and p2 alone in /b."""
    for place, who, other in (('/', 'p1', 'p2'), ('/b', 'p2', 'p1')):
        for command in READING[:3]:
            capsys.readouterr()
            assert read(command, bag, folder, '--namespace', place) == 0
            said = capsys.readouterr()
            assert 'message on' not in said.err
            found = said.out.replace(str(bag), '')
            assert who in found
            assert other not in found
        for command in ('play', 'export'):
            assert read(command, bag, folder / f'{who}-{command}', '--namespace', place) == 0


def test_a_bag_of_another_program_with_several_graphs_is_read_one_at_a_time(
    live: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [
        Lesson(live, '/', 'p1').taught(PICKUP),
        Lesson(live, '/b', 'p2').taught(NORTH, domain='rooms'),
    ]
    for bag, who in zip(bags, ('p1', 'p2')):
        assert summarise(open_bag(bag)).participants == [who]
        assert check_bag(open_bag(bag)).whole
    everything = tmp_path / 'all'
    with BagWriter(everything) as writer:
        for each in map(open_bag, bags):
            for recorded in each.messages():
                topic = each.topics[recorded.topic]
                qos = profiles(topic.qos)
                writer.add_topic(recorded.topic, recorded.type, qos, schema=topic.schema)
                writer.write(recorded.topic, recorded.data, recorded.log_time)
    assert read('check', everything, tmp_path) == 0
    for command in READING:
        if command != 'check':
            capsys.readouterr()
            assert read(command, everything, tmp_path / 'out') == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert 'holds the graphs of several namespaces: /, /b; choose one' in line
    check_people(everything, tmp_path, capsys)
    assert read('info', everything, tmp_path, '--namespace', '/c') == 2
    assert 'no graph of namespace /c: /, /b' in capsys.readouterr().err


def test_a_bag_with_another_graph_beside_its_own_is_whole_and_read_one_at_a_time(
    live: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beside = Lesson(live, '/b', 'p2')
    live.start(GAME, '/b', domain='rooms', expect_recorder=True)
    live.ready('/b/game')  # whose first state no later recorder gets
    lesson = Lesson(live, '/', 'p1', record_topics=['*'], metadata='{"seed": 7}')
    beside.taught(NORTH, game='')
    bag = lesson.taught(PICKUP)
    assert read('check', bag, tmp_path) == 0, capsys.readouterr()
    check_people(bag, tmp_path, capsys)
    for place, seed in (('/', 7), ('/b', 0)):
        capsys.readouterr()
        assert read('eval', bag, tmp_path, '--namespace', place) == 0
        assert f'seed {seed}' in capsys.readouterr().out
