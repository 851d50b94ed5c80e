"""
Files that people write, and YAML within limits.

Code that reads a file named by a person, a plan or a bag uses the functions here, so that neither
a device, an endless file nor a text made to blow up can stop or end a command.
"""

from collections.abc import Iterable, Iterator
import errno
import json
import os
from pathlib import Path
import re
import stat
from typing import Any, TYPE_CHECKING

from humanopts_ros.limits import MAX_DEPTH, MAX_INTEGER, shown
import yaml

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_TEXT = 2**20  # bytes of a text file
MAX_YAML = 4 * 2**20  # characters of a YAML text
MAX_NODES = 200_000  # values of a YAML text, those that aliases repeat included
MAX_ALIASES = 100  # repetitions (*name) in a YAML text
_MAX_DIRECTIVES = 4  # lines that begin with %; libyaml compares each with all before it
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_INTEGER = re.compile(r'0|-?[1-9][0-9]*')
_FLOAT = re.compile(r'-?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?')
_NOT_FINITE = re.compile(r'[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)')
_MAX_NUMBER = 400  # characters of a number
_BOOLEANS = {
    written: value
    for value, words in ((True, ('true', 'yes', 'on')), (False, ('false', 'no', 'off')))
    for word in words
    for written in (word, word.capitalize(), word.upper())
}
_NULL = ('', '~', 'null', 'Null', 'NULL')


class FileError(ValueError):
    """A file cannot be used; the text says why."""


class YamlError(FileError):
    """A text is not YAML that can be used; the text says where and why."""


def read_regular(path: Path, most: int | None = None, flags: int = 0) -> bytes:
    """
    Return the contents of a regular file; devices, pipes and folders are refused unread.

    :param most: bytes; None: any number.
    :param flags: of ``os.open``, besides those of reading.
    :raises OSError: it cannot be read, is not a regular file, or is larger.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC | flags)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, 'it is not a regular file', str(path))
        with open(handle, 'rb', closefd=False) as file:
            content = file.read(-1 if most is None else most + 1)
    finally:
        os.close(handle)
    if most is not None and len(content) > most:
        raise OSError(errno.EFBIG, f'it is larger than {most:,} bytes, the limit', str(path))
    return content


def read_bytes(path: Path, most: int = MAX_TEXT) -> bytes:
    """
    Return the contents of a regular file that a person named.

    :raises FileError: as ``read_regular``, or the path cannot be one.
    """
    try:
        return read_regular(path, most)
    except OSError as error:
        raise FileError(f'cannot read {_named(path)}: {error.strerror}') from error
    except ValueError as error:  # a NUL, or a name that is not in the encoding of file names
        raise FileError(f'cannot read {_named(path)}: it is not a file name') from error


def read_text(path: Path, most: int = MAX_TEXT) -> str:
    """
    Return the text of a regular file in UTF-8, without a byte order mark.

    :raises FileError: as ``read_bytes``, or it is not UTF-8.
    """
    try:
        text = read_bytes(path, most).decode('utf-8-sig')
    except UnicodeDecodeError:
        raise FileError(f'{_named(path)} is not a text in UTF-8') from None
    return text.replace('\r\n', '\n').replace('\r', '\n')


def read_yaml(path: Path, most: int = MAX_TEXT) -> Any:
    """
    Return the value of a YAML file, as ``parse_yaml`` does.

    :raises FileError: it cannot be read, or is not YAML that can be used.
    """
    text = read_text(path, most)
    try:
        return parse_yaml(text)
    except YamlError as error:
        raise YamlError(f'{_named(Path(path.name))}: {error}') from error


def _named(path: Path) -> str:
    return shown(str(path))


def parse_yaml(text: str) -> Any:
    """
    Return the value of a YAML text: dict, list, str, int, float, bool or None.

    Keys are texts, as written. Numbers are decimal, as in JSON and YAML 1.2; dates and other
    notations (010, 0x1F, 1_000, 12:30) are texts. Booleans are those of YAML 1.1: yes, no, on and
    off too. A value that an alias repeats is the same object, and is not to be changed.

    :raises YamlError: it is not YAML, exceeds a limit above, has two equal keys, merge keys (<<),
        tags or several documents, or holds a number that is too large or not finite.
    """
    if len(text) > MAX_YAML:
        raise YamlError(f'it has {len(text):,} characters, and {MAX_YAML:,} are allowed')
    if text.count('\n%') + text.startswith('%') > _MAX_DIRECTIVES:
        raise YamlError('it has too many directives, lines that begin with %: remove them')
    try:
        return _Document(yaml.parse(text, Loader=_LOADER)).value()
    except YamlError:
        raise
    except yaml.MarkedYAMLError as error:
        what = ', '.join(filter(None, (error.context, error.problem)))
        raise YamlError(f'it is not YAML: {shown(what)}{_place(error.problem_mark)}') from None
    except (yaml.YAMLError, ValueError) as error:  # characters that YAML does not allow
        raise YamlError(f'it is not YAML: {shown(" ".join(str(error).split()))}') from None


def _place(mark: Any) -> str:
    return f' (line {mark.line + 1}, column {mark.column + 1})' if mark is not None else ''


def fault_in(error: 'ValidationError', known: Iterable[str] = ()) -> str:
    """
    Return the first thing that is wrong with the values of a file, in one line.

    :param known: keys that the file may have.
    """
    first = error.errors(include_url=False)[0]
    place = ' '.join(str(each + 1 if isinstance(each, int) else each) for each in first['loc'])
    why = re.sub('^Value error, ', '', first['msg']).replace('Input should', 'it should')
    given = first['input']
    if first['type'] == 'extra_forbidden':
        why = f'unknown key; use {", ".join(known)}' if known else 'unknown key'
    elif not isinstance(given, dict | list):
        why += f', not {shown(json.dumps(given, ensure_ascii=False, default=str), 60)}'
    if first['type'] == 'string_type' and isinstance(given, bool | float):
        why += ': put it in quotes'
    return shown(f'{place}: {why}' if place else why)


class _Document:
    """The value of a YAML document, made from the events of the parser."""

    def __init__(self, events: Iterator[Any]) -> None:
        self._events = events
        self._anchors: dict[str, tuple[Any, int, int]] = {}  # value, values in it, their depth
        self._open: set[str] = set()  # anchors of values that are not complete
        self._nodes = self._aliases = 0

    def value(self) -> Any:
        """
        Return the value; None of an empty text.

        :raises YamlError: a limit is exceeded, or something cannot be used.
        """
        next(self._events)  # the stream begins
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        value, _ = self._read(next(self._events), 0)
        next(self._events)  # the document ends
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise _refused(after, 'it holds several documents (---): give one')
        return value

    def _read(self, event: Any, depth: int) -> tuple[Any, int]:
        """Return the value that begins with an event, and how many levels are below it."""
        if depth > MAX_DEPTH:
            raise _refused(event, f'it is nested more than {MAX_DEPTH} levels deep')
        if isinstance(event, yaml.AliasEvent):
            return self._repeat(event, depth)
        if event.tag is not None:
            raise _refused(event, f'it has the tag {shown(event.tag)}: remove tags (!)')
        if event.anchor is not None:
            self._open.add(event.anchor)
        before = self._nodes
        self._count(event, 1)
        value: Any
        if isinstance(event, yaml.ScalarEvent):
            value, below = _scalar(event), 0
        elif isinstance(event, yaml.SequenceStartEvent):
            value, below = self._list(depth)
        else:
            value, below = self._dict(depth)
        if event.anchor is not None:
            self._open.discard(event.anchor)
            self._anchors[event.anchor] = value, self._nodes - before, below
        return value, below

    def _list(self, depth: int) -> tuple[list[Any], int]:
        values, deepest = [], 0
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            value, below = self._read(event, depth + 1)
            values.append(value)
            deepest = max(deepest, below + 1)
        return values, deepest

    def _dict(self, depth: int) -> tuple[dict[str, Any], int]:
        values: dict[str, Any] = {}
        deepest = 0
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent) or event.tag is not None:
                raise _refused(event, 'a key has to be a plain text')
            key = str(event.value)
            if key == '<<' and event.implicit[0]:
                raise _refused(event, 'merge keys (<<) cannot be used: write the entries out')
            if key in values:
                raise _refused(event, f'the key {shown(key)!r} is there twice')
            if event.anchor is not None:
                raise _refused(event, 'a key cannot have an anchor (&)')
            self._count(event, 1)
            values[key], below = self._read(next(self._events), depth + 1)
            deepest = max(deepest, below + 1)
        return values, deepest

    def _repeat(self, event: Any, depth: int) -> tuple[Any, int]:
        self._aliases += 1
        if self._aliases > MAX_ALIASES:
            raise _refused(event, f'it has more than {MAX_ALIASES} aliases (*): write them out')
        if event.anchor in self._open or event.anchor not in self._anchors:
            raise _refused(event, f'the alias *{shown(event.anchor)} has no value before it')
        value, nodes, below = self._anchors[event.anchor]
        self._count(event, nodes)
        if depth + below > MAX_DEPTH:
            raise _refused(event, f'it is nested more than {MAX_DEPTH} levels deep')
        return value, below

    def _count(self, event: Any, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes > MAX_NODES:
            raise _refused(event, f'it holds more than {MAX_NODES:,} values')


def _refused(event: Any, why: str) -> YamlError:
    return YamlError(f'{why}{_place(event.start_mark)}')


def _scalar(event: Any) -> str | int | float | bool | None:
    """Return the value of a scalar; whatever is quoted is a text."""
    text = str(event.value)
    if not event.implicit[0]:
        return text
    if text in _NULL:
        return None
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if text[0] in '-+.0123456789' and len(text) <= _MAX_NUMBER:
        if _INTEGER.fullmatch(text):
            if abs(number := int(text)) >= MAX_INTEGER:
                raise _refused(event, 'it holds an integer that is too large')
            return number
        if _FLOAT.fullmatch(text):
            value = float(text)
            if abs(value) == float('inf'):
                raise _refused(event, f'it holds the number {shown(text)}, which is not finite')
            return value
        if _NOT_FINITE.fullmatch(text):
            raise _refused(event, f'it holds the number {text}, which is not finite')
    return text
