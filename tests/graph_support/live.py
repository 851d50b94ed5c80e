"""The graph of a test: node processes, and a node in the test's own process that talks to them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
import fcntl
import itertools
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, TypeVar

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED_ALL, STREAM
import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
import yaml

GAME = 'humanopts_env.ros.game_node'
LEARNER = 'humanopts_learner.ros.learner_node'
OPTION_SERVER = 'humanopts_learner.ros.option_server'
PLANNER = 'humanopts_learner.ros.planner_node'
LESSON = 'humanopts_teach.ros.lesson_node'
TEACHER = 'humanopts_teach.ros.simulated_teacher'
RECORDER = 'humanopts_teach.ros.recorder'
KEYBOARD = 'humanopts_teach.ros.keyboard_teleop'

N = TypeVar('N', bound=NodeBase)
_IDS = range(10, 100)
_TURN = itertools.count(os.getpid())


@contextmanager
def free_domain_id() -> Iterator[int]:
    """Claim a ROS_DOMAIN_ID that no other test of this machine uses."""
    for number in itertools.islice(_TURN, len(_IDS)):
        domain_id = _IDS[number % len(_IDS)]
        path = Path(tempfile.gettempdir()) / f'humanopts-test-{os.getuid()}-{domain_id}.lock'
        with path.open('w') as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
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

    def ended(self, seconds: float = 20.0) -> int:
        """Wait for its end and return its exit status."""
        return self.process.wait(seconds)

    def pause(self) -> None:
        """Stop it, as Ctrl-Z does."""
        self.process.send_signal(signal.SIGSTOP)
        self.stopped = True

    def go_on(self) -> None:
        """Undo ``pause``."""
        self.process.send_signal(signal.SIGCONT)
        self.stopped = False


class Goal:
    """A goal of an action, sent."""

    def __init__(self, graph: 'Graph', kind: Any, client: ActionClient, fields: Any) -> None:
        self._graph = graph
        self.feedback: list[Any] = []
        sent = client.send_goal_async(
            kind.Goal(**fields), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        graph.until(sent.done, 'the goal to be accepted')
        self._handle = sent.result()
        assert self._handle.accepted
        self._reply = self._handle.get_result_async()

    def cancel(self) -> None:
        """Ask for its end, and wait until that is accepted."""
        asked = self._handle.cancel_goal_async()
        self._graph.until(asked.done, 'an answer to cancel')

    def result(self, seconds: float = 30.0) -> tuple[int, Any]:
        """Wait for its end; return its GoalStatus and the result."""
        self._graph.until(self._reply.done, 'the result', seconds)
        reply = self._reply.result()
        return reply.status, reply.result.result


class Graph:
    """Processes of one test or module, and a node that sees and asks."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.domain_id = folder, domain_id
        self.started: list[NodeProcess] = []
        self.statuses: dict[str, list[NodeStatus]] = {}  # by full node name, in order
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node('person', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._hosted: list[NodeBase] = []
        self._clients: dict[str, Any] = {}
        self._watched: set[str] = set()

    def start(self, module: str, namespace: str = '/', /, **parameters: Any) -> NodeProcess:
        """Start a node in its own process."""
        self.watch(namespace)
        return self.run(
            ['-m', module, '--ros-args', '-r', f'__ns:={namespace}'], module, parameters
        )

    def host(self, node: type[N], namespace: str = '/', /, **parameters: Any) -> N:
        """
        Start a node in the test's own process; it works while the test waits.

        Whole episodes are slower so: one executor then looks at all ends of all nodes each time.
        """
        self.watch(namespace)
        given = [Parameter(name, value=_plain(value)) for name, value in parameters.items()]
        hosted = node(context=self.context, namespace=namespace, parameter_overrides=given)
        self._executor.add_node(hosted)
        self._hosted.append(hosted)
        return hosted

    def newest(self, module: str) -> NodeProcess:
        """Return the process of a node that was started last."""
        return [process for process in self.started if process.name == module][-1]

    def kill(self, module: str, how: signal.Signals = signal.SIGKILL) -> tuple[int, str]:
        """End a node by a signal; return its exit status and what it said."""
        process = self.newest(module)
        return process.kill(how), process.said()

    def refused(self, module: str, namespace: str = '/', /, **parameters: Any) -> str:
        """Start a node that cannot start; return the line that says why."""
        process = self.start(module, namespace, **parameters)
        process.expected = {2}
        assert process.ended() == 2, process.said()
        (line,) = process.said().splitlines()
        assert line.startswith('humanopts: ')
        return line

    def run(
        self,
        command: list[str],
        name: str,
        parameters: dict[str, Any] | None = None,
        **options: Any,
    ) -> NodeProcess:
        """Start Python in its own process."""
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
                [sys.executable, *command],
                stderr=stderr,
                env=environment,
                **{'stdin': subprocess.DEVNULL, 'stdout': subprocess.DEVNULL, **options},
            )
        self.started.append(NodeProcess(name, process, log))
        return self.started[-1]

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 20.0) -> None:
        """Serve the test's node until a condition holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                dead = [p for p in self.started if p.process.poll() not in (None, 0)]
                said = '\n'.join(f'{p.name}: {p.said()}' for p in dead)
                raise AssertionError(f'waited in vain for {what}\n{said}')
            self.spin()

    def spin(self) -> None:
        """Serve the test's node a moment."""
        self._executor.spin_once(0.02)

    def ready(self, *names: str) -> None:
        """Wait until nodes, by full name, are ready."""
        for name in names:
            self.until(
                lambda name=name: self.state(name) == NodeStatus.STATE_READY,
                f'{name} to be ready',
                30.0,
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
        """Send a goal to an action."""
        if action not in self._clients:
            self._clients[action] = ActionClient(self.node, kind, action)
        client = self._clients[action]
        self.until(client.server_is_ready, f'action {action}')
        return Goal(self, kind, client, fields)

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
        for node in self._hosted:
            node.close()
        self._executor.shutdown()
        for node in (*self._hosted, self.node):
            node.destroy_node()
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
                LATCHED_ALL,
            )


def _plain(value: Any) -> Any:
    """Return a value as a parameter can have it."""
    return str(value) if isinstance(value, Path) else value


G = TypeVar('G', bound=Graph)


@contextmanager
def open_graph(folder: Path, kind: type[G]) -> Iterator[G]:
    """Open a graph of its own; end everything in it, and check that it ended as it should."""
    with free_domain_id() as domain_id:
        graph = kind(folder, domain_id)
        try:
            yield graph
        finally:
            problems = graph.close()
    assert not problems, '\n'.join(problems)
