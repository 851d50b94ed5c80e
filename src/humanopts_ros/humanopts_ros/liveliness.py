"""Detection of processes that drive a robot and are killed, stopped or disconnected."""

from collections.abc import Callable
from functools import partial
from typing import Any

from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import WATCH
from humanopts_ros.senders import id_topic, Role
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from std_msgs.msg import Empty


class Liveliness:
    """
    Watches nodes that drive a robot, through their ``LIVELY`` announcements.

    Other nodes cannot be watched.

    The middleware's count of live nodes is unreliable; only its changes are used. The middleware
    does not count a node that it discovers while creating the subscription, or already knows from
    another one. Its count later becomes negative (``LivelinessManager`` of Fast DDS 2.14).

    :ivar lost: publisher ids of the watched nodes that are lost and have not come back.
    """

    def __init__(
        self, node: NodeBase, role: Role, on_lost: Callable[[str], object] = lambda _: None
    ) -> None:
        """
        Start without watched nodes.

        :param role: role of the nodes to watch.
        :param on_lost: callback invoked with the publisher id of a node that is no longer alive.
        """
        self._node, self._role, self._on_lost = node, role, node.guard.guarded(on_lost)
        self.lost: set[str] = set()
        self._watched: dict[str, Subscription] = {}  # by publisher id

    def watch(self, *publisher_ids: str) -> None:
        """Also watch these nodes; ignore empty ids, and drop nodes that have left the graph."""
        for gone in self._watched.keys() - {*publisher_ids}:
            if not self._node.count_publishers(id_topic(gone, self._role)):
                self._node.destroy_subscription(self._watched.pop(gone))
                self.lost.discard(gone)
        for publisher_id in publisher_ids:
            if '#' in publisher_id and publisher_id not in self._watched:
                self._watched[publisher_id] = self._node.create_subscription(
                    Empty,
                    id_topic(publisher_id, self._role),
                    lambda _: None,
                    WATCH,
                    event_callbacks=SubscriptionEventCallbacks(
                        liveliness=partial(self._on_change, publisher_id),
                        use_default_callbacks=False,
                    ),
                )

    def _on_change(self, publisher_id: str, status: Any) -> None:
        if status.alive_count_change > 0:
            self.lost.discard(publisher_id)
        elif status.alive_count_change < 0 or status.not_alive_count_change > 0:
            self.lost.add(publisher_id)
            self._on_lost(publisher_id)
