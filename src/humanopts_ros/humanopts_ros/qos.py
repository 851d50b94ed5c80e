"""The named QoS profiles of the graph; but for the recorder's reader, nothing else builds one."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(durability: DurabilityPolicy, depth: int) -> QoSProfile:
    """Build a reliable profile; depth 0 keeps everything."""
    history = HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
        history=history,
        depth=depth,
    )


# Publishes a current value: a newer one replaces it, so the first message that a late subscriber
# gets is the newest. What must not be lost is on a stream.
LATCHED = _profile(DurabilityPolicy.TRANSIENT_LOCAL, 1)
# Reads a current value: all of each publisher, so that one publisher does not displace
# another.
CURRENT = _profile(DurabilityPolicy.TRANSIENT_LOCAL, 0)
# Append-only streams, for the recorder and the lock-step partners. A reader that has stopped
# blocks the writer, so displays read LATCHED topics or DISPLAY instead.
STREAM = _profile(DurabilityPolicy.VOLATILE, 0)
DISPLAY = _profile(DurabilityPolicy.VOLATILE, 1)
# Requests and answers, of which those to other callers come, too: a burst of them loses none. A
# caller that has stopped does not block the server.
SERVICE = _profile(DurabilityPolicy.VOLATILE, 1000)
ACTION = {f'{name}_service_qos_profile': SERVICE for name in ('goal', 'result', 'cancel')}
