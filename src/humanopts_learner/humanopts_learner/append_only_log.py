"""Append-only files of JSON lines that survive crashes."""

from collections.abc import Callable
from contextlib import suppress
import errno
import os
from pathlib import Path
from typing import TypeVar

from humanopts_ros.limits import parse_json
from humanopts_ros.text_files import read_regular

T = TypeVar('T')
_APPENDING = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK
MAX_NAMED = 20  # problems of one file that are named; the others are counted


class AppendOnlyLog:
    """
    A file of JSON lines to which lines are only added.

    A line is on disk (fsync) before ``append`` returns. A last line that a crash cut off is moved
    aside when the file is opened; a line that was written whole is never lost.
    """

    def __init__(self, path: Path) -> None:
        """
        Open the file, which need not exist, and repair its end.

        :raises OSError: it is not a regular file, cannot be read, or its end cannot be repaired.
        """
        self.path = path
        self.problems: list[str] = []  # what was repaired or left out, in words
        content = read_in_place(path) if path.exists() or path.is_symlink() else b''
        end = content.rfind(b'\n') + 1
        torn = content[end:]
        if not torn:
            return
        try:
            parse_json(torn.decode())
        except ValueError:
            aside = unused_name(path, 'torn')
            append_bytes(aside, torn)
            os.truncate(path, end)
            sync(path)
            self.problems.append(
                f'the last line of {path} was cut off; its {len(torn)} bytes are now in '
                f'{aside.name}, and all lines before it are kept'
            )
        else:  # it lacks only its end
            append_bytes(path, b'\n')

    def read(self, entry_of: Callable[[str], T]) -> list[T]:
        """
        Return the entries that the lines of the file hold.

        :param entry_of: returns the entry of a line, or raises a ValueError that says why it
            cannot be used; then the line is left out and named in ``problems``.
        :raises OSError: the file cannot be read.
        """
        entries, problems = read_lines(self.path, entry_of)
        self.problems += [each for each in problems if each not in self.problems]
        return entries

    def append(self, *lines: str) -> None:
        """
        Add lines.

        :raises OSError: they could not be written; the file is unchanged.
        """
        append_bytes(self.path, ''.join(f'{line}\n' for line in lines).encode())


def read_lines(
    path: Path, entry_of: Callable[[str], T], most: int | None = None
) -> tuple[list[T], list[str]]:
    """
    Read a file of lines without changing it, since another process may be writing it.

    :param entry_of: returns the entry of a line, or raises a ValueError that says why it cannot be
        used; then the line is left out.
    :param most: bytes that the file may have; None: any number.
    :return: the entries, and what was left out, in words.
    :raises OSError: it is not a regular file, is larger, or cannot be read; there may be none.
    """
    try:
        content = read_in_place(path, most)
    except FileNotFoundError:
        return [], []
    entries, problems, unnamed = [], list[str](), 0
    for number, line in enumerate(content.removesuffix(b'\n').split(b'\n') if content else (), 1):
        try:
            entries.append(entry_of(line.decode()))
        except ValueError as error:
            utf8 = isinstance(error, UnicodeDecodeError)
            why = 'it is not a text in UTF-8' if utf8 else str(error)
            if len(problems) < MAX_NAMED:
                problems.append(f'line {number} of {path} is left out: {why}')
            else:
                unnamed += 1
    if unnamed:
        problems.append(f'{unnamed:,} more lines of {path} are left out')
    return entries, problems


def read_in_place(path: Path, most: int | None = None) -> bytes:
    """
    Return the content of a regular file that lies here itself.

    :param most: bytes that it may have; None: any number.
    :raises OSError: it is a symbolic link, a folder, a pipe or a device, is larger, or cannot be
        read.
    """
    refuse_link(path)
    return read_regular(path, most, os.O_NOFOLLOW)


def append_bytes(path: Path, content: bytes) -> None:
    """
    Append and fsync.

    :raises OSError: it could not be written; the file is cut back to what it was.
    """
    refuse_link(path)
    handle = os.open(path, _APPENDING, 0o644)
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
