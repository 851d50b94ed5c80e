"""The yardstick of the recorder: takes raw messages as it does, and writes nothing."""

from pathlib import Path
import sys

from humanopts_env.nodes.node_base import NodeBase, run_node
from humanopts_teach.benchmarks.records import RecordWriter
from humanopts_teach.nodes.intake import Intake

_LOOK_PERIOD = 0.05  # s between looks at the graph
_TAKE_PERIOD = 0.004  # s between takes, as the recorder has it while messages come


class BenchReader(NodeBase):
    """Counts what it takes on one topic."""

    def __init__(self) -> None:
        super().__init__('bench_reader')
        self._path = Path(self.setting('results', '', 'file to write'))
        self._topic = f'{self.get_namespace().rstrip("/")}/flood'
        self._intake = Intake(self)
        self._count = 0
        self.create_timer(_LOOK_PERIOD, self._intake.discover)
        self.create_timer(_TAKE_PERIOD, self._take)

    def close(self) -> None:
        """Tell how many there were."""
        self._take()
        with RecordWriter(self._path) as records:
            records.write(taken=self._count)

    def _take(self) -> None:
        self._count += sum(taken.topic == self._topic for taken in self._intake.take())


if __name__ == '__main__':
    sys.exit(run_node(BenchReader))
