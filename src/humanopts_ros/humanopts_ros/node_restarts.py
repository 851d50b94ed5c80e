"""Detects restarts of nodes: requests from before a restart are never answered."""

from collections import Counter
from collections.abc import Callable

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.graph import game_ids
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import signer


class NodeRestarts:
    """
    Counts restarts of the nodes of a namespace, by their statuses.

    :ivar counts: by name without the namespace.
    """

    def __init__(
        self, node: NodeBase, on_restart: Callable[[str], object] = lambda name: None
    ) -> None:
        """
        Subscribe to ``node_status``.

        :param on_restart: called with the name of a node that was started again, and once more
            when it is ready, for what was asked of it before that may have reached nobody.
        """
        self.counts: Counter[str] = Counter()
        self._node, self._prefix = node, node.full_name('')
        self._on_restart = on_restart
        self._lives: dict[str, str] = {}  # publisher_id by name
        self._starting: set[str] = set()  # nodes that were started again, and are not ready yet
        node.create_subscription(NodeStatus, 'node_status', self._on_status, CURRENT)

    def _on_status(self, status: NodeStatus) -> None:
        """Detect a restart; ignore statuses with a foreign publisher_id."""
        path = signer(status.publisher_id)
        if path != status.node or not path.startswith(self._prefix):
            return
        name = path.removeprefix(self._prefix)
        known = self._lives.setdefault(name, status.publisher_id)
        again = known != status.publisher_id and status.state != status.STATE_STOPPING
        games = [each for each in game_ids(self._node) if signer(each) == path] if again else []
        if games and status.publisher_id not in games:  # forged, or sent before it was listed
            return
        ready = status.state == status.STATE_READY
        if again or (ready and name in self._starting):
            self._lives[name] = status.publisher_id
            (self._starting.discard if ready else self._starting.add)(name)
            self.counts[name] += 1
            self._on_restart(name)
