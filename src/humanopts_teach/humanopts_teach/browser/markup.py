"""
Rendering of a view as HTML, one fragment per part of the page; the template is ``page.html``.

Buttons store their keys in ``data-keys``, which ``page.js`` sends.
"""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
import math
from typing import Any

from humanopts_teach.board_html import board_html, notes_html
from humanopts_teach.browser.speech import board_words
from humanopts_teach.dialogue.entry import MAX_CHARACTERS, PAGE
from humanopts_teach.dialogue.keys import (
    BACKSPACE,
    CLEAR,
    DOWN,
    ENTER,
    INTERRUPT,
    label,
    LEFT,
    RIGHT,
    UP,
)
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    Key,
    OPTION_KEYS,
    Options,
    Rating,
    ScreenView,
    TARGET,
    TypedText,
)
from humanopts_teach.language import _, in_its_language
from humanopts_teach.report.pages import page_style, templates
from markdown_it import MarkdownIt

PARTS = ('head', 'board', 'panel', 'said', 'keys')  # parts of the page; also CSS classes
_PAD = {'up': '▲', 'left': '◀', 'down': '▼', 'right': '▶'}
_BESIDE_PAD = 3  # number of keys as large as the arrows
_PACKAGE = 'humanopts_teach.browser'


@cache
def head_html() -> str:
    """Return the HTML head of each page: style sheet and script."""
    folder = files(_PACKAGE)
    style, script = (folder.joinpath(f'page.{end}').read_text('utf-8') for end in ('css', 'js'))
    return f'<style>{page_style()}{style}</style><script>{script}</script>'


@cache
def _macros() -> Any:
    # Escape HTML, and do not load images from other servers.
    page = MarkdownIt('commonmark', {'html': False}).disable('image').render
    given: dict[str, object] = {
        '_': _,
        'picking': _picking,
        'page': page,
        'interrupt': INTERRUPT,
        'label': label,
        'target': TARGET,
        'max_line': MAX_CHARACTERS,
        'option_keys': OPTION_KEYS,
        'clearing': lambda number: [CLEAR, *str(number)],
        'per_row': lambda count, most: math.ceil(count / math.ceil(count / most)),
    }
    return templates(_PACKAGE).get_template('page.html', globals=given).module


@in_its_language
def parts(view: ScreenView) -> dict[str, str]:
    """
    Return the HTML of each part of the page.

    :raises jinja2.UndefinedError: the template does not support a block of the panel.
    """
    made, blocks, board = _macros(), [*view.panel.beside, *view.panel.below], ''
    if view.board is not None:
        drawn = board_html(view.board, board_words(view.board))
        board = made.board(drawn, notes_html(view.board))
    found = (
        made.head(view),
        board,
        made.panel([(type(block).__name__, block) for block in blocks], ' · '.join(view.head)),
        made.said(view),
        made.keys(*_keys(view.keys, blocks), view.plays, [each.key for each in view.keys]),
    )
    return dict(zip(PARTS, map(str, found)))


def _keys(keys: Sequence[Key], blocks: Sequence[Block]) -> tuple[list[Key], list[Key], list[Key]]:
    """Return the arrow pad, the main buttons next to it, and all other buttons."""
    kinds, known = {type(block) for block in blocks}, {each.key: each for each in keys}
    elsewhere = {INTERRUPT, *((ENTER, BACKSPACE) if TypedText in kinds else ())}
    if Choices in kinds and RIGHT not in known:  # items are clicked directly
        elsewhere |= {ENTER, UP, DOWN}
    if kinds & {Choices, Options, Rating}:
        elsewhere |= {*'123456789'}
    if Rating in kinds:
        elsewhere |= {LEFT, RIGHT}
    shown = [
        each._replace(label=_PAD.get(each.key, label(each.key)))
        for each in keys
        if each.key not in elsewhere and (each.label or each.key in _PAD)
    ]
    others = [each for each in shown if each.key not in _PAD]
    pad = sorted(
        (each for each in shown if each.key in _PAD), key=lambda each: [*_PAD].index(each.key)
    )
    beside = _BESIDE_PAD if pad else 0
    return pad, others[:beside], others[beside:]


def _picking(choices: Choices, number: int) -> list[str]:
    """Return the keys that select an item by the shortest path."""
    if not choices.key and number // PAGE == choices.at // PAGE:
        return [str(number % PAGE + 1)]
    count = len(choices.items)
    down, up = (number - choices.at) % count, (choices.at - number) % count
    return [*([DOWN] * down if down <= up else [UP] * up), choices.key or ENTER]
