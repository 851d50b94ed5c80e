"""Screens in which the person types or picks something."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from humanopts_env.domains.capabilities import explanation
from humanopts_ros.limits import composed
from humanopts_teach.dialogue import keys
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.lesson.requests import Answer, Request

MOST_CHARACTERS = 60
PAGE = 9  # items that a terminal lists at once: each has a digit


@dataclass
class TextScreen(Screen):
    """One line that the person types; the first letter replaces the proposed text."""

    title: str
    explanation: str
    typed: str = ''
    submit: Callable[[str, App], None] = lambda text, app: None
    answered: Callable[[Request, Answer, App], None] = lambda request, answer, app: None
    back: Callable[[App], None] | None = None
    back_words: str = 'back'
    _edited: bool = field(default=False, init=False)

    def press(self, key: str, app: App) -> None:
        kept, self._edited = self.typed if self._edited else '', True
        if key == keys.ENTER and self.typed.strip():
            self.submit(composed(self.typed.strip()), app)
        elif key == keys.ESCAPE and self.back is not None:
            self.back(app)
        elif key == keys.BACKSPACE:
            self.typed = self.typed[:-1]
        elif key == keys.CLEAR:
            self.typed = ''
        elif len(key) == 1 and key.isprintable() and len(kept) < MOST_CHARACTERS:
            self.typed = kept + key

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        self.answered(request, answer, app)

    def keys(self, app: App) -> keys.Keys:
        back = [(keys.label(keys.ESCAPE), self.back_words)] if self.back is not None else []
        edit = [('Enter', 'accept')] if self.typed.strip() else []
        edit += [('Backspace', 'erase')] if self.typed else []
        return [*edit, *back, ('Ctrl-C', 'quit')]


@dataclass(frozen=True)
class Item:
    """One thing to pick."""

    text: str
    note: str
    pick: Callable[[App], None]
    states: Sequence[str] = ()  # that are drawn while it is chosen, the first one first


@dataclass
class ListScreen(Screen):
    """A list from which the person picks by arrow keys, or by number within a page."""

    title: str
    items: Sequence[Item]
    back: Callable[[App], None] | None = None
    answered: Callable[[Request, Answer, App], None] = lambda request, answer, app: None
    at: int = 0
    step: int = 0  # of the states of the chosen item

    @property
    def state(self) -> str:
        """The state of the chosen item that is drawn."""
        states = self.items[self.at].states
        return states[self.step] if states else ''

    def press(self, key: str, app: App) -> None:
        number = self.at - self.at % PAGE + int(key) - 1 if key in set('123456789') else -1
        if key in (keys.UP, keys.DOWN):
            self.at, self.step = (self.at + (1 if key == keys.DOWN else -1)) % len(self.items), 0
        elif key in (keys.LEFT, keys.RIGHT):
            last = len(self.items[self.at].states) - 1
            self.step = max(min(self.step + (1 if key == keys.RIGHT else -1), last), 0)
        elif 0 <= number < len(self.items):
            self.at, self.step = number, 0
            self.items[self.at].pick(app)
        elif key == '?':
            show_game(self, app)
        elif key == keys.ENTER:
            self.items[self.at].pick(app)
        elif key == keys.ESCAPE and self.back is not None:
            self.back(app)
        elif key in ('q', 'Q'):
            app.end()

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        self.answered(request, answer, app)

    def keys(self, app: App) -> keys.Keys:
        back = [(keys.label(keys.ESCAPE), 'back')] if self.back is not None else []
        along = [(keys.label(keys.LEFT), 'step back'), (keys.label(keys.RIGHT), 'step on')]
        way = along if len(self.items[self.at].states) > 1 else []
        first = [('↑ ↓', 'move'), *way, ('Enter', 'choose'), ('1-9', 'choose'), *back]
        return [*first, ('?', 'the game'), ('q', 'quit')]


@dataclass
class ConfirmScreen(Screen):
    """A question: every key goes back, and Enter affirms it then."""

    question: str
    affirm: Callable[[App], None]
    back: Callable[[App], None]

    def press(self, key: str, app: App) -> None:
        self.back(app)
        if key == keys.ENTER:
            self.affirm(app)

    def keys(self, app: App) -> keys.Keys:
        return [('Enter', 'yes'), ('any other key', 'go on as before')]


@dataclass
class HelpScreen(Screen):
    """All keys in words; any key goes back."""

    shows_board: ClassVar[bool] = False
    table: Sequence[tuple[str, str]]
    back: Callable[[App], None]
    title: str = 'Keys'

    def press(self, key: str, app: App) -> None:
        self.back(app)

    def keys(self, app: App) -> keys.Keys:
        return [('any key', 'go back')]


def show_game(screen: Screen, app: App) -> None:
    """Show what the game is about, what its signs mean, and what its actions do."""
    actions = [(keys.label(action.key), action.description) for action in app.domain.actions]
    app.show(HelpScreen([*explanation(app.domain), *actions], screen.again, 'The game'))
