"""A recorder that is killed while much is sent: what is missing, and what a repair saves."""

from pathlib import Path
import signal
import time

from graph_support import sending
from graph_support.live import Graph, RECORDER
from graph_support.sending import KINDS, read_sent
from humanopts_env.seeding import generator
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.cli import main
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

MOST = 0.5  # s that may be missing
EARLIEST, LATEST = 0.0, 3.0  # s after the first message, of a kill
SPLITS = 5  # at every fifth kill, the recorder is just beginning a new file
FILE_BYTES = 200_000  # of the files of such a recorder: half a second or less


def kill(live: Graph, folder: Path, after: float, split: float | None = None) -> int:
    """
    Kill a recorder.

    :param after: s since the first message.
    :param split: s since the next new file; None: there is only one file.
    :return: when, ns since the epoch.
    """
    folder.mkdir()
    bag, record = folder / 'bag', folder / 'sent'
    most = {} if split is None else {'max_bytes': FILE_BYTES}
    recorder = live.spawn(RECORDER, path=bag, **most)
    sender = live.run([sending.__file__, str(record)], 'sender')
    live.until(lambda: any(read_sent(record)), 'the first message')
    time.sleep(max(0.0, after - (time.time_ns() - next(read_sent(record)).time) / 1e9))
    if split is not None:
        files = set(bag.glob('*.mcap'))
        while set(bag.glob('*.mcap')) == files:
            assert recorder.process.poll() is None
        time.sleep(split)
    killed = time.time_ns()
    recorder.kill(signal.SIGKILL)
    assert sender.kill(signal.SIGTERM) == 0
    return killed


def repaired(folder: Path) -> Bag:
    """Repair a bag by the command; the original stays as it is."""
    bag, out = folder / 'bag', folder / 'repaired'
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    check = check_bag(open_bag(bag))
    assert any('was not closed' in text or 'cut short' in text for text in check.damage)
    assert not any(s.missing or s.repeated or s.late for s in check.streams)
    assert main(['bag', 'check', str(bag), '--repair', str(out)]) == 1
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    assert main(['bag', 'check', str(out)]) == 0
    return open_bag(out)


def seconds_lost(folder: Path, bag: Bag, killed: int) -> float:
    """Return the time before a kill of which messages are missing; what is there is as sent."""
    recorded = {t: iter([m.data for m in bag.messages([t])]) for t in KINDS}
    oldest = killed
    for sent in read_sent(folder / 'sent'):
        if sent.time < killed:
            there = next(recorded[sent.topic], None)
            assert there in (None, sent.data), sent.topic
            if there is None:
                oldest = min(oldest, sent.time)
    return (killed - oldest) / 1e9


def assert_read_by_others(bag: Bag) -> None:
    """Compare what rosbags reads with what our reader does."""
    ours = sorted((m.topic, m.log_time, m.data) for m in bag.messages())
    with AnyReader([bag.path]) as reader:
        theirs = [(c.topic, when, data, c.msgtype) for c, when, data in reader.messages()]
        for _, _, data, kind in theirs:
            reader.deserialize(data, kind)
    assert sorted(message[:3] for message in theirs) == ours


@pytest.mark.timeout(900)
@pytest.mark.parametrize('kills', [1, pytest.param(50, marks=pytest.mark.slow)])
def test_killed_recorders_lose_half_a_second_at_most_and_damage_nothing(
    live: Graph, tmp_path: Path, kills: int
) -> None:
    chance = generator(1, 'kills of the recorder')
    lost = []
    for number in range(kills):
        folder, after = tmp_path / str(number), chance.uniform(EARLIEST, LATEST)
        split = chance.uniform(0.0, 0.02) if number % SPLITS == SPLITS - 1 else None
        killed = kill(live, folder, after, split)
        bag = repaired(folder)
        assert_read_by_others(bag)
        lost.append(seconds_lost(folder, bag, killed))
    print(f'lost: median {np.median(lost):.3f} s, most {max(lost):.3f} s')
    assert max(lost) <= MOST
