"""Rendering of a board as HTML: an SVG or PNG image and its caption."""

from base64 import b64encode
from functools import cache
import html
from io import BytesIO

from humanopts_env.board import (
    BALL,
    Board,
    BOX,
    captions,
    DOT,
    FLAG,
    HATCHED_BOX,
    Image,
    Mark,
    OPEN_BOX,
    PERSON,
    runs,
)
from PIL import Image as Pillow
from rich.color import ColorSystem
from rich.style import Style

CELL = 40  # width and height of a cell in the image
# Shapes centred at (0, 0) in a square of size 20; other marks are letters.
_SHAPES = {
    OPEN_BOX: '<rect x="-7" y="-7" width="14" height="14" rx="3" class="open"/>',
    BOX: '<rect x="-8" y="-8" width="16" height="16" rx="3"/>',
    HATCHED_BOX: '<rect x="-7" y="-7" width="14" height="14" rx="3" class="open"/>'
    '<path d="M-4 4L4 -4M-4 -1L-1 -4M1 4L4 1" class="open"/>',
    PERSON: '<circle r="8.5"/><path d="M-3.2 -3v1M3.2 -3v1M-4.5 2.5Q0 7 4.5 2.5" class="face"/>',
    FLAG: '<path d="M-5 9V-9" class="open"/><path d="M-5 -9L8 -4.5L-5 0Z"/>',
    BALL: '<circle r="5.5"/>',
    DOT: '<circle r="2"/>',
}


def board_html(board: Board, words: str = 'the board') -> str:
    """
    Return the board as an image, with no reference to another file.

    The style sheet sets the colours of the classes of an SVG image.

    :param words: description for screen readers.
    """
    label = html.escape(words)
    if board.image is not None:
        return _png(board.image, label)
    if not board.rows:
        text = html.escape(board.picture)
        return f'<pre class="board" role="img" aria-label="{label}">{text}</pre>' if text else ''
    width, height, walls = board.cols * CELL, board.rows * CELL, style_classes(board.colour)
    lines = ''.join(
        f'M{left * CELL} {top * CELL}L{right * CELL} {bottom * CELL}'
        for top, left, bottom, right in board.walls
    )
    blocks = ''.join(f'M{c * CELL} {r * CELL}h{CELL}v{CELL}h-{CELL}z' for r, c in board.blocks)
    dots = ''.join(
        f'M{c * CELL + CELL // 2} {r * CELL + CELL // 2}h0' for r, c in board.empty_cells()
    )
    drawn = [
        f'<path class="blocks {walls}" d="{blocks}"/>',
        f'<path class="walls {walls}" d="M0 0H{width}V{height}H0z{lines}"/>',
        f'<path class="dots" d="{dots}"/>',
        *(_mark(*each) for each in board.places()),
    ]
    return (
        f'<svg class="board" role="img" aria-label="{label}" '
        f'viewBox="-3 -3 {width + 6} {height + 6}">{"".join(drawn)}</svg>'
    )


def _png(image: Image, label: str) -> str:
    """Return an image as an element of the same size in pixels."""
    height, width, _ = image.shape
    file = BytesIO()
    Pillow.fromarray(image).save(file, 'PNG')
    return (
        f'<img class="board" alt="{label}" width="{width}" height="{height}" decoding="sync" '
        f'src="data:image/png;base64,{b64encode(file.getvalue()).decode()}"/>'
    )


def notes_html(board: Board) -> list[str]:
    """Return the caption of a board, one HTML fragment per part."""
    return [
        ''.join(
            f'<b class="{style_classes(style)}">{html.escape(text)}</b>'
            if style
            else html.escape(text)
            for text, style in runs(piece)
        )
        for pieces in captions(board)
        for piece in pieces
    ]


def _mark(mark: Mark, place: tuple[float, float], size: float) -> str:
    name, scale = style_classes(mark.colour), 1.4 if size == 1 else 2 * size
    at = f'translate({place[1] * CELL:g} {place[0] * CELL:g}) scale({scale:.3g})'
    shape = _SHAPES.get(mark.kind) or f'<text y="6">{html.escape(mark.kind)}</text>'
    return f'<g class="{name}" transform="{at}">{shape}</g>'


@cache
def style_classes(style: str) -> str:
    """Return the CSS class for a style in rich's notation: the nearest of eight colours."""
    colour = Style.parse(style).color
    if colour is None or colour.is_default:
        return ''
    return f'g{(colour.downgrade(ColorSystem.STANDARD).number or 0) % 8}'
