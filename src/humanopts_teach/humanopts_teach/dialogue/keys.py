"""Keys: names, labels and commands."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import string
from typing import TYPE_CHECKING

from humanopts_teach.language import _, N_

if TYPE_CHECKING:
    from humanopts_teach.dialogue.app import App

ENTER, ESCAPE, BACKSPACE, SPACE = 'enter', 'escape', 'backspace', ' '
INTERRUPT, END_OF_FILE, CLEAR, SUSPEND = 'ctrl-c', 'ctrl-d', 'ctrl-u', 'ctrl-z'
UP, DOWN, LEFT, RIGHT = 'up', 'down', 'left', 'right'
_LABELS = {UP: '↑', DOWN: '↓', LEFT: '←', RIGHT: '→', ENTER: N_('Enter'), ESCAPE: N_('Esc')}
_LABELS |= {BACKSPACE: N_('Backspace'), SPACE: N_('Space'), INTERRUPT: N_('Ctrl-C')}
_SPARE = string.ascii_lowercase + string.digits + string.ascii_uppercase
Do = Callable[['App'], object]


@dataclass(frozen=True, slots=True)
class Command:
    """
    A command bound to a key on a screen.

    :ivar wanted: preferred keys, in order.
    :ivar words: short description, shown next to the key.
    :ivar do: callback; None: currently unavailable, and the key is hidden but stays reserved.
    :ivar help: description in a sentence; empty: ``words``.
    :ivar label: label shown instead of the key's own; empty: the key is shown only in the help, if
        it has one.
    """

    wanted: Sequence[str]
    words: str
    do: Do | None
    help: str = ''
    label: str | None = None


KeyTable = dict[str, Command]


def key_table(commands: Iterable[Command]) -> KeyTable:
    """Bind each command, in order, to its first free preferred key, or else any free character."""
    table: KeyTable = {}
    for each in commands:
        table[next(key for key in (*each.wanted, *_SPARE) if key not in table)] = each
    return table


def command_of(key: str, table: KeyTable) -> Command | None:
    """Return the command bound to a key; an unbound letter falls back to its other case."""
    return table.get(key) or table.get(key.swapcase() if len(key) == 1 else '')


def label(key: str) -> str:
    """Return the display label of a key."""
    return _(_LABELS.get(key, key))
