"""Looks at a graph from outside, before a launch and for ``status``: it publishes nothing."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
import shutil
import time
from typing import Any

from humanopts_interfaces import msg
from humanopts_ros.codec import Codec
from humanopts_ros.graph import game_ids
from humanopts_ros.node_base import start_ros, starting_ros
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import sender_of, signer
from humanopts_ros.workarounds import on_loopback, prepare_discovery
from humanopts_teach.launching import MODULES, OccupiedError
from humanopts_teach.launching.launcher import CONDUCTOR, PARAMETERS
from humanopts_teach.launching.place import domain_id, holder
from humanopts_teach.launching.processes import RECORDER
from humanopts_teach.launching.status import (
    GraphReport,
    NodeReport,
    RecorderReport,
    restarts_in,
)
import psutil
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

_SEARCH = 1.5  # s in which nodes are found; less where all of a launch on this machine are
_LOOK_PERIOD = 0.02  # s between looks for nodes
_SETTLING = 0.3  # s from when every process here is found until its nodes surely are
_REMOTE = 1.5  # s in which processes of other machines are found
_LONGEST = 5.0  # s, where a process here is never found, as one that is stopped
_LEAVING = 3.0  # s for nodes to leave whose launcher was killed
_WINDOW = 1.2  # s for them to answer, and between the two looks from which rates are
_MAX_PUBLISHERS = 100  # of a topic, of which the newest message is kept
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
    """Look at the nodes of a namespace in this ROS_DOMAIN_ID; takes about two seconds."""
    with _listener(namespace, 'status') as node:
        return _Probe(namespace, node).report()


def check_free(namespace: str, names: Iterable[str]) -> None:
    """
    Check that nodes of a launch are not on the graph, whoever has started them.

    The game may have any name: where one is to be started, no node may serve another there.

    It waits until every process of this ROS_DOMAIN_ID on this machine is found, and a moment for
    those of other machines where the graph spans some.

    :param names: of the nodes, without the namespace.
    :raises OccupiedError: some are there, and do not leave in a while.
    """
    prepare_discovery()
    if on_loopback() and not _participants_here():
        return
    wanted = {f'{namespace.rstrip("/")}/{name}' for name in names}
    game = f'{namespace.rstrip("/")}/game'
    with _listener(namespace, 'newcomer') as node:
        began = now = time.monotonic()
        earliest = began if on_loopback() else began + _REMOTE
        complete = leaving = 0.0  # since when all are found, and some are in the way; 0: not now
        while True:
            spaces = node.get_node_names_and_namespaces()
            found = {f'{space.rstrip("/")}/{name}' for name, space in spaces}
            games = map(signer, game_ids(node)) if game in wanted else []
            there = sorted({*(wanted & found), *games})
            leaving = (leaving or now) if there else 0.0
            if there and now > leaving + _LEAVING:
                raise OccupiedError(
                    f'{", ".join(there)} runs already in ROS_DOMAIN_ID {domain_id()}, namespace '
                    f'{namespace}, started by no launch of this machine; stop it, or choose '
                    'another --namespace or ROS_DOMAIN_ID'
                )
            all_found = len(spaces) >= _found(node) >= len(_participants_here())
            complete = (complete or now) if all_found else 0.0
            done = 0.0 < complete < now - _SETTLING or now > began + _LONGEST
            if done and now > earliest and not there:
                return
            time.sleep(_LOOK_PERIOD)
            now = time.monotonic()


def _participants_here() -> set[str]:
    """
    Return the addresses on this machine where processes of this ROS_DOMAIN_ID hear of others.

    The ports follow from the RTPS specification: 250 for each domain from 7400 on, and of those,
    from the tenth on, two for each process.
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


def _found(node: Node) -> int:
    """Return how many processes a node has found, its own among them."""
    found = node.get_publishers_info_by_topic('ros_discovery_info', no_mangle=True)
    return len({bytes(each.endpoint_gid[:12]) for each in found})


@contextmanager
def _listener(namespace: str, name: str) -> Iterator[Node]:
    """Join the graph with a node that publishes nothing."""
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
    Return the processes of the launches in a namespace on this machine.

    :return: by name of the node; None: it has ended and is to be started again.
    """
    holders = {name: who[0] for name in MODULES if (who := holder(namespace, name)) is not None}
    found: dict[str, psutil.Process | None] = dict.fromkeys(holders)
    for number in sorted(set(holders.values())):
        with suppress(psutil.Error, ValueError):  # it ends just now, or is in another container
            launcher = psutil.Process(number)
            for process in launcher.children(recursive=True):
                with suppress(psutil.Error):
                    words = ' '.join(process.cmdline()).rstrip()  # of a fork: one, and empty ones
                    name = Path(words.partition(f'{PARAMETERS} ')[2]).stem
                    if name in MODULES:  # "ros2 launch" names its files otherwise
                        found |= {name: process, CONDUCTOR: launcher}
    return found


class _Probe:
    """A node that listens, asks every other node for a parameter, and takes the time."""

    def __init__(self, namespace: str, node: Node) -> None:
        self._namespace, self._node = namespace, node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._statuses: dict[str, msg.NodeStatus] = {}  # the newest of each node
        # The newest message by topic and publisher.
        self._newest: defaultdict[str, dict[str, Any]] = defaultdict(dict)
        self._told: dict[str, str] = {}  # by each conductor: there is one for each part of a graph
        self._sent: dict[str, float] = {}  # when each node was asked, s
        self._answers: dict[str, float] = {}  # s, by node
        self._processes: dict[str, psutil.Process | None] = {}
        self._node.create_subscription(msg.NodeStatus, 'node_status', self._keep_status, CURRENT)
        for kind, topic in (
            (msg.RecorderStatus, 'recorder_status'),
            (msg.GameState, 'current_state'),
            (msg.DomainInfo, 'domain_info'),
            (msg.ControlState, 'control'),
        ):
            self._node.create_subscription(kind, topic, partial(self._keep, topic), CURRENT)

    def report(self) -> GraphReport:
        """Find the nodes, ask them, and look twice."""
        try:
            return self._report()
        finally:
            self._executor.shutdown()

    def _report(self) -> GraphReport:
        self._processes = _processes_of_launch(self._namespace)
        there = set(self._processes)
        self._serve(lambda: bool(there) and self._statuses.keys() >= there, _SEARCH)
        found = self._node.get_publishers_info_by_topic('node_status')
        publish = (str(each.node_name) for each in found if '_NODE' not in each.node_name)
        nodes = sorted({*self._statuses, *publish, *there})
        began, before = time.monotonic(), self._taken()
        asked = {
            name: self._node.create_client(GetParameters, f'{name}/get_parameters')
            for name in nodes
            if name != CONDUCTOR
        }
        self._serve(lambda: self._ask(asked), _WINDOW if nodes else 0.0)
        self._serve(lambda: False, _WINDOW - (time.monotonic() - began) if nodes else 0.0)
        passed, newest = time.monotonic() - began, self._taken()

        def rate(topic: str, count: Callable[[Any], int]) -> float | None:
            first, last = before.get(topic), newest.get(topic)
            if first is None or last is None or first.publisher_id != last.publisher_id:
                return None
            return max(0, count(last) - count(first)) / passed

        restarts = sum(map(restarts_in, self._told.values()), Counter[str]())
        state, info = newest.get('current_state'), newest.get('domain_info')
        control = newest.get('control')
        steps = rate('current_state', lambda message: int(message.sequence))
        return GraphReport(
            domain_id=domain_id(),
            namespace=self._namespace,
            nodes=[self._node_report(name, restarts[name]) for name in nodes],
            recorder=self._recorder(
                newest.get('recorder_status') if RECORDER in self._statuses else None,
                rate('recorder_status', lambda status: int(status.messages)),
            ),
            game=info.domain if info is not None else '',
            episode=state.episode if state is not None else 0,
            step=state.step if state is not None else 0,
            steps_per_second=None if state is None else steps or 0.0,
            holder=control.holder_id if control is not None else '',
            # One that was killed stays on the graph for a while, but sends nothing.
            games=[each for each in game_ids(self._node) if each in self._newest['domain_info']],
        )

    def _serve(self, done: Callable[[], bool], seconds: float) -> None:
        end = time.monotonic() + seconds
        while not done() and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(min(left, 0.05))

    def _ask(self, clients: dict[str, Client]) -> bool:
        """Ask the nodes that are found by now for a parameter; return whether all answered."""
        for name, client in clients.items():
            if name not in self._sent and client.service_is_ready():
                self._sent[name] = time.monotonic()
                future = client.call_async(GetParameters.Request(names=[]))
                future.add_done_callback(partial(self._answered, name))
        return len(self._answers) == len(clients)

    def _answered(self, name: str, done: Future) -> None:
        self._answers[name] = time.monotonic() - self._sent[name]

    def _keep(self, topic: str, message: Any) -> None:
        """Keep the newest message of each publisher."""
        newest = self._newest[topic]
        if len(newest) < _MAX_PUBLISHERS or message.publisher_id in newest:
            newest.pop(message.publisher_id, None)
            newest[message.publisher_id] = message

    def _taken(self) -> dict[str, Any]:
        """Return the newest message by topic, of the nodes that may publish there."""
        found, games = {}, game_ids(self._node)
        for topic, newest in self._newest.items():
            owner = sender_of(self._node.resolve_topic_name(topic), self._namespace)
            for publisher_id, message in newest.items():
                if (signer(publisher_id) == owner) if owner else (publisher_id in games):
                    found[topic] = message
        return found

    def _keep_status(self, status: msg.NodeStatus) -> None:
        if signer(status.publisher_id) != status.node:
            return
        name = status.node.rpartition('/')[2]
        if name == CONDUCTOR:
            self._told[status.publisher_id] = status.text
        known = self._statuses.get(name)
        same = known is None or status.publisher_id == known.publisher_id
        if same or status.state != status.STATE_STOPPING:  # another process has the name now
            self._statuses[name] = status

    def _status(self, name: str) -> msg.NodeStatus:
        """Return the newest status of a node; an empty one: it has published none."""
        return self._statuses.get(name, msg.NodeStatus())

    def _node_report(self, name: str, restarts: int) -> NodeReport:
        status, process = self._status(name), self._processes.get(name)
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
            except psutil.Error:  # it ended just now
                pass
        return NodeReport(
            name,
            _STATES.get(status.state, ''),
            self._answers.get(name),
            name != CONDUCTOR,  # it serves the graph only while it waits
            status.text,
            restarts,
            **found,
        )

    def _recorder(
        self, status: msg.RecorderStatus | None, rate: float | None
    ) -> RecorderReport | None:
        if status is None:
            return None
        try:
            left = shutil.disk_usage(status.path).free
        except OSError:  # it records on another machine
            left = None
        return _RECORDER.decode(status, rate=rate, disk_left=left)
