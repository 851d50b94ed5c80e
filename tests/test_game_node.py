"""The node game on the real graph: what it takes, what it refuses, and how it survives."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
import json
from pathlib import Path
import signal
import time
from typing import Any

from graph_support.live import GAME, Graph, NodeProcess
from graph_support.player import MACHINE, ME, PERSON, Player
from graph_support.scripted import TAXI
from humanopts_interfaces.msg import ActionRefusal, ControlState, DomainInfo, GameState, NodeStatus
from humanopts_interfaces.srv import ResetGame, SetControl, SetPace
from humanopts_ros.middleware import PROFILES, RANGE
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT, LATCHED
from humanopts_ros.workarounds import READ_PROFILES
import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

RENEWAL = 0.1  # s between signs of life
START = 'taxi 0,1 passenger R destination G'
NEARLY_DONE = 'taxi 0,4 passenger aboard destination G'
Answer = GameState | ActionRefusal


@pytest.fixture(scope='module')
def playing(shared: Graph) -> Player:
    shared.start(GAME)
    return Player(shared)


@pytest.fixture
def player(playing: Player) -> Player:
    """Begin an episode at START that nobody holds."""
    playing.fresh(START)
    return playing


def refused(answer: Answer) -> tuple[int, str]:
    assert isinstance(answer, ActionRefusal)
    return answer.reason, answer.detail


def taken(answer: Answer) -> tuple[int, str]:
    assert isinstance(answer, GameState), answer.detail
    return answer.step, answer.state


def place(state: GameState) -> tuple[int, int]:
    return state.episode, state.step


def test_a_stream_of_states_is_the_record_of_the_game(player: Player) -> None:
    for action in ('west', 'pickup', 'south'):
        player.do(action)
    first, *later = player.states[-4:]
    assert (first.state, first.step, first.previous_action) == (START, 0, '')
    assert [s.previous_action for s in later] == ['west', 'pickup', 'south']
    assert [s.reward for s in later] == [-1.0, 0.0, -1.0]
    assert [s.step for s in later] == [1, 2, 3]
    assert {(s.action_source, s.action_publisher_id) for s in later} == {(MACHINE, ME)}
    assert later[-1].state == 'taxi 1,0 passenger aboard destination G'
    for state in player.states[-4:]:
        values = TAXI.feature_values(TAXI.decode(state.state))
        assert state.features.tolist() == values.tolist()


def test_who_comes_late_knows_the_rules_and_the_current_state(
    player: Player, shared: Graph
) -> None:
    player.do('west')
    info = shared.listen(DomainInfo, 'domain_info', CURRENT)
    current = shared.listen(GameState, 'current_state', CURRENT)
    shared.until(lambda: info and current and current[-1].step, 'latched values')
    assert (info[0].domain, info[0].gamma, info[0].max_steps) == ('taxi', 0.99, 200)
    assert json.loads(info[0].parameters) == {'rows': 5, 'cols': 5}
    assert [a.name for a in info[0].actions] == [a.name for a in TAXI.actions]
    assert current[-1].state == player.state.state


def test_the_first_state_that_anybody_gets_is_the_newest(player: Player, shared: Graph) -> None:
    usual = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    known = shared.listen(GameState, 'current_state', LATCHED)
    for number in range(12):
        player.do('west' if number % 2 else 'east')
        newest = player.state.episode, number + 1
        shared.until(lambda n=newest: known and place(known[-1]) == n, 'the current state')
        states = shared.listen(GameState, 'current_state', usual)
        controls = shared.listen(ControlState, 'control', usual)
        shared.until(lambda s=states, c=controls: s and c, 'current values')
        assert place(states[0]) == newest
        assert controls[0].sequence == player.controls[-1].sequence


def test_current_states_come_at_most_fifty_times_a_second_while_the_machine_plays(
    player: Player, shared: Graph
) -> None:
    current = shared.listen(GameState, 'current_state')
    shared.until(lambda: player.do('west') and current, 'a current state')
    first, began = len(current), time.monotonic()
    for number in range(100):
        player.do('west' if number % 2 else 'east')
    shared.until(lambda: place(current[-1]) == place(player.state), 'the newest state')
    assert len(current) - first <= 50.0 * (time.monotonic() - began) + 2
    assert [s.sequence for s in current] == list(
        range(current[0].sequence, current[-1].sequence + 1)
    )
    for _ in range(3):  # a person sees each step
        player.do('east', PERSON)
        newest = place(player.state)
        shared.until(lambda n=newest: place(current[-1]) == n, 'the state of a person')
    assert [s.step for s in current[-3:]] == [player.state.step - n for n in (2, 1, 0)]


def test_every_refusal_names_its_reason_repeats_the_command_and_changes_nothing(
    player: Player,
) -> None:
    """All that is refused, and when, is in test_game.py of humanopts_env."""
    player.fresh(NEARLY_DONE)
    episode = player.state.episode
    refusal = player.do('jump', step=7)
    assert refused(refusal)[0] == ActionRefusal.REASON_STALE
    assert f'the game is at episode {episode} step 0' in refusal.detail
    assert (refusal.command_action, refusal.command_step) == ('jump', 7)
    assert (refusal.episode, refusal.step) == (episode, 0)
    delivered = player.do('dropoff')
    assert (delivered.terminated, delivered.truncated, delivered.reward) == (True, False, 1.0)
    reason, detail = refused(player.do('south'))
    assert reason == ActionRefusal.REASON_EPISODE_OVER
    assert 'the task is over; call reset_game' in detail
    for text in ('nowhere', delivered.state):
        reply = player.reset(text)
        assert (reply.status, reply.episode) == (ResetGame.Response.STATUS_BAD_STATE, 0)
        assert text in reply.detail
    assert player.reset(source=3).status == ResetGame.Response.STATUS_BAD_SOURCE
    assert player.reset(source=0).status == ResetGame.Response.STATUS_OK, 'an empty request'
    begun = player.reset(seed=2**64 - 1)
    assert (begun.episode, begun.state) == (player.state.episode, player.state.state)
    assert player.reset(seed=2**64 - 1).state == begun.state != player.reset(seed=5).state


def test_a_key_claims_control_and_applies_to_the_current_step(player: Player) -> None:
    player.do('south')
    state = player.do('south', PERSON, step=0, episode=0)
    assert taken(state) == (2, 'taxi 2,1 passenger R destination G')
    control = player.controls[-1]
    assert (control.holder, control.holder_id) == (ControlState.HOLDER_PERSON, ME)


def test_while_a_person_holds_control_machines_and_others_are_refused(player: Player) -> None:
    player.do('south', PERSON)
    held = ActionRefusal.REASON_HELD_BY_PERSON
    assert refused(player.do('south')) == (held, f'control is held by the person at {ME}')
    assert refused(player.do('south', PERSON, publisher_id='/person#2'))[0] == held
    reply = player.reset(source=MACHINE)
    assert reply.status == ResetGame.Response.STATUS_HELD_BY_PERSON
    other = player.hold(False, '/person#2')
    assert other.status == SetControl.Response.STATUS_NOT_HOLDER
    assert ME in other.detail
    assert player.hold(True, '').status == SetControl.Response.STATUS_NOT_HOLDER
    assert taken(player.do('south', PERSON))[0] == 2
    assert player.hold(False).status == SetControl.Response.STATUS_OK
    assert player.controls[-1].holder == ControlState.HOLDER_NOBODY
    assert taken(player.do('south'))[0] == 3
    assert player.hold(False).detail == 'nothing changed'


def seconds_between(first: ControlState, last: ControlState) -> float:
    stamps = [c.header.stamp.sec + c.header.stamp.nanosec / 1e9 for c in (first, last)]
    return stamps[1] - stamps[0]


def test_control_that_nobody_renews_ends_within_two_seconds(player: Player, shared: Graph) -> None:
    player.do('south', PERSON, publisher_id='pub')  # as ros2 topic pub does, once
    assert player.controls[-1].holder_id == 'pub'
    shared.until(lambda: not player.controls[-1].holder, 'control to be free')
    assert player.controls[-1].reason == 'pub is silent and has not renewed its control'
    assert 1.0 < seconds_between(*player.controls[-2:]) < 2.5
    assert taken(player.do('south'))[0] == 2


def test_a_holder_that_is_not_there_is_refused(player: Player) -> None:
    for holder in ('/nobody#1', 'pub', 'x' * 100_000):
        answer = player.hold(True, holder)
        assert answer.status == SetControl.Response.STATUS_NOT_HOLDER
        assert 'is there to hold control' in answer.detail
        assert len(answer.detail) < 1000
    assert not player.controls[-1].holder


@contextmanager
def terminal(graph: Graph) -> Iterator[NodeBase]:
    """A node in a process of its own, as far as game can see, that tells its life once."""
    context = Context()
    rclpy.init(
        context=context,
        domain_id=graph.domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node = NodeBase('terminal', context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
        context.shutdown()


def test_control_is_free_at_once_when_the_terminal_is_started_again_or_ends(
    player: Player, shared: Graph
) -> None:
    with terminal(shared) as first:
        shared.until(lambda: 'terminal' in shared.node.get_node_names(), 'the terminal')
        player.hold(True, first.publisher_id)
        assert player.controls[-1].holder_id == first.publisher_id
        with terminal(shared) as again:
            renewed = 0.0

            def is_free() -> bool:
                nonlocal renewed
                if time.monotonic() - renewed > RENEWAL:
                    renewed = time.monotonic()
                    first.publish_status_again()  # so that its lease goes on
                return not player.controls[-1].holder

            shared.until(is_free, 'control to be free')
            assert player.controls[-1].reason == '/terminal was restarted'
            player.hold(True, again.publisher_id)
            assert player.controls[-1].holder_id == again.publisher_id
            again.set_status(NodeStatus.STATE_STOPPING)
            shared.until(lambda: not player.controls[-1].holder, 'control to be free')
            assert player.controls[-1].reason.endswith(' has ended')
    assert taken(player.do('south'))[0] == 1


WRONG: list[tuple[dict[str, Any], str]] = [
    ({'domain': 'chess'}, "unknown domain 'chess'; choose from"),
    ({'domain_parameters': '{"rows": 1}'}, 'rows is 1'),
    ({'domain_parameters': 'rows=7'}, 'not JSON'),
    ({'seed': -1}, 'parameter seed'),
    ({'step_period': -0.5}, 'parameter step_period'),
]


@pytest.mark.parametrize(('parameters', 'says'), WRONG)
def test_a_game_that_cannot_start_says_why(
    shared: Graph, parameters: dict[str, Any], says: str
) -> None:
    assert says in shared.refused(GAME, '/wrong', **parameters)


def test_the_machine_is_paced_by_a_parameter_until_a_person_takes_control(
    live: Graph,
) -> None:
    game = live.start(GAME, step_period=0.1)
    player = Player(live)
    player.fresh(START)

    def steps_apart() -> float:
        for _ in range(2):
            player.do('south')
        stamps = [s.header.stamp.sec + s.header.stamp.nanosec * 1e-9 for s in player.states[-2:]]
        return stamps[1] - stamps[0]

    def answer(name: str, value: object) -> str:
        (result,) = game.set_parameters([Parameter(name, value=value)])
        return 'taken' if result.successful else result.reason

    assert steps_apart() > 0.09
    assert answer('step_period', 0.2) == 'taken'
    live.until(lambda: player.controls[-1].step_period == 0.2, 'the pace')
    assert steps_apart() > 0.19
    for value in (-0.5, 61.0, float('nan')):
        assert 'out of range' in answer('step_period', value)
    assert 'Wrong parameter type' in answer('step_period', 1)
    assert 'read-only parameter: seed' in answer('seed', 1)
    live.ask(SetPace, 'set_pace', step_period=0.5)
    assert game.get_parameter('step_period').value == 0.5
    live.until(lambda: player.controls[-1].step_period == 0.5, 'the pace of the service')

    assert answer('step_period', 60.0) == 'taken'
    waiting = player.command('south', publisher_id='/one#1')
    player.send(waiting)
    stale, detail = refused(player.do('west', publisher_id='/other#1'))
    assert stale == ActionRefusal.REASON_STALE
    assert "'south' waits for step_period" in detail
    player.hold(True)
    live.until(
        lambda: player.refusals[-1].command_publisher_id == waiting.publisher_id, 'its refusal'
    )
    assert player.refusals[-1].reason == ActionRefusal.REASON_HELD_BY_PERSON


# A participant that is silent for its lease (20 s) is dropped, and then blocks nobody. A writer
# that keeps everything is blocked by so many messages that a reader has not taken; else by 5,000.
UNREAD = 400
LIMITS = f"""<topic><resourceLimitsQos>
  <max_samples>{UNREAD}</max_samples><max_samples_per_instance>{UNREAD}</max_samples_per_instance>
</resourceLimitsQos></topic>"""
LEASE = '<leaseDuration><sec>600</sec></leaseDuration>'
READER = """
import signal, sys
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_interfaces import msg
import rclpy
from rclpy.signals import SignalHandlerOptions

ended = []
signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node('slow_reader')
numbers = open(sys.argv[1], 'w', buffering=1)
keep = lambda state: print(state.sequence, file=numbers)
node.create_subscription(msg.GameState, 'game_state', keep, STREAM)
while not ended:
    rclpy.spin_once(node, timeout_sec=0.1)
"""


@pytest.fixture
def impatient(live: Graph, monkeypatch: pytest.MonkeyPatch) -> Graph:
    """A game that readers block soon, as a process; sockets are as in every graph."""
    usual = (files('humanopts_ros') / 'loopback_discovery.xml').read_text()
    writer = '<data_writer profile_name="writer" is_default_profile="true">'
    profile = live.folder / 'profile.xml'
    profile.write_text(
        usual.replace('<leaseAnnouncement>', f'{LEASE}<leaseAnnouncement>').replace(
            writer, f'{writer}{LIMITS}'
        )
    )
    monkeypatch.setenv(PROFILES[0], str(profile))
    monkeypatch.setenv(READ_PROFILES, '1')
    monkeypatch.setenv(RANGE, 'SYSTEM_DEFAULT')  # LOCALHOST would add shared memory
    live.spawn(GAME)
    live.ready('/game')
    return live


def slow_reader(graph: Graph, player: Player) -> tuple[NodeProcess, Path]:
    """Start a reader of all states; return it, and the file with the numbers it has read."""
    numbers = graph.folder / 'numbers'
    reader = graph.run(['-c', READER, str(numbers)], 'reader')

    def there() -> bool:
        readers = graph.node.get_subscriptions_info_by_topic('game_state')
        return any(reader.node_name == 'slow_reader' for reader in readers)

    def heard() -> bool:  # which is later: we and game get to know the reader apart
        player.reset(START)
        return bool(numbers.read_text())

    graph.until(there, 'the reader')
    graph.until(heard, 'the reader to hear game')
    return reader, numbers


def flood_until_paused(graph: Graph, player: Player) -> str:
    """Have game publish as many states as it can; return why it pauses."""

    def paused() -> bool:
        return bool(graph.state('/game') == NodeStatus.STATE_PAUSED)

    enough = player.state.episode + 40
    while not paused():
        reply = graph.ask(ResetGame, 'reset_game', source=PERSON, start_state=START)
        graph.until(lambda n=reply.episode: player.state.episode >= n or paused(), 'a start')
        for _ in range(199):
            player.send(player.command('pickup', PERSON))
        graph.until(lambda: player.state.step == 199 or paused(), 'the steps')
        assert reply.episode < enough, 'game never paused'
    return str(graph.statuses['/game'][-1].text)


def test_a_stopped_reader_pauses_the_game_and_no_state_is_lost(
    impatient: Graph,
) -> None:
    player = Player(impatient)
    reader, numbers = slow_reader(impatient, player)
    player.reset(START)
    first = player.state.sequence
    for _ in range(100):  # game and reader know each other well before it stops
        player.do('pickup')

    def has_read() -> bool:
        return str(player.state.sequence) in numbers.read_text().split()

    impatient.until(has_read, 'the reader')
    reader.pause()
    cause = flood_until_paused(impatient, player)
    assert 'cannot publish on /game_state' in cause
    assert 'slow_reader' in cause
    assert refused(player.do('south', PERSON)) == (ActionRefusal.REASON_PAUSED, cause)
    reader.go_on()
    impatient.until(lambda: impatient.state('/game') == NodeStatus.STATE_READY, 'game to go on')
    player.fresh(START)
    assert taken(player.do('south'))[0] == 1
    last = player.state.sequence
    impatient.until(has_read, 'the reader to have it all')
    assert reader.kill(signal.SIGTERM) == 0
    for got in (player.states, numbers.read_text().split()):
        seen = [int(getattr(state, 'sequence', state)) for state in got]
        assert seen[seen.index(first) :] == list(range(first, last + 1))
