"""
Limits for external input: messages, files and settings.

These functions reject deeply nested, oversized and non-finite values, and keep raw text out of
logs and terminals.
"""

from io import TextIOWrapper
import json
import math
import sys
from typing import Any
from unicodedata import normalize

MAX_JSON = 64 * 2**20  # characters of a JSON text
MAX_DEPTH = 40  # nesting levels of a JSON text
MAX_INTEGER = 2**64  # exclusive bound on the magnitude of integers in a JSON text
MAX_WHOLE = 2**31 - 1  # maximum integer in demonstrations and options; fits int32 arrays
MAX_STATE = 20_000  # characters of a game state as text
MAX_SHOWN = 400  # characters of an external text in a log, status or response


class JsonError(ValueError):
    """A text is not valid JSON within the limits; the message gives the reason."""


def parse_json(text: str, limit: int = MAX_JSON) -> Any:
    """
    Parse a JSON text within the limits above.

    :param limit: maximum length in characters.
    :raises JsonError: the text is too long, invalid or nested too deeply, or contains a number
        that is too large or not finite.
    """
    if len(text) > limit:
        raise JsonError(f'it has {len(text):,} characters, but only {limit:,} are allowed')
    try:
        value = json.loads(text)
    except RecursionError:
        raise JsonError(_TOO_DEEP) from None
    except json.JSONDecodeError as error:
        raise JsonError(str(error)) from None
    except ValueError:  # an integer with too many digits for Python
        raise JsonError(_TOO_LARGE) from None
    check_json(value)
    return value


_TOO_DEEP = f'it is nested more than {MAX_DEPTH} levels deep'
_TOO_LARGE = 'it holds an integer that is too large'


def check_json(value: Any) -> None:
    """
    Check the depth and the numbers of a parsed text, level by level.

    :raises JsonError: as in ``parse_json``.
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
    """Return a text in Unicode composed form (NFC), in which é is a single character."""
    return normalize('NFC', text)


def caseless(text: str) -> str:
    """Return a text for comparisons that ignore case and Unicode normalisation."""
    return normalize('NFC', normalize('NFD', text).casefold())


def printable(text: str) -> str:
    """Escape unprintable characters, except line breaks, for output on a terminal."""
    if text.isprintable():
        return text
    return ''.join(
        char if char.isprintable() or char == '\n' else char.encode('unicode_escape').decode()
        for char in text
    )


def one_line(text: str) -> str:
    """
    Return an external text as one printable line.

    The text cannot break the line, move the cursor or change the writing direction, so it cannot
    imitate humanopts' own output.
    """
    return printable(text.replace('\n', ' '))


def shown(text: str, limit: int = MAX_SHOWN) -> str:
    """Return an external text as one printable line, shortened to its beginning and end."""
    if len(text) > limit:
        half = (limit - 5) // 2
        text = f'{text[:half]} ... {text[-half:]}'
    line = one_line(text)
    return line if len(line) <= 2 * limit else f'{line[:limit]} ...'


def accept_any_text() -> None:
    """
    Let the standard streams accept any text in every locale.

    Call once at the start of a process. In output, characters that the locale lacks are escaped;
    in input, invalid bytes are replaced.
    """
    for stream, errors in (
        (sys.stdin, 'replace'),
        (sys.stdout, 'backslashreplace'),
        (sys.stderr, 'backslashreplace'),
    ):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=errors)
