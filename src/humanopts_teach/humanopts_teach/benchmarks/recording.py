"""How many messages a second the recorder takes without losing one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from humanopts_learner.benchmarks.measured import compare, Comparison, OnMeasured
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import count_loss
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.benchmarks.processes import bench_spec, launched, NAMESPACE, wait
from humanopts_teach.benchmarks.records import read_records
from humanopts_teach.launching.launcher import LaunchError
from humanopts_teach.launching.processes import ProcessSpec

_SECONDS = 120.0  # at most, for one flood
FLOOD = f'{NAMESPACE}/flood'


@dataclass(frozen=True)
class RecordingSizes:
    """How much is sent."""

    floods: int = 3
    messages: int = 60_000  # each


@dataclass(frozen=True)
class Flood:
    """One flood of messages, and what the reader has of it."""

    sent: int
    taken: int
    lost: int
    size: int  # of a message, bytes
    seconds: float  # for each message, until the reader's middleware had all of them


def recording_row(
    sizes: RecordingSizes, folder: Path, progress: OnMeasured | None = None
) -> Comparison:
    """
    Flood the recorder, and in turns a reader that takes messages as it does and writes nothing.

    The clock stops when the reader's middleware has everything. It holds up to 5,000 messages that
    are not taken yet, so a flood has many times more.

    :param folder: for files that nobody needs afterwards.
    :raises LaunchError: a process died, or is not done in time.
    """
    recorded, read = [], []
    for number in range(sizes.floods):
        if progress is not None:
            progress(number / sizes.floods, 'recording a flood of messages')
        recorded.append(_record(sizes.messages, folder / f'recorder-{number}'))
        read.append(_read(sizes.messages, folder / f'reader-{number}'))
    return recording(recorded, read)


def recording(recorded: Sequence[Flood], read: Sequence[Flood]) -> Comparison:
    """Set floods of the recorder beside those of a bare reader."""
    return compare(
        'the recorder, one message',
        [flood.seconds for flood in recorded],
        'taken in the same way, not written',
        [flood.seconds for flood in read],
        facts={
            'sent': sum(flood.sent for flood in recorded),
            'recorded': sum(flood.taken for flood in recorded),
            'lost': sum(flood.lost for flood in recorded),
            'message_bytes': recorded[0].size,
            'yardstick_sent': sum(flood.sent for flood in read),
            'yardstick_taken': sum(flood.taken for flood in read),
        },
    )


def _record(messages: int, folder: Path) -> Flood:
    recorder = ProcessSpec(
        'recorder',
        'humanopts_teach',
        'humanopts_teach.nodes.recorder',
        {'path': str(folder / 'bag')},
    )
    seconds, size = _flood(recorder, messages, folder)
    try:
        bag = open_bag(folder / 'bag')
        loss = {topic: stream.missing for topic, _, stream in count_loss(bag)}
    except BagError as error:
        raise LaunchError(f'the recording cannot be read: {error}') from error
    return Flood(messages, bag.topics[FLOOD].messages, loss[FLOOD], size, seconds)


def _read(messages: int, folder: Path) -> Flood:
    results = folder / 'taken.jsonl'
    seconds, size = _flood(bench_spec('bench_reader', results=str(results)), messages, folder)
    (found,) = read_records(results)
    return Flood(messages, found['taken'], messages - found['taken'], size, seconds)


def _flood(reader: ProcessSpec, messages: int, folder: Path) -> tuple[float, int]:
    """Send messages to a reader; return the seconds and bytes of one."""
    results = folder / 'flood.jsonl'
    flood = bench_spec(
        'bench_flood',
        results=str(results),
        count=messages,
        reader=reader.name,
        expect_recorder=reader.name == 'recorder',
    )
    with launched([reader, flood], folder) as launcher:
        wait(launcher, lambda: any(read_records(results)), _SECONDS, 'the flood')
    (found,) = read_records(results)
    return found['seconds'], found['bytes']
