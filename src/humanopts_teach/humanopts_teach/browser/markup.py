"""
What is shown as HTML, in parts of the page; all texts in it are escaped.

What can be pressed has the keys that it stands for in ``data-keys``, which ``page.js`` sends.
"""

from collections.abc import Sequence
from functools import cache, singledispatch
from html import escape
from importlib.resources import files
import json

from humanopts_teach.dialogue.entry import Keys, MOST_CHARACTERS
from humanopts_teach.dialogue.keys import BACKSPACE, DOWN, ENTER, INTERRUPT, key_of, UP
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    Criteria,
    Features,
    KeyTable,
    TypedText,
    View,
)
from humanopts_teach.lesson.presentation import Line, TARGET
from humanopts_teach.report.pages import page_style
from humanopts_teach.state_drawing import board_svg, notes_html

PARTS = ('head', 'board', 'panel', 'said', 'keys')  # of the page, classes of its style sheet
_PAD = ('up', 'left', 'down', 'right')
_BESIDE_PAD = 3  # keys that are as big as the arrows


@cache
def head_html() -> str:
    """Return what the head of each page needs: style, and what sends keys."""
    folder = files('humanopts_teach.browser')
    style, script = (folder.joinpath(name).read_text('utf-8') for name in ('page.css', 'page.js'))
    return f'<style>{page_style()}{style}</style><script>{script}</script>'


def parts(view: View) -> dict[str, str]:
    """Return the HTML of each part of the page."""
    head = ''.join(f'<span>{escape(words)}</span>' for words in view.head)
    if view.paused:
        head += f'<p class="paused" role="alert"><b>Paused:</b> {escape(view.paused)}</p>'
    board = ''
    if view.board is not None and view.board.board:
        notes = ''.join(f'<span>{note}</span>' for note in notes_html(view.board))
        board = f'{board_svg(view.board)}<p class="notes">{notes}</p>'
    blocks = [*view.panel.beside, *view.panel.below]
    return {
        'head': head,
        'board': board,
        'panel': ''.join(map(drawn, blocks)),
        'said': f'<div role="status">{drawn(view.said)}</div>',
        'keys': _keys(view.keys, blocks),
    }


@singledispatch
def drawn(block: Block) -> str:
    """Return the HTML of a part of a panel."""
    raise TypeError(f'{type(block).__name__} cannot be drawn')


@drawn.register
def _line(line: Line) -> str:
    return f'<p>{_piece(line)}{"".join(map(_piece, line.more))}</p>' if line.text else ''


def _piece(line: Line) -> str:
    strong = ' strong' if line.strong else ''
    return f'<span class="{line.tone.value}{strong}">{escape(line.text)}</span>'


@drawn.register
def _typed(typed: TypedText) -> str:
    return (
        f'<form class="typed"><input value="{escape(typed.text)}" maxlength="{MOST_CHARACTERS}" '
        'aria-label="your answer" autocomplete="off" autocapitalize="off" spellcheck="false">'
        '<button class="enter">OK</button></form>'
    )


@drawn.register
def _choices(choices: Choices) -> str:
    rows = []
    for number, item in enumerate(choices.items):
        away = number - choices.at
        moves = [DOWN if away > 0 else UP] * abs(away)
        words = f'<b>{escape(item.text)}</b> <span class="quiet">{escape(item.note)}</span>'
        rows.append(_button([*moves, ENTER], words, 'choice' + (' at' if not away else '')))
    return f'<div class="choices">{"".join(rows)}</div>'


@drawn.register
def _key_table(keys: KeyTable) -> str:
    rows = [
        f'<dt><kbd>{escape(key)}</kbd></dt><dd>{escape(words)}</dd>'
        for key, words in keys.rows
        if key_of(key) != INTERRUPT
    ]
    return f'<dl>{"".join(rows)}</dl>'


@drawn.register
def _features(features: Features) -> str:
    rows = [
        f'<li>{escape(feature.name)} <b class="news">{escape(feature.value)}</b></li>'
        for feature in features.shown
    ]
    hidden = f'<li class="quiet">{escape(features.hidden)}</li>' if features.hidden else ''
    return f'<p class="quiet">depends on</p><ul class="features">{"".join(rows)}{hidden}</ul>'


@drawn.register
def _criteria(criteria: Criteria) -> str:
    rows = []
    for shown in criteria.rows:
        bar = f'<i style="width:{100 * (shown.share or 0):.1f}%"></i>'
        mark = f'<u style="left:{100 * TARGET:.1f}%"></u>'
        words = f'{escape(shown.now)} <span class="quiet">{escape(shown.needs)}</span>'
        rows.append(
            f'<li class="{shown.tone.value}"><span>{escape(shown.mark)} {escape(shown.name)}'
            f'</span><span>{words}</span><div class="bar" aria-hidden="true">{bar}{mark}</div>'
            '</li>'
        )
    return f'<ul class="criteria">{"".join(rows)}</ul>'


def _keys(keys: Keys, blocks: Sequence[Block]) -> str:
    """Return the buttons: a pad of arrows with what is used most beside it, then all others."""
    kinds = {type(block) for block in blocks}
    elsewhere = {ENTER, BACKSPACE} if kinds & {TypedText, Choices} else set()
    without = {'', INTERRUPT, *elsewhere}
    named = [(key_of(label), label, words) for label, words in keys]
    known = [named_key for named_key in named if named_key[0] not in without]
    arrows = {key: words for key, _, words in known if key in _PAD}
    others = [
        _button(
            [key],
            f'<kbd>{escape(label)}</kbd> {escape(words)}',
            'enter' if key == ENTER else '',
        )
        for key, label, words in known
        if key not in _PAD
    ]
    if len(arrows) < len(_PAD):
        return f'<div class="row">{"".join(others)}</div>'
    signs = dict(zip(_PAD, '▲◀▼▶'))
    pad = [
        _button([key], f'<span aria-hidden="true">{signs[key]}</span>', key, arrows[key])
        for key in _PAD
    ]
    main, rest = ''.join(others[:_BESIDE_PAD]), ''.join(others[_BESIDE_PAD:])
    return (
        f'<div class="driving"><div class="pad">{"".join(pad)}</div>'
        f'<div class="main">{main}</div><div class="row">{rest}</div></div>'
    )


def _button(keys: Sequence[str], inner: str, name: str, label: str = '') -> str:
    """
    Return a button.

    :param inner: what stands on it, as HTML.
    :param label: what it is called where that is no text.
    """
    called = f' aria-label="{escape(label)}" title="{escape(label)}"' if label else ''
    pressed = escape(json.dumps(list(keys)))
    return f'<button type="button" class="{name}" data-keys="{pressed}"{called}>{inner}</button>'
