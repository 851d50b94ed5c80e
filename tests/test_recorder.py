"""The recorder as a process on a real graph: everything is in the bag, whatever ends it."""

from collections import Counter
from collections.abc import Callable, Iterator
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import time
from typing import Any

from graph_support.live import free_domain_id
from humanopts_interfaces.action import Plan
from humanopts_interfaces.msg import GameState, NodeStatus, RecorderStatus
from humanopts_interfaces.srv import SetControl
from humanopts_ros.qos import LATCHED, LATCHED_ALL, STREAM
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.provenance import software
from humanopts_teach.bags.reader import Bag, open_bag
import pytest
import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.signals import SignalHandlerOptions
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

pytestmark = pytest.mark.live
BEST_EFFORT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
# Publishes game states, the first when the recorder has matched: as fast as it can, or at a rate.
BURST = """
import sys, time
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
            print('sent', flush=True)
            self.count = -1
run_node(Burst, ['--ros-args', '-p', 'expect_recorder:=true'])
"""


class Graph:
    """A recorder in its own process, and a node of the test."""

    def __init__(self, path: Path, domain_id: int) -> None:
        self.path = path
        self.environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        self.recorder: subprocess.Popen[str] | None = None
        self.others: list[subprocess.Popen[str]] = []
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node('tester', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.status = RecorderStatus()
        self.said: list[RecorderStatus] = []
        self.node_states: dict[str, int] = {}
        self.node.create_subscription(RecorderStatus, 'recorder_status', self._keep, LATCHED)
        self.node.create_subscription(
            NodeStatus,
            'node_status',
            lambda m: self.node_states.update({m.node: m.state}),
            LATCHED_ALL,
        )

    def _keep(self, status: RecorderStatus) -> None:
        self.status = status
        self.said.append(status)

    def record(self, *options: str, **popen: Any) -> None:
        """Start the recorder and wait until it has matched everything."""
        self.recorder = self.begin(*options, **popen)
        self.complete()

    def begin(self, *options: str, **popen: Any) -> 'subprocess.Popen[str]':
        """Start a recorder."""
        return self.run(
            '-m',
            'humanopts_teach.ros.recorder',
            '--ros-args',
            '-p',
            f'path:={self.path}',
            *options,
            **popen,
        )

    def run(self, *arguments: str, **popen: Any) -> 'subprocess.Popen[str]':
        """Start Python on the graph."""
        process = subprocess.Popen(
            [sys.executable, *arguments],
            env=self.environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            **popen,
        )
        self.others.append(process)
        return process

    def until(self, condition: Callable[[], bool], what: str, seconds: float = 20.0) -> None:
        """Serve the node until a condition holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f'waited in vain for {what}'
            self.executor.spin_once(0.02)

    def complete(self, *hidden: str) -> None:
        """
        Wait until the recorder has every publisher of this process.

        :param hidden: topics that rclpy publishes on by itself.
        """
        publishers = list(self.node.publishers)
        self.until(
            lambda: (
                self.status.complete
                and all(p.get_subscription_count() > 0 for p in publishers)
                and all(map(self._read_by_recorder, hidden))
            ),
            'the recorder',
        )

    def _read_by_recorder(self, topic: str) -> bool:
        readers = self.node.get_subscriptions_info_by_topic(topic)
        return any(reader.node_name == 'recorder' for reader in readers)

    def recorded(self, topic: str) -> list[Any]:
        """Return what is in the bag of a topic, also while it is being written."""
        return [r.message for r in open_bag(self.path).messages([topic])]

    def holds(self, topic: str, count: int) -> None:
        """Wait until so many messages of a topic are in the bag; ``stop`` waits for nothing."""
        self.until(lambda: len(self.recorded(topic)) >= count, f'{count} messages on {topic}')

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Signal the recorder and wait for its end."""
        assert self.recorder is not None
        self.recorder.send_signal(number)
        return self.recorder.wait(10)

    def close(self) -> None:
        """End every process, and the node."""
        for process in self.others:
            process.kill()
            process.communicate()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    """A graph with no recorder yet."""
    with free_domain_id() as domain_id:
        graph = Graph(tmp_path / 'bag', domain_id)
        try:
            yield graph
        finally:
            graph.close()


def counts(bag: Bag) -> dict[str, int]:
    """Return the number of messages by topic."""
    return dict(Counter(recorded.topic for recorded in bag.messages(decoded=False)))


def test_a_burst_is_recorded_whole_and_in_order(graph: Graph) -> None:
    graph.record()
    burst = graph.run('-c', BURST, '10000', '0')
    assert burst.stdout is not None
    assert 'sent\n' in burst.stdout  # reads until then
    assert graph.stop() == 0
    bag = open_bag(graph.path)
    assert bag.damage == ''
    assert summarise(bag).missing == 0
    assert [r.message.step for r in bag.messages(['/game_state'])] == list(range(10000))
    with Reader(graph.path) as reader:
        assert reader.topics['/game_state'].msgcount == 10000


def test_service_requests_and_responses_are_recorded(graph: Graph) -> None:
    def answer(request: Any, response: Any) -> Any:
        response.status, response.detail = 1, f'for {request.holder_id}'
        return response

    service = graph.node.create_service(SetControl, 'set_control', answer)
    client = graph.node.create_client(SetControl, 'set_control')
    for end in (service, client):
        end.configure_introspection(
            graph.node.get_clock(), STREAM, ServiceIntrospectionState.CONTENTS
        )
    graph.record()
    graph.complete('/set_control/_service_event')
    graph.until(client.service_is_ready, 'the service')
    for number in range(5):
        future = client.call_async(SetControl.Request(hold=True, holder_id=f'terminal {number}'))
        graph.until(future.done, 'an answer')
    graph.holds('/set_control/_service_event', 20)  # each call has four
    graph.stop()
    events = [r.message for r in open_bag(graph.path).messages(['/set_control/_service_event'])]
    requests = [event.request[0].holder_id for event in events if event.request]
    responses = [event.response[0].detail for event in events if event.response]
    assert sorted(requests) == sorted([f'terminal {number}' for number in range(5)] * 2)
    assert sorted(responses) == sorted([f'for terminal {number}' for number in range(5)] * 2)


def test_action_feedback_and_status_are_recorded(graph: Graph) -> None:
    def execute(goal: Any) -> Any:
        for sweeps in range(3):
            goal.publish_feedback(Plan.Feedback(stage='sweeps', sweeps=sweeps))
        goal.succeed()
        return Plan.Result()

    def last_status() -> int:
        said = graph.recorded('/plan/_action/status')
        return int(said[-1].status_list[-1].status) if said else 0

    server = ActionServer(graph.node, Plan, 'plan', execute)
    client = ActionClient(graph.node, Plan, 'plan')
    graph.record()
    graph.complete('/plan/_action/feedback', '/plan/_action/status')
    graph.until(client.server_is_ready, 'the action')
    accepted = client.send_goal_async(Plan.Goal())
    graph.until(accepted.done, 'the goal')
    result = accepted.result().get_result_async()
    graph.until(result.done, 'the result')
    graph.holds('/plan/_action/feedback', 3)
    graph.until(lambda: last_status() == 4, 'the status: it succeeded')
    graph.stop()
    feedback = [m.feedback.sweeps for m in graph.recorded('/plan/_action/feedback')]
    assert feedback == [0, 1, 2]
    assert last_status() == 4
    client.destroy()
    server.destroy()


def test_what_was_latched_before_the_recorder_came_is_recorded(graph: Graph) -> None:
    early = graph.node.create_publisher(GameState, 'current_state', LATCHED)
    early.publish(GameState(publisher_id='/early#1', sequence=1, state='early'))
    graph.record()
    graph.holds('/current_state', 1)
    graph.stop()
    bag = open_bag(graph.path)
    assert [r.message.state for r in bag.messages(['/current_state'])] == ['early']
    assert 'transient_local' in bag.topics['/current_state'].qos
    assert bag.topics['/current_state'].type_hash.startswith('RIHS01_')


def test_nodes_that_come_later_are_recorded_from_their_first_message(graph: Graph) -> None:
    graph.record()
    for topic, text in (('late', 'first'), ('other', 'first'), ('late', 'again')):
        publisher = graph.node.create_publisher(String, topic, STREAM)
        graph.until(lambda p=publisher: p.get_subscription_count() > 0, 'the recorder')
        publisher.publish(String(data=text))
        graph.until(
            lambda t=topic, d=text: d in [m.data for m in graph.recorded(f'/{t}')],
            'the message in the bag',
        )
        graph.node.destroy_publisher(publisher)
    graph.stop()
    assert [m.data for m in graph.recorded('/late')] == ['first', 'again']
    assert [m.data for m in graph.recorded('/other')] == ['first']


def test_publishers_that_promise_less_are_matched(graph: Graph) -> None:
    first = graph.node.create_publisher(String, 'mixed', LATCHED)
    graph.record()
    second = graph.node.create_publisher(String, 'mixed', BEST_EFFORT)
    graph.until(lambda: second.get_subscription_count() > 0, 'a match with less')
    graph.until(lambda: first.get_subscription_count() > 0, 'a match')
    first.publish(String(data='first'))

    def recorded() -> set[str]:
        return {message.data for message in graph.recorded('/mixed')}

    def both() -> bool:
        second.publish(String(data='second'))  # best effort: one may be lost
        return recorded() == {'first', 'second'}

    graph.until(both, 'messages of both')
    graph.stop()
    assert recorded() == {'first', 'second'}


def test_the_log_the_parameters_and_the_recorder_itself_are_recorded(graph: Graph) -> None:
    def logged() -> list[str]:
        return [message.msg for message in graph.recorded('/rosout')]

    def changed() -> list[str]:
        events = graph.recorded('/parameter_events')
        return [p.name for event in events for p in event.changed_parameters]

    graph.node.declare_parameter('colour', 'red')
    graph.record('-p', 'metadata:=\'{"seed": 7, "strategy": "failures"}\'')
    graph.node.get_logger().info('a line of the log')
    graph.node.set_parameters([rclpy.Parameter('colour', value='blue')])
    graph.until(lambda: 'a line of the log' in logged(), 'the log')
    graph.until(lambda: changed() == ['colour'], 'the change of a parameter')
    graph.stop()
    bag = open_bag(graph.path)
    assert 'a line of the log' in logged()
    assert changed() == ['colour']
    assert {'/recorder_status', '/node_status'} <= counts(bag).keys()
    facts = {'seed': '7', 'strategy': 'failures', 'record_include': '["*"]', **software()}
    assert facts.items() <= bag.metadata['humanopts'].items()


def test_a_namespace_is_recorded_without_its_neighbours(graph: Graph) -> None:
    ours = graph.node.create_publisher(String, '/a/chatter', LATCHED)
    theirs = graph.node.create_publisher(String, '/ab/chatter', LATCHED)
    for publisher in (ours, theirs):
        publisher.publish(String(data='x'))
    graph.node.create_subscription(RecorderStatus, '/a/recorder_status', graph._keep, LATCHED)
    graph.recorder = graph.begin('-r', '__ns:=/a')
    graph.until(lambda: graph.status.complete, 'the recorder')
    graph.until(lambda: ours.get_subscription_count() == 1, 'a match')
    graph.holds('/a/chatter', 1)
    graph.stop()
    topics = set(open_bag(graph.path).topics)
    assert '/a/chatter' in topics
    assert all(t.startswith('/a/') or t in ('/rosout', '/parameter_events') for t in topics)


def test_a_gap_is_said_while_recording_with_its_topic_and_sender(graph: Graph) -> None:
    publisher = graph.node.create_publisher(GameState, 'game_state', STREAM)
    graph.record()
    for sequence in (1, 2, 6):
        publisher.publish(GameState(publisher_id='/tester#1', sequence=sequence))
    graph.until(lambda: graph.status.missing == 3, 'three missing messages')
    (loss,) = graph.status.losses
    assert (loss.topic, loss.sender) == ('/game_state', '/tester#1')
    assert (loss.sent, loss.missing) == (6, 3)
    graph.stop()


def test_a_recorder_that_was_stopped_says_that_it_is_behind_and_when_no_longer(
    graph: Graph,
) -> None:
    graph.record()
    assert graph.recorder is not None
    graph.run('-c', BURST, '1000000', '200')
    graph.until(lambda: graph.status.messages > 20, 'messages')
    graph.recorder.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    graph.until(lambda: time.monotonic() > stopped + 1.0, 'a second')
    graph.recorder.send_signal(signal.SIGCONT)
    graph.until(lambda: graph.status.behind, 'a word about it')
    assert graph.status.lag > 0.9
    assert 'does not keep up' in graph.status.text
    graph.until(lambda: not graph.status.behind, 'a recovery')
    assert graph.status.text == ''
    assert 0 < graph.status.cpu_seconds < 60
    assert 2**20 < graph.status.memory < 2**32
    assert graph.stop() == 0
    assert summarise(open_bag(graph.path)).missing == 0
    assert graph.recorder.stderr is not None
    log = graph.recorder.stderr.read()
    assert log.count('does not keep up') == log.count('keeps up again')


def test_a_recording_goes_on_in_other_files_and_loses_nothing(graph: Graph) -> None:
    graph.record('-p', 'max_bytes:=20000', '-p', 'max_seconds:=30.0')
    burst = graph.run('-c', BURST, '2000', '2000')
    assert burst.stdout is not None
    assert 'sent\n' in burst.stdout
    graph.until(lambda: graph.status.messages >= 2000, 'messages')
    assert graph.stop() == 0
    bag = open_bag(graph.path)
    assert len(bag.files) > 2
    assert graph.status.files in (len(bag.files), len(bag.files) - 1)
    assert [r.message.step for r in bag.messages(['/game_state'])] == list(range(2000))
    assert check_bag(bag).findings == ()


def test_a_recorder_killed_after_a_split_loses_half_a_second_at_most(graph: Graph) -> None:
    graph.record('-p', 'max_seconds:=0.3')
    graph.run('-c', BURST, '1000000', '500')
    graph.until(lambda: graph.status.messages > 300 and graph.status.files > 2, 'files')
    killed = time.time_ns()
    graph.stop(signal.SIGKILL)
    bag = open_bag(graph.path)
    recorded = list(bag.messages(['/game_state']))
    assert [r.message.step for r in recorded] == list(range(len(recorded)))
    assert killed - recorded[-1].log_time < 0.5e9
    told = bag.information['files']
    assert len(told) == len(bag.files)
    assert all(file['message_count'] > 0 for file in told[:-1])


def test_only_chosen_topics_are_recorded_and_nobody_waits_for_others(graph: Graph) -> None:
    patterns = ['-p', 'record_include:=["*_state", "recorder_*"]', '-p', 'record_exclude:=["c*"]']
    other = graph.node.create_publisher(String, 'chatter_state', LATCHED)
    other.publish(String(data='x'))
    graph.recorder = graph.begin(*patterns)
    graph.until(lambda: graph.status.complete, 'the recorder')
    waiting = BURST.replace("'expect_recorder:=true'", f"'expect_recorder:=true', *{patterns}")
    burst = graph.run('-c', waiting, '100', '0')
    assert burst.stdout is not None
    assert 'sent\n' in burst.stdout
    graph.stop()
    bag = open_bag(graph.path)
    assert set(bag.topics) == {'/game_state', '/recorder_status'}
    assert [r.message.step for r in bag.messages(['/game_state'])] == list(range(100))
    facts = bag.metadata['humanopts']
    assert facts['record_include'] == '["*_state", "recorder_*"]'
    assert facts['record_exclude'] == '["c*"]'
    assert 'demonstrations and domain_info will not be recorded' in graph.said[0].text


def test_patterns_that_leave_nothing_are_said(graph: Graph) -> None:
    graph.recorder = graph.begin('-p', 'record_include:=["nothing"]')
    graph.until(lambda: graph.status.complete, 'the recorder')
    assert graph.status.text == 'the patterns leave no topic to record'
    assert graph.stop() == 0


def test_option_files_are_kept_as_they_are_at_the_end(graph: Graph, tmp_path: Path) -> None:
    folder = tmp_path / 'options'
    graph.record('-p', f'attach:=["{folder}"]')
    (folder / 'p1').mkdir(parents=True)
    (folder / 'p1' / 'go.json').write_text('{"version": 1}')
    (folder / 'p1' / 'secret.json').symlink_to(tmp_path / 'nowhere')
    assert graph.stop() == 0
    (kept,) = open_bag(graph.path).attached()
    assert (kept.name, kept.data) == ('options/p1/go.json', b'{"version": 1}')
    assert kept.media_type == 'application/json'
    assert kept.create_time == (folder / 'p1' / 'go.json').stat().st_mtime_ns


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_a_whole_bag(graph: Graph, number: int) -> None:
    publisher = graph.node.create_publisher(String, 'chatter', STREAM)
    graph.record()
    for word in range(500):
        publisher.publish(String(data=str(word)))
    assert graph.stop(number) == 0
    bag = open_bag(graph.path)
    assert bag.damage == ''
    assert [r.message.data for r in bag.messages(['/chatter'])] == [str(n) for n in range(500)]


def test_a_full_disk_is_said_and_holds_nobody_back(graph: Graph) -> None:
    limit = 20_000
    graph.record(
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    publisher = graph.node.create_publisher(String, 'chatter', STREAM)
    graph.until(lambda: publisher.get_subscription_count() > 0, 'the recorder')
    publisher.publish(String(data='before'))
    graph.until(lambda: graph.status.messages > 4, 'a status')
    for _ in range(8):
        publisher.publish(String(data=os.urandom(10_000).hex()))
    graph.until(lambda: graph.status.stopped, 'the end of the recording')
    assert 'recording stopped: cannot write to' in graph.status.text
    graph.until(
        lambda: graph.node_states.get('/recorder') == NodeStatus.STATE_PAUSED, 'its node status'
    )
    for _ in range(6000):  # more than a reader that has stopped would let pass
        publisher.publish(String(data='after'))
    assert graph.stop() == 0
    first = next(open_bag(graph.path).messages(['/chatter']))
    assert first.message.data == 'before'


def test_a_recorder_that_stopped_stays_when_nodes_come(graph: Graph) -> None:
    graph.record('-p', 'max_seconds:=0.1')
    (graph.path / 'metadata.yaml.new').mkdir()
    graph.until(lambda: graph.status.stopped, 'the end of the recording')
    late = graph.node.create_publisher(GameState, 'game_state', STREAM)
    graph.until(lambda: late.get_subscription_count() > 0, 'the recorder')
    said = graph.status.sequence
    graph.until(lambda: graph.status.sequence > said, 'another word')
    assert graph.stop() == 0


@pytest.mark.parametrize(
    ('options', 'reason'),
    [
        ((), 'exists already'),
        (('-p', 'path:=/proc/no/such'), 'cannot make /proc/no/such'),
        (('-p', "path:=''"), 'name the directory'),
        (('-p', 'metadata:="[1]"', '-p', 'path:=/tmp/never'), 'not a JSON object'),
    ],
)
def test_a_recording_that_cannot_begin_says_why(
    graph: Graph, options: tuple[str, ...], reason: str
) -> None:
    graph.path.mkdir()
    process = graph.begin(*options)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 2
    assert reason in errors
    assert 'Traceback' not in errors
