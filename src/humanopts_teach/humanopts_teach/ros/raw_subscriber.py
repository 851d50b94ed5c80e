"""Reception of all messages of the graph as bytes, without an executor."""

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from operator import attrgetter
import time
from typing import Any, NamedTuple

from humanopts_ros.peers import announced_ids, publishers_of
from humanopts_ros.polled import never_called, Polled
from humanopts_ros.recording import INTERFACES, is_own, Selection, SHARED
from humanopts_ros.senders import signer
from humanopts_ros.workarounds import TimeOfDay
from humanopts_teach.bags.arrival_times import ArrivalTimes
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

_QOS = (
    *('history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan', 'liveliness'),
    *('liveliness_lease_duration', 'avoid_ros_namespace_conventions'),
)
_AT_ONCE = 2000  # maximum number of messages taken from a topic before the next topic


class Taken(NamedTuple):
    """A received message."""

    received: int  # ns since the epoch, from a steady clock
    sent: int  # ns since the epoch, from the sender's middleware
    topic: str
    data: bytes  # CDR


@dataclass
class TopicSubscription:
    """The subscription to one topic."""

    topic: str
    type: str
    kind: Any  # message class
    offers: list[dict[str, Any]]  # QoS of the publishers, in rosbag2's metadata format
    type_hash: str
    subscription: Subscription
    profile: QoSProfile  # requested profile
    publishers: int  # number of publishers when the QoS was last compared

    @property
    def latched(self) -> bool:
        """Whether every publisher offers its last message to late subscribers."""
        return bool(self.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


class RawSubscriber:
    """
    The subscriptions of a recorder.

    All queued messages are taken together, many times per second, at less than a twentieth of an
    executor's cost.

    :ivar times: arrival times.
    :ivar own_nodes: full names of the nodes that have announced their ids in the namespace.
    """

    def __init__(self, node: Node, selection: Selection) -> None:
        self.times = ArrivalTimes(TimeOfDay())
        self._node = node
        self._selection = selection
        self._group = Polled()
        self._subscriptions: dict[str, TopicSubscription] = {}
        self.own_nodes: set[str] = set()
        self._left: list[Taken] = []  # from replaced subscriptions
        self.unknown: dict[str, str] = {}  # type by topic, for topics that cannot be recorded
        self.complete = False  # whether all publishers to record were matched at the last check

    def discover(self) -> list[TopicSubscription]:
        """Subscribe to new topics with QoS compatible with their publishers; return them."""
        added: list[TopicSubscription] = []
        self.complete = True
        self.own_nodes.update(map(signer, announced_ids(self._node)))
        for topic, types in self._node.get_topic_names_and_types():
            kind = next((each for each in types if each.startswith(INTERFACES)), types[0])
            if topic in self.unknown or not self._wants(topic, kind):
                continue
            publishers = self._node.count_publishers(topic)
            if not publishers:
                continue
            known = self._subscriptions.get(topic)
            if known is None or known.publishers != publishers:
                offers = self._node.get_publishers_info_by_topic(topic)
                if offers and known is not None:
                    self._adapt(known, offers)
                elif offers and (known := self._subscribe(topic, kind, offers)) is not None:
                    added.append(known)
            if known is None or known.subscription.get_publisher_count() < publishers:
                self.complete = False
        return added

    def _wants(self, topic: str, kind: str) -> bool:
        """Return whether a topic is recorded."""
        if topic in self._subscriptions or topic in SHARED:
            return self._selection.wants(topic, own=True)
        publishers = partial(publishers_of, self._node, topic)
        own = is_own(topic, kind, self._selection.namespace, self.own_nodes, publishers)
        return self._selection.wants(topic, own)

    def take(self) -> list[Taken]:
        """Return all received messages, in order of arrival."""
        batch, self._left = self._left, []
        for each in self._subscriptions.values():
            batch += _take(each, each.subscription)
        self.times.check()
        batch = [t._replace(received=self.times.of(t.topic, t.received)) for t in batch]
        batch.sort(key=attrgetter('received'))
        return batch

    def _adapt(self, known: TopicSubscription, offers: Collection[TopicEndpointInfo]) -> None:
        """Resubscribe if a new publisher offers less than requested."""
        known.publishers = len(offers)
        profile = _common([known.profile, *(offer.qos_profile for offer in offers)])
        if profile != known.profile:
            old, known.profile = known.subscription, profile
            known.subscription = self._subscription(known.topic, known.kind, profile)
            self._left += _take(known, old)
            self._node.destroy_subscription(old)

    def _subscribe(
        self, topic: str, kind: str, offers: Collection[TopicEndpointInfo]
    ) -> TopicSubscription | None:
        """Subscribe to a topic; None: its type is not installed."""
        try:
            loaded = load_type(kind)
        except (ImportError, AttributeError, ValueError):
            self.unknown[topic] = kind
            return None
        profile = _common([offer.qos_profile for offer in offers])
        added = self._subscriptions[topic] = TopicSubscription(
            topic,
            kind,
            loaded,
            [qos_to_plain(offer.qos_profile) for offer in offers],
            next((str(o.topic_type_hash) for o in offers), '').replace('INVALID', ''),
            self._subscription(topic, loaded, profile),
            profile,
            len(offers),
        )
        return added

    def _subscription(self, topic: str, kind: Any, profile: QoSProfile) -> Subscription:
        return self._node.create_subscription(
            kind, topic, never_called, profile, callback_group=self._group, raw=True
        )


def _take(followed: TopicSubscription, subscription: Subscription) -> list[Taken]:
    """Return the queued messages of a subscription."""
    found = []
    handle = subscription.handle
    with handle:
        for _ in range(_AT_ONCE):
            taken = handle.take_message(followed.kind, True)
            if taken is None:
                break
            data, info = taken
            received = info['received_timestamp'] or time.time_ns()
            sent = info['source_timestamp'] or received
            found.append(Taken(received, sent, followed.topic, data))
    return found


def load_type(name: str) -> Any:
    """
    Return the class of a message type, including the parts of services and actions.

    :raises ImportError: the package is not installed.
    :raises AttributeError: the package lacks the type.
    :raises ValueError: the type name is invalid.
    """
    package, kind, own = name.split('/')
    module = import_module(f'{package}.{kind}')
    base, _, part = own.partition('_')
    if part == 'FeedbackMessage':
        return getattr(module, base).Impl.FeedbackMessage
    if part in ('Goal', 'Result', 'Feedback'):
        return getattr(getattr(module, base), part)
    return getattr(module, own)


def qos_to_plain(profile: QoSProfile) -> dict[str, Any]:
    """Return a QoS profile in rosbag2's metadata format."""
    return {name: _plain(getattr(profile, name)) for name in _QOS}


def _plain(value: Any) -> Any:
    if isinstance(value, Duration):
        seconds, nanoseconds = divmod(value.nanoseconds, 10**9)
        return {'sec': seconds, 'nsec': nanoseconds}
    return value.name.lower() if isinstance(value, Enum) else value


def _common(profiles: Collection[QoSProfile]) -> QoSProfile:
    """Return the strongest profile that all publishers offer, keeping all messages."""
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
