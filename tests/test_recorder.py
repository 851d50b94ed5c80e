"""The recorder on a real graph: everything is in the bag, whatever ends it."""

from functools import partial
import json
import os
from pathlib import Path
import resource
import signal
import time
from typing import Any

from graph_support.live import GAME, Graph, NodeProcess, RECORDER
from humanopts_interfaces.msg import GameState, NodeStatus, RecorderStatus
from humanopts_interfaces.srv import ResetGame
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.provenance import software
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.ros import recorder
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

BEST_EFFORT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
# Publishes game states, the first when the recorder has matched: as fast as it can, or at a rate.
BURST = """
import os, signal, sys, time
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_interfaces.msg import GameState
from rclpy.duration import Duration
class Burst(NodeBase):
    def __init__(self):
        super().__init__('burst')
        self.count, self.rate = int(sys.argv[1]), float(sys.argv[2])
        self.states = self.stamped_publisher(GameState, 'game_state')
        self.sent, self.begun = 0, 0.0
    def on_ready(self):
        self.begun = time.monotonic()
        self.create_timer(0.002, self.send)
    def send(self):
        due = (time.monotonic() - self.begun) * self.rate if self.rate else self.sent + 1000
        while self.sent < min(due, self.count):
            self.states.publish(GameState(step=self.sent, state='x' * 40))
            self.sent += 1
        if self.sent == self.count:
            for publisher in self.publishers:
                publisher.wait_for_all_acked(Duration(seconds=20))
            os.kill(os.getpid(), signal.SIGTERM)
run_node(Burst, ['--ros-args', '-p', 'expect_recorder:=true'])
"""


class Recording:
    """
    A recorder on a graph, in the test's own process where no signal or limit is to reach it.

    :ivar said: its statuses, in order.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph, self.node = graph, graph.node
        self.path = graph.folder / 'bag'
        self.said: list[RecorderStatus] = graph.listen(RecorderStatus, 'recorder_status', CURRENT)
        self._recorder: Any = None

    @property
    def status(self) -> RecorderStatus:
        """Its newest status."""
        return self.said[-1] if self.said else RecorderStatus()

    def record(self, **parameters: Any) -> None:
        """Start the recorder and wait until it has matched everything."""
        self._recorder = self.graph.start(RECORDER, path=self.path, **parameters)
        self.complete()

    def spawn(self, **parameters: Any) -> NodeProcess:
        """Start the recorder in a process of its own and wait until it has matched everything."""
        self._recorder = self.graph.spawn(RECORDER, path=self.path, **parameters)
        self.complete()
        return self._recorder

    def burst(self, count: int, rate: int = 0) -> NodeProcess:
        """Start a process that sends game states, at a rate or as fast as it can."""
        return self.graph.run(['-c', BURST, str(count), str(rate)], 'burst')

    def complete(self) -> None:
        """Wait until the recorder has every publisher of the test's node."""
        publishers = list(self.node.publishers)
        self.graph.until(
            lambda: self.status.complete and all(p.get_subscription_count() for p in publishers),
            'the recorder',
        )

    def recorded(self, topic: str) -> list[Any]:
        """Return what is in the bag of a topic, also while it is being written."""
        return [r.message for r in open_bag(self.path).messages([topic])]

    def texts(self, topic: str) -> list[str]:
        """Return the texts in the bag of a topic."""
        return [message.data for message in self.recorded(topic)]

    def holds(self, topic: str, count: int) -> None:
        """Wait until a number of messages of a topic are in the bag."""
        self.graph.until(
            lambda: len(self.recorded(topic)) >= count, f'{count} messages on {topic}'
        )

    def stop(self) -> Bag:
        """End a recorder in the test's own process, as SIGTERM does; return its bag."""
        self.graph.stop(self._recorder)
        return open_bag(self.path)


@pytest.fixture
def recording(live: Graph) -> Recording:
    """A graph with no recorder yet."""
    return Recording(live)


def test_a_burst_is_recorded_whole_and_in_order_though_ctrl_c_ends_it(
    recording: Recording,
) -> None:
    recorder = recording.spawn()
    assert recording.burst(10_000).ended() == 0
    assert recorder.kill(signal.SIGINT) == 0
    bag = open_bag(recording.path)
    assert bag.damage == ''
    assert summarise(bag).missing == 0
    assert [r.message.step for r in bag.messages(['/game_state'])] == list(range(10000))
    with Reader(recording.path) as reader:
        assert reader.topics['/game_state'].msgcount == 10000


def test_one_recording_has_what_its_graph_said_and_says_what_is_missing(
    recording: Recording,
) -> None:
    node, until, folder = recording.node, recording.graph.until, recording.graph.folder / 'options'
    early = node.create_publisher(GameState, 'current_state', LATCHED)
    early.publish(GameState(publisher_id='/tester#1', sequence=1, state='early'))
    reliable = node.create_publisher(String, 'mixed', LATCHED)
    recording.record(
        record_topics=['late', 'mixed'],
        metadata='{"seed": 7, "strategy": "failures"}',
        attach=[str(folder)],
    )
    # Nodes that come later, from their first message on, and again.
    for text in ('first', 'again'):
        late = node.create_publisher(String, 'late', STREAM)
        until(late.get_subscription_count, 'the recorder')
        late.publish(String(data=text))
        until(lambda t=text: t in recording.texts('/late'), 'the message in the bag')
        node.destroy_publisher(late)
    # A publisher that promises less than the one before it.
    less = node.create_publisher(String, 'mixed', BEST_EFFORT)
    for publisher in (less, reliable):
        until(publisher.get_subscription_count, 'the recorder')
    reliable.publish(String(data='reliable'))

    def both() -> bool:
        less.publish(String(data='less'))  # best effort: one may be lost
        return set(recording.texts('/mixed')) == {'reliable', 'less'}

    until(both, 'messages of both')
    # The log and the parameters, of the graph alone.
    own = recording.graph.start(GAME)
    own.declare_parameter('colour', 'red')
    for each in (node, own):
        each.get_logger().info(f'a line of the log of {each.get_name()}')
    own.set_parameters([Parameter('colour', value='blue')])

    def logged() -> list[str]:
        return [message.msg for message in recording.recorded('/rosout')]

    def changed() -> list[str]:
        events = recording.recorded('/parameter_events')
        return [p.name for event in events for p in event.changed_parameters]

    until(lambda: 'a line of the log of game' in logged(), 'the log')
    until(lambda: changed() == ['colour'], 'the change of a parameter')
    # A gap in a stream is a loss, and one in current values is none.
    stream = node.create_publisher(GameState, 'game_state', STREAM)
    until(stream.get_subscription_count, 'the recorder')
    for sequence in (1, 2, 6):
        for publisher in (stream, early):
            publisher.publish(GameState(publisher_id='/tester#1', sequence=sequence))
    until(lambda: recording.status.missing == 3, 'three missing messages')
    (loss,) = recording.status.losses
    assert (loss.topic, loss.sender, loss.sent) == ('/game_state', '/tester#1', 6)
    # Numbers that cannot be do not mute it.
    for sender in ('/one#1', '/two#1', 'x' * 100_000, *(f'/many#{n}' for n in range(120))):
        stream.publish(GameState(publisher_id=sender, sequence=2**64 - 1))
    until(lambda: recording.status.missing == 2**64 - 1, 'its status')
    assert len(recording.status.losses) == 100
    assert max(len(loss.sender) for loss in recording.status.losses) < 1000
    known = len(recording.said)
    until(lambda: len(recording.said) > known, 'another status')
    # Files are kept as they are at the end.
    (folder / 'p1').mkdir(parents=True)
    (folder / 'p1' / 'go.json').write_text('{"version": 1}')
    (folder / 'p1' / 'secret.json').symlink_to(recording.graph.folder / 'nowhere')

    bag = recording.stop()
    assert next(bag.messages(['/current_state'])).message.state == 'early'
    assert 'transient_local' in bag.topics['/current_state'].qos
    assert bag.topics['/current_state'].type_hash.startswith('RIHS01_')
    assert recording.texts('/late') == ['first', 'again']
    assert 'a line of the log of person' not in logged()
    assert changed() == ['colour']
    assert {'/recorder_status', '/node_status'} <= {r.topic for r in bag.messages()}
    facts = {'seed': '7', 'strategy': 'failures', 'namespace': '/', **software()}
    assert facts.items() <= bag.metadata['humanopts'].items()
    current = [s for s in summarise(bag).streams if s.topic == '/current_state']
    assert sum(s.missing for s in current) == 0
    (kept,) = bag.attached()
    assert (kept.name, kept.data) == ('options/p1/go.json', b'{"version": 1}')
    assert kept.media_type == 'application/json'
    assert kept.create_time == (folder / 'p1' / 'go.json').stat().st_mtime_ns


def test_a_graph_is_recorded_without_its_neighbours_and_other_software(live: Graph) -> None:
    state = partial(GameState, publisher_id='/game#1', sequence=1)
    of_all = [
        (live.node.create_publisher(kind, topic, LATCHED), kind)
        for topic, kind in (
            *((f'{space}/current_state', state) for space in ('/a', '/ab', '/a/b', '')),
            *((topic, String) for topic in ('/a/odom', '/a/scan', '/a/camera/raw', '/tf')),
        )
        for kind in [GameState if kind is state else kind]
    ]
    for publisher, kind in of_all:
        publisher.publish(kind())
    for namespace, added in (('/a', ['scan']), ('/', ['/tf', '/ab/*'])):
        prefix = namespace.rstrip('/')
        said = live.listen(RecorderStatus, f'{prefix}/recorder_status', CURRENT)
        path = live.folder / f'bag{prefix[1:]}'
        recorder = live.start(RECORDER, namespace, path=path, record_topics=added)
        live.until(lambda s=said: s and s[-1].complete, 'the recorder')
        live.until(lambda p=path: open_bag(p).n_messages > 3, 'messages')
        live.stop(recorder)
    names = ('current_state', 'node_status', 'recorder_status')
    shared = {'/rosout', '/parameter_events'}
    both = [set(open_bag(live.folder / name).topics) - shared for name in ('baga', 'bag')]
    assert both[0] == {*(f'/a/{name}' for name in names), '/a/scan'}
    assert both[1] == {*(f'/{name}' for name in names), '/tf', '/ab/current_state'}


def _seconds(status: RecorderStatus) -> float:
    return float(status.header.stamp.sec) + float(status.header.stamp.nanosec) / 1e9


def test_a_recorder_that_was_stopped_says_so_and_one_killed_after_a_split_keeps_what_is_flushed(
    recording: Recording,
) -> None:
    recorder, until = recording.spawn(max_seconds=0.3), recording.graph.until
    recording.burst(1_000_000, 200)
    until(lambda: recording.status.messages > 20, 'messages')
    recorder.pause()
    stopped = time.monotonic()
    until(lambda: time.monotonic() > stopped + 1.0, 'a second')
    recorder.go_on()
    until(lambda: recording.status.behind, 'a word about it')
    assert recording.status.lag > 0.9
    assert 'does not keep up' in recording.status.text
    until(lambda: not recording.status.behind, 'a recovery')
    assert recording.status.text == ''
    assert 0 < recording.status.cpu_seconds < 60
    assert 2**20 < recording.status.memory < 2**32
    log = recorder.said()
    assert log.count('does not keep up') == log.count('keeps up again')
    until(lambda: recording.status.messages > 300 and recording.status.files > 2, 'files')
    before = recording.status
    until(lambda: _seconds(recording.status) > _seconds(before) + 0.5, 'flushes, every 0.25 s')
    recorder.kill(signal.SIGKILL)
    bag = open_bag(recording.path)
    recorded = list(bag.messages(['/game_state']))
    assert [r.message.step for r in recorded] == list(range(len(recorded)))
    assert bag.n_messages >= before.messages
    assert bag.information is not None
    described = len(bag.information.relative_file_paths)
    assert described in (len(bag.files), len(bag.files) - 1)  # the newest may have just begun


def test_what_patterns_add_or_leave_out_is_kept_and_no_node_waits_for_what_is_left_out(
    recording: Recording,
) -> None:
    left_out = ['current_state', 'domain_info', 'control', 'action_*', '*_status', '*_event']
    patterns = {'record_topics': ['chatter_*'], 'record_exclude': left_out}
    other = recording.node.create_publisher(String, 'chatter_state', LATCHED)
    other.publish(String(data='x'))
    recorder = recording.graph.start(RECORDER, path=recording.path, **patterns)
    recording.graph.until(lambda: recording.status.complete, 'the recorder')
    recording.graph.start(GAME, expect_recorder=True, **patterns)
    recording.graph.ready('/game')
    recording.graph.ask(ResetGame, 'reset_game', source=ResetGame.Request.SOURCE_PERSON)
    recording.holds('/game_state', 1)
    recording.graph.stop(recorder)
    bag = open_bag(recording.path)
    assert set(bag.topics) - {'/parameter_events', '/rosout'} == {'/game_state', '/chatter_state'}
    facts = bag.metadata['humanopts']
    assert facts['record_topics'] == '["chatter_*"]'
    assert facts['record_exclude'] == json.dumps(left_out)
    assert 'domain_info will not be recorded' in recording.said[0].text


def test_a_bag_names_a_topic_before_the_next_flush_is_due(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, '_FLUSH_PERIOD', 3600.0)
    recording.record(record_topics=['chatter'])
    recording.node.create_publisher(String, 'chatter', STREAM)
    recording.graph.until(lambda: '/chatter' in open_bag(recording.path).topics, 'the topic')


def test_a_full_disk_is_said_and_holds_nobody_back(recording: Recording) -> None:
    recorder, until = recording.spawn(record_topics=['chatter']), recording.graph.until
    publisher = recording.node.create_publisher(String, 'chatter', STREAM)
    until(lambda: publisher.get_subscription_count() > 0, 'the recorder')
    publisher.publish(String(data='before'))
    recording.holds('/chatter', 1)
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))
    for _ in range(8):
        publisher.publish(String(data=os.urandom(10_000).hex()))
    until(lambda: recording.status.stopped, 'the end of the recording')
    assert 'recording stopped: cannot write to' in recording.status.text
    until(lambda: recording.graph.state('/recorder') == NodeStatus.STATE_PAUSED, 'its node status')
    for _ in range(6000):  # more than a reader that has stopped would let pass
        publisher.publish(String(data='after'))
    assert recorder.kill(signal.SIGTERM) == 0
    first = next(open_bag(recording.path).messages(['/chatter']))
    assert first.message.data == 'before'


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({}, 'already exists'),
        ({'path': '/proc/no/such'}, 'cannot create /proc/no/such'),
        ({'path': ''}, 'name the directory'),
        ({'path': '/proc/never', 'metadata': '[1]'}, 'not a JSON object'),
    ],
)
def test_a_recording_that_cannot_begin_says_why(
    live: Graph, parameters: dict[str, Any], reason: str
) -> None:
    (live.folder / 'bag').mkdir()
    assert reason in live.refused(RECORDER, **{'path': live.folder / 'bag', **parameters})


def test_a_recorder_that_outlasts_a_node_records_its_end_though_both_are_ended_at_once(
    live: Graph, tmp_path: Path
) -> None:
    statuses = live.listen(RecorderStatus, 'recorder_status', CURRENT)
    recorder = live.spawn(RECORDER, path=tmp_path / 'bag', outlasts=['game', 'absent'])
    game = live.spawn(GAME, expect_recorder=True)
    live.ready('/recorder', '/game')
    game.pause()  # it is busy
    for node in (recorder, game):
        node.process.send_signal(signal.SIGINT)
    before = len(statuses)
    live.until(lambda: len(statuses) > before + 2, 'the recorder to go on')
    game.go_on()
    assert (game.ended(), recorder.ended()) == (0, 0)
    bag = open_bag(tmp_path / 'bag')
    ends = [r.message for r in bag.messages(['/node_status']) if r.message.node == '/game']
    assert ends[-1].state == NodeStatus.STATE_STOPPING
    assert bag.damage == ''
