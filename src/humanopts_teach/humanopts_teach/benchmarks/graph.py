"""Everything that is measured on real processes."""

from dataclasses import dataclass, field
from pathlib import Path
import tempfile

from humanopts_learner.benchmarks.measured import Comparison, OnMeasured
from humanopts_teach.benchmarks.latencies import latency_rows, LatencySizes
from humanopts_teach.benchmarks.place import own_domain
from humanopts_teach.benchmarks.recording import recording_row, RecordingSizes

_LATENCIES = 0.6  # of all time


@dataclass(frozen=True)
class GraphSizes:
    """How much is measured."""

    latencies: LatencySizes = field(default_factory=LatencySizes)
    recording: RecordingSizes = field(default_factory=RecordingSizes)


def graph_rows(sizes: GraphSizes, progress: OnMeasured | None = None) -> list[Comparison]:
    """
    Measure the graph, in a ROS domain of its own.

    :raises LaunchError: a process died, or is not done in time.
    """
    tell = progress or (lambda share, text: None)
    tell(0.0, 'starting the nodes')
    with tempfile.TemporaryDirectory(prefix='humanopts-bench-') as name, own_domain():
        folder = Path(name)
        rows = latency_rows(
            sizes.latencies, folder, lambda share, text: tell(_LATENCIES * share, text)
        )
        last = recording_row(
            sizes.recording,
            folder,
            lambda share, text: tell(_LATENCIES + (1 - _LATENCIES) * share, text),
        )
    return [*rows, last]
