"""Subscriptions that are polled instead of served by an executor."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import LATCHED
from rclpy.callback_groups import CallbackGroup

T = TypeVar('T')
V = TypeVar('V')


class Polled(CallbackGroup):
    """
    A callback group that hides its subscriptions from executors, so that they can be polled.

    An executor takes one message at a time and checks every entity for each message.
    """

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        """No-op."""


class PolledValue(Generic[T, V]):
    """The newest value of a latched topic that changes more often than it is read."""

    def __init__(self, node: NodeBase, kind: type[T], topic: str, read: Callable[[T], V]) -> None:
        """
        Subscribe.

        :param read: function as in ``NodeBase.subscribe``.
        """
        self._node, self._kind, self._topic, self._read = node, kind, topic, read
        self._subscription = node.create_subscription(
            kind, topic, never_called, LATCHED, callback_group=Polled()
        )

    def take(self) -> V | None:
        """Return the newest value since the last call; None if there is no new value."""
        handle = self._subscription.handle
        with handle:
            taken = handle.take_message(self._kind, False)
        return self._node.accepted(self._topic, self._read, taken[0]) if taken else None


def never_called(message: Any) -> None:
    """No-op: rclpy requires a callback."""
