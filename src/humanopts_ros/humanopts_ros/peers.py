"""The nodes of a namespace: who is there, under which id, and in which state."""

from collections import Counter
from collections.abc import Callable

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import Role, signer, stated_id
from rclpy.node import Node

_UNKNOWN = '_UNKNOWN_'  # in the name of a node of which only a topic or service is found yet


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
    The newest status of each node of a namespace, and the number of its restarts.

    A status counts if the graph states its publisher_id. A process announces its endpoints in the
    order of their creation, so a genuine id is stated before its first status arrives. A process
    that was replaced by another one of the same name no longer counts.

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
        self._starting: set[str] = set()  # restarted nodes that are not ready yet
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
