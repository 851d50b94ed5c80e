"""Bad messages and errors that nobody foresaw: counted and named, and no node ends by them."""

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
    """A whole graph, and somebody who publishes on all of its topics."""

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

    def check_works(self) -> None:
        """A primitive action is run as an option."""
        state = self.player.fresh(START)
        name = 'action:north'
        result = self.graph.ask(
            RunOption, 'run_option', option_name=name, episode=state.episode, step=0
        ).result
        assert result.status == OptionResult.STATUS_REACHED, result.detail


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


@pytest.mark.parametrize(('fields', 'why'), STATES, ids=[why[:20] for _, why in STATES])
@pytest.mark.parametrize('topic', ['game_state', 'current_state'])
def test_a_state_that_is_none_of_the_game_is_refused(
    attacked: Attacked, topic: str, fields: dict[str, Any], why: str
) -> None:
    attacked.check_refused(topic, state(**fields), why)


def test_an_option_runs_after_a_state_that_was_refused(attacked: Attacked) -> None:
    attacked.check_refused('game_state', state(state='nowhere'), "'nowhere'")
    attacked.check_works()
    graph = attacked.graph
    for name in TOPICS['game_state'][1]:
        remark = graph.node_called(name).guard.remark
        graph.until(lambda n=name, r=remark: r in graph.statuses[n][-1].text, 'its status')


LARGE = domain_to_info(make_domain('taxi', {'rows': 1000, 'cols': 1000}))
INFOS = [
    ({'domain': 'chess', 'features': []}, "'chess' cannot be used: it has no feature"),
    ({'parameters': '[' * 100_000}, 'nested more than'),
    ({'parameters': '{"rows": ' + '{"a":' * 100_000}, 'nested more than'),
    ({'parameters': '{"rows": 1' + '0' * 6000 + '}'}, 'an integer that is too large'),
    ({'parameters': '{"rows": 1000, "cols": 1000}'}, 'another version of taxi'),
    ({'gamma': math.nan}, 'another version of taxi'),
    ({'features': []}, 'another version of taxi'),
    ({'domain': 'rooms', 'parameters': '{}'}, 'another version of rooms'),
    ({'publisher_id': '/stranger#1'}, 'it is not from /game'),
]


@pytest.mark.parametrize(('fields', 'why'), INFOS, ids=[why[:20] for _, why in INFOS])
def test_a_game_that_cannot_be_is_refused(
    attacked: Attacked, fields: dict[str, Any], why: str
) -> None:
    info = domain_to_info(TAXI)
    for name, value in {'publisher_id': GAMES_NAME, **fields}.items():
        setattr(info, name, value)
    attacked.check_refused('domain_info', info, why)


def test_another_game_in_the_namespace_is_refused_whoever_announces_it(
    attacked: Attacked,
) -> None:
    for domain in (make_domain('rooms'), make_domain('taxi', {'rows': 1000, 'cols': 1000})):
        info = domain_to_info(domain)
        info.publisher_id = '/other_lab/game#1'
        attacked.check_refused('domain_info', info, 'it is not from /game')
        info.publisher_id = GAMES_NAME
        attacked.check_refused('domain_info', info, 'this namespace plays taxi')
    attacked.check_works()


def test_options_values_and_executions_that_cannot_be_are_refused(attacked: Attacked) -> None:
    planners = {'publisher_id': '/planner#00000000'}
    values = OptionValues(**planners, plan_id='x', names=['a'], states=[1, 2], option_values=[1.0])
    attacked.check_refused('option_values', values, 'option_values has 1 values')
    attacked.check_refused('execution', ExecutionState(**planners, execution='fly'), "'fly'")
    deep = LearnedOption(publisher_id='/learner#00000000', name='x', model='[' * 100_000)
    attacked.check_refused('learned_options', deep, 'nested more than')


@pytest.mark.parametrize(
    ('topic', 'kind'),
    [
        ('learned_options', LearnedOption),
        ('learning_status', LearningStatus),
        ('demonstration_receipts', DemonstrationReceipt),
        ('automatic_options', LearnedOption),
        ('option_values', OptionValues),
        ('execution', ExecutionState),
    ],
)
def test_what_another_node_publishes_in_the_place_of_learner_or_planner_is_refused(
    attacked: Attacked, topic: str, kind: type
) -> None:
    owner = TOPICS[topic][0]
    for forged in ('/stranger#1', '', owner, f'{owner}s#1', f'/other{owner}#1'):
        attacked.check_refused(topic, kind(publisher_id=forged), f'it is not from {owner}')


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


def test_errors_that_nobody_foresaw_are_counted_and_answered(live: Graph) -> None:
    node = live.start(FAULTY)
    live.until(lambda: node.ticks > 20, 'the timer to go on')
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


def test_the_log_and_the_status_of_a_flood_of_errors_are_limited(
    live: Graph, capfd: pytest.CaptureFixture[str]
) -> None:
    node = live.start(FAULTY)
    live.until(lambda: node.ticks > 100, 'a hundred errors')
    lines = [line for line in capfd.readouterr().err.splitlines() if 'an error in on_tick' in line]
    assert 0 < len(lines) < 20
    assert len(live.statuses['/faulty']) < 20


def test_a_state_of_the_lesson_that_another_node_publishes_is_replaced(
    live: Graph, tmp_path: Path
) -> None:
    lesson = live.start(LESSON, directory=tmp_path)
    live.start(GAME)
    live.ready('/lesson', '/game')
    states = live.listen(LessonState, 'lesson_state', LATCHED)
    live.until(lambda: states, 'the state of the lesson')
    out = live.node.create_publisher(LessonState, 'lesson_state', LATCHED)
    live.until(lambda: out.get_subscription_count() > 1, 'its readers')
    for forged in ('/stranger#1', '/lesson#garbage'):
        out.publish(LessonState(publisher_id=forged, phase=LessonState.PHASE_FINISHED))
        live.until(lambda f=forged: states[-1].publisher_id == f, 'the forged state')
        live.until(lambda: states[-1].publisher_id == lesson.publisher_id, 'the state again')
        assert states[-1].phase == LessonState.PHASE_NO_SESSION
    assert lesson.guard.refused == 2
    assert 'on lesson_state from /lesson#garbage' in lesson.guard.remark


def test_a_recorder_that_is_none_pauses_no_lesson(live: Graph, tmp_path: Path) -> None:
    lesson = live.start(LESSON, directory=tmp_path)
    live.start(GAME)
    live.ready('/lesson', '/game')
    out = live.node.create_publisher(RecorderStatus, 'recorder_status', LATCHED)
    live.until(out.get_subscription_count, 'its reader')
    out.publish(RecorderStatus(publisher_id='/stranger#1', stopped=True, text='full'))
    live.until(lambda: lesson.guard.refused, 'the refusal')
    assert 'it is not from /recorder' in lesson.guard.remark
    assert live.state('/lesson') == NodeStatus.STATE_READY


def test_a_lesson_goes_on_after_a_forged_status_of_the_recorder(
    live: Graph, tmp_path: Path
) -> None:
    live.start(GAME)
    live.start(RECORDER, path=tmp_path / 'bag')
    live.start(LESSON, directory=tmp_path / 'lesson', expect_recorder=True)
    live.ready('/lesson', '/game', '/recorder')
    out = live.node.create_publisher(RecorderStatus, 'recorder_status', LATCHED)
    live.until(lambda: out.get_subscription_count() > 1, 'its readers')
    out.publish(RecorderStatus(publisher_id='/recorder#garbage'))
    live.until(lambda: live.state('/lesson') == NodeStatus.STATE_PAUSED, 'the lesson to pause')
    live.until(lambda: live.state('/lesson') == NodeStatus.STATE_READY, 'the lesson to go on')


def test_a_current_state_that_another_node_publishes_is_replaced(live: Graph) -> None:
    game = live.start(GAME)
    live.ready('/game')
    states = live.listen(GameState, 'current_state', LATCHED)
    live.until(lambda: states, 'the state of the game')
    genuine = states[-1].state
    out = live.node.create_publisher(GameState, 'current_state', LATCHED)
    live.until(out.get_subscription_count, 'its readers')
    out.publish(state())
    live.until(lambda: states[-1].publisher_id == GAMES_NAME, 'the forged state')
    live.until(lambda: states[-1].publisher_id == game.publisher_id, 'the state again')
    assert (states[-1].state, states[-1].episode, states[-1].step) == (genuine, 1, 0)


def test_a_node_that_starts_beside_a_stranger_learns_the_game_all_the_same(
    live: Graph, tmp_path: Path
) -> None:
    live.start(GAME)
    live.ready('/game')
    out = live.node.create_publisher(DomainInfo, 'domain_info', LATCHED)
    out.publish(DomainInfo(publisher_id='/stranger#1', domain='chess'))
    for turn in range(3):
        learner = live.start(LEARNER, directory=tmp_path / str(turn))
        live.until(lambda n=learner: n.ready and n.guard.refused, 'the learner, and its refusal')
        live.stop(learner)


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
