"""Files of JSON lines that are only appended to, and that a crash cannot spoil."""

from collections.abc import Callable
from contextlib import suppress
import errno
import os
from pathlib import Path
from typing import TypeVar

from humanopts_ros.limits import parse_json

T = TypeVar('T')


class AppendOnlyLog:
    """
    A file of JSON lines to which lines are added, and from which none is ever removed.

    A line is on disk (fsync) before ``append`` returns. A last line that a crash cut off is moved
    aside when the file is opened; a line that was written whole is never lost.
    """

    def __init__(self, path: Path) -> None:
        """
        Open the file, which need not exist, and repair its end.

        :raises OSError: it is a symbolic link, cannot be read, or its end cannot be repaired.
        """
        self.path = path
        self.problems: list[str] = []  # what was repaired or left out, in words
        content = self._content()
        end = content.rfind(b'\n') + 1
        if content[end:]:
            self._mend(end, content[end:])

    def read(self, entry_of: Callable[[str], T]) -> list[T]:
        """
        Return the entries that the lines of the file hold.

        :param entry_of: returns the entry of a line, or raises a ValueError that says why it
            cannot be used; then the line is left out and named in ``problems``.
        :raises OSError: the file cannot be read.
        """
        entries = []
        lines = self._content().decode(errors='replace').split('\n')[:-1]
        for number, line in enumerate(lines, start=1):
            try:
                entries.append(entry_of(line))
            except ValueError as error:
                problem = f'line {number} of {self.path} is left out: {error}'
                if problem not in self.problems:
                    self.problems.append(problem)
        return entries

    def append(self, *lines: str) -> None:
        """
        Add lines.

        :raises OSError: they could not be written; nothing of them is kept.
        """
        append_bytes(self.path, ''.join(f'{line}\n' for line in lines).encode())

    def _content(self) -> bytes:
        refuse_link(self.path)
        return self.path.read_bytes() if self.path.exists() else b''

    def _mend(self, size: int, torn: bytes) -> None:
        """Complete a last line that lacks only its end; move any other aside."""
        try:
            parse_json(torn.decode())
        except ValueError:
            aside = unused_name(self.path, 'torn')
            append_bytes(aside, torn)
            os.truncate(self.path, size)
            sync(self.path)
            self.problems.append(
                f'the last line of {self.path} was cut off; its {len(torn)} bytes are now in '
                f'{aside.name}, and all lines before it are kept'
            )
        else:
            append_bytes(self.path, b'\n')


def append_bytes(path: Path, content: bytes) -> None:
    """
    Append and fsync.

    :raises OSError: it could not be written; the file is cut back to what it was.
    """
    refuse_link(path)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o644)
    try:
        size = append_whole(handle, content, os.fsync)
    finally:
        os.close(handle)
    if size == 0:
        sync(path.parent)


def refuse_link(path: Path) -> None:
    """
    Refuse a symbolic link in the place of a file: what is written would be written elsewhere.

    :raises OSError: it is one.
    """
    if path.is_symlink():
        text = f'it is a symbolic link to {os.readlink(path)}; put the file itself there'
        raise OSError(errno.ELOOP, text, str(path))


def link_remark(directory: Path) -> str:
    """Return that a folder is a symbolic link, and where to, in words; empty: it is none."""
    if not directory.is_symlink():
        return ''
    return f'{directory} is a symbolic link: its files are those of {directory.resolve()}'


def append_whole(
    handle: int, content: bytes, finish: Callable[[int], object] = lambda _: None
) -> int:
    """
    Append to an open file.

    :param finish: is called after the last byte, such as ``os.fsync``.
    :return: the size of the file before, bytes.
    :raises OSError: it could not be written; the file is cut back to what it was.
    """
    size = os.fstat(handle).st_size
    try:
        left = memoryview(content)
        while left:
            left = left[os.write(handle, left) :]
        finish(handle)
    except OSError:
        with suppress(OSError):
            os.ftruncate(handle, size)
        raise
    return size


def sync(path: Path) -> None:
    """Write the changes of a file or a folder to disk (fsync)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def unused_name(path: Path, why: str) -> Path:
    """Return a path beside a file, to which it can be moved: its name with ``.WHY-1``, 2, ..."""
    number = 1
    while (aside := path.with_name(f'{path.name}.{why}-{number}')).exists():
        number += 1
    return aside
