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
MAX_NAMED = 20  # problems listed per file; the rest are only counted


class AppendOnlyLog:
    """
    An append-only file of JSON lines.

    A line is on disk (fsync) before ``append`` returns. A last line truncated by a crash is moved
    to another file on opening; a complete line is never lost.
    """

    def __init__(self, path: Path) -> None:
        """
        Open the file, which need not exist, and repair its last line.

        :raises OSError: the file is not regular, or cannot be read or repaired.
        """
        self.path = path
        self.problems: list[str] = []  # descriptions of repairs and skipped lines
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
        else:  # only the newline is missing
            append_bytes(path, b'\n')

    def read(self, entry_of: Callable[[str], T]) -> list[T]:
        """
        Parse the lines of the file into entries.

        :param entry_of: parser of a line; if it raises a ValueError, the line is skipped and the
            reason is added to ``problems``.
        :raises OSError: the file cannot be read.
        """
        entries, problems = read_lines(self.path, entry_of)
        self.problems += [each for each in problems if each not in self.problems]
        return entries

    def append(self, *lines: str) -> None:
        """
        Append lines.

        :raises OSError: writing failed; the file is unchanged.
        """
        append_bytes(self.path, ''.join(f'{line}\n' for line in lines).encode())


def read_lines(
    path: Path, entry_of: Callable[[str], T], most: int | None = None
) -> tuple[list[T], list[str]]:
    """
    Read a file of lines without changing it, since another process may be writing it.

    :param entry_of: parser of a line; if it raises a ValueError, the line is skipped.
    :param most: maximum file size in bytes; None: unlimited.
    :return: the entries, and descriptions of skipped lines; a missing file has no entries.
    :raises OSError: the file is not regular, is too large, or cannot be read.
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
            why = 'it is not UTF-8 text' if utf8 else str(error)
            if len(problems) < MAX_NAMED:
                problems.append(f'line {number} of {path} is left out: {why}')
            else:
                unnamed += 1
    if unnamed:
        problems.append(f'{unnamed:,} more lines of {path} are left out')
    return entries, problems


def read_in_place(path: Path, most: int | None = None) -> bytes:
    """
    Return the content of a regular file, without following symbolic links.

    :param most: maximum size in bytes; None: unlimited.
    :raises OSError: the file is not regular, is too large, or cannot be read.
    """
    refuse_link(path)
    return read_regular(path, most, os.O_NOFOLLOW)


def append_bytes(path: Path, content: bytes) -> None:
    """
    Append to a file and sync it to disk.

    :raises OSError: writing failed; the file is truncated to its previous size, or deleted if that
        is zero.
    """
    refuse_link(path)
    handle = os.open(path, _APPENDING, 0o644)
    try:
        size = append_whole(handle, content, os.fsync)
    except OSError:
        if not os.fstat(handle).st_size:
            path.unlink(missing_ok=True)
        raise
    finally:
        os.close(handle)
    if size == 0:
        sync(path.parent)


def refuse_link(path: Path) -> None:
    """
    Refuse a symbolic link, since writing to it would change a file elsewhere.

    :raises OSError: the path is a symbolic link.
    """
    if path.is_symlink():
        text = f'it is a symbolic link to {os.readlink(path)}; put the file itself there'
        raise OSError(errno.ELOOP, text, str(path))


def link_remark(directory: Path) -> str:
    """Return a remark that names the target if a folder is a symbolic link; otherwise empty."""
    if not directory.is_symlink():
        return ''
    return f'{directory} is a symbolic link: its files are those of {directory.resolve()}'


def append_whole(
    handle: int, content: bytes, finish: Callable[[int], object] = lambda _: None
) -> int:
    """
    Append to an open file.

    :param finish: called after the last byte, such as ``os.fsync``.
    :return: previous size of the file in bytes.
    :raises OSError: writing failed; the file is truncated to its previous size.
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
    """Flush changes of a file or folder to disk (fsync)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def unused_name(path: Path, why: str) -> Path:
    """Return an unused path in the same folder: the file name plus ``.WHY-1``, ``.WHY-2``, ..."""
    number = 1
    while (aside := path.with_name(f'{path.name}.{why}-{number}')).exists():
        number += 1
    return aside
