"""What a screen shows, as plain values, which the terminal and the page only draw."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from humanopts_env.board import Board

TARGET = 1 / 3  # of the length of a bar: where a criterion begins to hold


class Tone(Enum):
    """What kind of information a line gives."""

    PLAIN = 'plain'
    QUIET = 'quiet'  # background
    NEWS = 'news'  # the current position
    GOOD = 'good'
    WARNING = 'warning'
    BAD = 'bad'


@dataclass(frozen=True, slots=True)
class Line:
    """A sentence or a few words."""

    text: str
    tone: Tone = Tone.PLAIN
    strong: bool = False
    more: tuple['Line', ...] = ()  # continues in the same line, each with its own tone


GAP = Line('')


@dataclass(frozen=True, slots=True)
class TypedText:
    """The line that the person types."""

    text: str


@dataclass(frozen=True, slots=True)
class Choices:
    """A list to choose from."""

    items: Sequence[tuple[str, str]]  # text and note
    at: int  # index of the one that Enter chooses


@dataclass(frozen=True, slots=True)
class KeyList:
    """Keys and what they do, one per row."""

    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Features:
    """The features that the option depends on."""

    shown: Sequence[tuple[str, str]]  # name and value; no value outside of a demonstration
    hidden: str  # what is not shown, in words; empty: nothing


@dataclass(frozen=True, slots=True)
class CriterionRow:
    """A criterion and what it requires."""

    mark: str
    name: str
    now: str
    needs: str
    tone: Tone
    share: float | None  # of the bar that is filled, 0 to 1; None: not measured


@dataclass(frozen=True, slots=True)
class Criteria:
    """The criteria of an option, one per row."""

    rows: Sequence[CriterionRow]


@dataclass(frozen=True, slots=True)
class Page:
    """A page to read."""

    text: str  # Markdown


Block = Page | Line | TypedText | Choices | KeyList | Features | Criteria


@dataclass(frozen=True, slots=True)
class Panel:
    """What a screen shows besides the board, from top to bottom."""

    beside: Sequence[Block] = ()
    below: Sequence[Block] = ()  # beside the board too where there is room


class Key(NamedTuple):
    """A key that does something."""

    key: str
    label: str  # empty: shown only where it is a button
    words: str


@dataclass(frozen=True, slots=True)
class ScreenView:
    """Everything that is shown."""

    head: Sequence[str]  # where the person is, in a few words each
    panel: Panel
    said: Line = GAP
    keys: Sequence[Key] = ()
    paused: str = ''  # why nothing new can be taught now; empty: it can
    board: Board | None = None  # None: the screen has no board
    plays: bool = False  # the game is being played
