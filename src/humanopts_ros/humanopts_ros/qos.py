"""The QoS profiles of the graph; all endpoints use them, except the recorder's reader."""

from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

LEASE = 0.25  # s without contact after which a process that drives a robot counts as lost


def _profile(
    durability: DurabilityPolicy,
    depth: int,
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    **more: Any,
) -> QoSProfile:
    """Build a profile; depth 0 keeps all messages."""
    history = HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL
    return QoSProfile(
        reliability=reliability,
        durability=durability,
        history=history,
        depth=depth,
        **more,
    )


# For publishing current values: a newer value replaces an older one, and late subscribers receive
# the newest. Messages that must not be lost use STREAM.
LATCHED = _profile(DurabilityPolicy.TRANSIENT_LOCAL, 1)


def _lively(lease: float) -> QoSProfile:
    return _profile(
        DurabilityPolicy.TRANSIENT_LOCAL,
        1,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=lease),
    )


# For announcing a node that drives a robot. The middleware asserts liveliness after two thirds of
# this lease, so on a busy machine several assertions may be late before LEASE expires.
LIVELY = _lively(LEASE / 3)
# For watching such a node: the middleware detects within LEASE that the process was killed or
# stopped, or that the network connection was lost.
WATCH = _lively(LEASE)
# For reading current values: keeps the messages of all publishers, so that one publisher does not
# displace another.
CURRENT = _profile(DurabilityPolicy.TRANSIENT_LOCAL, 0)
# For append-only streams, read by the recorder and the lock-step partners. A stalled reader blocks
# the writer, so displays use LATCHED topics or DISPLAY instead.
STREAM = _profile(DurabilityPolicy.VOLATILE, 0)
DISPLAY = _profile(DurabilityPolicy.VOLATILE, 1)
# For reading from devices with reliable or best-effort publishers.
SENSOR = _profile(DurabilityPolicy.VOLATILE, 10, ReliabilityPolicy.BEST_EFFORT)
# For requests and responses. Each client also receives responses to other clients; the depth
# absorbs bursts. A stalled client does not block the server.
SERVICE = _profile(DurabilityPolicy.VOLATILE, 1000)
ACTION = {f'{name}_service_qos_profile': SERVICE for name in ('goal', 'result', 'cancel')}
