"""
How many messages a second the recorder takes, what that costs, and what is lost.

The same messages are sent to the recorder, and in turns to readers that write nothing, on
processes of their own.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import statistics
from typing import Any

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import count_loss
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.usage import look, Usage

from benchmarks.measure import OnMeasured, read_records, Row
from benchmarks.processes import bench_spec, launched, NAMESPACE, wait

_PATIENCE = 120.0  # s, beside the time that messages take at their rate
_USUAL_RATE = 20_000  # messages a second, where a reader takes them as fast as it can
_TOPICS = [f'{NAMESPACE}/{name}' for name in ('game_state', 'action', 'current_state')]
_STATUS = f'{NAMESPACE}/recorder_status'
RECORDER = 'the recorder'
YARDSTICK = 'taken in the same way, not written'
CALLBACK = 'a raw subscription with a callback, not written'
OnSent = Callable[[float], object]  # share that is sent


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

    @property
    def seconds(self) -> float:
        """About how long a turn takes."""
        return self.messages / (self.rate or _USUAL_RATE)


LOADS = (Load(60_000, 0, 5), Load(180_000, 3_000, 1))


@dataclass(frozen=True)
class Run:
    """One turn of a reader."""

    sent: int
    taken: int
    lost: int  # by the numbers in the messages where they are read, else by their count
    bytes: int  # of all messages
    seconds: float  # in which they were sent; as fast as can be, until all had arrived
    processor: float  # share of one core that the reader used meanwhile
    memory: int  # the most that it had at once, bytes
    grown: int  # by how much its memory grew in the second half, bytes
    waited: float  # longest time that a message waited for the reader, s


def _record(load: Load, folder: Path, on_sent: OnSent) -> Run:
    recorder = ProcessSpec(
        'recorder',
        'humanopts_teach.ros.recorder',
        {'path': str(folder / 'bag')},
    )
    sent = _send(load, recorder, folder, on_sent)
    try:
        bag = open_bag(folder / 'bag')
        streams = [stream for topic, _, stream in count_loss(bag) if topic in _TOPICS]
        waited = max(recorded.message.lag for recorded in bag.messages([_STATUS]))
    except BagError as error:
        raise LaunchError(f'the recording cannot be read: {error}') from error
    taken = sum(stream.received + stream.duplicates for stream in streams)
    lost = load.messages - sum(stream.received for stream in streams)
    return Run(load.messages, taken, lost, waited=waited, **sent)


def _read(load: Load, folder: Path, on_sent: OnSent, *, polled: bool) -> Run:
    results = folder / 'taken.jsonl'
    reader = bench_spec('bench_reader', results=str(results), polled=polled)
    sent = _send(load, reader, folder, on_sent)
    (found,) = read_records(results)
    lost = load.messages - found['taken']
    return Run(load.messages, found['taken'], lost, waited=found['waited'], **sent)


def _send(load: Load, reader: ProcessSpec, folder: Path, on_sent: OnSent) -> dict[str, Any]:
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
                on_sent(min(1.0, (looks[-1].time - looks[0].time) / load.seconds))
            return records > 1

        wait(launcher, done, _PATIENCE + load.seconds, f'messages {load.name}')
    *_, found = read_records(results)
    first, middle, last = looks[0], looks[len(looks) // 2], looks[-1]
    return {
        'bytes': found['bytes'],
        'seconds': found['seconds'],
        'processor': (last.cpu - first.cpu) / (last.time - first.time) if len(looks) > 1 else 0.0,
        'memory': last.peak,
        'grown': last.memory - middle.memory,
    }


READERS: dict[str, Callable[[Load, Path, OnSent], Run]] = {
    RECORDER: _record,
    YARDSTICK: partial(_read, polled=True),
    CALLBACK: partial(_read, polled=False),
}


def recording_rows(folder: Path, progress: OnMeasured, loads: Sequence[Load] = LOADS) -> list[Row]:
    """
    Send to the recorder, and in turns to readers that write nothing.

    A reader's middleware holds up to 5,000 messages of a topic that are not taken yet, so a load
    as fast as can be has many times more.

    :param folder: for files that nobody needs afterwards.
    :raises LaunchError: a process died, or is not done in time.
    """
    work = [(load, turn, name) for load in loads for turn in range(load.turns) for name in READERS]
    total, done = sum(load.seconds for load, _, _ in work), 0.0
    runs: dict[Load, dict[str, list[Run]]] = {load: defaultdict(list) for load in loads}
    for number, (load, _, name) in enumerate(work):
        text = f'messages {load.name}: {name}'
        on_sent = _part(progress, done / total, load.seconds / total, text)
        on_sent(0.0)
        runs[load][name].append(READERS[name](load, folder / str(number), on_sent))
        done += load.seconds
    return [row for load in loads for row in recording(load, runs[load])]


def _part(progress: OnMeasured, begun: float, length: float, text: str) -> OnSent:
    """Return the progress of one part of the work, as a share of all of it."""
    return lambda share: progress(begun + share * length, text)


def recording(load: Load, runs: Mapping[str, Sequence[Run]]) -> list[Row]:
    """Return what readers made of a load, beside the yardstick."""
    yardstick = _seconds(runs[YARDSTICK])
    rows = []
    for name, found in runs.items():
        sent, seconds = sum(run.sent for run in found), _seconds(found)
        rows.append(
            {
                'load': load.name,
                'what': name,
                'turns': len(found),
                'sent': sent,  # over all turns, as the next two
                'taken': sum(run.taken for run in found),
                'lost': sum(run.lost for run in found),
                'message_bytes': sum(run.bytes for run in found) / sent,
                'seconds': seconds,  # for each message, the median of the turns
                'yardstick': YARDSTICK,
                'yardstick_seconds': yardstick,
                'target': load.rate or None,  # a second; None: as many as are taken
                'processor': statistics.median(run.processor for run in found),
                'memory': max(run.memory for run in found),
                'grown': max(run.grown for run in found),
                'waited': max(run.waited for run in found),
                'per_second': 1.0 / seconds,
                'ratio': seconds / yardstick,
                'throughput': yardstick / seconds,  # share of the yardstick's messages a second
            }
        )
    return rows


def _seconds(runs: Sequence[Run]) -> float:
    return statistics.median(run.seconds / run.sent for run in runs)
