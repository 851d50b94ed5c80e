"""Mutated bags: no crash, no hang, and no wrong number without a warning."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import shutil
import struct
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.ros.convert import domain_to_info
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import GameState
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags import BagError
from humanopts_teach.bags.check import check_bag, repair
from humanopts_teach.bags.contents import read_demonstrations, read_domain, read_episodes
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.writer import Limits, NO_LIMITS
import numpy as np
import pytest
from std_msgs.msg import String
from teach_support.bags import write_messages

pytestmark = pytest.mark.heavy

ATTACHED = b'{"a": 1}'
BATCH = 25  # mutated bags in one test


@pytest.fixture(scope='module')
def lessons(
    tmp_path_factory: pytest.TempPathFactory,
    taxi: Domain,
    taxi_lesson: Sequence[Demonstration],
) -> list[Path]:
    """A whole bag of a small lesson in some 20 chunks, and the same in several files."""

    def messages() -> Iterator[tuple[str, Any]]:
        yield '/domain_info', domain_to_info(taxi)
        for number, demo in enumerate(taxi_lesson, start=1):
            yield '/demonstrations', demonstration_to_message(demo)
            yield '/chatter', String(data=f'demonstration {number}')
            for step in range(4):
                yield '/game_state', GameState(episode=number, step=step, state=demo.states[0])

    facts, how = {'seed': '7', 'participant': 'p1'}, {'attached': {'options.json': ATTACHED}}
    folder = tmp_path_factory.mktemp('lessons')
    return [
        write_messages(
            folder / f'lesson{at}', messages(), facts, flush=8, limits=limits, **how
        ).path
        for at, limits in enumerate((NO_LIMITS, Limits(seconds=40)))
    ]


def records(data: bytes) -> list[bytes]:
    """Split a file after its magic into records; the last may be none."""
    found, at = [], 8
    while at + 9 <= len(data) - 8:
        end = at + 9 + struct.unpack_from('<Q', data, at + 1)[0]
        found.append(data[at:end])
        at = end
    return [*found, data[at:]]


def mutated(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return the bytes of a file with one thing wrong."""
    start = int(rng.integers(len(data)))
    parts = records(data)
    first, second = rng.integers(len(parts) - 1, size=2) if len(parts) > 1 else (0, 0)
    match kind:
        case 'flip':  # up to four bytes
            changed = bytearray(data)
            for place in rng.integers(len(data), size=rng.integers(1, 5)):
                changed[place] ^= int(rng.integers(1, 256))
            return bytes(changed)
        case 'cut':
            return data[:start]
        case 'lose':
            return data[:start] + data[start + int(rng.integers(1, 300)) :]
        case 'insert':
            return data[:start] + rng.bytes(int(rng.integers(1, 300))) + data[start:]
        case 'swap':
            parts[first], parts[second] = parts[second], parts[first]
        case 'repeat':
            parts.insert(first, parts[second])
        case 'drop':
            del parts[first]
    return data[:8] + b''.join(parts)


KINDS = ('flip', 'cut', 'lose', 'insert', 'swap', 'repeat', 'drop')


def mutate(bag: Path, target: Path, number: int) -> None:
    """Write a bag with one or two things wrong in its file, and now and then its metadata."""
    rng = generator(1, 'mutated bag', number)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(bag, target)
    file = rng.choice(sorted(target.glob('*.mcap')))
    data = file.read_bytes()
    in_metadata = (target / 'metadata.yaml').exists() and rng.random() < 0.2
    if in_metadata:
        text = (target / 'metadata.yaml').read_bytes()
        (target / 'metadata.yaml').write_bytes(mutated(text, KINDS[rng.integers(3)], rng))
    for _ in range(int(rng.integers(0 if in_metadata else 1, 3))):
        if len(data) > 50:
            data = mutated(data, KINDS[rng.integers(len(KINDS))], rng)
    file.write_bytes(data)


def numbers_of_info(bag: Bag) -> tuple[Any, bool]:
    """Return the facts of ``bag info``, and whether it shows that something is wrong."""
    info = summarise(bag)
    assert info.to_text()
    warned = bool(info.damage) or any(s.missing or s.repeated for s in info.streams)
    hidden = ('path', 'files', 'bytes', 'damage')
    return {name: v for name, v in info.to_dict().items() if name not in hidden}, warned


def numbers_of_eval(bag: Bag) -> tuple[Any, bool]:
    """Return what ``bag eval`` and reports read, and whether there would be a warning."""
    domain, demonstrations = read_domain(bag), read_demonstrations(bag)
    episodes = [(each.key, each.times, each.transitions) for each in read_episodes(bag)]
    found = bag.facts, domain.name, dict(domain.parameters), demonstrations, episodes
    return found, bool(bag.damage)


def numbers_of_check(bag: Bag) -> tuple[Any, bool]:
    """Return the counts of ``bag check``, and whether it shows that something is wrong."""
    check = check_bag(bag)
    assert check.to_text()
    return (check.messages, check.streams), not check.whole


def outcome(entry: Callable[[Bag], tuple[Any, bool]], path: Path) -> tuple[Any, bool]:
    """Return numbers and whether there is a warning; an error with a text is one."""
    try:
        return entry(open_bag(path))
    except BagError as error:
        return None, bool(str(error))


ENTRIES = (numbers_of_info, numbers_of_eval, numbers_of_check)


@pytest.mark.parametrize(
    'batch', [0, 1, *(pytest.param(number, marks=pytest.mark.slow) for number in range(2, 40))]
)
def test_no_number_of_a_mutated_bag_is_wrong_without_a_warning(
    lessons: list[Path], tmp_path: Path, batch: int
) -> None:
    assert [len(open_bag(each).files) for each in lessons] == [1, 4]
    whole, same = ([entry(open_bag(each)) for entry in ENTRIES] for each in lessons)
    assert whole == same
    assert not any(warned for _, warned in whole)
    lesson = lessons[batch % 2]
    sent = {(r.topic, r.log_time, r.data) for r in open_bag(lesson).messages()}
    for number in range(batch * BATCH, (batch + 1) * BATCH):
        path = tmp_path / 'bag'
        mutate(lesson, path, number)
        for entry, (right, _) in zip(ENTRIES, whole):
            found, warned = outcome(entry, path)
            assert warned or found == right, (number, entry.__name__)
        try:
            bag = open_bag(path)
        except BagError:
            continue
        again = tmp_path / f'repaired{number}'
        repair(bag, again)
        repaired = open_bag(again)
        assert not check_bag(repaired).damage, number
        kept = [(r.topic, r.log_time, r.data) for r in repaired.messages()]
        assert set(kept) <= sent, number
        assert all(file.data == ATTACHED for file in repaired.attached()), number
        shutil.rmtree(again)
