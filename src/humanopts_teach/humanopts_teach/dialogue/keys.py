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


class KeyCommand(Enum):
    """
    What a person can ask for besides the domain's actions.

    :ivar words: what its key does, beside it on the screen.
    :ivar wanted: its keys by preference.
    :ivar help: the same in a sentence.
    """

    DONE = 'done', [ENTER], 'the option ends here: keep this demonstration'
    START_AGAIN = (
        'start again',
        'sa',
        'with done: say whether the option could start again where it ended',
    )
    NOT_HERE = 'not here', 'nh', 'the option cannot start here; only before the first step'
    DISCARD = 'discard', [BACKSPACE], 'forget this demonstration and try the same start again'
    UNDO = 'undo a step', 'uz', 'undo your last step: a new episode repeats the steps before it'
    DEMONSTRATIONS = 'demonstrations', 'lb', 'list all demonstrations; look at any, or delete it'
    WATCH = (
        'watch and correct',
        'wv',
        'watch the option from a start of the task; an action key takes over',
    )
    BACK = 'previous question', [BACKSPACE]
    QUESTIONS = (
        'questions',
        'ek',
        'answer again what the option depends on; Enter keeps an answer',
    )
    BEGIN = 'begin', [ENTER]
    PAUSE = 'pause', [SPACE]
    STEP = 'single step', '.,'
    SLOWER = 'slower', '-'
    FASTER = 'faster', '+'
    UNCOVERED = (
        'uncovered places',
        'cy',
        'list where no option could start, so that a single step was taken (a fallback), or a '
        'single step was worth more',
    )
    RUN = 'run it', 'rg'
    RUN_HERE = 'run it from here', [ENTER]
    NEW_START = 'new start', 'no', 'begin an episode from a start of the task'
    EXECUTION = 'other arbitration', 'xm', 'choose between options in another way'
    MENU = 'menu', [ESCAPE]
    HELP = 'help', '?h'
    QUIT = 'quit', 'qQ', 'leave; everything taught is saved, and goes on next time'

    def __init__(self, words: str, wanted: Sequence[str], sentence: str = '') -> None:
        self.words, self.wanted, self.help = words, wanted, sentence or words


Keys = list[tuple[str, str]]  # label of a key, and what it does
_SPARE = string.ascii_lowercase + string.digits + string.ascii_uppercase


@dataclass(frozen=True)
class KeyTable:
    """The keys of one screen."""

    actions: Mapping[str, str]  # key -> name of the action
    commands: Mapping[str, KeyCommand]  # key -> command

    def action(self, key: str) -> str | None:
        """Return the action of a key, in either case; None: it has none."""
        return self.actions.get(key) or self.actions.get(_other_case(key, self.commands))

    def command(self, key: str) -> KeyCommand | None:
        """Return the command of a key, in either case; None: it has none."""
        return self.commands.get(key) or self.commands.get(_other_case(key, self.actions))

    def labelled(self, words: Mapping[KeyCommand, str]) -> Keys:
        """
        Return the labels of the commands' keys, and what these do.

        :param words: of commands that do something else here than by their name.
        """
        return [(label(key), words.get(c, c.words)) for key, c in self.commands.items()]

    def help(self, actions: Sequence[Action], words: Mapping[KeyCommand, str]) -> Keys:
        """Return all keys in sentences; ``words`` as for ``labelled``."""
        shown = [(label(action.key), action.description) for action in actions]
        shown += [(label(key), words.get(c, c.help)) for key, c in self.commands.items()]
        return [*shown, (label(INTERRUPT), 'leave at once')]

    def key(self, command: KeyCommand) -> str:
        """Return the label of the key of a command that the table has."""
        return label(next(key for key, found in self.commands.items() if found is command))


def key_table(actions: Sequence[Action], commands: Iterable[KeyCommand]) -> KeyTable:
    """Give each command the first of its keys, or of all characters, that is still free."""
    taken = {action.key for action in actions}
    table: dict[str, KeyCommand] = {}
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
