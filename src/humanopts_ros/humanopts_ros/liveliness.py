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

    :ivar alive: publisher ids of the watched nodes that are known to be alive.
    """

    def __init__(
        self, node: NodeBase, role: Role, on_lost: Callable[[str], object] = lambda _: None
    ) -> None:
        """
        Watch no one yet.

        :param role: of the nodes to watch.
        :param on_lost: called with the publisher id of a watched node that is not alive any more.
        """
        self._node, self._role, self._on_lost = node, role, node.guard.guarded(on_lost)
        self.alive: set[str] = set()
        self._watched: dict[str, Subscription] = {}  # by publisher id

    def watch(self, *publisher_ids: str) -> None:
        """Watch these nodes, and no others; empty ids are ignored."""
        for gone in self._watched.keys() - {*publisher_ids}:
            self._node.destroy_subscription(self._watched.pop(gone))
            self.alive.discard(gone)
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
        if status.alive_count:
            self.alive.add(publisher_id)
        elif publisher_id in self.alive:
            self.alive.discard(publisher_id)
            self._on_lost(publisher_id)
