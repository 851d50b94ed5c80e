"""Which key means what: actions keep the domain's keys, commands give way to them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
import string

from humanopts_env.domains.base import Action

ENTER, ESCAPE, BACKSPACE, SPACE = 'enter', 'escape', 'backspace', ' '
INTERRUPT, END_OF_FILE, CLEAR = 'ctrl-c', 'ctrl-d', 'ctrl-u'
UP, DOWN, LEFT, RIGHT = 'up', 'down', 'left', 'right'
_LABELS = {UP: '↑', DOWN: '↓', LEFT: '←', RIGHT: '→', ENTER: 'Enter', ESCAPE: 'Esc'}
_LABELS |= {BACKSPACE: 'Backspace', SPACE: 'Space', INTERRUPT: 'Ctrl-C'}


class Command(Enum):
    """What a person can ask for besides the domain's actions."""

    DONE = 'done'
    START_AGAIN = 'start again'
    NOT_HERE = 'not here'
    DISCARD = 'discard'
    UNDO = 'undo'
    DEMONSTRATIONS = 'demonstrations'
    WATCH = 'watch'
    BACK = 'back'
    QUESTIONS = 'questions'
    BEGIN = 'begin'
    PAUSE = 'pause'
    STEP = 'step'
    SLOWER = 'slower'
    FASTER = 'faster'
    PLACES = 'places'
    RUN = 'run'
    RUN_HERE = 'run here'
    NEW_START = 'new start'
    EXECUTION = 'execution'
    MENU = 'menu'
    HELP = 'help'
    QUIT = 'quit'


_WANTED: Mapping[Command, Sequence[str]] = {  # keys by preference
    Command.DONE: [ENTER],
    Command.START_AGAIN: 'sa',
    Command.NOT_HERE: 'nh',
    Command.DISCARD: [BACKSPACE],
    Command.UNDO: 'uz',
    Command.DEMONSTRATIONS: 'lb',
    Command.WATCH: 'wv',
    Command.BACK: [BACKSPACE],
    Command.PAUSE: [SPACE],
    Command.STEP: '.,',
    Command.SLOWER: '-',
    Command.FASTER: '+',
    Command.PLACES: 'cy',
    Command.QUESTIONS: 'ek',
    Command.BEGIN: [ENTER],
    Command.RUN: 'rg',
    Command.RUN_HERE: [ENTER],
    Command.NEW_START: 'no',
    Command.EXECUTION: 'xm',
    Command.MENU: [ESCAPE],
    Command.HELP: '?h',
    Command.QUIT: 'qQ',
}
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

    def key(self, command: Command) -> str:
        """Return the label of the key of a command that the table has."""
        return label(next(key for key, found in self.commands.items() if found is command))


def key_table(actions: Sequence[Action], commands: Iterable[Command]) -> KeyTable:
    """Give each command the first of its keys, or of all characters, that is still free."""
    taken = {action.key for action in actions}
    table: dict[str, Command] = {}
    for command in commands:
        wanted = (*_WANTED[command], *_SPARE)
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
