"""The lesson's memory: for each participant one journal of what they said and showed."""

import errno
import fcntl
import os
from pathlib import Path
import re
from types import TracebackType

from humanopts_learner.journal import Journal
from humanopts_teach.demos.entries import Entry, entry_from_line, entry_to_line, EntryError

_SUFFIX = '.jsonl'
_LOCK = '.lock'
CODE = re.compile(r'[A-Za-z0-9_-]{1,60}')
CODE_RULE = 'letters, digits, - and _, at most 60 of them'


class StoreError(OSError):
    """The folder cannot be read or written; the text says why, and what to do."""


class DemonstrationStore:
    """What every participant said and showed, in one folder that one process uses at a time."""

    def __init__(self, directory: Path) -> None:
        """
        Open the folder, creating it where needed, and repair what a crash left behind.

        :raises StoreError: the folder cannot be made or read, or another process has it open.
        """
        self.directory = directory
        self.damage: list[str] = []  # what was found damaged, in words
        self._entries: dict[str, list[Entry]] = {}
        self._journals: dict[str, Journal] = {}
        self._lock = -1
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(directory / _LOCK)
            for path in sorted(directory.glob(f'*{_SUFFIX}')):
                self._entries[path.stem] = self._load(path)
        except OSError as error:
            self.close()
            raise _explained(error, f'open the folder of demonstrations {directory}') from error

    def __enter__(self) -> 'DemonstrationStore':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let another process use the folder."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def participants(self) -> list[str]:
        """Return the codes of everybody in the folder, sorted."""
        return sorted(self._entries)

    def entries(self, participant: str) -> tuple[Entry, ...]:
        """Return all that one participant said and showed, in that order."""
        return tuple(self._entries.get(participant, ()))

    def append(self, entry: Entry) -> None:
        """
        Keep an entry; it is on disk when this returns.

        :raises StoreError: it could not be written (disk full, folder gone); nothing of it is
            kept, and the same call can be tried again.
        :raises ValueError: the participant is not a code.
        """
        if not CODE.fullmatch(entry.participant):
            raise ValueError(f'participant {entry.participant!r} is not a code: {CODE_RULE}')
        path = self.directory / f'{entry.participant}{_SUFFIX}'
        try:
            if entry.participant not in self._journals:
                self._journals[entry.participant] = Journal(path)
            self._journals[entry.participant].append(entry_to_line(entry))
        except OSError as error:
            raise _explained(error, f'write to {path}') from error
        self._entries.setdefault(entry.participant, []).append(entry)

    def _load(self, path: Path) -> list[Entry]:
        journal = self._journals[path.stem] = Journal(path)
        if journal.damage:
            self.damage.append(journal.damage)
        found: list[Entry] = []
        for number, line in enumerate(journal.lines, start=1):
            try:
                entry = entry_from_line(line)
                if entry.participant != path.stem:
                    raise EntryError(f'it is of participant {entry.participant!r}')
                found.append(entry)
            except EntryError as error:
                self.damage.append(f'line {number} of {path} is left out: {error}')
        return found


def _lock(path: Path) -> int:
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _explained(error: OSError, what: str) -> StoreError:
    causes = {
        errno.ENOSPC: 'the disk is full; free some space and try again',
        errno.EDQUOT: 'the disk quota is used up; free some space and try again',
        errno.EACCES: 'no permission; choose another folder or change its permissions',
        errno.EROFS: 'the file system is read-only; choose another folder',
        errno.EWOULDBLOCK: 'another lesson has it open; end that one or choose another folder',
    }
    cause = causes.get(error.errno or 0, error.strerror or str(error))
    return StoreError(f'cannot {what}: {cause}')
