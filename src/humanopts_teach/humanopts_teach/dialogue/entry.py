"""Generic screens: texts, questions, text fields and lists."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from humanopts_env.domains.capabilities import explanation
from humanopts_ros.limits import composed
from humanopts_teach.dialogue import keys
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.keys import Command, Do
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    GAP,
    KeyList,
    Line,
    Panel,
    Tone,
    TypedText,
)
from humanopts_teach.language import _, N_, translated

MAX_CHARACTERS = 60
SCROLLED = 5  # number of lines scrolled per key press
PAGE = 9  # number of items per page; each has a digit key


def end(app: App) -> None:
    """Leave the dialogue."""
    app.end()


QUIT = Command('qQ', N_('quit'), end, N_('quit; everything taught is saved for next time'))
INTERRUPT = Command(
    [keys.INTERRUPT], N_('quit'), end, N_('quit at once')
)  # handled in ``App.type``


@dataclass
class Notice(Screen):
    """
    A text to read, and the keys that continue.

    :ivar other: command of all other keys; None: they are ignored.
    """

    blocks: Sequence[Block]
    choices: Sequence[Command]
    other: Do | None = None
    shows_board: bool = True
    claims_lesson: bool = False
    hides_features: bool = True
    earliest: float = 0.0
    scroll: int | None = None

    def panel(self, app: App) -> Panel:
        return Panel(self.blocks)

    def commands(self, app: App) -> Sequence[Command]:
        return self.choices

    def other_key(self, key: str, app: App) -> None:
        if self.scroll is not None and key in (keys.UP, keys.DOWN):
            self.scroll = max(self.scroll + (SCROLLED if key == keys.DOWN else -SCROLLED), 0)
        elif self.other is not None:
            self.other(app)


def confirm(question: str, affirm: Do, back: Do) -> Notice:
    """Return a yes-no question: Enter means yes, any other key no; both go back first."""

    def affirmed(app: App) -> None:
        back(app)
        affirm(app)

    choices = [
        Command([keys.ENTER], _('yes'), affirmed),
        Command([keys.ESCAPE], _('no'), back, label=_('any other key')),
    ]
    return Notice([Line(question, strong=True)], choices, back)


def quitting(app: App) -> list[Command]:
    """Return the quit command; none in a study, where only Ctrl-C quits."""
    return [] if app.in_study else [QUIT]


def key_list(
    title: str, rows: Sequence[tuple[str, str]], back: Do, explanation: str = ''
) -> Notice:
    """Return a list of keys or signs and their meanings; any key closes it."""
    choices = [Command([keys.ESCAPE], _('back'), back, label=_('any key'))]
    above = [Line(explanation), GAP] if explanation else []
    blocks: list[Block] = [*above, Line(title, strong=True), KeyList(rows)]
    return Notice(blocks, choices, back, shows_board=False)


def with_help(
    commands: Sequence[Command], back: Do, explained: Sequence[Command] = ()
) -> list[Command]:
    """
    Return the commands with a help command appended.

    :param explained: commands that the help explains; empty: the given ones.
    """

    def show(app: App) -> None:
        table = keys.key_table([*(explained or commands), helping, INTERRUPT])
        rows = [
            (keys.label(key), _(each.help or each.words))
            for key, each in table.items()
            if each.do is not None and (each.label is None or each.help)
        ]
        app.show(key_list(_('Keys'), rows, back, _(app.screen.explain(app))))

    helping = Command('?h', _('help'), show)
    return [*commands, helping]


def _show_game(back: Do, app: App) -> None:
    """Explain the game, its signs and its actions."""
    actions = [(keys.label(action.key), action.description) for action in app.domain.actions]
    rows = [(sign, translated(text)) for sign, text in (*explanation(app.domain), *actions)]
    app.show(key_list(_('The game'), rows, back))


@dataclass
class TextScreen(Screen):
    """A text field; the first letter typed replaces the proposed text."""

    title: str
    explanation: str
    typed: str = ''
    submit: Callable[[str, App], None] = lambda text, app: None
    back: Do | None = None
    back_words: str = N_('back')
    max_characters: int = MAX_CHARACTERS
    may_be_empty: bool = False
    takes_text = True
    _edited: bool = field(default=False, init=False)

    def press(self, key: str, app: App) -> None:
        super().press(key, app)
        self._edited = True

    def panel(self, app: App) -> Panel:
        title, explanation = Line(self.title, strong=True), Line(self.explanation, Tone.QUIET)
        return Panel((title, GAP, TypedText(self.typed, self.max_characters), GAP, explanation))

    def commands(self, app: App) -> Sequence[Command]:
        text = self.typed.strip()
        accept = (
            (lambda app: self.submit(composed(text), app)) if text or self.may_be_empty else None
        )
        return [
            Command([keys.ENTER], _('accept'), accept),
            Command([keys.BACKSPACE], _('erase'), self._erase if self.typed else None),
            Command([keys.CLEAR], _('erase all'), self._clear, label=''),
            Command([keys.ESCAPE], _(self.back_words), self.back),
            INTERRUPT,
        ]

    def other_key(self, key: str, app: App) -> None:
        kept = self.typed if self._edited else ''
        if len(key) == 1 and key.isprintable() and len(kept) < self.max_characters:
            self.typed = kept + key

    def _erase(self, app: App) -> None:
        self.typed = self.typed[:-1]

    def _clear(self, app: App) -> None:
        self.typed = ''


@dataclass(frozen=True)
class Item:
    """An item of a list."""

    text: str
    note: str
    choose: Do
    states: Sequence[str] = ()  # drawn while the item is selected, starting with the first


@dataclass
class ListScreen(Screen):
    """A list with selection by arrow keys, or by number within a page."""

    title: str
    items: Sequence[Item]
    back: Do | None = None
    at: int = 0
    step: int = 0  # index into the states of the selected item
    hides_features: bool = False

    @property
    def state(self) -> str:
        """The state of the selected item to draw."""
        states = self.items[self.at].states
        return states[self.step] if states else ''

    def panel(self, app: App) -> Panel:
        n_states = len(self.items[self.at].states)
        blocks: list[Block] = [Line(self.title, strong=True)]
        if n_states > 1:
            blocks.append(
                Line(
                    _('board: step {number} of {count}').format(
                        number=self.step, count=n_states - 1
                    ),
                    Tone.QUIET,
                )
            )
        blocks += [GAP, Choices([(item.text, item.note) for item in self.items], self.at)]
        if len(self.items) > PAGE:
            blocks.append(
                Line(
                    _('{number} of {count}').format(number=self.at + 1, count=len(self.items)),
                    Tone.QUIET,
                )
            )
        return Panel(blocks)

    def commands(self, app: App) -> Sequence[Command]:
        first, last = self.at - self.at % PAGE, len(self.items[self.at].states) - 1
        numbers = range(first, min(first + PAGE, len(self.items)))

        def go(at: int, step: int = 0) -> Do:
            return lambda app: self._go(at % len(self.items), step)

        def choose(at: int) -> Do:
            def choose_it(app: App) -> None:
                self._go(at)
                self.items[at].choose(app)

            return choose_it

        along = [
            Command([keys.LEFT], _('step back'), go(self.at, max(self.step - 1, 0))),
            Command([keys.RIGHT], _('step forward'), go(self.at, min(self.step + 1, last))),
        ]
        return [
            Command([keys.UP], _('move'), go(self.at - 1), label='↑ ↓'),
            Command([keys.DOWN], _('move down'), go(self.at + 1), label=''),
            *(along if last > 0 else []),
            Command([keys.ENTER], _('choose'), choose(self.at)),
            *(
                Command(
                    str(at - first + 1), _('choose'), choose(at), label='' if at > first else '1-9'
                )
                for at in numbers
            ),
            Command([keys.ESCAPE], _('back'), self.back),
            Command('?', _('the game'), partial(_show_game, self.again)),
            *quitting(app),
        ]

    def _go(self, at: int, step: int = 0) -> None:
        self.at, self.step = at, step
