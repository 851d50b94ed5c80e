"""Sends messages to the recorder, and to readers that write nothing, on processes of their own."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import count_loss
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.usage import look, Usage

from benchmarks.processes import bench_spec, launched, NAMESPACE, wait
from benchmarks.records import read_records

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
