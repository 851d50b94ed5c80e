"""
The node ``diagnostics``: states of nodes and recording on ``/diagnostics``, for ROS tools.

These tools read that topic regardless of the namespace.
"""

from functools import partial
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from humanopts_interfaces.msg import NodeStatus, RecorderStatus
from humanopts_ros.node_base import NodeBase, RECORDER
from humanopts_ros.peers import node_names
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT, STREAM

TOPIC = '/diagnostics'
_PERIOD = 1.0  # s
_LEVELS = {
    NodeStatus.STATE_STARTING: (DiagnosticStatus.WARN, 'starting'),
    NodeStatus.STATE_READY: (DiagnosticStatus.OK, 'ready'),
    NodeStatus.STATE_PAUSED: (DiagnosticStatus.ERROR, 'paused'),
    NodeStatus.STATE_STOPPING: (DiagnosticStatus.STALE, 'stopped'),
}
_COUNTS = ('path', 'files', 'topics', 'messages', 'bytes', 'missing', 'lag')


class DiagnosticsNode(NodeBase):
    """Publishes the states of all nodes of its namespace once per second."""

    def __init__(self, **options: Any) -> None:
        super().__init__('diagnostics', **options)
        self._statuses = self.peers.statuses
        self._recorder: RecorderStatus | None = None
        self._out = self.create_publisher(DiagnosticArray, TOPIC, STREAM)
        keep = partial(setattr, self, '_recorder')
        self.create_subscription(RecorderStatus, 'recorder_status', keep, CURRENT)
        self.create_timer(_PERIOD, self._publish)

    def _publish(self) -> None:
        present = node_names(self)
        found = [of_node(each, each.node in present) for _, each in sorted(self._statuses.items())]
        if self._recorder is not None:
            found.append(of_recording(f'{self.full_name(RECORDER)}: bag', self._recorder))
        message = DiagnosticArray(status=found)
        message.header.stamp = self.get_clock().now().to_msg()
        self._out.publish(message)


def of_node(status: NodeStatus, present: bool) -> DiagnosticStatus:
    """
    Return the diagnostic status of a node.

    :param present: whether the node is on the graph; a missing node is stale.
    """
    level, word = _LEVELS.get(status.state, (DiagnosticStatus.ERROR, 'unknown'))
    if not present and status.state != NodeStatus.STATE_STOPPING:
        level, word = DiagnosticStatus.STALE, 'gone'
    return _diagnostic(status.node, level, word, status)


def of_recording(name: str, status: RecorderStatus) -> DiagnosticStatus:
    """Return the diagnostic status of the recording."""
    level, word = DiagnosticStatus.OK, 'recording'
    if status.behind or status.missing or not status.complete:
        level, word = DiagnosticStatus.WARN, 'not whole'
    if status.stopped:
        level, word = DiagnosticStatus.ERROR, 'stopped'
    found = _diagnostic(name, level, word, status)
    found.values = [KeyValue(key=key, value=str(getattr(status, key))) for key in _COUNTS]
    return found


def _diagnostic(
    name: str, level: bytes, word: str, status: NodeStatus | RecorderStatus
) -> DiagnosticStatus:
    message = f'{word}: {status.text}' if status.text else word
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=status.publisher_id
    )


main = partial(run_node, DiagnosticsNode)

if __name__ == '__main__':
    sys.exit(main())
