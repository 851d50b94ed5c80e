"""Bad messages and unexpected errors are counted and named, and end no node."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import math
from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import GAME, Graph, LEARNER, LESSON, OPTION_SERVER, PLANNER, RECORDER
from graph_support.player import Player
from graph_support.scripted import FETCH, TAXI, walk
from humanopts_env.domains.registry import make_domain
from humanopts_env.ros.convert import domain_to_info
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    Demonstration,
    DemonstrationReceipt,
    DomainInfo,
    ExecutionState,
    GameState,
    LearnedOption,
    LearningStatus,
    LessonState,
    NodeStatus,
    OptionResult,
    OptionValues,
    RecorderStatus,
)
from humanopts_interfaces.srv import ListOptions, RunOption
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_teach.ros.graph_probe import probe_graph
import pytest

FAULTY = 'graph_support.faulty:Faulty'
START = 'taxi 2,2 passenger aboard destination G'
GAMES_NAME = '/game#00000000'  # the game's own id takes its place where a reader checks it
TOPICS = {  # the node whose topic it is, and those that read it
    'domain_info': ('/game', ['/learner', '/lesson', '/option_server', '/planner']),
    'game_state': ('/game', ['/lesson', '/option_server']),
    'current_state': ('/game', ['/option_server']),
    'learned_options': ('/learner', ['/option_server', '/planner', '/lesson']),
    'learning_status': ('/learner', ['/lesson']),
    'demonstration_receipts': ('/learner', ['/lesson']),
    'automatic_options': ('/planner', ['/option_server']),
    'option_values': ('/planner', ['/option_server']),
    'execution': ('/planner', ['/option_server']),
}


class Attacked:
    """A whole graph, and a stranger that publishes on all of its topics."""

    def __init__(self, graph: Graph, folder: Path) -> None:
        self.graph = graph
        graph.start(GAME)
        graph.start(LEARNER, directory=folder / 'options')
        graph.start(LESSON, directory=folder / 'demonstrations')
        graph.start(OPTION_SERVER)
        graph.start(PLANNER)
        graph.ready('/game', '/learner', '/lesson', '/option_server', '/planner')
        self.player = Player(graph)
        self.receipts = graph.listen(DemonstrationReceipt, 'demonstration_receipts')

    @contextmanager
    def publisher(self, kind: Any, topic: str) -> Iterator[Callable[[Any], None]]:
        """Publish on a topic; wait until all of its readers listen."""
        latched = topic not in ('game_state', 'demonstrations')
        out = self.graph.node.create_publisher(kind, topic, LATCHED if latched else STREAM)
        readers = self.graph.node.count_subscribers
        self.graph.until(
            lambda: out.get_subscription_count() >= readers(topic) > 0, f'readers of {topic}'
        )
        yield out.publish
        self.graph.node.destroy_publisher(out)

    def refused(self, name: str) -> int:
        """Return how many messages a node has refused so far."""
        return self.graph.node_called(name).guard.refused

    def check_refused(self, topic: str, message: Any, why: str) -> None:
        """Publish a message; each node that reads it refuses it, and notes why for its status."""
        owner, readers = TOPICS[topic]
        if message.publisher_id == GAMES_NAME:
            message.publisher_id = self.graph.node_called(owner).publisher_id
        before = {name: self.refused(name) for name in readers}
        # The owner would replace what is current before all have read it.
        with self.graph.silent(owner), self.publisher(type(message), topic) as publish:
            publish(message)
            for name, count in before.items():
                self.graph.until(lambda n=name, c=count: self.refused(n) > c, f'{name} to refuse')
        for name in before:
            remark = self.graph.node_called(name).guard.remark
            assert f'on {topic}' in remark
            assert why in remark


@pytest.fixture(scope='module')
def attacked(shared: Graph, tmp_path_factory: pytest.TempPathFactory) -> Attacked:
    return Attacked(shared, tmp_path_factory.mktemp('attacked'))


def state(**fields: Any) -> GameState:
    """A state of the game that is right but for some fields, far ahead of the game."""
    start = TAXI.decode(START)
    usual = {
        'publisher_id': GAMES_NAME,
        'sequence': 1,
        'episode': 2**31,
        'state': START,
        'features': TAXI.feature_values(start).tolist(),
    }
    return GameState(**{**usual, **fields})


STATES = [
    ({'action_source': 9}, '9 is not a valid Source'),
    ({'state': 'nowhere'}, "'nowhere'"),
    ({'state': 'taxi ' * 10_000}, 'its state has 50,000 characters'),
    ({'features': [1.0, 2.0]}, 'its features are not those of taxi'),
    ({'features': [99.0] * len(TAXI.features)}, 'its feature taxi_row of taxi cannot be 99'),
    ({'step': 1, 'previous_action': 'fly'}, "'fly'"),
    ({'reward': math.nan}, 'its reward is nan'),
    ({'publisher_id': '/stranger#1'}, 'it is not from /game'),
]
INFOS = [
    ({'domain': 'chess', 'features': []}, "'chess' cannot be used: it has no feature"),
    ({'parameters': '[' * 100_000}, 'nested more than'),
    ({'parameters': '{"rows": 1' + '0' * 6000 + '}'}, 'an integer that is too large'),
    ({'parameters': '{"rows": 1000, "cols": 1000}'}, 'another version of taxi'),
    ({'gamma': math.nan}, 'another version of taxi'),
    ({'domain': 'rooms', 'parameters': '{}'}, 'another version of rooms'),
    ({'publisher_id': '/stranger#1'}, 'it is not from /game'),
]
VALUES = {'plan_id': 'x', 'names': ['a'], 'states': [1, 2], 'option_values': [1.0]}
OF_PLANNER, OF_LEARNER = '/planner#00000000', '/learner#00000000'


def cases() -> Iterator[tuple[str, Any, str]]:
    """Yield messages that cannot be used: the topic, the message, and why."""
    for fields, why in STATES:
        for topic in ('game_state', 'current_state'):
            yield topic, state(**fields), why
    rooms, large = make_domain('rooms'), make_domain('taxi', {'rows': 1000, 'cols': 1000})
    for domain, changed in (
        (TAXI, INFOS),
        (rooms, [({}, 'plays taxi')]),
        (large, [({}, 'plays')]),
    ):
        for fields, why in changed:
            info = domain_to_info(domain)
            for name, value in {'publisher_id': GAMES_NAME, **fields}.items():
                setattr(info, name, value)
            yield 'domain_info', info, why
    values = OptionValues(publisher_id=OF_PLANNER, **VALUES)
    yield 'option_values', values, 'option_values has 1 values'
    yield 'execution', ExecutionState(publisher_id=OF_PLANNER, execution='fly'), "'fly'"
    deep = LearnedOption(publisher_id=OF_LEARNER, name='x', model='[' * 100_000)
    yield 'learned_options', deep, 'nested more than'
    for topic, kind in (
        ('learned_options', LearnedOption),
        ('learning_status', LearningStatus),
        ('demonstration_receipts', DemonstrationReceipt),
        ('automatic_options', LearnedOption),
        ('option_values', OptionValues),
        ('execution', ExecutionState),
    ):
        owner = TOPICS[topic][0]
        for forged in ('', f'{owner}s#1', f'/other{owner}#1'):
            yield topic, kind(publisher_id=forged), f'it is not from {owner}'


@pytest.mark.parametrize(
    ('topic', 'message', 'why'), cases(), ids=lambda each: each[:24] if type(each) is str else ''
)
def test_a_message_that_cannot_be_used_is_refused_by_each_reader(
    attacked: Attacked, topic: str, message: Any, why: str
) -> None:
    attacked.check_refused(topic, message, why)


def test_an_option_runs_after_all_this_and_the_statuses_name_what_was_refused(
    attacked: Attacked,
) -> None:
    attacked.check_refused('game_state', state(state='nowhere'), "'nowhere'")
    start = attacked.player.fresh(START)
    run = {'option_name': 'action:north', 'episode': start.episode, 'step': 0}
    graph = attacked.graph
    result = graph.ask(RunOption, 'run_option', **run).result
    assert result.status == OptionResult.STATUS_REACHED, result.detail
    for name in TOPICS['game_state'][1]:
        remark = graph.node_called(name).guard.remark
        graph.until(lambda n=name, r=remark: r in graph.statuses[n][-1].text, 'its status')


@pytest.mark.parametrize(
    ('topic', 'forged'),
    [
        *(('lesson_state', LessonState(publisher_id=i)) for i in ('/x#1', '/lesson#garbage')),
        ('current_state', state()),
    ],
    ids=lambda each: getattr(each, 'publisher_id', each),
)
def test_a_current_value_that_another_node_publishes_is_replaced(
    topic: str, forged: Any, attacked: Attacked
) -> None:
    owner = attacked.graph.node_called('/lesson' if topic == 'lesson_state' else '/game')
    seen = attacked.graph.listen(type(forged), topic, LATCHED)
    until = attacked.graph.until
    until(lambda: seen, 'the current value')
    genuine = seen[-1]
    with attacked.publisher(type(forged), topic) as publish:
        publish(forged)
        until(lambda: seen[-1].publisher_id == forged.publisher_id, 'the forged value')
        until(lambda: seen[-1].publisher_id == owner.publisher_id, 'the value again')
    for field in ('state', 'episode', 'step', 'phase'):
        assert getattr(seen[-1], field, None) == getattr(genuine, field, None)


DEMO = walk(START, ['north'], FETCH, ['taxi_row'])
DEMONSTRATIONS = [
    ({'domain_parameters': '[' * 100_000}, 'nested more than'),
    ({'domain_parameters': '{"rows": 1' + '0' * 6000 + '}'}, 'an integer that is too large'),
    ({'kind': 9}, 'not "number 9"'),
    ({'rewards': [math.inf]}, 'not finite'),
    ({'uuid': 'x' * 100_000}, 'is not a UUID'),
]


@pytest.mark.parametrize(('fields', 'why'), DEMONSTRATIONS, ids=[w for _, w in DEMONSTRATIONS])
def test_a_demonstration_that_cannot_be_learned_is_answered(
    attacked: Attacked, fields: dict[str, Any], why: str
) -> None:
    message = demonstration_to_message(DEMO)
    for name, value in fields.items():
        setattr(message, name, value)
    before, refused = len(attacked.receipts), attacked.refused('/learner')
    with attacked.publisher(Demonstration, 'demonstrations') as publish:
        publish(message)
        attacked.graph.until(lambda: len(attacked.receipts) > before, 'a receipt')
    receipt = attacked.receipts[-1]
    assert receipt.status == DemonstrationReceipt.STATUS_REFUSED
    assert why in receipt.detail
    assert len(receipt.detail) < 500
    assert attacked.refused('/learner') == refused + 1


def test_unexpected_errors_are_counted_and_answered_and_a_flood_of_them_is_limited(
    live: Graph, capfd: pytest.CaptureFixture[str]
) -> None:
    node = live.start(FAULTY)
    live.until(lambda: node.ticks > 100, 'a hundred errors')
    lines = [line for line in capfd.readouterr().err.splitlines() if 'an error in on_tick' in line]
    assert 0 < len(lines) < 20
    assert len(live.statuses['/faulty']) < 20
    response = live.ask(ListOptions, 'list_options')
    assert response.status == 0
    assert 'RuntimeError: of the service\\x1b[2J' in response.detail
    assert len(response.detail) < 600
    result = live.ask(RunOption, 'run_option').result
    assert result.status == OptionResult.STATUS_FAILED
    assert 'RuntimeError: of the coroutine' in result.detail
    status, result = live.act(ExecuteOption, 'execute_option').result()
    assert (status, result.status) == (GoalStatus.STATUS_ABORTED, OptionResult.STATUS_FAILED)
    assert 'RuntimeError: of the action' in result.detail
    out = live.node.create_publisher(GameState, 'game_state', STREAM)
    live.until(out.get_subscription_count, 'the node to listen')
    before = node.guard.failed
    out.publish(GameState(state='here'))
    live.until(lambda: 'on_state: KeyError' in node.guard.remark, 'the message to be handled')
    live.until(lambda: node.guard.failed > before + 10, 'the timer to go on')
    live.until(lambda: ' errors, the last in ' in live.statuses['/faulty'][-1].text, 'its status')


def test_a_lesson_goes_on_after_a_forged_status_of_the_recorder(
    live: Graph, tmp_path: Path
) -> None:
    live.start(GAME)
    live.start(RECORDER, path=tmp_path / 'bag')
    live.start(LESSON, directory=tmp_path / 'lesson', expect_recorder=True)
    live.ready('/lesson', '/game', '/recorder')
    out = live.node.create_publisher(RecorderStatus, 'recorder_status', LATCHED)
    live.until(lambda: out.get_subscription_count() > 1, 'its readers')
    out.publish(RecorderStatus(publisher_id='/stranger#1', stopped=True))
    out.publish(RecorderStatus(publisher_id='/recorder#garbage'))
    live.until(lambda: live.state('/lesson') == NodeStatus.STATE_PAUSED, 'the lesson to pause')
    live.ready('/lesson')
    assert live.node_called('/lesson').guard.refused == 1


def test_the_status_tells_of_nothing_that_others_signed(
    live: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(live.domain_id))
    live.start(GAME)
    live.ready('/game')
    for kind, topic, fields in (
        (NodeStatus, 'node_status', {'node': '/learner'}),
        (DomainInfo, 'domain_info', {'domain': 'forged'}),
        (RecorderStatus, 'recorder_status', {}),
    ):
        for signed in ('/recorder#1', '/learner#1', '/stranger#1'):
            out = live.node.create_publisher(kind, topic, CURRENT)
            out.publish(kind(publisher_id=signed, **fields))
    report = probe_graph('/')
    assert report.game == 'taxi'
    assert [node.name for node in report.nodes] == ['game']
    assert report.recorder is None
