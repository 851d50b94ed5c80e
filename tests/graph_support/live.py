"""
The graph of a test: nodes in the test's own process, and one among them that talks to the others.

One executor serves them all, and only while the test waits. What only a process can show, such as
signals, an exit status or a terminal, is a process that the test starts.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import gc
import itertools
import os
from pathlib import Path
from pkgutil import resolve_name
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.guarded_node import StartError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT, STREAM
import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.event_handler import EventHandler, QoSPublisherEventType, QoSSubscriptionEventType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
import yaml

# Nodes, each as module:class.
GAME = 'humanopts_env.ros.game_node:GameNode'
WORLD = 'humanopts_env.ros.world_node:WorldNode'
LEARNER = 'humanopts_learner.ros.learner_node:LearnerNode'
OPTION_SERVER = 'humanopts_learner.ros.option_server:OptionServerNode'
PLANNER = 'humanopts_learner.ros.planner_node:PlannerNode'
LESSON = 'humanopts_teach.ros.lesson_node:LessonNode'
TEACHER = 'humanopts_teach.ros.simulated_teacher:SimulatedTeacherNode'
RECORDER = 'humanopts_teach.ros.recorder:Recorder'
KEYBOARD = 'humanopts_teach.ros.keyboard_teleop:KeyboardTeleopNode'
JOY = 'humanopts_teach.ros.joy_teleop:JoyTeleopNode'

SPIN = 0.02  # s that an executor waits for something to do
HURRY = 50.0  # s of the nodes' clock in a second, where a test waits for a deadline
_IDS = range(10, 100)
# Processes of tests have neighbouring numbers; far turns let what one leaves behind end before
# another uses the same identifier.
_TURN = itertools.count(37 * os.getpid())


def module_of(node: str) -> str:
    """Return the module that runs a node as a process."""
    return node.partition(':')[0]


@contextmanager
def free_domain_id() -> Iterator[int]:
    """Claim a ROS_DOMAIN_ID that no other test of this machine uses."""
    for number in itertools.islice(_TURN, len(_IDS)):
        domain_id = _IDS[number % len(_IDS)]
        with socket.socket(socket.AF_UNIX) as claim:
            try:  # a name without a file: one for all users and folders, gone with the process
                claim.bind(f'\0humanopts-test-{domain_id}')
            except OSError:
                continue
            yield domain_id
            return
    raise RuntimeError(f'every ROS_DOMAIN_ID from {_IDS[0]} to {_IDS[-1]} is in use')


@dataclass
class NodeProcess:
    """A process that the test started."""

    name: str
    process: 'subprocess.Popen[bytes]'
    stderr: Path
    stopped: bool = False  # by SIGSTOP
    expected: set[int] = field(default_factory=lambda: {0})  # exit statuses

    def said(self) -> str:
        """Return what it wrote on standard error."""
        return self.stderr.read_text(errors='replace')

    def kill(self, how: signal.Signals) -> int:
        """Send a signal that ends it, and return its exit status."""
        if how == signal.SIGKILL:
            self.expected.add(-how)
        self.process.send_signal(how)
        return self.ended()

    def ended(self, seconds: float = 60.0) -> int:
        """Wait for its end and return its exit status; 0 where Fast DDS held up a clean end."""
        status = self.process.wait(seconds)
        return 0 if status == -signal.SIGALRM else status

    def pause(self) -> None:
        """Stop it, as Ctrl-Z does."""
        self.process.send_signal(signal.SIGSTOP)
        self.stopped = True

    def go_on(self) -> None:
        """Undo ``pause``."""
        self.process.send_signal(signal.SIGCONT)
        self.stopped = False


class Clock:
    """The monotonic clock of the nodes of the test's own process; a test makes it run faster."""

    def __init__(self) -> None:
        self._rate, self._since, self._before = 1.0, time.monotonic(), 0.0

    def __call__(self) -> float:
        """Return the time, s."""
        return self._before + (time.monotonic() - self._since) * self._rate

    def set_rate(self, rate: float) -> None:
        """Go on from now on at another rate, s of this clock in a second."""
        self._before, self._since, self._rate = self(), time.monotonic(), rate


_USED = (
    QoSPublisherEventType.RCL_PUBLISHER_MATCHED,
    QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED,
)


class Server(SingleThreadedExecutor):
    """Serves many nodes; of their QoS events, which take half of a wait, those in use."""

    def can_execute(self, entity: Any) -> bool:
        """Return whether the executor serves a part of a node."""
        unused = isinstance(entity, EventHandler) and entity.event_type not in _USED
        return not unused and bool(super().can_execute(entity))


class Goal:
    """A goal of an action that the server has accepted."""

    def __init__(self, graph: 'Graph', handle: Any, feedback: list[Any]) -> None:
        self._graph, self._handle, self.feedback = graph, handle, feedback
        self._reply = handle.get_result_async()
        self.goal_id = handle.goal_id

    def cancel(self) -> None:
        """Ask for its end, and wait until that is accepted."""
        self._graph.until(self._handle.cancel_goal_async().done, 'an answer to cancel')

    def result(self, seconds: float = 30.0) -> tuple[int, Any]:
        """Wait for its end; return its GoalStatus and the result."""
        self._graph.until(self._reply.done, 'the result', seconds)
        reply = self._reply.result()
        return reply.status, getattr(reply.result, 'result', reply.result)


class Graph:
    """
    Nodes and processes of one test or module, and a node that sees and asks.

    :ivar started: the processes, in order.
    :ivar statuses: those of every node that was watched, by its full name, in order.
    """

    def __init__(self, folder: Path, domain_id: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.domain_id = folder, domain_id
        self.started: list[NodeProcess] = []
        self.statuses: dict[str, list[NodeStatus]] = {}
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node('person', context=self.context)
        self._executor = Server(context=self.context)
        self._executor.add_node(self.node)
        self._hosted: list[NodeBase] = []
        self._clients: dict[str, Any] = {}
        self._clock = Clock()
        self._watched: set[str] = set()

    def start(self, node: str, namespace: str = '/', /, **parameters: Any) -> Any:
        """
        Start a node in the test's own process, and return it; it works while the test waits.

        :raises StartError: it cannot start with these parameters.
        """
        self.watch(namespace)
        given = [Parameter(name, value=_plain(value)) for name, value in parameters.items()]
        given.append(Parameter('start_type_description_service', value=False))
        hosted: NodeBase = resolve_name(node)(
            context=self.context,
            monotonic=self._clock,
            namespace=namespace,
            parameter_overrides=given,
            start_parameter_services=False,
        )
        self._executor.add_node(hosted)
        self._hosted.append(hosted)
        return hosted

    def stop(self, node: NodeBase) -> None:
        """End a node of the test's own process, as SIGTERM ends its process."""
        self._hosted.remove(node)
        node.close()
        node.set_status(NodeStatus.STATE_STOPPING)
        node.drain()
        self._executor.remove_node(node)
        node.destroy_node()

    @contextmanager
    def hurried(self, rate: float = HURRY) -> Iterator[None]:
        """
        Let every deadline of the nodes of the test's own process be soon over.

        :param rate: s of their clock in a second; below 1, they have time.
        """
        self._clock.set_rate(rate)
        yield
        self._clock.set_rate(1.0)

    def node_called(self, name: str) -> NodeBase:
        """Return a node of the test's own process by its full name."""
        (node,) = (n for n in self._hosted if n.get_fully_qualified_name() == name)
        return node

    @contextmanager
    def silent(self, name: str) -> Iterator[None]:
        """Let a node of the test's own process, by its full name, do nothing meanwhile."""
        node = self.node_called(name)
        self._executor.remove_node(node)
        yield
        self._executor.add_node(node)

    def spawn(self, node: str, namespace: str = '/', /, **parameters: Any) -> NodeProcess:
        """Start a node in a process of its own."""
        self.watch(namespace)
        arguments = ['-m', module_of(node), '--ros-args', '-r', f'__ns:={namespace}']
        return self.run(arguments, module_of(node), parameters)

    def refused(self, node: str, namespace: str = '/', /, **parameters: Any) -> str:
        """Start a node that cannot start with these parameters, or in this game; return why."""
        known = len(self._hosted)
        try:
            self.start(node, namespace, **parameters)
            self.until(lambda: False, 'the refusal')
        except StartError as error:
            return str(error)
        finally:
            for begun in self._hosted[known:]:
                self._hosted.remove(begun)
                self._executor.remove_node(begun)
                begun.destroy_node()
        raise AssertionError('the node has started')

    def run(
        self,
        command: list[str],
        name: str,
        parameters: dict[str, Any] | None = None,
        *,
        before: Sequence[str] = (),
        **options: Any,
    ) -> NodeProcess:
        """Start Python in its own process; a command before it runs it, such as nsenter."""
        stem = self.folder / f'{len(self.started)}-{name}'
        if parameters:
            file = stem.with_suffix('.yaml')
            plain = {name: _plain(value) for name, value in parameters.items()}
            tree = {'/**': {'ros__parameters': plain}}
            file.write_text(yaml.safe_dump(tree))
            command = [*command, '--params-file', str(file)]
        log = stem.with_suffix('.stderr')
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(self.domain_id)}
        with log.open('wb') as stderr:
            process = subprocess.Popen(
                [*before, sys.executable, *command],
                stderr=stderr,
                env=environment,
                **{'stdin': subprocess.DEVNULL, 'stdout': subprocess.DEVNULL, **options},
            )
        self.started.append(NodeProcess(name, process, log))
        return self.started[-1]

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 20.0) -> float:
        """
        Serve all nodes until a condition holds, and return the seconds that it took.

        Time that callbacks of nodes in this process take, such as learning, does not count, nor
        does time that the machine gives to other processes.

        :param seconds: at most.
        """
        waited = 0.0
        while not condition():
            if waited > seconds:
                dead = [p for p in self.started if p.process.poll() not in (None, 0)]
                said = '\n'.join(f'{p.name}: {p.said()}' for p in dead)
                raise AssertionError(f'timed out waiting for {what}\n{said}')
            began = time.monotonic()
            self.spin()
            waited += min(time.monotonic() - began, 2 * SPIN)
        return waited

    def spin(self) -> None:
        """
        Serve all nodes a moment.

        It is as long every time: another timeout lets the executor begin anew, with what is always
        the first to be ready.
        """
        self._executor.spin_once(SPIN)

    def ready(self, *names: str) -> None:
        """Wait until nodes, by full name, are ready."""
        for name in names:
            self.until(
                lambda name=name: self.state(name) == NodeStatus.STATE_READY,
                f'{name} to be ready',
                90.0,
            )

    def state(self, name: str) -> int:
        """Return the last state that a node was in; 0: it has not said yet."""
        return int(self.statuses[name][-1].state) if name in self.statuses else 0

    def listen(self, kind: Any, topic: str, qos: Any = STREAM) -> list[Any]:
        """Return the list to which the messages of a topic will be added."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def ask(self, kind: Any, service: str, /, **fields: Any) -> Any:
        """Call a service and return the response."""
        future = self.request(kind, service, **fields)
        self.until(future.done, f'an answer of {service}', 30.0)
        return future.result()

    def request(self, kind: Any, service: str, /, **fields: Any) -> Any:
        """Call a service and return the future of its response."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.until(client.service_is_ready, f'service {service}')
        return client.call_async(kind.Request(**fields))

    def act(self, kind: Any, action: str, /, **fields: Any) -> Goal:
        """Send a goal to an action, which accepts it."""
        handle, feedback = self._send_goal(kind, action, **fields)
        assert handle.accepted
        return Goal(self, handle, feedback)

    def accepts(self, kind: Any, action: str, /, **fields: Any) -> bool:
        """Send a goal to an action, and return whether it accepts it."""
        return bool(self._send_goal(kind, action, **fields)[0].accepted)

    def _send_goal(self, kind: Any, action: str, /, **fields: Any) -> tuple[Any, list[Any]]:
        if action not in self._clients:
            self._clients[action] = ActionClient(self.node, kind, action)
        client = self._clients[action]
        self.until(client.server_is_ready, f'action {action}')
        feedback: list[Any] = []
        sent = client.send_goal_async(
            kind.Goal(**fields), feedback_callback=lambda m: feedback.append(m.feedback)
        )
        self.until(sent.done, 'the goal to be accepted')
        return sent.result(), feedback

    def close(self) -> list[str]:
        """End everything; say which processes did not end as they should."""
        running = [started for started in self.started if started.process.poll() is None]
        for started in running:
            started.go_on()
            started.process.terminate()
        problems = []
        for started in self.started:
            try:
                status = started.ended()
            except subprocess.TimeoutExpired:
                started.process.kill()
                status = started.ended()
            if status not in started.expected or 'Traceback' in started.said():
                problems.append(f'{started.name} ended with {status}: {started.said()}')
        for node in reversed(self._hosted):
            self.stop(node)
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        return problems

    def watch(self, namespace: str) -> None:
        """Keep the statuses of the nodes of a namespace."""
        if namespace not in self._watched:
            self._watched.add(namespace)
            self.node.create_subscription(
                NodeStatus,
                f'{namespace.rstrip("/")}/node_status',
                lambda status: self.statuses.setdefault(status.node, []).append(status),
                CURRENT,
            )


def _plain(value: Any) -> Any:
    """Return a value as a parameter can have it."""
    return str(value) if isinstance(value, Path) else value


@contextmanager
def open_graph(folder: Path) -> Iterator[Graph]:
    """Open a graph of its own; end everything in it, and check that it ended as it should."""
    with free_domain_id() as domain_id:
        graph = Graph(folder, domain_id)
        try:
            yield graph
        finally:
            problems = graph.close()
            gc.collect()  # what holds a node in a circle keeps it on the graph
    assert not problems, '\n'.join(problems)
