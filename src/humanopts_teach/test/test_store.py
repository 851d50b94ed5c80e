"""Entries of a lesson survive crashes; a restarted process resumes the open session."""

import os
from pathlib import Path
import subprocess
import sys

from humanopts_learner.demonstrations import Demonstration, GOAL, Kind
from humanopts_teach.lesson.store import (
    DemonstrationStore,
    Entry,
    entry_from_line,
    entry_to_line,
    EntryError,
    LessonEvent,
    OPEN_SESSION,
    OpenSessionFile,
    StoreError,
)
import pytest

KEY = ('taxi', '{}')
SESSION = LessonEvent('session', *KEY, 'p1', 's1')
DEMONSTRATION = Demonstration(
    kind=Kind.TRAJECTORY,
    uuid='3f0c1a52-3e0e-5d3a-9a43-8b6c3f6f0a11',
    domain='taxi',
    domain_parameters='{}',
    participant='p1',
    session='s1',
    option_name='go \N{RIGHTWARDS ARROW} "there"',
    number=1,
    chosen_features=('row',),
    feature_names=('row', 'col'),
    features=((0, 1), (0, 2)),
    states=('a', 'b'),
    actions=('east',),
    rewards=(-1.0,),
    seconds=0.5,
)
ENTRIES: list[Entry] = [
    SESSION,
    LessonEvent('option', *KEY, 'p1', 's1', 'go', ask_again=True, method=GOAL),
    LessonEvent('answer', *KEY, 'p1', 's1', 'go', 'row', yes=True),
    DEMONSTRATION,
]


def filled(directory: Path) -> Path:
    """Write all entries and return the participant's file."""
    with DemonstrationStore(directory) as store:
        for entry in ENTRIES:
            store.append(entry)
    return directory / 'p1.jsonl'


@pytest.mark.parametrize(
    ('line', 'says'),
    [
        ('{"version": 1, "entry": "session"', 'not JSON'),
        ('[]', 'version'),
        ('{"version": 2, "entry": "session"}', 'version'),
        ('{"version": 1, "entry": "dream"}', 'dream'),
        ('{"version": 1, "entry": ["session"]}', 'entry'),
        ('{"version": 1, "entry": "session", "domain": "taxi"}', 'domain_parameters'),
        ('{"version": 1, "entry": "demonstration"}', 'kind: Field required'),
        (entry_to_line(ENTRIES[2]).replace('true', '1'), 'yes'),
    ],
)
def test_a_line_that_is_no_entry_is_refused_with_the_reason(line: str, says: str) -> None:
    with pytest.raises(EntryError, match=says):
        entry_from_line(line)


def test_entries_come_back_in_order_after_a_restart(tmp_path: Path) -> None:
    filled(tmp_path)
    with DemonstrationStore(tmp_path) as store:
        assert store.participants() == ['p1']
        assert list(store.entries('p1')) == ENTRIES
        assert store.damage == []
        assert store.entries('stranger') == ()


@pytest.mark.parametrize(
    'line',
    [
        '[' * 100_000,
        '{"a":' * 900 + '1' + '}' * 900,
        '{"version": 1' + '0' * 6000 + '}',
        '[1e999]',
    ],
    ids=['deep', 'deep but whole', 'large', 'infinite'],
)
@pytest.mark.parametrize('torn', [False, True])
def test_json_that_cannot_be_used_does_not_keep_a_folder_from_starting(
    tmp_path: Path, line: str, torn: bool
) -> None:
    path = filled(tmp_path)
    path.write_bytes(path.read_bytes() + line.encode() + b'\n' * (not torn))
    with DemonstrationStore(tmp_path) as store:
        assert list(store.entries('p1')) == ENTRIES
        (damage,) = store.damage
    assert 'was cut off' in damage if torn else f'line {len(ENTRIES) + 1} of' in damage


def test_symbolic_links_are_named_and_nothing_is_written_through_them(tmp_path: Path) -> None:
    other = filled(tmp_path / 'other')
    content = other.read_bytes()
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'folder' / 'p1.jsonl').symlink_to(other)
    (tmp_path / 'link').symlink_to('folder')
    with DemonstrationStore(tmp_path / 'link') as store:
        assert [d.partition(' is ')[2][:25] for d in store.damage] == [
            'a symbolic link: its file',
            'left out: it is a symboli',
        ]
        assert store.entries('p1') == ()
        with pytest.raises(StoreError, match='symbolic link'):
            store.append(SESSION)
    assert other.read_bytes() == content


def test_lines_of_another_participant_are_left_out(tmp_path: Path) -> None:
    filled(tmp_path).rename(tmp_path / 'p2.jsonl')
    with DemonstrationStore(tmp_path) as store:
        assert store.entries('p2') == ()
        assert len(store.damage) == len(ENTRIES)


def test_a_line_is_synced_to_disk_before_append_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[bytes] = []
    real = os.fsync

    def fsync(handle: int) -> None:
        synced.append(Path(f'/proc/self/fd/{handle}').resolve().name.encode())
        real(handle)

    with DemonstrationStore(tmp_path) as store:
        monkeypatch.setattr(os, 'fsync', fsync)
        store.append(SESSION)
    assert synced == [b'p1.jsonl', tmp_path.name.encode()]  # the file, and its new name


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(StoreError, match='cannot open the folder of demonstrations'):
        DemonstrationStore(tmp_path / 'file' / 'below')
    with DemonstrationStore(gone := tmp_path / 'gone') as store:
        with pytest.raises(StoreError, match='another lesson'):
            DemonstrationStore(gone)
        (gone / '.lock').unlink()
        gone.rmdir()
        with pytest.raises(StoreError, match=r'cannot write to .*p1\.jsonl'):
            store.append(SESSION)
    DemonstrationStore(gone).close()


ELSEWHERE = """
import sys
from pathlib import Path
from humanopts_teach.lesson.store import OpenSessionFile
OpenSessionFile(Path(sys.argv[1])).keep('p1', 's1')
"""


def test_only_a_process_of_the_same_parent_goes_on_with_what_was_open(tmp_path: Path) -> None:
    place = OpenSessionFile(tmp_path)
    os.mkfifo(tmp_path / OPEN_SESSION)  # no process writes to it
    assert place.left() is None
    for session in ('s1', 's2'):
        place.keep('p1', session)
    assert OpenSessionFile(tmp_path).left() == ('p1', 's2')
    for _ in range(2):
        place.forget()
        assert place.left() is None
    assert list(tmp_path.iterdir()) == []
    subprocess.run([sys.executable, '-c', ELSEWHERE, str(tmp_path)], check=True)
    assert (tmp_path / OPEN_SESSION).exists()
    assert place.left() is None


@pytest.mark.parametrize('text', ['', '[]', '{"parent": 1}', '\0', '[' * 100])
def test_an_unreadable_file_of_the_open_session_is_ignored(tmp_path: Path, text: str) -> None:
    (tmp_path / OPEN_SESSION).write_text(text)
    assert OpenSessionFile(tmp_path).left() is None
    nowhere = OpenSessionFile(tmp_path / 'no such folder')
    nowhere.keep('p1', 's1')
    assert nowhere.left() is None
