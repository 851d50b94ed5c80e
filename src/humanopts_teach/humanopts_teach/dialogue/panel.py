"""Screen contents as plain values, which the terminal and the web page render."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
import string
from typing import NamedTuple

from humanopts_env.board import Board
from humanopts_teach.language import _

OPTION_KEYS = string.digits[1:] + string.ascii_letters  # keys of ``Options``, in order
TARGET = 1 / 3  # share of a bar's length that marks the threshold of a criterion


class Tone(Enum):
    """The kind of information in a line."""

    PLAIN = 'plain'
    QUIET = 'quiet'  # background
    NEWS = 'news'  # the current position
    GOOD = 'good'
    WARNING = 'warning'
    BAD = 'bad'


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text."""

    text: str
    tone: Tone = Tone.PLAIN
    strong: bool = False
    more: tuple['Line', ...] = ()  # continuation of the line, in other tones


GAP = Line('')


@dataclass(frozen=True, slots=True)
class TypedText:
    """The text typed by the person."""

    text: str
    most: int = 60  # maximum number of characters


@dataclass(frozen=True, slots=True)
class Rating:
    """A scale of numbered points with labelled ends."""

    points: int
    low: str
    high: str
    value: int | None  # chosen point, from 1; None: none yet


@dataclass(frozen=True, slots=True)
class Options:
    """Possible answers, each with a key; see ``OPTION_KEYS``."""

    texts: Sequence[str]
    chosen: frozenset[int]  # indices of the chosen ones
    several: bool  # whether several can be chosen


@dataclass(frozen=True, slots=True)
class Choices:
    """A list of items, one of which is selected."""

    items: Sequence[tuple[str, str]]  # text and note
    at: int  # index of the selected item
    key: str = ''  # key that chooses the selected item; empty: Enter, or the number of any item


@dataclass(frozen=True, slots=True)
class KeyList:
    """Keys and their descriptions, one per row."""

    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Features:
    """The features that the option depends on, or all features."""

    shown: Sequence[tuple[str, str]]  # name and value; the value is empty outside demonstrations
    hidden: str = ''  # note about the other features; empty: there are none
    chosen: bool = True  # False: all features
    in_rows: bool = False  # one per row, since no board shows them

    @property
    def title(self) -> str:
        """The heading of the features."""
        return _('depends on') if self.chosen else _('features')


@dataclass(frozen=True, slots=True)
class CriterionRow:
    """A criterion and its requirement."""

    mark: str
    name: str
    now: str
    needs: str
    tone: Tone
    share: float  # filled share of the bar, 0 to 1


@dataclass(frozen=True, slots=True)
class Criteria:
    """The criteria of an option, one per row."""

    rows: Sequence[CriterionRow]


@dataclass(frozen=True, slots=True)
class Page:
    """A page of text."""

    text: str  # Markdown


Block = Page | Line | TypedText | Rating | Options | Choices | KeyList | Features | Criteria


@dataclass(frozen=True, slots=True)
class Panel:
    """The contents of a screen apart from the board, from top to bottom."""

    beside: Sequence[Block] = ()
    below: Sequence[Block] = ()  # also placed next to the board if there is room


class Key(NamedTuple):
    """A key and its command."""

    key: str
    label: str  # empty: shown only as a button
    words: str


@dataclass(frozen=True, slots=True)
class ScreenView:
    """The complete contents of the display."""

    head: Sequence[str]  # header fields: domain, participant, session, driver
    panel: Panel
    said: Line = GAP
    keys: Sequence[Key] = ()
    paused: str = ''  # reason why teaching is paused; empty: not paused
    board: Board | None = None  # None: nothing is drawn
    plays: bool = False  # whether the game is being played
    language: str = ''  # as in ``speaking``
    task: str = ''  # what the person should do; empty: not shown
