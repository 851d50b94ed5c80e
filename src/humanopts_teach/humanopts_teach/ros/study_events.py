"""The record of a participant of a study, whose events are on the graph too."""

from pathlib import Path

from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import STREAM
from humanopts_teach.study.record import Record, TOPIC


def published_record(node: NodeBase, path: Path, participant: str) -> Record:
    """
    Return the record of a participant; a node publishes each of its new events.

    :raises OSError: the record cannot be read.
    """
    from humanopts_interfaces.msg import StudyEvent

    publisher = node.stamped_publisher(StudyEvent, TOPIC, STREAM)

    def publish(line: str) -> None:
        publisher.publish(StudyEvent(participant=participant, event=line))

    return Record(path, publish)
