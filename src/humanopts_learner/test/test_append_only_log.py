"""Files of JSON lines that a crash cannot spoil."""

import errno
import os
from pathlib import Path

from humanopts_learner.append_only_log import append_bytes, AppendOnlyLog
import pytest


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'lines.jsonl'


def test_what_was_appended_is_there_when_it_is_opened_again(path: Path) -> None:
    log = AppendOnlyLog(path)
    assert (log.lines, log.problems) == ([], [])
    for line in ('{"a": 1}', '{"name": "Zoë"}'):
        log.append(line)
    again = AppendOnlyLog(path)
    assert again.lines == log.lines == ['{"a": 1}', '{"name": "Zoë"}']
    assert again.problems == []


def test_a_link_is_refused_when_it_is_opened_and_when_it_comes_later(path: Path) -> None:
    other = path.with_name('other')
    other.write_bytes(b'{}\n')
    log = AppendOnlyLog(path)
    path.symlink_to(other)
    with pytest.raises(OSError, match='symbolic link to'):
        log.append('{"a": 1}')
    with pytest.raises(OSError, match='symbolic link to'):
        AppendOnlyLog(path)
    assert other.read_bytes() == b'{}\n'


def test_a_file_is_not_made_before_there_is_a_line(path: Path) -> None:
    AppendOnlyLog(path)
    assert not path.exists()


@pytest.mark.parametrize('torn', [b'{"a": ', b'{', 'é'.encode()[:1]])
def test_a_last_line_that_was_cut_off_is_moved_aside(path: Path, torn: bytes) -> None:
    path.write_bytes(b'{"a": 1}\n' + torn)
    log = AppendOnlyLog(path)
    assert log.lines == ['{"a": 1}']
    assert f'its {len(torn)} bytes are now in lines.jsonl.torn-1' in log.problems[0]
    assert path.with_name('lines.jsonl.torn-1').read_bytes() == torn
    log.append('{"b": 2}')
    assert AppendOnlyLog(path).lines == ['{"a": 1}', '{"b": 2}']


def test_a_second_torn_line_does_not_replace_the_first(path: Path) -> None:
    for torn in (b'{"first', b'{"second'):
        path.write_bytes(torn)
        AppendOnlyLog(path)
    names = ['lines.jsonl.torn-1', 'lines.jsonl.torn-2']
    assert [path.with_name(name).read_bytes() for name in names] == [b'{"first', b'{"second']


def test_a_last_line_that_lacks_only_its_end_is_kept(path: Path) -> None:
    path.write_bytes(b'{"a": 1}\n{"b": 2}')
    log = AppendOnlyLog(path)
    assert (log.lines, log.problems) == (['{"a": 1}', '{"b": 2}'], [])
    assert path.read_bytes() == b'{"a": 1}\n{"b": 2}\n'


def test_a_line_that_is_no_text_is_given_as_it_can_be_read(path: Path) -> None:
    path.write_bytes(b'\xff\n{"a": 1}\n')
    assert AppendOnlyLog(path).lines == ['\ufffd', '{"a": 1}']


def test_a_write_that_fails_half_way_leaves_the_file_as_it_was(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = AppendOnlyLog(path)
    log.append('{"a": 1}')
    write = os.write

    def full_disk(handle: int, content: memoryview) -> int:
        if len(content) > 4:
            return write(handle, content[:4])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, 'write', full_disk)
    with pytest.raises(OSError, match='No space left'):
        log.append('{"b": 2}')
    monkeypatch.undo()
    assert log.lines == ['{"a": 1}']
    assert path.read_bytes() == b'{"a": 1}\n'
    log.append('{"c": 3}')
    assert AppendOnlyLog(path).lines == ['{"a": 1}', '{"c": 3}']


def test_a_write_goes_on_after_a_part_of_it(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, 'write', lambda handle, content: write(handle, content[:3]))
    append_bytes(path, b'0123456789')
    assert path.read_bytes() == b'0123456789'
