"""The nodes of a namespace: who is there, under which id, and in which state."""

from collections import Counter
from collections.abc import Callable

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import Role, signer, stated_id
from rclpy.node import Node

_UNKNOWN = '_UNKNOWN_'  # in the name of a node of which only a topic or service is found yet
_LOOK_PERIOD = 0.1  # s between looks at the graph while statuses wait to be stated there
_LOOKS = 50
_MAX_UNSTATED = 100  # ids with a status that the graph does not state


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes on the graph; any process may use any name."""
    found = node.get_node_names_and_namespaces()
    return [f'{namespace.rstrip("/")}/{name}' for name, namespace in found]


def publishers_of(node: Node, topic: str) -> list[str]:
    """Return the full name of the node of each publisher of a topic, where it is known."""
    found = node.get_publishers_info_by_topic(topic)
    names = (f'{each.node_namespace.rstrip("/")}/{each.node_name}' for each in found)
    return [name for name in names if _UNKNOWN not in name]


def stated_ids(node: Node, *roles: Role) -> list[str]:
    """
    Return the publisher ids that the nodes in the namespace of a node state in the graph.

    :param roles: of those nodes; none: any.
    """
    namespace = node.get_namespace()
    return sorted(
        publisher_id
        for topic, _ in node.get_topic_names_and_types()
        for role in roles or ('node', 'game')
        if (publisher_id := stated_id(topic, namespace, role))
        and node.count_publishers(topic)  # a mere subscriber states nothing
    )


class Peers:
    """
    The newest status of each node of a namespace, and how often each was started again.

    A status counts once the graph states its publisher_id. A process that another one of the same
    name has replaced counts no more.

    :ivar statuses: by name, without the namespace.
    :ivar restarts: by name; a restart counts when the node begins, and when it is ready.
    :ivar on_restart: each is called with the name whenever a restart counts, the second time
        because requests sent before the node was ready may be lost.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe to ``node_status``."""
        self.statuses: dict[str, NodeStatus] = {}
        self.restarts: Counter[str] = Counter()
        self.on_restart: list[Callable[[str], object]] = []
        self._node = node
        self._expected: dict[str, str] = {}  # the only publisher_id that counts, by name
        self._replaced: set[str] = set()  # publisher ids
        self._starting: set[str] = set()  # nodes that were started again, and are not ready yet
        self._unstated: dict[str, NodeStatus] = {}  # the newest by publisher_id
        self._looks = 0  # that are left before these are dropped
        self._timer = node.create_timer(_LOOK_PERIOD, self._look, autostart=False)
        node.create_subscription(NodeStatus, 'node_status', self._on_status, CURRENT)

    def state(self, name: str) -> int:
        """Return the state of a node; 0: it has published none."""
        return int(self.statuses[name].state) if name in self.statuses else 0

    def expect(self, publisher_id: str) -> None:
        """Let a process that is about to start be the only one that counts under its name."""
        name = signer(publisher_id).rpartition('/')[2]
        self.forget(self._expected.get(name, ''))
        self._expected[name] = publisher_id

    def forget(self, publisher_id: str) -> None:
        """Ignore a process that has ended."""
        self._replaced.add(publisher_id)
        name = signer(publisher_id).rpartition('/')[2]
        if name in self.statuses and self.statuses[name].publisher_id == publisher_id:
            del self.statuses[name]

    def _on_status(self, status: NodeStatus) -> None:
        path, publisher_id = status.node, status.publisher_id
        name = path.rpartition('/')[2]
        here = f'{self._node.get_namespace().rstrip("/")}/{name}'
        expected = self._expected.get(name, publisher_id) == publisher_id
        if not signer(publisher_id) == path == here or not expected:
            return
        if publisher_id in self._replaced:
            return
        known = self.statuses.get(name, status)
        again = known.publisher_id != publisher_id
        if (again or name not in self.statuses) and publisher_id not in stated_ids(self._node):
            if len(self._unstated) < _MAX_UNSTATED:
                self._unstated[publisher_id], self._looks = status, _LOOKS
                self._timer.reset()
            return
        if again:
            if status.state == status.STATE_STOPPING:
                return
            self._replaced.add(known.publisher_id)
            self._starting.add(name)
        self.statuses[name] = status
        ready = status.state == status.STATE_READY and name in self._starting
        if ready:
            self._starting.remove(name)
        if again or ready:
            self.restarts[name] += 1
            for call in self.on_restart:
                call(name)

    def _look(self) -> None:
        """Take the statuses whose ids are stated by now."""
        stated, self._looks = stated_ids(self._node), self._looks - 1
        for publisher_id in self._unstated.keys() & stated:
            self._on_status(self._unstated.pop(publisher_id))
        if not self._unstated or self._looks <= 0:
            self._unstated.clear()
            self._timer.cancel()
