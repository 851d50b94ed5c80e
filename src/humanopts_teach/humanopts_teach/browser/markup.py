"""
A view as HTML, one piece for each part of the page; ``page.html`` is the template.

Buttons have their keys in ``data-keys``, which ``page.js`` sends.
"""

from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from humanopts_env.board import Board
from humanopts_teach.board_html import board_html, notes_html
from humanopts_teach.dialogue.entry import MOST_CHARACTERS, PAGE
from humanopts_teach.dialogue.keys import BACKSPACE, DOWN, ENTER, INTERRUPT, key_of, Keys, LEFT, UP
from humanopts_teach.dialogue.panel import Block, Choices, ScreenView, TARGET, TypedText
from humanopts_teach.report.pages import page_style, templates
from markdown_it import MarkdownIt

PARTS = ('head', 'board', 'panel', 'said', 'keys')  # of the page, classes of its style sheet
_PAD = {'up': '▲', 'left': '◀', 'down': '▼', 'right': '▶'}
_BESIDE_PAD = 3  # keys that are as big as the arrows
_PACKAGE = 'humanopts_teach.browser'


class _Key(NamedTuple):
    key: str
    label: str
    words: str


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
    functions: dict[str, Callable[..., object]] = {
        'picking': _picking,
        'can_press': _can_press,
        'page': page,
    }
    given = {**functions, 'target': TARGET, 'most_characters': MOST_CHARACTERS}
    return templates(_PACKAGE).get_template('page.html', globals=given).module


def parts(view: ScreenView) -> dict[str, str]:
    """
    Return the HTML of each part of the page.

    :raises jinja2.UndefinedError: the panel has a block of a kind that the template does not know.
    """
    made, board = _macros(), ''
    if view.board not in (None, Board()):
        board = made.board(board_html(view.board), notes_html(view.board))
    blocks = [*view.panel.beside, *view.panel.below]
    panel = made.panel([(type(block).__name__, block) for block in blocks])
    found = (
        made.head(view),
        board,
        panel,
        made.said(view),
        made.keys(*_keys(view.keys, blocks), view.plays),
    )
    return dict(zip(PARTS, map(str, found)))


def _keys(keys: Keys, blocks: Sequence[Block]) -> tuple[list[_Key], list[_Key], list[_Key]]:
    """Return the arrow pad, the main buttons beside it, and all other buttons."""
    kinds = {type(block) for block in blocks}
    known = [
        _Key(key_of(each), each, words if each == label else f'{words} {each}')
        for label, words in keys
        for each in ([label] if _can_press(label) else label.split())  # as in "← →"
        if _can_press(each)
    ]
    named = {each.key: each for each in known}
    elsewhere = {ENTER, BACKSPACE} if TypedText in kinds else set()
    if Choices in kinds and LEFT not in named:  # they are pressed themselves, and have no parts
        elsewhere = {ENTER, UP, DOWN}
    for key in elsewhere & named.keys():
        del named[key]
    pad = [named.pop(key)._replace(label=sign) for key, sign in _PAD.items() if key in named]
    beside = _BESIDE_PAD if pad else 0
    others = list(named.values())
    return pad, others[:beside], others[beside:]


def _can_press(label: str) -> bool:
    """Return whether a label names a single key of the page."""
    return key_of(label) not in ('', INTERRUPT)


def _picking(choices: Choices, number: int) -> list[str]:
    """Return the keys that pick a choice, moving the shorter way around."""
    if number // PAGE == choices.at // PAGE:
        return [str(number % PAGE + 1)]
    count = len(choices.items)
    down, up = (number - choices.at) % count, (choices.at - number) % count
    return [*([DOWN] * down if down <= up else [UP] * up), ENTER]
