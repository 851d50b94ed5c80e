"""Publishers that stamp and number their messages."""

from collections.abc import Callable
import time
from typing import Any, Generic, Protocol, TYPE_CHECKING, TypeVar

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

if TYPE_CHECKING:  # avoids importing 30 modules for one type
    from std_msgs.msg import Header


class Stamped(Protocol):
    """A message with the three leading fields of every humanopts message."""

    header: 'Header'
    publisher_id: str
    sequence: int


M = TypeVar('M', bound=Stamped)
_ACKNOWLEDGED_PERIOD = 0.002  # s, polling period for acknowledgements


class PublishError(RuntimeError):
    """A message could not be sent; the error message names the topic and the cause."""


class StampedPublisher(Generic[M]):
    """
    Publishes on one topic, filling in header, publisher_id and sequence.

    :ivar sequence: sequence number of the last message sent; 0 if none.
    :ivar newest: last message sent; None if none.
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
        """The full name of the topic."""
        return str(self._publisher.topic_name)

    def publish(self, message: M) -> None:
        """
        Publish a message.

        :raises PublishError: the middleware rejected the message, for example because a KEEP_ALL
            reader has stalled.
        """
        message.publisher_id = self._publisher_id
        message.sequence = self.sequence + 1
        try:
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(message)
        except Exception as error:
            cause, names = without_source(error), ', '.join(sorted(set(self.readers()))) or 'none'
            raise PublishError(
                f'cannot publish on {self.topic}: {cause}; has a reader stopped? Readers: {names}'
            ) from error
        self.sequence += 1
        self.newest = message

    def readers(self) -> list[str]:
        """Return the node name of each subscription to the topic."""
        found = self._node.get_subscriptions_info_by_topic(self.topic)
        return [str(reader.node_name) for reader in found]

    def is_matched(self) -> bool:
        """Return whether all subscriptions to the topic are matched."""
        return bool(self._publisher.get_subscription_count() >= len(self.readers()))

    def is_matched_by(self, node_name: str) -> bool:
        """Return whether a node subscribes to the topic and all subscriptions are matched."""
        return self.is_matched() and node_name in self.readers()

    def drain(self, seconds: float) -> None:
        """Wait until the readers have acknowledged all messages, or time is up."""
        end = time.monotonic() + seconds  # waits in the middleware depend on the system time
        while not self._publisher.wait_for_all_acked(Duration()) and time.monotonic() < end:
            time.sleep(_ACKNOWLEDGED_PERIOD)


def without_source(error: Exception) -> str:
    """Return an error message without the source locations added by rcl."""
    return str(error).split(', at /')[0]
