"""Which session a lesson goes on with whose process has died."""

from pathlib import Path
import subprocess
import sys

from humanopts_teach.lesson.store import OPEN_SESSION, OpenSessionFile
import pytest

ELSEWHERE = """
import sys
from pathlib import Path
from humanopts_teach.lesson.store import OpenSessionFile
OpenSessionFile(Path(sys.argv[1])).keep('p1', 's1')
"""


def test_a_process_of_the_same_parent_goes_on_with_what_was_open(tmp_path: Path) -> None:
    assert OpenSessionFile(tmp_path).left() is None
    OpenSessionFile(tmp_path).keep('p1', 's1')
    OpenSessionFile(tmp_path).keep('p1', 's2')
    assert OpenSessionFile(tmp_path).left() == ('p1', 's2')
    OpenSessionFile(tmp_path).forget()
    OpenSessionFile(tmp_path).forget()
    assert OpenSessionFile(tmp_path).left() is None
    assert list(tmp_path.iterdir()) == []


def test_a_process_of_another_parent_does_not(tmp_path: Path) -> None:
    subprocess.run([sys.executable, '-c', ELSEWHERE, str(tmp_path)], check=True)
    assert (tmp_path / OPEN_SESSION).exists()
    assert OpenSessionFile(tmp_path).left() is None


@pytest.mark.parametrize('text', ['', '[', '[]', '"x"', '{"parent": 1}', '\0', '[' * 100])
def test_a_file_that_cannot_be_read_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / OPEN_SESSION).write_text(text)
    assert OpenSessionFile(tmp_path).left() is None


def test_a_folder_that_cannot_be_written_stops_nobody(tmp_path: Path) -> None:
    place = OpenSessionFile(tmp_path / 'no such folder')
    place.keep('p1', 's1')
    assert place.left() is None
