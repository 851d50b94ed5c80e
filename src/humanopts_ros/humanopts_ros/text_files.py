"""
Reading of user-supplied files, and of YAML within limits.

These functions read files named by a user, a plan or a bag. Devices, endless files and malicious
YAML aliases cannot block or crash them.
"""

from collections.abc import Iterable, Iterator
import errno
from itertools import count
import json
import os
from pathlib import Path
import re
import stat
from typing import Any, TYPE_CHECKING, TypeVar

from humanopts_ros.limits import check_json, JsonError, MAX_DEPTH, shown
import yaml

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

M = TypeVar('M', bound='BaseModel')
MAX_TEXT = 2**20  # bytes of a text file
MAX_YAML = 4 * 2**20  # characters of a YAML text
MAX_NODES = 200_000  # values of a YAML text, including those repeated by aliases
_MAX_DIRECTIVES = 4  # lines that begin with %; libyaml compares all pairs of them
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_NUMBER = re.compile(r'-?((0|[1-9]\d{0,399})(\.\d*)?|\.\d+)([eE][-+]?\d+)?', re.ASCII)
_WORDS: dict[str, bool | None] = {**yaml.SafeLoader.bool_values, '': None, '~': None, 'null': None}


class FileError(ValueError):
    """A file is unusable; the message gives the reason."""


class YamlError(FileError):
    """A YAML text is invalid or exceeds a limit; the message gives the location and reason."""


def read_regular(path: Path, limit: int | None = None, flags: int = 0) -> bytes:
    """
    Return the contents of a regular file; reject devices, pipes and folders without reading.

    :param limit: maximum size in bytes; None: no limit.
    :param flags: additional flags for ``os.open``.
    :raises OSError: the file cannot be read, is not regular, or exceeds the limit.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC | flags)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, 'it is not a regular file', str(path))
        with open(handle, 'rb', closefd=False) as file:
            content = file.read(-1 if limit is None else limit + 1)
    finally:
        os.close(handle)
    if limit is not None and len(content) > limit:
        raise OSError(errno.EFBIG, f'it is larger than {limit:,} bytes, the limit', str(path))
    return content


def read_bytes(path: Path, limit: int = MAX_TEXT) -> bytes:
    """
    Return the contents of a regular file named by the user.

    :raises FileError: as in ``read_regular``, or the path is not a valid file name.
    """
    try:
        return read_regular(path, limit)
    except OSError as error:
        raise FileError(f'cannot read {_named(path)}: {error.strerror}') from error
    except ValueError as error:  # a NUL, or a name that the file system cannot encode
        raise FileError(f'cannot read {_named(path)}: it is not a file name') from error


def read_text(path: Path, limit: int = MAX_TEXT) -> str:
    """
    Return the text of a regular UTF-8 file, without a byte order mark.

    :raises FileError: as in ``read_bytes``, or the file is not UTF-8.
    """
    try:
        text = read_bytes(path, limit).decode('utf-8-sig')
    except UnicodeDecodeError:
        raise FileError(f'{_named(path)} is not UTF-8 text') from None
    return text.replace('\r\n', '\n').replace('\r', '\n')


def read_yaml(path: Path, limit: int = MAX_TEXT) -> Any:
    """
    Parse a YAML file with ``parse_yaml``.

    :raises FileError: the file cannot be read, or its YAML is invalid.
    """
    text = read_text(path, limit)
    try:
        return parse_yaml(text)
    except YamlError as error:
        raise YamlError(f'{_named(Path(path.name))}: {error}') from error


def _named(path: Path) -> str:
    return shown(str(path))


def parse_yaml(text: str) -> Any:
    """
    Parse a YAML text into dict, list, str, int, float, bool or None.

    Keys are strings, as written. Numbers are decimal, as in JSON and YAML 1.2; dates and other
    notations (010, 0x1F, 1_000, 12:30) are strings. Booleans are those of YAML 1.1, including yes,
    no, on and off.

    :raises YamlError: the text is invalid, exceeds a limit above, has duplicate keys, merge keys
        (<<), tags or several documents, or contains a number that is too large or not finite.
    """
    if len(text) > MAX_YAML:
        raise YamlError(f'it has {len(text):,} characters, but only {MAX_YAML:,} are allowed')
    if text.count('\n%') + text.startswith('%') > _MAX_DIRECTIVES:
        raise YamlError('it has too many directives, lines that begin with %: remove them')
    try:
        _check_events(text)
        node = yaml.compose(text, Loader=_LOADER)
        value = None if node is None else _value(node, 0, count(1))
        check_json(value)
    except JsonError as error:
        raise YamlError(str(error)) from None
    except yaml.MarkedYAMLError as error:
        what = ', '.join(filter(None, (error.context, error.problem)))
        raise YamlError(f'it is not YAML: {shown(what)}{_place(error.problem_mark)}') from None
    except yaml.YAMLError as error:  # characters that YAML does not allow
        raise YamlError(f'it is not YAML: {shown(" ".join(str(error).split()))}') from None
    return value


def _check_events(text: str) -> None:
    """
    Check depth, size and tags without recursion, since the parser could overflow the C stack.

    :raises YamlError: a limit is exceeded, or the text contains a tag.
    """
    depth = 0
    for number, event in enumerate(yaml.parse(text, Loader=_LOADER)):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH + 1:
            raise _refused(event, f'it is nested more than {MAX_DEPTH} levels deep')
        if number > 2 * MAX_NODES:
            raise _refused(event, f'it holds more than {MAX_NODES:,} values')
        if (tag := getattr(event, 'tag', None)) is not None:
            raise _refused(event, f'it has the tag {shown(tag)}: remove tags (!)')


def _value(node: yaml.Node, depth: int, number: Iterator[int]) -> Any:
    """Return the value of a node; values repeated by aliases count towards depth and number."""
    if depth > MAX_DEPTH:
        raise _refused(node, f'it is nested more than {MAX_DEPTH} levels deep')
    if next(number) > MAX_NODES:
        raise _refused(node, f'it holds more than {MAX_NODES:,} values')
    if isinstance(node, yaml.SequenceNode):
        return [_value(each, depth + 1, number) for each in node.value]
    if isinstance(node, yaml.ScalarNode):
        text = node.value
        if node.style:  # quoted, or a block
            return text
        if _NUMBER.fullmatch(text):
            return int(text) if text.lstrip('-').isdigit() else float(text)
        return _WORDS.get(text.lower(), text)
    values: dict[str, Any] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise _refused(key, 'a key must be plain text')
        if key.value == '<<' and not key.style:
            raise _refused(key, 'merge keys (<<) cannot be used: write the entries out')
        if key.value in values:
            raise _refused(key, f'the key {shown(key.value)!r} occurs twice')
        values[key.value] = _value(value, depth + 1, number)
    return values


def _place(mark: Any) -> str:
    return f' (line {mark.line + 1}, column {mark.column + 1})' if mark is not None else ''


def fault_in(error: 'ValidationError', known: Iterable[str] = ()) -> str:
    """
    Describe the first validation error of a file in one line.

    A missing key may be misspelled, so an unknown key beside it is the error described.

    :param known: keys allowed in the file.
    """
    first, *others = error.errors(include_url=False)
    if first['type'] == 'missing':
        unknown = (
            each
            for each in others
            if each['type'] == 'extra_forbidden' and each['loc'][:-1] == first['loc'][:-1]
        )
        first = next(unknown, first)
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


def model_of(kind: type[M], what: str, line: str) -> M:
    """
    Parse a line of JSON as a model.

    :param what: name of the model in the error message, with its article.
    :raises ValueError: the line is invalid; the message is a single line.
    """
    from pydantic import ValidationError

    try:
        return kind.model_validate_json(line)
    except ValidationError as error:
        raise ValueError(f'it is not {what}: {fault_in(error)}') from None


def _refused(place: Any, why: str) -> YamlError:
    return YamlError(f'{why}{_place(place.start_mark)}')
