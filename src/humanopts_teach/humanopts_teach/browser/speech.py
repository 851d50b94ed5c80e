"""Texts for screen readers: the board in words, and the changes since the last frame."""

import re

from humanopts_env.board import Board, Cell
from humanopts_teach.dialogue.panel import Features, Line, ScreenView
from humanopts_teach.language import _, in_its_language, N_

_MAX_PLACES = 6  # maximum number of listed places; more are counted
_NUMBER = re.compile(r'\d+')
_SIDES = {N_('north'): (-1, 0), N_('east'): (0, 1), N_('south'): (1, 0), N_('west'): (0, -1)}


def board_words(board: Board) -> str:
    """Return the board in words: its size, marks, walls next to the first mark, and notes."""
    size = _('{rows} rows and {columns} columns, counted from 0 at the top left')
    places = (f'{name}: {where}' for name, where in _places(board).items())
    found = (
        (size.format(rows=board.rows, columns=board.cols), *places, *_surroundings(board))
        if board.rows
        else ()
    )
    return '. '.join((_('The board'), *found, *board.notes))


@in_its_language
def changes(now: ScreenView, before: ScreenView | None) -> str:
    """
    Return what to announce about a frame; empty: nothing is new.

    These are lines that differ in more than their numbers, and changed marks or features.
    """
    known = _lines(before)
    new = [text for key, text in _lines(now).items() if key not in known]
    if before is not None and now.plays and before.plays:
        moved = _moved(before, now)
        stepped = _lines(now) != known
        new += moved or ([_('no change on the board')] if stepped and not new else [])
    return re.sub(r'(?<=[?!])\.', '', '. '.join(text.rstrip('.') for text in new))


def _lines(view: ScreenView | None) -> dict[str, str]:
    """Return the lines of the panel by their text without numbers."""
    blocks = () if view is None else (*view.panel.beside, *view.panel.below)
    texts = [
        ''.join(piece.text for piece in (block, *block.more))
        for block in blocks
        if isinstance(block, Line)
    ]
    return {_NUMBER.sub('', text): text for text in texts if text}


def _moved(before: ScreenView, now: ScreenView) -> list[str]:
    """Return the changes made by a step on the board or in the table of features."""
    old, new = (_facts(each) for each in (before, now))
    return [' '.join(fact) for fact in new if fact not in old]


def _facts(view: ScreenView) -> list[tuple[str, ...]]:
    if view.board is not None and view.board.rows:
        near = [(text,) for text in _surroundings(view.board)]
        return [*_places(view.board).items(), *near, *((note,) for note in view.board.notes)]
    shown = [b.shown for b in view.panel.beside if isinstance(b, Features)]
    return [(name, value) for features in shown for name, value in features]


def _places(board: Board) -> dict[str, str]:
    """Return the places of the marks by name."""
    by_name: dict[str, list[tuple[str, Cell]]] = {}
    for mark in board.marks:
        by_name.setdefault(mark.name, []).append((mark.kind, mark.cell))
    found = {}
    for name, marks in by_name.items():
        several = len({kind for kind, _ in marks}) > 1
        each = _('row {row}, column {column}')
        places = [
            (f'{kind} ' if several else '') + each.format(row=row, column=column)
            for kind, (row, column) in marks
        ]
        found[name] = (
            '; '.join(places)
            if len(places) <= _MAX_PLACES
            else _('in {count} cells').format(count=len(places))
        )
    return found


def _surroundings(board: Board) -> list[str]:
    """Describe the walls next to the first mark, which is the agent if it is shown."""
    if not board.marks:
        return []
    (row, col), name = board.marks[0].cell, board.marks[0].name
    edges = board.edges()
    walls = [
        _(side)
        for side, (down, right) in _SIDES.items()
        if (row + down, col + right) in board.blocks
        or any(_separates(edge, row, col, down, right) for edge in edges)
    ]
    if not walls:
        return [_('no wall next to {name}').format(name=name)]
    return [_('walls next to {name}: {sides}').format(name=name, sides=', '.join(walls))]


def _separates(edge: tuple[int, int, int, int], row: int, col: int, down: int, right: int) -> bool:
    """Return whether a wall is on one side of a cell."""
    top, left, bottom, end = edge
    if down:
        return top == bottom == row + (down > 0) and left <= col < end
    return left == end == col + (right > 0) and top <= row < bottom
