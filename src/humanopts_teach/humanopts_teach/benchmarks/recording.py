"""How many messages a second the recorder takes, what it costs, and what is lost."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
import statistics
from typing import Any

from humanopts_learner.benchmarks.measured import OnMeasured
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import count_loss
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.benchmarks.processes import bench_spec, launched, NAMESPACE, wait
from humanopts_teach.benchmarks.records import read_records
from humanopts_teach.benchmarks.usage import look, Usage
from humanopts_teach.launching.launcher import LaunchError
from humanopts_teach.launching.processes import ProcessSpec

_PATIENCE = 120.0  # s, beside the time that messages take at their rate
_TOPICS = [f'{NAMESPACE}/{name}' for name in ('game_state', 'action', 'current_state')]
_STATUS = f'{NAMESPACE}/recorder_status'
RECORDER = 'the recorder'
YARDSTICK = 'taken in the same way, not written'
CALLBACK = 'a raw subscription with a callback, not written'


@dataclass(frozen=True)
class Load:
    """What is sent to a reader."""

    messages: int
    rate: int  # messages a second; 0: as fast as the reader takes them
    turns: int  # of every reader

    @property
    def name(self) -> str:
        """What it is, in words."""
        if not self.rate:
            return 'as fast as they are taken'
        return f'{self.rate:,} a second for {self.messages / self.rate:g} s'


LOADS = (Load(60_000, 0, 3), Load(180_000, 3_000, 1))


@dataclass(frozen=True)
class Run:
    """One turn of a reader."""

    sent: int
    taken: int
    lost: int  # by the numbers in the messages where they are read, else by their count
    bytes: int  # of all messages
    seconds: float  # until the reader's middleware had everything
    processor: float  # share of one core that the reader used meanwhile
    memory: int  # the most that it had at once, bytes
    grown: int  # by how much its memory grew in the second half, bytes
    waited: float  # longest time that a message waited for the reader, s


@dataclass(frozen=True)
class RecordingRow:
    """How one reader stood one load, beside a reader that does no more than it must."""

    load: str
    what: str
    turns: int
    sent: int  # over all turns, as the next two
    taken: int
    lost: int
    message_bytes: float
    seconds: float  # for each message, the median of the turns
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
        own = ('ratio', 'per_second', 'throughput')
        return {
            **asdict(self),
            'yardstick': YARDSTICK,
            **{name: getattr(self, name) for name in own},
        }


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
    rows = []
    work = [(load, turn) for load in loads for turn in range(load.turns)]
    runs: dict[Load, dict[str, list[Run]]] = {
        load: {name: [] for name in READERS} for load in loads
    }
    for done, (load, turn) in enumerate(work):
        for place, (name, run) in enumerate(READERS.items()):
            if progress is not None:
                share = (done + place / len(READERS)) / len(work)
                progress(share, f'messages {load.name}: {name}')
            at = folder / f'{loads.index(load)}-{turn}-{place}'
            runs[load][name].append(run(load, at))
    for load in loads:
        rows += recording(load, runs[load])
    return rows


def recording(load: Load, runs: dict[str, list[Run]]) -> list[RecordingRow]:
    """Set what readers made of a load beside the yardstick."""
    (yardstick,) = [_seconds(found) for name, found in runs.items() if name == YARDSTICK]
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
            yardstick_seconds=yardstick,
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


def _record(load: Load, folder: Path) -> Run:
    recorder = ProcessSpec(
        'recorder',
        'humanopts_teach',
        'humanopts_teach.nodes.recorder',
        {'path': str(folder / 'bag')},
    )
    sent = _send(load, recorder, folder)
    try:
        bag = open_bag(folder / 'bag')
        streams = [stream for topic, _, stream in count_loss(bag) if topic in _TOPICS]
        statuses = [recorded.message for recorded in bag.messages([_STATUS])]
    except BagError as error:
        raise LaunchError(f'the recording cannot be read: {error}') from error
    taken = sum(stream.received + stream.duplicates for stream in streams)
    lost = load.messages - sum(stream.received for stream in streams)
    waited = max(status.lag for status in statuses)
    return Run(load.messages, taken, lost, waited=waited, **sent)


def _read(load: Load, folder: Path, *, polled: bool) -> Run:
    results = folder / 'taken.jsonl'
    reader = bench_spec('bench_reader', results=str(results), polled=polled)
    sent = _send(load, reader, folder)
    (found,) = read_records(results)
    lost = load.messages - found['taken']
    return Run(load.messages, found['taken'], lost, waited=found['waited'], **sent)


def _send(load: Load, reader: ProcessSpec, folder: Path) -> dict[str, Any]:
    """Send to a reader; return the fields of ``Run`` that do not depend on what it took."""
    results = folder / 'sent.jsonl'
    sender = bench_spec(
        'bench_sender',
        results=str(results),
        count=load.messages,
        rate=load.rate,
        reader=reader.name,
        expect_recorder=reader.name == 'recorder',
    )
    looks: list[Usage] = []

    with launched([reader, sender], folder) as launcher:

        def done() -> bool:
            records = len(list(read_records(results)))
            if records:
                looks.append(look(launcher.pid(reader.name)))
            return records > 1

        seconds = _PATIENCE + (load.messages / load.rate if load.rate else 0.0)
        wait(launcher, done, seconds, f'messages {load.name}')
    *_, found = read_records(results)
    first, middle, last = looks[0], looks[len(looks) // 2], looks[-1]
    return {
        'bytes': found['bytes'],
        'seconds': found['seconds'],
        'processor': (last.cpu - first.cpu) / (last.time - first.time) if len(looks) > 1 else 0.0,
        'memory': last.peak,
        'grown': last.memory - middle.memory,
    }


READERS: dict[str, Callable[[Load, Path], Run]] = {
    RECORDER: _record,
    YARDSTICK: partial(_read, polled=True),
    CALLBACK: partial(_read, polled=False),
}
