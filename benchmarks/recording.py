"""How many messages a second the recorder takes, what that costs, and what is lost."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
import statistics
from typing import Any

from benchmarks.measured import OnMeasured
from benchmarks.readers import Load, OnSent, READERS, Run, YARDSTICK

LOADS = (Load(60_000, 0, 5), Load(180_000, 3_000, 1))


@dataclass(frozen=True)
class RecordingRow:
    """How one reader stood one load, beside one that takes messages as the recorder does."""

    load: str
    what: str
    turns: int
    sent: int  # over all turns, as the next two
    taken: int
    lost: int
    message_bytes: float
    seconds: float  # for each message, the median of the turns
    yardstick: str
    yardstick_seconds: float
    target: float | None  # how many a second were sent; None: as many as are taken
    processor: float  # share of one core
    memory: int  # bytes
    grown: int  # bytes
    waited: float  # s

    @property
    def ratio(self) -> float:
        """How many times the yardstick's time it takes."""
        return self.seconds / self.yardstick_seconds

    @property
    def per_second(self) -> float:
        """How many messages it took in a second."""
        return 1.0 / self.seconds

    @property
    def throughput(self) -> float:
        """What share of the yardstick's messages it took in a second."""
        return 1.0 / self.ratio

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        own = ('per_second', 'ratio', 'throughput')
        return {**asdict(self), **{name: getattr(self, name) for name in own}}


def recording_rows(
    loads: Sequence[Load], folder: Path, progress: OnMeasured | None = None
) -> list[RecordingRow]:
    """
    Send to the recorder, and in turns to readers that write nothing.

    A reader's middleware holds up to 5,000 messages of a topic that are not taken yet, so a load
    as fast as can be has many times more.

    :param folder: for files that nobody needs afterwards.
    :raises LaunchError: a process died, or is not done in time.
    """
    tell = progress or (lambda share, text: None)
    work = [(load, turn, name) for load in loads for turn in range(load.turns) for name in READERS]
    total, done = sum(load.seconds for load, _, _ in work), 0.0
    runs: dict[Load, dict[str, list[Run]]] = {load: defaultdict(list) for load in loads}
    for number, (load, _, name) in enumerate(work):
        text = f'messages {load.name}: {name}'
        on_sent = _part(tell, done / total, load.seconds / total, text)
        on_sent(0.0)
        runs[load][name].append(READERS[name](load, folder / str(number), on_sent))
        done += load.seconds
    return [row for load in loads for row in recording(load, runs[load])]


def _part(tell: OnMeasured, begun: float, length: float, text: str) -> OnSent:
    """Return what tells of a part of the work, as a share of all of it."""
    return lambda share: tell(begun + share * length, text)


def recording(load: Load, runs: Mapping[str, Sequence[Run]]) -> list[RecordingRow]:
    """Set what readers made of a load beside the yardstick."""
    return [
        RecordingRow(
            load=load.name,
            what=name,
            turns=len(found),
            sent=sum(run.sent for run in found),
            taken=sum(run.taken for run in found),
            lost=sum(run.lost for run in found),
            message_bytes=sum(run.bytes for run in found) / sum(run.sent for run in found),
            seconds=_seconds(found),
            yardstick=YARDSTICK,
            yardstick_seconds=_seconds(runs[YARDSTICK]),
            target=load.rate or None,
            processor=statistics.median(run.processor for run in found),
            memory=max(run.memory for run in found),
            grown=max(run.grown for run in found),
            waited=max(run.waited for run in found),
        )
        for name, found in runs.items()
    ]


def _seconds(runs: Sequence[Run]) -> float:
    return statistics.median(run.seconds / run.sent for run in runs)
