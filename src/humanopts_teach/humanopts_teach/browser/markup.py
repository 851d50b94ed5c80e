"""
A view as HTML, one piece for each part of the page; ``page.html`` is the template.

Buttons have their keys in ``data-keys``, which ``page.js`` sends.
"""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from humanopts_env.board import Board
from humanopts_teach.board_html import board_html, notes_html
from humanopts_teach.dialogue.entry import MAX_CHARACTERS, PAGE
from humanopts_teach.dialogue.keys import BACKSPACE, DOWN, ENTER, INTERRUPT, label, LEFT, UP
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    Key,
    ScreenView,
    TARGET,
    TypedText,
)
from humanopts_teach.report.pages import page_style, templates
from markdown_it import MarkdownIt

PARTS = ('head', 'board', 'panel', 'said', 'keys')  # of the page, classes of its style sheet
_PAD = {'up': '▲', 'left': '◀', 'down': '▼', 'right': '▶'}
_BESIDE_PAD = 3  # keys that are as large as the arrows
_PACKAGE = 'humanopts_teach.browser'


@cache
def head_html() -> str:
    """Return the head of each page: its style sheet and script."""
    folder = files(_PACKAGE)
    style, script = (folder.joinpath(f'page.{end}').read_text('utf-8') for end in ('css', 'js'))
    return f'<style>{page_style()}{style}</style><script>{script}</script>'


@cache
def _macros() -> Any:
    # HTML is escaped, and no picture is asked for from another server.
    page = MarkdownIt('commonmark', {'html': False}).disable('image').render
    given: dict[str, object] = {
        'picking': _picking,
        'page': page,
        'interrupt': label(INTERRUPT),
        'target': TARGET,
        'max_characters': MAX_CHARACTERS,
    }
    return templates(_PACKAGE).get_template('page.html', globals=given).module


def parts(view: ScreenView) -> dict[str, str]:
    """
    Return the HTML of each part of the page.

    :raises jinja2.UndefinedError: the panel has a block of a kind that the template does not know.
    """
    made, blocks, board = _macros(), [*view.panel.beside, *view.panel.below], ''
    if view.board not in (None, Board()):
        board = made.board(board_html(view.board), notes_html(view.board))
    found = (
        made.head(view),
        board,
        made.panel([(type(block).__name__, block) for block in blocks]),
        made.said(view),
        made.keys(*_keys(view.keys, blocks), view.plays),
    )
    return dict(zip(PARTS, map(str, found)))


def _keys(keys: Sequence[Key], blocks: Sequence[Block]) -> tuple[list[Key], list[Key], list[Key]]:
    """Return the arrow pad, the main buttons beside it, and all other buttons."""
    kinds, known = {type(block) for block in blocks}, {each.key: each for each in keys}
    elsewhere = {INTERRUPT, *((ENTER, BACKSPACE) if TypedText in kinds else ())}
    if Choices in kinds:  # they are pressed themselves, unless there are steps to move along
        elsewhere |= {*'123456789', *(() if LEFT in known else (ENTER, UP, DOWN))}
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
    """Return the keys that choose an item, moving the shorter way around."""
    if number // PAGE == choices.at // PAGE:
        return [str(number % PAGE + 1)]
    count = len(choices.items)
    down, up = (number - choices.at) % count, (choices.at - number) % count
    return [*([DOWN] * down if down <= up else [UP] * up), ENTER]
