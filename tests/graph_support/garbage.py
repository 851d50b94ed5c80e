"""Random messages of any type of the graph, by a seeded generator."""

import math
import random
import re
from typing import Any

from humanopts_teach.ros.raw_subscriber import load_type

# Words that get past the first check, beside those that do not.
WORDS = (
    '', 'taxi', 'north', 'pickup', 'p1', 'human', 'primitive', 'interrupted', 'failures', 'trees',
    'go to passenger and pickup', 'action:north', 'taxi 2,2 passenger aboard destination G',
    '{}', '{"rows": 5, "cols": 5}', '[' * 50_000, '{"a":' * 5000, '\x1b[2J\x1b]0;x\x07',
    '\u202e', '\U0001f600' * 3000, 'x' * 20_000, '/game#garbage', '/stranger#1', 'NaN', '-1', ' ',
    '../../etc/passwd',
)  # fmt: skip
REALS = (0.0, -1.0, 1.0, math.nan, math.inf, -math.inf, 1e308, -1e-300, 0.5)
MOST_WORK = 50  # in fields that say how much is to be computed
_WORK = re.compile(r'episodes|tasks|max_|steps|sweeps|game_|sizes?|budget')
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>|(.+)\[(\d+)\]')
_INTEGER = re.compile(r'(u?)int(\d+)')


class Garbage:
    """Makes messages; the same seed makes the same ones."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    def message(self, kind: Any, like: Any = None) -> Any:
        """
        Return a message.

        :param like: a message that was right, of which a copy with a changed field or two is as
            likely; None: there is none.
        """
        fields = kind.get_fields_and_field_types()
        if like is not None and self._rng.random() < 0.5:
            made = kind(**{name: getattr(like, name) for name in fields})
            for name in self._rng.sample(
                sorted(fields), min(len(fields), self._rng.choice((1, 2)))
            ):
                setattr(made, name, self._value(fields[name], name))
            if hasattr(made, 'publisher_id'):  # signed as the node, but not as its process
                made.publisher_id = f'{like.publisher_id.partition("#")[0]}#garbage'
            return made
        return kind(**{name: self._value(type_, name) for name, type_ in fields.items()})

    def raw(self) -> bytes:
        """Return bytes that are no message of any type, but for chance."""
        head = self._rng.choice((b'\0\1\0\0', b'\0\0\0\0', b''))
        return head + self._rng.randbytes(self._rng.choice((0, 1, 7, 60, 3000)))

    def _value(self, kind: str, name: str) -> Any:
        rng = self._rng
        if found := _SEQUENCE.fullmatch(kind):
            element, count = found[1] or found[3], int(found[4] or 0)
            size = count or rng.choice((0, 0, 1, 2, 7, 40))
            return self._several(element, size, name)
        if '/' in kind:
            package, own = kind.split('/')
            return self.message(load_type(f'{package}/msg/{own}'))
        return self._plain(kind, name)

    def _several(self, element: str, size: int, name: str) -> Any:
        values = [self._value(element, name) for _ in range(size)]
        return bytes(v[0] for v in values) if element == 'octet' and size else values

    def _plain(self, kind: str, name: str) -> Any:
        rng = self._rng
        if kind == 'boolean':
            return rng.random() < 0.5
        if kind in ('float', 'double'):
            value = rng.choice((*REALS, rng.uniform(-1e3, 1e3)))
            return (
                max(-3e38, min(3e38, value)) if math.isfinite(value) and kind == 'float' else value
            )
        if kind == 'octet':
            return rng.randbytes(1)
        if found := _INTEGER.fullmatch(kind):
            bits, signed = int(found[2]), not found[1]
            low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
            if _WORK.search(name):
                return rng.randint(0, MOST_WORK)
            return rng.choice((0, 1, 2, 3, low, high, rng.randint(low, high)))
        if kind.startswith(('string', 'wstring')):
            if rng.random() < 0.2:
                return ''.join(chr(rng.randint(1, 0x2FFF)) for _ in range(rng.randint(0, 30)))
            return rng.choice(WORDS)
        raise ValueError(f'no garbage of type {kind}')
