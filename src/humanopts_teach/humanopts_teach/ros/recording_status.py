"""What the recorder says of itself on ``recorder_status``."""

import os
import time

from humanopts_interfaces.msg import RecorderStatus, StreamLoss
from humanopts_ros.node_base import NodeBase
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import LATCHED
from humanopts_teach.bags.pace import LIMIT, Pace
from humanopts_teach.bags.sequence_numbers import Ledger
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.launching.usage import look

_PERIOD = 1.0  # s between statuses that differ only in their counts
_BEHIND = (
    f'the recorder does not keep up: messages wait for it longer than {LIMIT} s; '
    'end other programs, or leave topics out'
)


class RecordingStatus:
    """Publishes how the recording stands, at every change that matters and once a second."""

    def __init__(self, node: NodeBase, bag: BagWriter, ledger: Ledger, pace: Pace) -> None:
        self._node, self._bag, self._ledger, self._pace = node, bag, ledger, pace
        self._publisher = node.stamped_publisher(RecorderStatus, 'recorder_status', LATCHED)
        self._behind = False
        self._said: tuple[object, ...] = ()
        self._said_at = 0.0

    def say(self, *, complete: bool, stopped: str, text: str) -> None:
        """
        Publish the status, if it is time to.

        :param stopped: why nothing is written any more; empty: it is.
        :param text: what else there is to say.
        """
        now = time.monotonic()
        self._tell_pace(self._pace.behind(now))
        text = stopped or (_BEHIND if self._behind else text)
        state = (complete, self._behind, text, self._ledger.missing)
        if state == self._said and now - self._said_at < _PERIOD:
            return
        self._said, self._said_at = state, now
        try:
            self._publisher.publish(self._status(complete, bool(stopped), text))
        except PublishError as error:
            self._node.get_logger().error(str(error))

    def _tell_pace(self, behind: bool) -> None:
        """Log when the recorder falls behind, and when it no longer is."""
        if behind and not self._behind:
            self._node.get_logger().warning(_BEHIND)
        if self._behind and not behind:
            self._node.get_logger().info('the recorder keeps up again')
        self._behind = behind

    def _status(self, complete: bool, stopped: bool, text: str) -> RecorderStatus:
        used = look(os.getpid())
        return RecorderStatus(
            path=str(self._bag.path),
            files=self._bag.n_files,
            topics=len(self._bag.topics),
            messages=self._bag.extent.messages,
            bytes=self._bag.bytes_written,
            complete=complete,
            missing=self._ledger.missing,
            losses=[
                StreamLoss(topic=topic, sender=sender, sent=stream.last, missing=stream.missing)
                for topic, sender, stream in self._ledger
                if stream.missing
            ],
            lag=self._pace.report(),
            behind=self._behind,
            cpu_seconds=used.cpu,
            memory=used.peak,
            stopped=stopped,
            text=text,
        )
