"""
The bags of one recording: a recorder that is started again begins the next, beside the first.

They are ``bag``, ``bag-2``, ``bag-3``: a bag whose recorder died stays as it was left.
"""

from collections.abc import Iterator
from itertools import count, takewhile
from pathlib import Path


def _names(bag: Path) -> Iterator[Path]:
    yield bag
    for number in count(2):
        yield bag.with_name(f'{bag.name}-{number}')


def parts(bag: Path) -> list[Path]:
    """Return the bags of a recording that there are, in order."""
    return list(takewhile(Path.exists, _names(bag)))


def next_part(bag: Path) -> Path:
    """Return where the recording of a bag is to be begun, or goes on."""
    return next(path for path in _names(bag) if not path.exists())
