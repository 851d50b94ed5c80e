"""Publishers that number and stamp their messages."""

from collections.abc import Callable
import time
from typing import Any, Generic, Protocol, TYPE_CHECKING, TypeVar

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

if TYPE_CHECKING:  # 30 modules, for a type alone
    from std_msgs.msg import Header


class Stamped(Protocol):
    """A message with the three fields that every message of humanopts begins with."""

    header: 'Header'
    publisher_id: str
    sequence: int


M = TypeVar('M', bound=Stamped)
_ACKNOWLEDGED_PERIOD = 0.002  # s between looks whether all that was sent was taken


class PublishError(RuntimeError):
    """A message could not be sent; the text names the topic and the cause."""


class StampedPublisher(Generic[M]):
    """
    Publishes on one topic, filling in header, publisher_id and sequence.

    :ivar sequence: of the last message that was sent; 0: none was sent.
    :ivar newest: that message; None: none was sent.
    """

    def __init__(
        self,
        node: Node,
        publisher_id: str,
        kind: type[M],
        topic: str,
        qos: QoSProfile,
        on_matched: Callable[[Any], None] | None = None,
    ) -> None:
        self._node, self._publisher_id = node, publisher_id
        events = PublisherEventCallbacks(matched=on_matched)
        self._publisher: Publisher = node.create_publisher(
            kind, topic, qos, event_callbacks=events
        )
        self.sequence = 0
        self.newest: M | None = None

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        return str(self._publisher.topic_name)

    def publish(self, message: M) -> None:
        """
        Send the message.

        :raises PublishError: the middleware refused it, as it does when a reader that keeps
            everything has stopped reading.
        """
        message.publisher_id = self._publisher_id
        message.sequence = self.sequence + 1
        try:
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(message)
        except Exception as error:
            cause, names = without_source(error), ', '.join(sorted(set(self.readers()))) or 'none'
            raise PublishError(
                f'cannot publish on {self.topic}: {cause}; has a reader stopped? They are: {names}'
            ) from error
        self.sequence += 1
        self.newest = message

    def readers(self) -> list[str]:
        """Return the name of the node of each subscription of the topic."""
        found = self._node.get_subscriptions_info_by_topic(self.topic)
        return [str(reader.node_name) for reader in found]

    def is_matched(self) -> bool:
        """Return whether every subscription of the topic would get a message."""
        return bool(self._publisher.get_subscription_count() >= len(self.readers()))

    def is_matched_by(self, node_name: str) -> bool:
        """Return whether a node's subscription is matched, so that a message would arrive."""
        return self.is_matched() and node_name in self.readers()

    def drain(self, seconds: float) -> None:
        """Wait until the readers have received what was sent."""
        end = time.monotonic() + seconds  # a wait in the middleware ends by the time of day
        while not self._publisher.wait_for_all_acked(Duration()) and time.monotonic() < end:
            time.sleep(_ACKNOWLEDGED_PERIOD)


def without_source(error: Exception) -> str:
    """Return the text of an error without the places in the source of rcl."""
    return str(error).split(', at /')[0]
