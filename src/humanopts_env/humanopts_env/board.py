"""
A board as geometry and as text.

A domain defines a board by its cells, walls and marks. Terminals, web pages, RViz and the figures
of reports all draw the same ``Board``; ``board_text`` draws it for terminals, logs and tests.

Cells are (row, column), row 0 in the north and column 0 in the west. The corner between four
cells has the row and column of the cell south-east of it. The frame around all cells is implied.
"""

from dataclasses import dataclass, field
from itertools import groupby, product
import math
import re

import numpy as np
from numpy.typing import NDArray

# Marks drawn as shapes in pictures; all others are letters.
PERSON, BOX, OPEN_BOX, HATCHED_BOX, FLAG, BALL, DOT = '☻■□▒⚑●·'
DIM = 'dim'  # a style, like the colours in ``colours``
BLOCK = '█'
CAPTION_WIDTH = 78  # characters
_LINES = ' ╹╻┃╸┛┓┫╺┗┏┣━┻┳╋'  # indexed by arms: bit 0 up, 1 down, 2 left, 3 right
_HIGHLIGHT = re.compile(r'(?:\x1b\[[\d;]*m)*\x1b\[(?:\d+;)*4\d(?:;\d+)*m([^\x1b]*)\x1b\[0?m')
_ESCAPE = re.compile(r'\x1b\[[\d;]*m')
_UP, _DOWN, _LEFT, _RIGHT = 1, 2, 4, 8

Cell = tuple[int, int]
Wall = tuple[int, int, int, int]  # row and column of one corner, then of the other
Sign = tuple[str, str]  # a character and its rich style
Image = NDArray[np.uint8]  # (height, width, 3): red, green, blue


@dataclass(frozen=True, slots=True)
class Mark:
    """An object in a cell."""

    cell: Cell
    kind: str  # one character: one of the shapes above, or a letter
    name: str  # text in the legend; marks with equal names are grouped
    colour: str = ''  # one of ``colours``; empty: text colour


@dataclass(frozen=True, slots=True)
class Board:
    """The visible part of a state. Blocks and walls are the same in all states of a domain."""

    rows: int = 0
    cols: int = 0
    blocks: tuple[Cell, ...] = ()  # cells that nothing can enter
    walls: tuple[Wall, ...] = ()  # straight lines along the edges of cells
    marks: tuple[Mark, ...] = ()  # the first mark of a cell is in front
    notes: tuple[str, ...] = ()  # information that is not drawn
    colour: str = ''  # colour of blocks and walls
    dotted: bool = True  # draw a dot in each empty cell, so that cells are easy to count
    picture: str = ''  # text drawing of a world without cells
    image: Image | None = field(default=None, compare=False)  # image of a world without cells
    unseen: str = 'hidden: {name} in row {row}, column {col}'  # note for a mark that does not fit

    @property
    def drawn(self) -> bool:
        """Whether there are cells or a picture, and not only notes."""
        return bool(self.rows or self.picture) or self.image is not None

    def edges(self) -> tuple[Wall, ...]:
        """Return the sides of the frame and all walls."""
        return (*_frame(self.rows, self.cols), *self.walls) if self.rows else ()

    def places(self) -> list[tuple[Mark, tuple[float, float], float]]:
        """Return each mark with its position in rows and columns, and its size in cells."""
        found = []
        for (row, col), marks in self.marks_by_cell().items():
            across = math.ceil(math.sqrt(len(marks)))
            down = math.ceil(len(marks) / across)
            for number, mark in enumerate(marks):
                part = divmod(number, across)
                place = row + (part[0] + 0.5) / down, col + (part[1] + 0.5) / across
                found.append((mark, place, 1 / across))
        return found

    def marks_by_cell(self) -> dict[Cell, list[Mark]]:
        """Return the marks of each cell that has any."""
        found: dict[Cell, list[Mark]] = {}
        for mark in self.marks:
            found.setdefault(mark.cell, []).append(mark)
        return found

    def empty_cells(self) -> list[Cell]:
        """Return the cells without a block or a mark; none if the board is not dotted."""
        taken = {*self.blocks, *(mark.cell for mark in self.marks)}
        cells = product(range(self.rows), range(self.cols)) if self.dotted else ()
        return [cell for cell in cells if cell not in taken]


def signs(board: Board, scale: int = 1) -> list[list[Sign]]:
    """
    Return the board as rows of characters of equal length.

    A cell is two characters wide and shows two marks; on boards with walls between cells, it is
    three characters wide and shows three marks.

    :param scale: factor for the width and height of cells, at least 1.
    """
    if not board.rows:
        lines = board.picture.split('\n') if board.picture else []
        width = max(map(len, lines), default=0)
        return [_plain(line.ljust(width)) for line in lines]
    down, across, edge = (2 * scale, 4 * scale, 0) if board.walls else (scale, 2 * scale, 1)
    bottom, right = down * board.rows + edge, across * board.cols + edge
    width, height = across + edge - 1, down + edge - 1  # size inside a cell
    arms = np.zeros((bottom + 1, right + 1), dtype=np.intp)
    inner = [(down * a, across * b, down * c, across * d) for a, b, c, d in board.walls]
    for top, left, end, last in (*_frame(bottom, right), *inner):
        arms[top:end, left : last + 1] |= _DOWN
        arms[top + 1 : end + 1, left : last + 1] |= _UP
        arms[top : end + 1, left:last] |= _RIGHT
        arms[top : end + 1, left + 1 : last + 1] |= _LEFT
    glyphs = [(line, board.colour) for line in _LINES]
    rows = [[glyphs[arm] for arm in row] for row in arms.tolist()]
    block, dot = [(BLOCK, board.colour)] * width, [(DOT, DIM)]
    cells = dict.fromkeys(board.blocks, block) | dict.fromkeys(board.empty_cells(), dot)
    for cell, marks in board.marks_by_cell().items():
        cells[cell] = [(mark.kind, _style(mark)) for mark in marks[: 3 - edge]]
    for (row, col), shown in cells.items():
        start, above = across * col + 1 + (width - len(shown) + edge) // 2, down * row + 1
        inside = range(height) if shown is block else [(height - 1) // 2]
        for line in inside:
            rows[above + line][start : start + len(shown)] = shown
    return rows


def caption(board: Board, width: int = CAPTION_WIDTH) -> list[list[Sign]]:
    """
    Return the lines below the board.

    :param width: line width in characters, exceeded only by a longer single piece.
    """
    lines: list[list[Sign]] = []
    for pieces in captions(board):
        start = len(lines)
        for piece in pieces:
            if len(lines) > start and len(lines[-1]) + 3 + len(piece) <= width:
                lines[-1] += [(' ', '')] * 3 + piece
            else:
                lines.append(piece)
    return lines


def captions(board: Board) -> tuple[list[list[Sign]], list[list[Sign]]]:
    """Return the pieces of the legend and of the notes."""
    legend: dict[str, dict[str, str]] = {}  # name -> sign -> style
    for mark in board.marks:
        legend.setdefault(mark.name, {})[mark.kind] = _style(mark)
    shown = 3 if board.walls else 2
    hidden = [
        board.unseen.format(name=mark.name, row=row, col=col)
        for (row, col), marks in board.marks_by_cell().items()
        for mark in marks[shown:]
    ]
    explained = [
        [sign for kind in kinds.items() for sign in (kind, (' ', ''))] + _plain(name)
        for name, kinds in legend.items()
    ]
    return explained, [_plain(note) for note in (*board.notes, *hidden)]


def board_text(board: Board) -> str:
    """Return the board with its caption as lines of text."""
    lines = [*signs(board), *caption(board)]
    return '\n'.join(''.join(sign for sign, _ in line).rstrip() for line in lines)


def plain_picture(text: str) -> str:
    """Convert a world's terminal drawing to plain text, with blocks instead of highlights."""
    blocks = _HIGHLIGHT.sub(lambda match: BLOCK * len(match[1]), text)
    return _ESCAPE.sub('', blocks).rstrip()


def _frame(rows: int, cols: int) -> tuple[Wall, ...]:
    return (0, 0, 0, cols), (rows, 0, rows, cols), (0, 0, rows, 0), (0, cols, rows, cols)


def _plain(words: str) -> list[Sign]:
    return [(character, '') for character in words]


def _style(mark: Mark) -> str:
    return mark.colour if mark.kind == DOT else f'bold {mark.colour}'.rstrip()


def runs(line: list[Sign]) -> list[Sign]:
    """Merge adjacent characters of the same style."""
    return [
        (''.join(sign for sign, _ in group), style)
        for style, group in groupby(line, key=lambda sign: sign[1])
    ]
