"""``bag check``: damage has a name, what is missing a number, and a repair saves the rest."""

from collections.abc import Iterable, Iterator
import fcntl
from itertools import pairwise
import json
import os
from pathlib import Path
import resource
import struct
import time
from typing import Any

from humanopts_interfaces.msg import DomainInfo, GameState, LessonState
from humanopts_teach.bags import BagError
from humanopts_teach.bags.check import check_bag, RECORDER, REPAIR, repair
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.writer import Limits, NO_LIMITS
from humanopts_teach.cli import main
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
import pytest
from rosbags.rosbag2 import Reader
from std_msgs.msg import String
from teach_support.bags import START, state, write_messages, write_states
import yaml


def write(path: Path, sequences: Iterable[int], limits: Limits = NO_LIMITS) -> Path:
    """Write game states with these numbers, and a text for each, ten of both in a chunk."""

    def entries() -> Iterator[tuple[str, Any]]:
        for place, sequence in enumerate(sequences):
            filler = os.urandom(20).hex()  # does not compress
            yield '/game_state', GameState(publisher_id='/game#1', sequence=sequence, state=filler)
            yield '/chatter', String(data=str(place))

    attached = {'options.json': b'{"a": 1}'}
    how: Any = {'start': START, 'period': 10**6, 'limits': limits, 'attached': attached}
    return write_messages(path, entries(), {'seed': '7'}, **how).path


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A whole bag of 100 game states and 100 texts in 10 chunks."""
    return write(tmp_path / 'bag', range(1, 101))


def chunk_at(bag: Path, number: int) -> tuple[int, int]:
    """Return begin and end of a chunk in the file."""
    with (bag / f'{bag.name}_0.mcap').open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[number]
    return chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length


def contents(bag: Path) -> list[tuple[str, int, int, bytes]]:
    """Return all messages in order."""
    found = open_bag(bag).messages()
    return [(r.topic, r.log_time, r.publish_time, r.data) for r in found]


def numbers(bag: Path) -> dict[str, tuple[int, int, int, int, int]]:
    """Return sent, recorded, missing, repeated and late by publisher."""
    streams = check_bag(open_bag(bag)).streams
    return {s.publisher: (s.sent, s.recorded, s.missing, s.repeated, s.late) for s in streams}


def in_json(bag: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, Any]:
    """Return the status of ``bag check``, and its JSON."""
    status = main(['bag', 'check', str(bag), '--json'])
    return status, json.loads(capsys.readouterr().out)


def test_missing_repeated_and_late_messages_are_counted_by_publisher(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert numbers(bag) == {'/game#1': (100, 100, 0, 0, 0), RECORDER: (100, 100, 0, 0, 0)}
    status, found = in_json(bag, capsys)
    assert (status, found['whole'], found['messages']) == (0, True, 200)
    lossy = write(tmp_path / 'lossy', [2, 3, 7, 6, 6, 8])
    assert numbers(lossy)['/game#1'] == (8, 5, 3, 1, 1)
    status, found = in_json(lossy, capsys)
    assert (status, found['damage']) == (1, [])
    assert found['findings'] == [
        '3 messages were sent and are missing (in 1 streams)',
        '1 messages are there more than once (in 1 streams)',
        '1 messages come after one that was sent later (in 1 streams)',
    ]


def test_a_running_recording_is_not_damaged_but_its_losses_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / 'bag'
    with write_states(bag, 57, limits=Limits(seconds=0.03)) as writer:
        recorded = open_bag(bag).n_messages  # the rest is in a chunk that is not yet written
        assert 0 < recorded < 57
        status, found = in_json(bag, capsys)
        assert (status, found['recording'], found['findings']) == (0, True, [])
        assert main(['bag', 'info', str(bag)]) == 0
        text = capsys.readouterr().out
        assert 'DAMAGED' not in text
        assert 'the bag is being recorded: this is what it holds so far' in text
        with (bag / 'half.mcap').open('wb') as half:  # as while a chunk is being written
            half.write((bag / 'bag_0.mcap').read_bytes()[:-30])
            half.flush()
            fcntl.flock(half, fcntl.LOCK_EX)
            assert not check_bag(open_bag(bag / 'half.mcap')).damage
        (bag / 'half.mcap').unlink()
        writer.write('/game_state', state(99), START + 10**9)
        writer.flush()
        status, found = in_json(bag, capsys)
        assert (status, found['recording'], found['damage']) == (1, True, [])
        assert found['findings'] == ['42 messages were sent and are missing (in 1 streams)']
    status, found = in_json(bag, capsys)
    assert (status, found['recording'], found['damage']) == (1, False, [])


def damage(bag: Path, kind: str) -> None:
    """Damage a bag."""
    file, metadata = bag / f'{bag.name}_0.mcap', bag / 'metadata.yaml'
    data = bytearray(file.read_bytes())
    (first, second), (start, end), (last, _) = (chunk_at(bag, at) for at in (0, 4, 9))
    match kind:
        case 'byte of a chunk':
            data[(start + end) // 2] ^= 0xFF
        case 'byte of the attached file':
            data[data.index(b'{"a": 1}') + 6] = ord('2')
        case 'end within a chunk':
            del data[last + 100 :]
        case 'byte of the index':
            data[-60] ^= 0xFF
        case 'index and the chunk that describes the topics':
            data[-60] ^= 0xFF
            data[(first + second) // 2] ^= 1
        case 'chunks exchanged':
            data[first:end] = data[start:end] + data[second:start] + data[first:second]
        case 'huge chunk':
            struct.pack_into('<Q', data, start + 9 + 16, 2**40)
        case 'huge index':
            struct.pack_into('<Q', data, len(data) - 8 - 20, 100)  # where it begins
        case 'a fact':
            data[data.index(b'seed\1\0\0\0') + 8] = ord('8')
        case 'no metadata':
            metadata.unlink()
        case 'counts of metadata':
            text = metadata.read_text()
            metadata.write_text(text.replace('message_count: 100', 'message_count: 99'))
    file.write_bytes(data)


@pytest.mark.parametrize(
    ('kind', 'words', 'left'),
    [
        ('byte of a chunk', 'is damaged and left out', 180),
        ('byte of the attached file', 'checksum', 200),
        ('end within a chunk', 'cut short', 180),
        ('byte of the index', 'index is damaged', 200),
        ('index and the chunk that describes the topics', 'record of their topic is damaged', 0),
        ('chunks exchanged', 'another record', 100),
        ('huge chunk', 'crc validation failed', 200),
        ('huge index', 'index is damaged', 200),
        ('a fact', 'metadata.yaml and the record humanopts differ', 200),
        ('no metadata', 'metadata.yaml: No such file', 200),
        ('counts of metadata', 'metadata.yaml lists 99 messages; 100 were read', 200),
    ],
)
def test_damage_is_named_and_the_rest_is_saved(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    words: str,
    left: int,
) -> None:
    sent = contents(bag)
    damage(bag, kind)
    before = {file: file.read_bytes() for file in bag.iterdir()}
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main(['bag', 'check', str(bag), '--repair', str(tmp_path / 'out')]) == 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 100_000  # KiB
    assert words in capsys.readouterr().out
    assert {file: file.read_bytes() for file in bag.iterdir()} == before
    saved = contents(tmp_path / 'out')
    assert len(saved) == left
    assert [message for message in sent if message in set(saved)] == saved
    assert check_bag(open_bag(tmp_path / 'out')).damage == []


def test_a_repaired_bag_is_whole_for_other_tools_and_its_losses_count(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damage(bag, 'byte of a chunk')
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')  # no definitions are installed
    missing = {'/game#1': (100, 90, 10, 0, 0), RECORDER: (100, 90, 10, 0, 0)}
    assert numbers(bag) == missing
    assert repair(open_bag(bag), tmp_path / 'out') == 180
    with Reader(tmp_path / 'out') as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) == 180
    with (tmp_path / 'out' / 'out_0.mcap').open('rb') as stream:
        other = make_reader(stream, validate_crcs=True)
        assert sum(1 for _ in other.iter_messages()) == 180
        assert other.get_header().profile == 'ros2'
        (file,) = other.iter_attachments()
        assert (file.name, file.data, file.create_time) == ('options.json', b'{"a": 1}', 5)
        assert {m.name for m in other.iter_metadata()} == {'humanopts', 'rosbag2', REPAIR}
    out = open_bag(tmp_path / 'out')
    assert out.metadata['humanopts'] == {'seed': '7'}
    assert 'damaged and left out' in out.metadata[REPAIR]['damage']
    repair(out, tmp_path / 'again')
    assert numbers(tmp_path / 'out') == numbers(tmp_path / 'again') == missing


def test_a_repair_writes_only_where_nothing_is(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'out').mkdir()
    assert main(['bag', 'check', str(bag), '--repair', str(tmp_path / 'out')]) == 2
    assert 'already exists' in capsys.readouterr().err
    assert list((tmp_path / 'out').iterdir()) == []
    with pytest.raises(BagError, match='is inside'):
        repair(open_bag(bag), bag / 'out')
    assert not (bag / 'out').exists()


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """The same 200 messages in 12 files, the attached file in the last."""
    path = write(tmp_path / 'split', range(1, 101), limits=Limits(seconds=0.018))
    assert len(list(path.glob('*.mcap'))) == 12
    return path


def test_a_missing_file_is_named_and_counted_as_loss(
    split: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = len(contents(split / 'split_4.mcap'))
    (split / 'split_4.mcap').unlink()
    assert main(['bag', 'check', str(split)]) == 1
    text = capsys.readouterr().out
    assert 'split_4.mcap is' in text
    assert f'{lost} messages were sent and are missing (in 2 streams)' in text


@pytest.mark.parametrize(('place', 'whole_file'), [(0, True), (4, False), (11, True)])
def test_a_damaged_file_costs_only_its_damaged_part(
    split: Path, tmp_path: Path, place: int, whole_file: bool
) -> None:
    sent, file = contents(split), split / f'split_{place}.mcap'
    lost = contents(file) if whole_file else []
    # Without its end, it has no index.
    file.write_bytes(b'nothing of a bag' if whole_file else file.read_bytes()[:-100])
    assert any(file.name in text for text in check_bag(open_bag(split)).damage)
    repair(open_bag(split), tmp_path / 'out')
    assert contents(tmp_path / 'out') == [message for message in sent if message not in lost]
    kept = [each.name for each in open_bag(tmp_path / 'out').attachments]
    assert kept == ([] if place == 11 else ['options.json'])


def test_a_file_that_metadata_does_not_list_is_read_and_named(bag: Path) -> None:
    text = (bag / 'metadata.yaml').read_text()
    (bag / 'metadata.yaml').write_text(text.replace('bag_0.mcap', 'gone.mcap'))
    opened = open_bag(bag)
    assert opened.n_messages == 200
    assert 'gone.mcap is in metadata.yaml but does not exist' in opened.damage
    assert 'bag_0.mcap is not in metadata.yaml' in opened.damage


@pytest.mark.parametrize('end', ['\n', '\u2028', '\x1b[1A'])
def test_no_text_in_a_bag_ends_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], end: str
) -> None:
    fake = f'x{end}FAKE'
    info = DomainInfo(domain=fake, features=[], actions=[])
    lesson = LessonState(participant=fake, option_name=fake, paused=fake)
    state = GameState(publisher_id=f'/{fake}#1', sequence=5)
    messages = [('/domain_info', info), ('/lesson_state', lesson), ('/game_state', state)]
    write_messages(tmp_path / 'bag', [*messages, *messages], {fake: fake, 'domain': 'rooms'})
    for command in ('info', 'check', 'eval', 'play', 'table1'):
        main(['bag', command, str(tmp_path / 'bag')])
        text = ''.join(capsys.readouterr())
        assert [line for line in text.splitlines() if line.startswith('FAKE')] == []
        assert [c for c in text if not c.isprintable() and c != '\n'] == [], command


ROOT = 'rosbag2_bagfile_information'
_VALUE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
) | st.sampled_from([[f'a_{"9" * 5000}.mcap', 'bag_0.mcap', 'bag_99999.mcap', '/', '\0'], {}])
_TEXT = st.text(alphabet='[]{}:,-&*!<>| \n\tab0"', max_size=20)


@given(st.data())
@settings(
    max_examples=int(os.environ.get('GENERATED', '100')),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_a_bag_is_read_whatever_its_metadata_says(tmp_path: Path, data: st.DataObject) -> None:
    bag = tmp_path / 'bag'
    if not bag.exists():
        write(bag, range(1, 11))
    path = bag / 'metadata.yaml'
    kept = path.with_suffix('.kept')
    if not kept.exists():
        kept.write_bytes(path.read_bytes())
    text = kept.read_text()
    if data.draw(st.booleans()):
        values = yaml.safe_load(text)
        keys = st.sampled_from(sorted(values[ROOT]))
        values[ROOT] |= data.draw(st.dictionaries(keys, _VALUE, max_size=3))
        text = yaml.safe_dump(values)
    else:
        at = data.draw(st.integers(0, len(text)))
        text = text[:at] + data.draw(_TEXT) + text[at + data.draw(st.integers(0, 9)) :]
    path.write_text(text, 'utf-8', errors='surrogatepass')
    began = time.process_time()
    try:
        found = check_bag(open_bag(bag))
    except BagError as error:
        assert str(error).isprintable()  # noqa: PT017
    else:
        assert found.messages == 20
    assert time.process_time() - began < 1


def test_metadata_that_is_made_to_blow_up_is_damaged(bag: Path) -> None:
    names = 'abcdefghi'
    merges = [
        f'{new}: &{new} {{<<: [{",".join([f"*{old}"] * 9)}]}}\n' for old, new in pairwise(names)
    ]
    path = bag / 'metadata.yaml'
    path.write_text(f'a: &a {{k: v}}\n{"".join(merges)}{path.read_text()}')
    began = time.process_time()
    assert 'metadata.yaml is damaged: merge keys (<<)' in open_bag(bag).damage
    path.unlink()
    os.mkfifo(path)
    assert 'it is not a regular file' in open_bag(bag).damage
    assert time.process_time() - began < 1
