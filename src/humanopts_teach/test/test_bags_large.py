"""Large bags take little memory, and show how far they are read."""

from collections.abc import Callable
import os
from pathlib import Path
import struct
import tracemalloc
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.game import Command, Game, Source
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_interfaces.msg import ActionCommand, GameState, OptionValues
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.contents import find_episodes, read_episodes
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.writer import BagWriter
import pytest
from rclpy.serialization import serialize_message

pytestmark = pytest.mark.heavy

MESSAGES = 'humanopts_interfaces/msg/'
VALUES = 8192  # numbers in a large message, 64 KiB
STEPS = 20  # of an episode


class Lesson:
    """Writes a lesson with many episodes, and with values of options that do not compress."""

    def __init__(self, path: Path, domain: Domain[Any], period: int = 10**6) -> None:
        """
        Begin the bag.

        :param period: ns between messages.
        """
        self._writer = BagWriter(path, {'seed': '7', 'budget': '150'})
        self._domain, self._period = domain, period
        self._numbers: dict[str, int] = {}
        self._time = 10**18
        self._values = OptionValues(publisher_id='/n#1', option_values=[0.0] * VALUES)

    def write(self, demonstrations: list[Demonstration], size: int, episodes: int) -> None:
        """Write about ``size`` bytes, and close the bag."""
        self._send('/domain_info', domain_to_info(self._domain))
        for demonstration in demonstrations:
            self._send('/demonstrations', demonstration_to_message(demonstration))
        for number in range(1, episodes + 1):
            self._play(number)
            for _ in range(size // (8 * VALUES) * number // episodes - self._sent()):
                self._send_values()
        self._writer.close()

    def _sent(self) -> int:
        return self._numbers.get('/option_values', 0)

    def _play(self, number: int) -> None:
        """Write an episode that an option plays."""
        game = Game(self._domain)
        game.reset('', number, Source.MACHINE)
        for step in range(STEPS + 1):
            state = transition_to_message(game.transition)
            state.episode, state.action_publisher_id = number, '/n#1'
            state.action_sequence = (number - 1) * STEPS + step
            self._send('/game_state', state)
            if step < STEPS:
                name = self._domain.actions[(number + step) % 4].name
                game.command(Command('/o#1', step + 1, Source.MACHINE, 1, step, name))
                self._send('/action', ActionCommand(action=name, option_name=f'go {number % 3}'))

    def _send(self, topic: str, message: Any) -> None:
        message.publisher_id, message.sequence = '/n#1', self._count(topic)
        self._put(topic, type(message).__name__, serialize_message(message))

    def _send_values(self) -> None:
        """Put numbers of chance in place of the zeros."""
        self._values.sequence = self._count('/option_values')
        data = bytearray(serialize_message(self._values))
        start = data.index(struct.pack('<I', VALUES)) + 4
        start += (4 - start) % 8  # CDR aligns from after the first four bytes
        data[start : start + 8 * VALUES] = os.urandom(8 * VALUES)
        self._put('/option_values', 'OptionValues', bytes(data))

    def _count(self, topic: str) -> int:
        self._numbers[topic] = self._numbers.get(topic, 0) + 1
        return self._numbers[topic]

    def _put(self, topic: str, kind: str, data: bytes) -> None:
        self._time += self._period
        self._writer.add_topic(topic, MESSAGES + kind)
        self._writer.write(topic, data, self._time)


def peak(work: Callable[[], object]) -> int:
    """Return the most memory, in bytes, that Python objects take while work is done."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def drain(rows: Any) -> None:
    for _ in rows:
        pass


READERS: dict[str, Callable[[Bag], object]] = {
    'messages': lambda bag: drain(bag.messages()),
    'info': summarise,
    'check': check_bag,
    'episodes': lambda bag: drain(read_episodes(bag)),
    'played': find_episodes,
}


@pytest.mark.parametrize('period', [10**6, 0], ids=['clock that runs', 'clock that stands'])
def test_reading_holds_a_few_chunks_however_long_the_bag_is(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration], period: int
) -> None:
    Lesson(tmp_path / 'bag', taxi, period).write(taxi_lesson, 10_000_000, 20)
    bag = open_bag(tmp_path / 'bag')
    check = check_bag(bag)
    assert check.whole, check.findings
    for name, read in READERS.items():
        assert peak(lambda read=read: read(bag)) < 5_000_000, name


def write_mixed(path: Path) -> None:
    """Write twenty chunks, each with messages of all times."""
    with BagWriter(path) as writer:
        writer.add_topic('/game_state', MESSAGES + 'GameState')
        for number in range(1, 401):
            state = GameState(publisher_id='/game#1', sequence=number, state='x' * 200)
            writer.write('/game_state', serialize_message(state), number * 7 % 20 + 1)
            if number % 20 == 0:
                writer.flush()


def test_messages_of_chunks_that_overlap_in_time_come_in_order(tmp_path: Path) -> None:
    write_mixed(tmp_path / 'bag')
    bag = open_bag(tmp_path / 'bag')
    found = [(r.log_time, r.sequence) for r in bag.messages()]
    assert found == sorted(found)
    assert (len(found), bag.damage) == (400, '')


@pytest.mark.parametrize('indexed', [True, False])
def test_every_pass_tells_how_far_it_is_a_scan_too(
    tmp_path: Path, taxi: Domain[Any], indexed: bool
) -> None:
    Lesson(tmp_path / 'bag', taxi).write([], 4_000_000, 10)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    if not indexed:
        os.truncate(file, file.stat().st_size - 1000)
    told: list[tuple[int, int]] = []
    bag = open_bag(tmp_path / 'bag', lambda done, total: told.append((done, total)))
    assert bool(told) is not indexed
    for read in (
        lambda: None,
        lambda: drain(r.message for r in bag.messages()),
        bag.compare_bytes,
    ):
        read()
        if told:
            done = [at for at, _ in told]
            assert len({total for _, total in told}) == 1
            assert done == sorted(done)
            assert len(done) < 5 or done[0] < 0.1 * told[0][1]
            assert done[-1] > 0.8 * told[0][1]
        told.clear()
