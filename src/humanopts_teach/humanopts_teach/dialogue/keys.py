"""Which key means what: actions keep the domain's keys, commands give way to them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
import string

from humanopts_env.domains.base import Action

ENTER, ESCAPE, BACKSPACE, SPACE = 'enter', 'escape', 'backspace', ' '
INTERRUPT, END_OF_FILE, CLEAR, SUSPEND = 'ctrl-c', 'ctrl-d', 'ctrl-u', 'ctrl-z'
UP, DOWN, LEFT, RIGHT = 'up', 'down', 'left', 'right'
_LABELS = {UP: '↑', DOWN: '↓', LEFT: '←', RIGHT: '→', ENTER: 'Enter', ESCAPE: 'Esc'}
_LABELS |= {BACKSPACE: 'Backspace', SPACE: 'Space', INTERRUPT: 'Ctrl-C'}


class Command(Enum):
    """
    What a person can ask for besides the domain's actions.

    :ivar words: what its key does, beside it on the screen.
    :ivar wanted: its keys by preference.
    """

    DONE = 'done', [ENTER]
    START_AGAIN = 'start again', 'sa'
    NOT_HERE = 'not here', 'nh'
    DISCARD = 'discard', [BACKSPACE]
    UNDO = 'undo a step', 'uz'
    DEMONSTRATIONS = 'what was shown', 'lb'
    WATCH = 'watch and correct', 'wv'
    BACK = 'back a question', [BACKSPACE]
    QUESTIONS = 'questions', 'ek'
    BEGIN = 'begin', [ENTER]
    PAUSE = 'wait', [SPACE]
    STEP = 'single step', '.,'
    SLOWER = 'slower', '-'
    FASTER = 'faster', '+'
    UNCOVERED = 'what is not covered', 'cy'
    RUN = 'run it', 'rg'
    RUN_HERE = 'run it from here', [ENTER]
    NEW_START = 'new start', 'no'
    EXECUTION = 'other arbitration', 'xm'
    MENU = 'menu', [ESCAPE]
    HELP = 'help', '?h'
    QUIT = 'quit', 'qQ'

    def __init__(self, words: str, wanted: Sequence[str]) -> None:
        self.words, self.wanted = words, wanted


_SPARE = string.ascii_lowercase + string.digits + string.ascii_uppercase


@dataclass(frozen=True)
class KeyTable:
    """The keys of one screen."""

    actions: Mapping[str, str]  # key -> name of the action
    commands: Mapping[str, Command]  # key -> command

    def action(self, key: str) -> str | None:
        """Return the action of a key, in either case; None: it has none."""
        return self.actions.get(key) or self.actions.get(_other_case(key, self.commands))

    def command(self, key: str) -> Command | None:
        """Return the command of a key, in either case; None: it has none."""
        return self.commands.get(key) or self.commands.get(_other_case(key, self.actions))

    def labelled(self, words: Mapping[Command, str]) -> list[tuple[str, str]]:
        """
        Return the labels of the commands' keys, and what these do.

        :param words: of commands that do something else here than by their name.
        """
        return [(label(key), words.get(c, c.words)) for key, c in self.commands.items()]

    def key(self, command: Command) -> str:
        """Return the label of the key of a command that the table has."""
        return label(next(key for key, found in self.commands.items() if found is command))


def key_table(actions: Sequence[Action], commands: Iterable[Command]) -> KeyTable:
    """Give each command the first of its keys, or of all characters, that is still free."""
    taken = {action.key for action in actions}
    table: dict[str, Command] = {}
    for command in commands:
        wanted = (*command.wanted, *_SPARE)
        table[next(key for key in wanted if key not in taken and key not in table)] = command
    return KeyTable({action.key: action.name for action in actions}, table)


def label(key: str) -> str:
    """Return how a key reads on the screen."""
    return _LABELS.get(key, key)


def key_of(label: str) -> str:
    """Return the key that a label on the screen stands for; empty: for no single key."""
    if label in ('any key', 'any other key'):
        return ESCAPE
    named = {shown: key for key, shown in _LABELS.items()}
    return named.get(label, label if len(label) == 1 else '')


def _other_case(key: str, exact: Mapping[str, object]) -> str:
    """Return the key in the other case, unless ``exact`` means it as it is."""
    return '' if key in exact or len(key) != 1 else key.swapcase()
