"""
The entries of a lesson on disk, with one file of answers and demonstrations per participant.

Each line of JSON is one entry, which is durable (fsync) before the lesson continues.
"""

from collections.abc import Iterable
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass
import errno
import fcntl
from functools import partial
import json
import os
from pathlib import Path
import re
from typing import Annotated, Literal, TextIO

from humanopts_learner.append_only_log import AppendOnlyLog, link_remark
from humanopts_learner.demonstrations import Demonstration, DemonstrationError
from humanopts_ros.limits import caseless, composed, JsonError, parse_json
from humanopts_ros.text_files import fault_in, FileError, read_text
import psutil
from pydantic import AfterValidator, TypeAdapter, ValidationError

VERSION = 1  # of the line format
OPEN_SESSION = 'open_session.json'
_SUFFIX = '.jsonl'
_LOCK = '.lock'
CODE = re.compile(r'[A-Za-z0-9_-]{1,60}')  # participants (also file names) and sessions
CODE_RULE = 'use at most 60 letters, digits, - and _'


def similar_code(code: str, known: Iterable[str]) -> str:
    """Return a known code that differs only in case; empty: none, or the code is known."""
    similar = [each for each in known if caseless(each) == caseless(code)]
    return '' if code in similar else next(iter(similar), '')


class EntryError(ValueError):
    """A line is not an entry; the message says why."""


@dataclass(frozen=True, slots=True)
class LessonEvent:
    """An event in a lesson; all kinds except the first two name an option."""

    entry: Literal['session', 'feature', 'option', 'answer', 'answer taken back', 'option deleted']
    domain: str
    domain_parameters: str  # JSON object
    participant: str
    session: str
    option_name: Annotated[str, AfterValidator(composed)] = ''
    feature: str = ''  # of the question; with "feature": the derived feature that is added
    yes: bool = False  # the answer
    ask_again: bool = False  # with "option": discard earlier answers
    method: str = ''  # with "option": requested learning method; empty: none


Entry = LessonEvent | Demonstration
_EVENT = TypeAdapter(LessonEvent)


def entry_to_line(entry: Entry) -> str:
    """Return the entry as one line of JSON, without a newline."""
    if isinstance(entry, Demonstration):
        values = {'entry': 'demonstration', **json.loads(entry.to_json())}
    else:
        values = {name: value for name, value in asdict(entry).items() if value not in ('', False)}
    return json.dumps({'version': VERSION, **values}, sort_keys=True)


def entry_from_line(line: str) -> Entry:
    """
    Return the entry written by ``entry_to_line``.

    :raises EntryError: the line is not JSON, has another version, or a field is invalid or absent.
    """
    try:
        values = parse_json(line)
        if not isinstance(values, dict) or values.get('version') != VERSION:
            raise EntryError(f'it is not an entry of version {VERSION}')
        if values.get('entry') == 'demonstration':
            return Demonstration.from_fields(values)
        return _EVENT.validate_json(line, strict=True)
    except JsonError as error:
        raise EntryError(f'it is not JSON: {error}') from None
    except DemonstrationError as error:
        raise EntryError(str(error)) from None
    except ValidationError as error:
        raise EntryError(fault_in(error)) from None


class StoreError(OSError):
    """The folder cannot be read or written; the message says why, and what to do."""


class DemonstrationStore(AbstractContextManager['DemonstrationStore']):
    """
    The entries of all participants, in a folder used by one process at a time.

    They are read from files on request, and not kept in memory.
    """

    def __init__(self, directory: Path) -> None:
        """
        Open the folder, creating it if needed, and repair damage from crashes.

        :raises StoreError: the folder cannot be created or read, or another process uses it.
        """
        self.directory = directory
        self.damage: list[str] = []  # descriptions of damage found
        self._logs: dict[str, AppendOnlyLog] = {}  # by participant
        self._lock: TextIO | None = None
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if remark := link_remark(directory):
                self.damage.append(remark)
            self._lock = (directory / _LOCK).open('a', encoding='utf-8')
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in sorted(directory.glob(f'*{_SUFFIX}')):
                if path.is_symlink():
                    self.damage.append(f'{path} is left out: it is a symbolic link')
                elif not path.is_file():
                    self.damage.append(f'{path} is left out: it is not a regular file')
                else:
                    log = self._logs[path.stem] = AppendOnlyLog(path)
                    log.read(partial(_entry_of, path.stem))
                    self.damage += log.problems
        except OSError as error:
            self.close()
            raise _explained(error, f'open the folder of demonstrations {directory}') from error

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Unlock the folder for another process."""
        if self._lock is not None:
            self._lock.close()

    def participants(self) -> list[str]:
        """Return the codes of all participants in the folder, sorted."""
        return sorted(self._logs)

    def entries(self, participant: str) -> tuple[Entry, ...]:
        """
        Return the entries of one participant, in the order written.

        :raises StoreError: the file cannot be read.
        """
        log = self._logs.get(participant)
        try:
            return tuple(log.read(partial(_entry_of, participant))) if log is not None else ()
        except OSError as error:
            raise _explained(error, f'read what {participant} did') from error

    def append(self, *entries: Entry) -> None:
        """
        Append entries of one participant; they are on disk when this returns.

        :raises StoreError: writing failed (disk full, folder gone); nothing is stored, and the
            call can be repeated.
        """
        participant = entries[0].participant
        path = self.directory / f'{participant}{_SUFFIX}'
        try:
            log = self._logs.get(participant) or AppendOnlyLog(path)
            log.append(*map(entry_to_line, entries))
        except OSError as error:
            raise _explained(error, f'write to {path}') from error
        self._logs[participant] = log


def _entry_of(participant: str, line: str) -> Entry:
    """
    Return the entry in a line.

    :raises EntryError: the line is not an entry, or belongs to another participant.
    """
    entry = entry_from_line(line)
    if entry.participant != participant:
        raise EntryError(f'it is of participant {entry.participant!r}')
    return entry


def _explained(error: OSError, what: str) -> StoreError:
    causes = {
        errno.ENOSPC: 'the disk is full; free some space and try again',
        errno.EACCES: 'no permission; choose another folder or change its permissions',
        errno.EWOULDBLOCK: 'another lesson has it open; end that one or choose another folder',
    }
    cause = causes.get(error.errno or 0, error.strerror or str(error))
    return StoreError(f'cannot {what}: {cause}')


class OpenSessionFile:
    """
    The file in the demonstrations folder that names the open session.

    A restarted lesson node resumes this session, but only if it has the same parent process, that
    is, if the same launcher restarted it; the next launch opens a new session.
    """

    def __init__(self, folder: Path) -> None:
        """Set the path, without writing the file."""
        self._path = folder / OPEN_SESSION
        parent = psutil.Process(os.getppid())
        self._parent = f'{parent.pid} {parent.create_time()}'

    def left(self) -> tuple[str, str] | None:
        """Return the participant and session left open by an earlier process, if any."""
        try:
            values = parse_json(read_text(self._path))
            if values['parent'] == self._parent:
                return str(values['participant']), str(values['session'])
        except (FileError, JsonError, LookupError, TypeError):
            pass  # no such file, or written by another launch
        return None

    def keep(self, participant: str, session: str) -> None:
        """Record the open session; if that fails, a restarted lesson has no session."""
        values = {'parent': self._parent, 'participant': participant, 'session': session}
        new = self._path.with_name(f'{OPEN_SESSION}.new')
        with suppress(OSError):
            new.write_text(json.dumps(values), 'utf-8')
            os.replace(new, self._path)

    def forget(self) -> None:
        """Record that no session is open."""
        with suppress(OSError):
            self._path.unlink()
