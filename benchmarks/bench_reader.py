"""The yardstick for the recorder: it takes raw messages in the same way, but writes nothing."""

import json
from pathlib import Path
import sys
import time

from humanopts_interfaces.msg import ActionCommand, GameState
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_teach.ros.raw_subscriber import RawSubscriber

KINDS = {'game_state': GameState, 'action': ActionCommand, 'current_state': GameState}
_LOOK_PERIOD = 0.05  # s between checks of the graph
_TAKE_PERIOD = 0.004  # s between takes, as in the recorder while messages arrive


class BenchReader(NodeBase):
    """Count messages."""

    def __init__(self) -> None:
        super().__init__('bench_reader')
        self._path = Path(self.setting('results', '', 'file to write'))
        prefix = self.get_namespace().rstrip('/')
        self._topics = {f'{prefix}/{topic}' for topic in KINDS}
        self._taken, self._waited = 0, 0
        self._intake = RawSubscriber(self, self.selection)
        self.create_timer(_LOOK_PERIOD, self._intake.discover)
        self.create_timer(_TAKE_PERIOD, self._take)

    def close(self) -> None:
        """Write the number of messages and their longest waiting time, s."""
        while self._take():
            time.sleep(_TAKE_PERIOD)
        found = {'taken': self._taken, 'waited': self._waited / 1e9}
        self._path.write_text(json.dumps(found), 'utf-8')

    def _take(self) -> int:
        times = [t.received for t in self._intake.take() if t.topic in self._topics]
        if times:
            self._taken += len(times)
            self._waited = max(self._waited, time.time_ns() - times[0])
        return len(times)


def main() -> int:
    """Run the node."""
    return run_node(BenchReader)


if __name__ == '__main__':
    sys.exit(main())
