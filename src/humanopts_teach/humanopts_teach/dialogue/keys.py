"""Keys: their names and labels, and what they do on a screen."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import string
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from humanopts_teach.dialogue.app import App

ENTER, ESCAPE, BACKSPACE, SPACE = 'enter', 'escape', 'backspace', ' '
INTERRUPT, END_OF_FILE, CLEAR, SUSPEND = 'ctrl-c', 'ctrl-d', 'ctrl-u', 'ctrl-z'
UP, DOWN, LEFT, RIGHT = 'up', 'down', 'left', 'right'
_LABELS = {UP: '↑', DOWN: '↓', LEFT: '←', RIGHT: '→', ENTER: 'Enter', ESCAPE: 'Esc'}
_LABELS |= {BACKSPACE: 'Backspace', SPACE: 'Space', INTERRUPT: 'Ctrl-C'}
_SPARE = string.ascii_lowercase + string.digits + string.ascii_uppercase
Do = Callable[['App'], object]


@dataclass(frozen=True, slots=True)
class Command:
    """
    One thing that a key does on a screen.

    :ivar wanted: its keys by preference.
    :ivar words: shown beside the key.
    :ivar do: None: not possible now; the key is neither shown nor given to another command.
    :ivar help: the same in a sentence; empty: ``words``.
    :ivar label: shown instead of the key's own; empty: the key is not shown.
    """

    wanted: Sequence[str]
    words: str
    do: Do | None
    help: str = ''
    label: str | None = None


KeyTable = dict[str, Command]


def key_table(commands: Iterable[Command]) -> KeyTable:
    """Give each command, in order, the first of its keys, or of all characters, that is free."""
    table: KeyTable = {}
    for each in commands:
        table[next(key for key in (*each.wanted, *_SPARE) if key not in table)] = each
    return table


def command_of(key: str, table: KeyTable) -> Command | None:
    """Return the command of a key; a letter without one stands for the other case."""
    return table.get(key) or table.get(key.swapcase() if len(key) == 1 else '')


def label(key: str) -> str:
    """Return how a key reads on the screen."""
    return _LABELS.get(key, key)
