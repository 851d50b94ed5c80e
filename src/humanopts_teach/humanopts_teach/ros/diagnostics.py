"""
The node ``diagnostics``: the states of nodes and recording on ``/diagnostics``, for ROS tools.

These tools read that topic whatever the namespace.
"""

from collections.abc import Iterator, Mapping
from functools import partial
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from humanopts_interfaces.msg import NodeStatus, RecorderStatus
from humanopts_ros.node_base import NodeBase, RECORDER
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
    """Publishes the state of all nodes of its namespace once a second."""

    def __init__(self, **options: Any) -> None:
        super().__init__('diagnostics', **options)
        self._recorder: RecorderStatus | None = None
        self._out = self.create_publisher(DiagnosticArray, TOPIC, STREAM)
        self._statuses = self.peers.statuses
        keep = partial(setattr, self, '_recorder')
        self.create_subscription(RecorderStatus, 'recorder_status', keep, CURRENT)
        self.create_timer(_PERIOD, self._publish)

    def _publish(self) -> None:
        found = list(of_nodes(self._statuses, set(self.nodes_there())))
        if self._recorder is not None:
            found.append(of_recording(f'{self.full_name(RECORDER)}: bag', self._recorder))
        message = DiagnosticArray(status=found)
        message.header.stamp = self.get_clock().now().to_msg()
        self._out.publish(message)


def of_nodes(statuses: Mapping[str, NodeStatus], there: set[str]) -> Iterator[DiagnosticStatus]:
    """
    Yield what nodes say of themselves.

    :param there: full names of the nodes on the graph; what is gone is stale.
    """
    for _, status in sorted(statuses.items()):
        name = status.node
        level, word = _LEVELS.get(status.state, (DiagnosticStatus.ERROR, 'unknown'))
        if name not in there and status.state != NodeStatus.STATE_STOPPING:
            level, word = DiagnosticStatus.STALE, 'gone'
        yield DiagnosticStatus(
            level=level,
            name=name,
            message=f'{word}: {status.text}' if status.text else word,
            hardware_id=status.publisher_id,
        )


def of_recording(name: str, status: RecorderStatus) -> DiagnosticStatus:
    """Return the state of the recording."""
    level, word = DiagnosticStatus.OK, 'recording'
    if status.behind or status.missing or not status.complete:
        level, word = DiagnosticStatus.WARN, 'not whole'
    if status.stopped:
        level, word = DiagnosticStatus.ERROR, 'stopped'
    return DiagnosticStatus(
        level=level,
        name=name,
        message=f'{word}: {status.text}' if status.text else word,
        hardware_id=status.publisher_id,
        values=[KeyValue(key=key, value=str(getattr(status, key))) for key in _COUNTS],
    )


main = partial(run_node, DiagnosticsNode)

if __name__ == '__main__':
    sys.exit(main())
