"""
Limits of what comes from outside: messages, files and settings.

Code that reads them uses the functions here, so that nothing nested too deeply, too long or not
finite gets any further, and nothing of it reaches a log or a terminal as it came.
"""

from io import TextIOWrapper
import json
import math
import sys
from typing import Any
from unicodedata import normalize

MAX_JSON = 64 * 2**20  # characters of a JSON text, such as an option with its demonstrations
MAX_DEPTH = 40  # levels of lists and objects in a JSON text
MAX_INTEGER = 2**64  # integers in a JSON text are smaller, and greater than its negative
MAX_WHOLE = 2**31 - 1  # whole numbers of demonstrations and options, which fit int32 arrays
MAX_STATE = 20_000  # characters of a state of a game, in its domain's notation
MAX_SHOWN = 400  # characters of a text from outside in a log, a status or an answer


class JsonError(ValueError):
    """A text is not JSON that can be used; the text says why."""


def parse_json(text: str, limit: int = MAX_JSON) -> Any:
    """
    Return the value of a JSON text within the limits above.

    :param limit: in characters.
    :raises JsonError: it is longer, is not JSON, is nested too deeply, or holds a number that is
        too large or not finite.
    """
    if len(text) > limit:
        raise JsonError(f'it has {len(text):,} characters, and {limit:,} are allowed')
    try:
        value = json.loads(text)
    except RecursionError:
        raise JsonError(_TOO_DEEP) from None
    except json.JSONDecodeError as error:
        raise JsonError(str(error)) from None
    except ValueError:  # an integer of more digits than Python converts
        raise JsonError(_TOO_LARGE) from None
    check_json(value)
    return value


_TOO_DEEP = f'it is nested more than {MAX_DEPTH} levels deep'
_TOO_LARGE = 'it holds an integer that is too large'


def check_json(value: Any) -> None:
    """
    Check depth and numbers of a parsed text, one level after the other.

    :raises JsonError: as ``parse_json``.
    """
    level, depth = [value], 0
    while level:
        if depth > MAX_DEPTH:
            raise JsonError(_TOO_DEEP)
        depth += 1
        below: list[Any] = []
        for each in level:
            if type(each) is dict:
                below.extend(each.values())
            elif type(each) is list:
                below.extend(each)
            elif type(each) is int:
                if not -MAX_INTEGER < each < MAX_INTEGER:
                    raise JsonError(_TOO_LARGE)
            elif type(each) is float and not math.isfinite(each):
                raise JsonError(f'it holds the number {each}, which is not finite')
        level = below


def composed(text: str) -> str:
    """Return a text in Unicode's composed form (NFC): é is one character, however it was typed."""
    return normalize('NFC', text)


def caseless(text: str) -> str:
    """Return a text for comparisons in which neither case nor the form of letters counts."""
    return normalize('NFC', normalize('NFD', text).casefold())


def printable(text: str) -> str:
    """Return a text for a terminal, with escapes for unprintable characters except line breaks."""
    if text.isprintable():
        return text
    return ''.join(
        char if char.isprintable() or char == '\n' else char.encode('unicode_escape').decode()
        for char in text
    )


def one_line(text: str) -> str:
    """
    Return a text from outside in one printable line.

    Nothing in it ends the line, moves the cursor or turns the direction of writing, so that none
    of it looks like a line of ours.
    """
    return printable(text.replace('\n', ' '))


def shown(text: str, limit: int = MAX_SHOWN) -> str:
    """Return external text in one printable line; of a long text, the beginning and the end."""
    if len(text) > limit:
        half = (limit - 5) // 2
        text = f'{text[:half]} ... {text[-half:]}'
    line = one_line(text)
    return line if len(line) <= 2 * limit else f'{line[:limit]} ...'


def accept_any_text() -> None:
    """
    Let standard output take every text, and standard input give every byte, whatever the locale.

    To be called once where a process begins: what the locale does not have becomes an escape.
    """
    for stream, errors in (
        (sys.stdin, 'replace'),
        (sys.stdout, 'backslashreplace'),
        (sys.stderr, 'backslashreplace'),
    ):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=errors)
