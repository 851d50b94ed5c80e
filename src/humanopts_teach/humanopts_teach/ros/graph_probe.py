"""Inspects a graph without publishing, before a launch and for ``status``."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
import shutil
import time
from typing import Any

from humanopts_interfaces import msg
from humanopts_ros.codec import Codec
from humanopts_ros.guarded_node import start_ros, starting_ros
from humanopts_ros.peers import announced_ids, node_names, Peers
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import sender_of, signer
from humanopts_ros.workarounds import on_loopback, prepare_discovery
from humanopts_teach.launching import CONDUCTOR, MODULES, OccupiedError, RECORDER
from humanopts_teach.launching.launcher import PARAMETERS
from humanopts_teach.launching.place import domain_id, holder
from humanopts_teach.launching.status import (
    GraphReport,
    NodeReport,
    RecorderReport,
)
import psutil
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

_SEARCH = 1.5  # s to discover nodes; ends early if all nodes of a local launch are found
_LOOK_PERIOD = 0.02  # s between checks for nodes
_SETTLING = 0.3  # s from the discovery of all local processes to that of their nodes
_REMOTE = 1.5  # s to discover processes on other machines
_LONGEST = 5.0  # s, limit if a local process is never discovered, such as a suspended one
_LEAVING = 3.0  # s for nodes to leave after their launcher was killed
_WINDOW = 1.2  # s for nodes to respond, and between the two samples for rates
_RECORDER = Codec(
    RecorderReport,
    msg.RecorderStatus,
    of_value=['rate', 'disk_left'],
    of_message=['files', 'topics', 'losses', 'cpu_seconds', 'memory'],
)
_STATES = {
    msg.NodeStatus.STATE_STARTING: 'starting',
    msg.NodeStatus.STATE_READY: 'ready',
    msg.NodeStatus.STATE_PAUSED: 'paused',
    msg.NodeStatus.STATE_STOPPING: 'stopping',
}


def probe_graph(namespace: str) -> GraphReport:
    """Inspect the nodes of a namespace in this ROS_DOMAIN_ID; takes about two seconds."""
    with _listener(namespace, 'status') as node:
        return _Probe(namespace, node).report()


def check_free(namespace: str, names: Collection[str]) -> None:
    """
    Check that the nodes of a launch are not already on the graph.

    Since a game may have any name, launching a game requires that no other game is present.

    Waits until every process of this ROS_DOMAIN_ID on this machine is discovered and, if the graph
    spans machines, briefly for processes of other machines.

    :param names: node names, without the namespace.
    :raises OccupiedError: some nodes are present and do not leave in time.
    """
    prepare_discovery()
    if on_loopback() and not _participants_here():
        return
    wanted = {f'{namespace.rstrip("/")}/{name}' for name in names}
    plays = not {'game', 'world'}.isdisjoint(names)
    with _listener(namespace, 'newcomer') as node:
        began = now = time.monotonic()
        earliest = began if on_loopback() else began + _REMOTE
        complete = leaving = 0.0  # s, start of these conditions; 0: not met
        while True:
            found = node_names(node)
            games = [*map(signer, announced_ids(node, 'game'))] if plays else []
            present = sorted({*wanted.intersection(found), *games})
            leaving = (leaving or now) if present else 0.0
            if present and now > leaving + _LEAVING:
                raise OccupiedError(
                    f'{", ".join(present)} already runs in ROS_DOMAIN_ID {domain_id()}, namespace '
                    f'{namespace}, not started by a launch on this machine; stop it, or choose '
                    'another --namespace or ROS_DOMAIN_ID'
                )
            all_found = len(found) >= _n_processes(node) >= len(_participants_here())
            complete = (complete or now) if all_found else 0.0
            done = 0.0 < complete < now - _SETTLING or now > began + _LONGEST
            if done and now > earliest and not present:
                return
            time.sleep(_LOOK_PERIOD)
            now = time.monotonic()


def _participants_here() -> set[str]:
    """
    Return the local discovery addresses of processes in this ROS_DOMAIN_ID.

    The ports follow from the RTPS specification: 250 ports per domain, starting at 7400; from
    offset 10, two ports per process.
    """
    first, found = 7400 + 250 * domain_id(), set[str]()
    for table in ('udp', 'udp6'):
        try:
            lines = Path('/proc/net', table).read_text('ascii').splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            address = line.split()[1]
            port = int(address.rpartition(':')[2], 16) - first
            if 10 <= port < 250 and port % 2 == 0:
                found.add(address)
    return found


def _n_processes(node: Node) -> int:
    """Return the number of processes a node has discovered, including its own."""
    found = node.get_publishers_info_by_topic('ros_discovery_info', no_mangle=True)
    return len({bytes(each.endpoint_gid[:12]) for each in found})


@contextmanager
def _listener(namespace: str, name: str) -> Iterator[Node]:
    """Join the graph with a node that does not publish."""
    context = Context()
    start_ros(context=context)
    try:
        with starting_ros():
            node = Node(
                name,
                namespace=namespace,
                context=context,
                enable_rosout=False,
                start_parameter_services=False,
            )
        yield node
        node.destroy_node()
    finally:
        context.try_shutdown()


def _processes_of_launch(namespace: str) -> dict[str, psutil.Process | None]:
    """
    Return the processes of launches in a namespace on this machine.

    :return: processes by node name; None: the process has ended and will be restarted.
    """
    holders = {name: who[0] for name in MODULES if (who := holder(namespace, name)) is not None}
    found: dict[str, psutil.Process | None] = dict.fromkeys(holders)
    for number in sorted(set(holders.values())):
        with suppress(psutil.Error, ValueError):  # it has just ended, or is in another container
            launcher = psutil.Process(number)
            for process in launcher.children(recursive=True):
                with suppress(psutil.Error):
                    words = ' '.join(process.cmdline()).rstrip()  # a fork has one nonempty word
                    name = Path(words.partition(f'{PARAMETERS} ')[2]).stem
                    if name in MODULES:  # "ros2 launch" uses other file names
                        found |= {name: process, CONDUCTOR: launcher}
    return found


class _Probe:
    """A listener that also measures how long each node takes to respond to a request."""

    def __init__(self, namespace: str, node: Node) -> None:
        self._namespace, self._node = namespace, node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._peers = Peers(node)
        self._newest: dict[str, Any] = {}  # latest message by topic
        self._games: set[str] = set()  # publisher ids
        self._sent: dict[str, float] = {}  # s, time of the request by node
        self._answers: dict[str, float] = {}  # s, response time by node
        self._processes = _processes_of_launch(namespace)
        for kind, topic in (
            (msg.RecorderStatus, 'recorder_status'),
            (msg.GameState, 'current_state'),
            (msg.DomainInfo, 'domain_info'),
            (msg.ControlState, 'control'),
        ):
            self._node.create_subscription(kind, topic, partial(self._keep, topic), CURRENT)

    def report(self) -> GraphReport:
        """Discover the nodes, send requests, and sample the topics twice."""
        try:
            return self._report()
        finally:
            self._executor.shutdown()

    def _report(self) -> GraphReport:
        launched, statuses = set(self._processes), self._peers.statuses
        self._serve(lambda: bool(launched) and statuses.keys() >= launched, _SEARCH)
        announced = (signer(each).rpartition('/')[2] for each in announced_ids(self._node))
        nodes = sorted({*statuses, *announced, *launched})
        began, before = time.monotonic(), dict(self._newest)
        clients = {
            name: self._node.create_client(GetParameters, f'{name}/get_parameters')
            for name in nodes
            if name != CONDUCTOR
        }
        self._serve(lambda: self._ask(clients), _WINDOW if nodes else 0.0)
        self._serve(lambda: False, _WINDOW - (time.monotonic() - began) if nodes else 0.0)
        passed, newest = time.monotonic() - began, self._newest

        def rate(topic: str, count: str) -> float | None:
            first, last = before.get(topic), newest.get(topic)
            if first is None or last is None or first.publisher_id != last.publisher_id:
                return None
            return max(0, int(getattr(last, count)) - int(getattr(first, count))) / passed

        state = newest.get('current_state', msg.GameState())
        control = newest.get('control', msg.ControlState())
        return GraphReport(
            domain_id=domain_id(),
            namespace=self._namespace,
            nodes=[self._node_report(name) for name in nodes],
            recorder=self._recorder(rate('recorder_status', 'messages')),
            game=newest.get('domain_info', msg.DomainInfo()).domain,
            episode=state.episode,
            step=state.step,
            steps_per_second=(
                (rate('current_state', 'sequence') or 0.0) if 'current_state' in newest else None
            ),
            holder='locked' if control.holder == control.HOLDER_LOCKED else control.holder_id,
            # A killed game stays on the graph for a while but does not publish.
            games=[each for each in announced_ids(self._node, 'game') if each in self._games],
        )

    def _serve(self, done: Callable[[], bool], seconds: float) -> None:
        end = time.monotonic() + seconds
        while not done() and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(min(left, 0.05))

    def _ask(self, clients: dict[str, Client]) -> bool:
        """Send a request to each node found so far; return whether all have responded."""
        for name, client in clients.items():
            if name not in self._sent and client.service_is_ready():
                self._sent[name] = time.monotonic()
                future = client.call_async(GetParameters.Request(names=[]))
                future.add_done_callback(partial(self._answered, name))
        return len(self._answers) == len(clients)

    def _answered(self, name: str, done: Future) -> None:
        self._answers[name] = time.monotonic() - self._sent[name]

    def _keep(self, topic: str, message: Any) -> None:
        """Keep the latest message from the permitted publisher of a topic."""
        sender = sender_of(self._node.resolve_topic_name(topic), self._namespace)
        publisher_id = message.publisher_id
        games = announced_ids(self._node, 'game')
        if (signer(publisher_id) == sender) if sender else (publisher_id in games):
            self._newest[topic] = message
            if topic == 'domain_info':
                self._games.add(publisher_id)

    def _node_report(self, name: str) -> NodeReport:
        status = self._peers.statuses.get(name, msg.NodeStatus())
        process = self._processes.get(name)
        found: dict[str, Any] = {}
        if process is not None:
            try:
                with process.oneshot():
                    found = {
                        'pid': process.pid,
                        'stopped': process.status() == psutil.STATUS_STOPPED,
                        'memory': process.memory_info().rss,
                        'threads': process.num_threads(),
                    }
            except psutil.Error:  # it has just ended
                pass
        return NodeReport(
            name,
            _STATES.get(status.state, ''),
            self._answers.get(name),
            name != CONDUCTOR,  # the conductor responds only while it waits
            status.text,
            status.restarts,
            **found,
        )

    def _recorder(self, rate: float | None) -> RecorderReport | None:
        status = self._newest.get('recorder_status')
        if status is None or RECORDER not in self._peers.statuses:
            return None
        try:
            left = shutil.disk_usage(status.path).free
        except OSError:  # the recorder runs on another machine
            left = None
        return _RECORDER.decode(status, rate=rate, disk_left=left)
