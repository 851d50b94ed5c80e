"""Large bags take little memory, and show their progress."""

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import tracemalloc
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import ActionCommand, OptionValues
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.contents import find_episodes, read_episodes
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.writer import Limits, NO_LIMITS
from humanopts_teach.export.tables import bag_tables, write_tables
import pytest
from teach_support.bags import play, write_messages

pytestmark = pytest.mark.heavy


def lesson(domain: Domain, size: int) -> Iterator[tuple[str, Any]]:
    """Yield a lesson of 20 episodes, with values of options that do not compress, of a size."""
    chance = generator(1, 'values that do not compress')
    yield '/domain_info', domain_to_info(domain)
    moves = [domain.actions[step % 4].name for step in range(20)]
    for number in range(1, 21):
        for transition in play(domain, moves):
            state = transition_to_message(transition)
            state.episode = number
            yield '/game_state', state
            yield '/action', ActionCommand(action='north', option_name=f'go {number % 3}')
        for _ in range(size // 20 // 2**16):
            yield '/option_values', OptionValues(option_values=chance.random(2**13))


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


@pytest.mark.parametrize(
    ('period', 'limits'),
    [(10**6, Limits(bytes=200_000)), (0, NO_LIMITS)],
    ids=['many files', 'stopped clock'],
)
def test_reading_holds_a_few_chunks_however_long_the_bag_is(
    tmp_path: Path,
    taxi: Domain,
    taxi_lesson: list[Demonstration],
    period: int,
    limits: Limits,
) -> None:
    shown = (('/demonstrations', demonstration_to_message(demo)) for demo in taxi_lesson)
    entries = (entry for each in (lesson(taxi, 10_000_000), shown) for entry in each)
    bag = write_messages(tmp_path / 'bag', entries, start=10**18, period=period, limits=limits)
    assert check_bag(bag).whole
    readers: dict[str, Callable[[Bag], object]] = {
        'messages': lambda bag: drain(bag.messages()),
        'info': summarise,
        'check': check_bag,
        'episodes': lambda bag: drain(read_episodes(bag)),
        'play': find_episodes,
        'export': lambda bag: write_tables(bag_tables(bag), tmp_path / 'out', 'csv'),
    }
    for name, read in readers.items():
        assert peak(lambda read=read: read(bag)) < 5_000_000, name


@pytest.mark.parametrize('indexed', [True, False])
def test_every_pass_reports_its_progress(tmp_path: Path, taxi: Domain, indexed: bool) -> None:
    write_messages(tmp_path / 'bag', lesson(taxi, 4_000_000), period=10**6)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    if not indexed:
        os.truncate(file, file.stat().st_size - 1000)
    progress: list[tuple[int, int]] = []
    bag = open_bag(tmp_path / 'bag', lambda done, total: progress.append((done, total)))
    assert bool(progress) is not indexed
    for read in (lambda: None, lambda: drain(bag.messages()), bag.compare_bytes):
        read()
        if progress:
            done = [at for at, _ in progress]
            assert len({total for _, total in progress}) == 1
            assert done == sorted(done)
            assert len(done) < 5 or done[0] < 0.1 * progress[0][1]
            assert done[-1] > 0.8 * progress[0][1]
        progress.clear()
