"""A state of a game as a drawing: lines of characters with colours, for screens and pages."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
import html
from typing import Any
import unicodedata

from humanopts_env.domains.base import Domain
from rich.cells import cell_len
from rich.color import ColorSystem
from rich.errors import StyleSyntaxError
from rich.style import Style

CELL = (10, 20)  # width and height of a character in the picture
_ARMS = {  # words in the Unicode names of lines, and the edges of the cell that these reach
    'UP': 'U',
    'DOWN': 'D',
    'LEFT': 'L',
    'RIGHT': 'R',
    'VERTICAL': 'UD',
    'HORIZONTAL': 'LR',
}
DOT = '·'
# Characters that fonts draw in many ways, or not at all; drawn around (0, 0) in a square of 20.
_SHAPES = {
    '□': '<rect x="-7" y="-7" width="14" height="14" rx="3" class="open"/>',
    '■': '<rect x="-8" y="-8" width="16" height="16" rx="3"/>',
    '▒': '<rect x="-7" y="-7" width="14" height="14" rx="3" class="open"/>'
    '<path d="M-4 4L4 -4M-4 -1L-1 -4M1 4L4 1" class="open"/>',
    '☻': '<circle r="8.5"/><path d="M-3.2 -3v1M3.2 -3v1M-4.5 2.5Q0 7 4.5 2.5" class="face"/>',
    '⚑': '<path d="M-5 9V-9" class="open"/><path d="M-5 -9L8 -4.5L-5 0Z"/>',
    '●': '<circle r="5.5"/>',
}


@dataclass(frozen=True, slots=True)
class StateDrawing:
    """A drawn state; without lines, nothing is drawn yet."""

    board: tuple[str, ...] = ()  # lines, each as wide as the others
    notes: tuple[str, ...] = ()  # lines below it, which may be wider
    styles: Mapping[str, str] = field(default_factory=dict)  # of characters, in rich's notation


def draw_state(
    domain: Domain[Any], state: Any, shown: Collection[str] | None = None
) -> StateDrawing:
    """
    Return a state as its domain draws it.

    :param shown: names of the features that may be revealed; None: all.
    """
    lines = domain.render(state, shown).split('\n')
    width = cell_len(lines[0])
    end = next((n for n, line in enumerate(lines) if cell_len(line) != width), len(lines))
    return StateDrawing(tuple(lines[:end]), tuple(lines[end:]), domain.glyph_styles)


def board_svg(drawing: StateDrawing) -> str:
    """
    Return the board as an SVG picture, whose colours are classes of the style sheet.

    Lines of box characters are joined, and signs that fonts draw differently have shapes.
    """
    width, height = CELL
    classes = {glyph: style_classes(style) for glyph, style in drawing.styles.items()}
    lines: dict[str, str] = {}  # paths by their classes
    signs = []
    for row, line in enumerate(drawing.board):
        for column, character in enumerate(line):
            x, y = column * width + width // 2, row * height + height // 2
            name = classes.get(character, '')
            weight, reached = arms(character)
            if reached:
                key = f'line {weight} {name}'.rstrip()
                ends = {'U': f'V{y - 10}', 'D': f'V{y + 10}', 'L': f'H{x - 5}', 'R': f'H{x + 5}'}
                lines[key] = lines.get(key, '') + ''.join(
                    f'M{x} {y}{ends[arm]}' for arm in reached
                )
            elif character == DOT:
                lines['dots'] = lines.get('dots', '') + f'M{x} {y}h0'
            elif character != ' ':
                beside = line[max(column - 1, 0) : column] + line[column + 1 : column + 2]
                signs.append(_sign(character, x, y, name, crowded=bool(beside.strip(' ·'))))
    drawn = ''.join(f'<path class="{name}" d="{path}"/>' for name, path in lines.items())
    size = max(map(len, drawing.board), default=0) * width, len(drawing.board) * height
    return (
        f'<svg class="board" role="img" aria-label="the board" '
        f'viewBox="-5 0 {size[0] + 10} {size[1]}">{drawn}{"".join(signs)}</svg>'
    )


@cache
def arms(character: str) -> tuple[str, str]:
    """
    Return the weight of a box character, heavy or light, and the edges that it reaches.

    :return: edges are letters of UDLR (up, down, left, right); empty: it is no box character.
    """
    words = unicodedata.name(character, '').split()
    if words[:2] != ['BOX', 'DRAWINGS']:
        return '', ''
    weight = 'heavy' if 'HEAVY' in words else 'light'
    return weight, ''.join(_ARMS.get(word, '') for word in words)


def _sign(character: str, x: int, y: int, name: str, *, crowded: bool) -> str:
    """Draw any other character; a shape is smaller where it has a neighbour."""
    if character == '█':
        return f'<rect class="{name}" x="{x - 5}" y="{y - 10}" width="10.5" height="20.5"/>'
    shape = _SHAPES.get(character)
    if shape is None:
        return f'<text class="{name}" x="{x}" y="{y + 6}">{html.escape(character)}</text>'
    scale = ' scale(.72)' if crowded else ''
    return f'<g class="{name}" transform="translate({x} {y}){scale}">{shape}</g>'


def notes_html(drawing: StateDrawing) -> Iterator[str]:
    """Yield what stands below the board, a piece for each thing, with its colours, as HTML."""
    for line in drawing.notes:
        for piece in filter(None, map(str.strip, line.split('   '))):
            around = f' {piece} '
            yield ''.join(
                f'<b class="{style_classes(drawing.styles[sign])}">{html.escape(sign)}</b>'
                if sign in drawing.styles
                and not (around[at].isalpha() or around[at + 2].isalpha())
                else html.escape(sign)
                for at, sign in enumerate(piece)
            )


@cache
def style_classes(style: str) -> str:
    """Return CSS classes for a style in rich's notation: the nearest of eight colours."""
    try:
        parsed = Style.parse(style)
    except StyleSyntaxError:
        return ''
    names = ['dim'] if parsed.dim else []
    if parsed.color is not None and not parsed.color.is_default:
        nearest = parsed.color.downgrade(ColorSystem.STANDARD)
        names.append(f'g{(nearest.number or 0) % 8}')
    return ' '.join(names)
