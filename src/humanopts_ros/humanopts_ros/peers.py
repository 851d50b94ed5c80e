"""The nodes of a namespace: their names, publisher ids and states."""

from collections import Counter
from collections.abc import Callable

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import announced_id, Role, signer
from rclpy.node import Node

_UNKNOWN = '_UNKNOWN_'  # part of the name of a node known only by its endpoints


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes on the graph; any process may use any name."""
    found = node.get_node_names_and_namespaces()
    return [f'{namespace.rstrip("/")}/{name}' for name, namespace in found]


def publishers_of(node: Node, topic: str) -> list[str]:
    """Return the full node name of each publisher of a topic, if known."""
    found = node.get_publishers_info_by_topic(topic)
    names = (f'{each.node_namespace.rstrip("/")}/{each.node_name}' for each in found)
    return [name for name in names if _UNKNOWN not in name]


def announced_ids(node: Node, *roles: Role) -> list[str]:
    """
    Return the publisher ids announced in the graph by the nodes in a node's namespace.

    :param roles: roles of these nodes; empty: any.
    """
    namespace = node.get_namespace()
    return sorted(
        publisher_id
        for topic, _ in node.get_topic_names_and_types()
        for role in roles or ('node', 'game')
        if (publisher_id := announced_id(topic, namespace, role))
        and node.count_publishers(topic)  # subscribers do not announce an id
    )


class GameIdentity:
    """
    The publisher id of the game in a node's namespace; the game may have any node name.

    A restarted game replaces the current one immediately; a game with another name does so only
    after the current one has left the graph. Only announced ids are accepted, as in ``Peers``.

    :ivar publisher_id: id of the current game; empty if not found yet.
    """

    def __init__(self, node: Node) -> None:
        self.publisher_id = ''
        self._node = node

    def accepts(self, publisher_id: str) -> bool:
        """Return whether a message comes from the current game or its replacement."""
        if publisher_id and publisher_id == self.publisher_id:
            return True
        games = announced_ids(self._node, 'game')
        again = signer(publisher_id) == signer(self.publisher_id)
        if publisher_id not in games or not (again or self.publisher_id not in games):
            return False
        self.publisher_id = publisher_id
        return True


class Peers:
    """
    The latest status and the restart count of each node in a namespace.

    A status is accepted if its publisher_id is announced in the graph. A process announces its
    endpoints in order of creation, so its id is announced before its first status arrives. A
    process that was replaced by another one is ignored.

    :ivar statuses: latest status by node name, without the namespace.
    :ivar restarts: restart count by node name; incremented when the node restarts and again when
        it is ready, since requests sent in between may be lost.
    :ivar on_restart: callbacks invoked with the node name at each increment.
    :ivar starting: names of restarted nodes that are not ready yet.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe to ``node_status``."""
        self.statuses: dict[str, NodeStatus] = {}
        self.restarts: Counter[str] = Counter()
        self.on_restart: list[Callable[[str], object]] = []
        self._node = node
        self._expected: dict[str, str] = {}  # the only accepted publisher_id, by name
        self._replaced: set[str] = set()  # publisher ids
        self.starting: set[str] = set()
        node.create_subscription(NodeStatus, 'node_status', self._on_status, CURRENT)

    def state(self, name: str) -> int:
        """Return the state of a node; 0 if it has not published a status."""
        return int(self.statuses[name].state) if name in self.statuses else 0

    def expect(self, publisher_id: str) -> None:
        """Accept only this process under its node name; call this before it starts."""
        name = signer(publisher_id).rpartition('/')[2]
        if name in self._expected:
            self.forget(self._expected[name])
        self._expected[name] = publisher_id

    def forget(self, publisher_id: str) -> None:
        """Ignore a process that has ended; this counts as a restart."""
        if publisher_id in self._replaced:
            return
        name = signer(publisher_id).rpartition('/')[2]
        if name in self.statuses and self.statuses[name].publisher_id == publisher_id:
            del self.statuses[name]
        self._replaced.add(publisher_id)
        self.starting.add(name)
        self._count(name)

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
        if (again or name not in self.statuses) and publisher_id not in announced_ids(self._node):
            return
        if again:
            if status.state == status.STATE_STOPPING:
                return
            self._replaced.add(known.publisher_id)
            self.starting.add(name)
        self.statuses[name] = status
        ready = status.state == status.STATE_READY and name in self.starting
        if ready:
            self.starting.remove(name)
        if again or ready:
            self._count(name)

    def _count(self, name: str) -> None:
        self.restarts[name] += 1
        for call in self.on_restart:
            call(name)
