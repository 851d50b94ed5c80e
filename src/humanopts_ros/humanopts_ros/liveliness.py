"""Whether processes that drive a robot are alive: killed, stopped and cut off ones are noticed."""

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
    Watches the announcements of nodes that drive, which have the QoS ``LIVELY``.

    Other nodes cannot be watched: nothing is known of them.

    The totals of the middleware do not tell who is alive, only their changes do: it misses that a
    node is alive if it hears of it while it creates the subscription, or knows it already from
    another one (``LivelinessManager`` of Fast DDS 2.14), and counts below 0 from then on.

    :ivar lost: publisher ids of the watched nodes that were lost, and did not come back.
    """

    def __init__(
        self, node: NodeBase, role: Role, on_lost: Callable[[str], object] = lambda _: None
    ) -> None:
        """
        Watch no one yet.

        :param role: of the nodes to watch.
        :param on_lost: called with the publisher id of a node that is not alive any more.
        """
        self._node, self._role, self._on_lost = node, role, node.guard.guarded(on_lost)
        self.lost: set[str] = set()
        self._watched: dict[str, Subscription] = {}  # by publisher id

    def watch(self, *publisher_ids: str) -> None:
        """Watch these nodes, beside those watched before; empty ids are ignored."""
        for gone in self._watched.keys() - {*publisher_ids}:
            if not self._node.count_publishers(id_topic(gone, self._role)):  # it left the graph
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
