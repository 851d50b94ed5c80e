"""
A board as planar shapes, in metres, for viewers such as RViz and Foxglove.

A cell is 1 m wide and high: x points right, y up, and the origin is the lower left corner.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
import math

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.board import Board, BOX, caption, DOT, FLAG, HATCHED_BOX, Mark, OPEN_BOX
from humanopts_env.domains.base import BoardSlice
import numpy as np
from rich.style import Style

RESOLUTION = 0.25  # m, cell size of the map
_CELLS = round(1 / RESOLUTION)  # number of map cells along a cell of the board
_MAX_CELLS = 400  # maximum number of cells of a layout to draw values
_PLAIN, _DIM = (0.9, 0.9, 0.9), (0.45, 0.45, 0.45)
_LOWEST, _HIGHEST = (0.15, 0.2, 0.55), (0.95, 0.85, 0.2)  # colours of values

Point = tuple[float, float]  # x, y in m
Colour = tuple[float, float, float]  # red, green, blue, from 0 to 1


class Kind(Enum):
    """The kind of a shape; the values are type names of visualization_msgs/Marker."""

    LINES = 'LINE_LIST'  # two points per line
    TILES = 'CUBE_LIST'  # centres of rectangles
    DOTS = 'SPHERE_LIST'  # centres of balls
    BALL = 'SPHERE'  # centre of the ball
    BOX = 'CUBE'  # centre of the box
    TEXT = 'TEXT_VIEW_FACING'  # centre of the text


@dataclass(frozen=True)
class Shape:
    """A shape of one kind in one layer."""

    layer: str  # board, signs, notes, option or values; viewers can hide each layer
    kind: Kind
    points: tuple[Point, ...]
    colours: tuple[Colour, ...]  # one per point, or one for all points
    size: Point  # m, width and height; lines use only the first, texts only the second
    text: str = ''


def occupied(board: Board) -> Flags:
    """
    Return an occupancy map, (rows, columns) of 0.25 m cells starting at the bottom.

    Walls are one cell wide, so the map is one cell larger than the board.
    """
    grid = np.zeros((_CELLS * board.rows + 1, _CELLS * board.cols + 1), dtype=np.bool_)
    blocks = [(row, col, row + 1, col + 1) for row, col in board.blocks]
    for ends in (*board.edges(), *blocks):
        top, left, bottom, right = (_CELLS * end for end in ends)
        grid[top : bottom + 1, left : right + 1] = True
    return grid[::-1]


def scene(board: Board) -> Iterator[Shape]:
    """Yield the shapes of a board: walls, blocks, dots, marks, and the caption below it."""
    colour, thin = _rgb(board.colour), (0.08, 0.08)
    height, width = board.rows, board.cols
    if height:
        ends = (p for a, b, c, d in board.edges() for p in ((b, height - a), (d, height - c)))
        points = tuple((float(x), float(y)) for x, y in ends)
        yield Shape('board', Kind.LINES, points, (colour,), thin)
    for kind, cells, of, size in (
        (Kind.TILES, board.blocks, colour, (1.0, 1.0)),
        (Kind.DOTS, board.empty_cells(), _DIM, (0.12, 0.12)),
    ):
        if cells:
            centres = tuple((col + 0.5, height - row - 0.5) for row, col in cells)
            yield Shape('board', kind, centres, (of,), size)
    for mark, (row, col), part in board.places():
        yield _sign(mark, (col, height - row), 1.0 if part == 1 else 0.7)
    lines = [*board.picture.split('\n'), *(''.join(s for s, _ in line) for line in caption(board))]
    for number, note in enumerate(filter(None, lines)):
        yield Shape(
            'notes', Kind.TEXT, ((width / 2, -0.8 - 0.6 * number),), (_PLAIN,), (0.0, 0.4), note
        )


def text_above(board: Board, text: str, layer: str, distance: float, size: float) -> Shape:
    """Return a text centred above the board, at a distance in m."""
    at = board.cols / 2, board.rows + distance
    return Shape(layer, Kind.TEXT, (at,), (_PLAIN,), (0.0, size), text)


def layout_of(layouts: Sequence[BoardSlice], state: int) -> BoardSlice:
    """Return the board layout that contains a state; if none does, the first one."""
    return next((layout for layout in layouts if state in layout.states), layouts[0])


def value_shapes(
    board: Board, layout: BoardSlice, states: Ints, values: Floats, plan: str
) -> Iterator[Shape]:
    """
    Yield a tile for each cell, from blue (minimum value) to yellow (maximum), and a legend.

    Nothing is drawn if the layout has no values or more than 400 cells.

    :param states: (K,) indices of states.
    :param values: (K,) values of these states, discounted return.
    :param plan: description of the plan.
    """
    known = {s: v for s, v in zip(states.tolist(), values.tolist()) if math.isfinite(v)}
    cells = {
        (col + 0.5, board.rows - row - 0.5): known[int(state)]
        for (row, col), state in np.ndenumerate(layout.states)
        if state in known
    }
    if not cells or np.count_nonzero(layout.states >= 0) > _MAX_CELLS:
        return
    low, high = min(cells.values()), max(cells.values())
    colours = tuple(_mixed((value - low) / ((high - low) or 1.0)) for value in cells.values())
    yield Shape('values', Kind.TILES, tuple(cells), colours, (1.0, 1.0))
    legend = f'{plan}: {low:.3g} (blue) to {high:.3g} (yellow), {layout.title}'
    yield text_above(board, legend, 'values', 1.4, 0.4)


def _sign(mark: Mark, at: Point, scale: float) -> Shape:
    """Draw a letter as text; RViz supports no other signs, so they become boxes and balls."""
    colour = (_rgb(mark.colour),)
    if mark.kind.isascii():
        return Shape('signs', Kind.TEXT, (at,), colour, (0.0, 0.6 * scale), mark.kind)
    sides = {BOX: 0.6, OPEN_BOX: 0.6, HATCHED_BOX: 0.6, DOT: 0.2}
    side = sides.get(mark.kind, 0.45) * scale
    kind = Kind.BOX if mark.kind in (BOX, OPEN_BOX, HATCHED_BOX, FLAG) else Kind.BALL
    return Shape('signs', kind, (at,), colour, (side, side), mark.kind)


def _rgb(colour: str) -> Colour:
    """Convert a colour from rich's notation."""
    parsed = Style.parse(colour).color
    if parsed is None or parsed.is_default:
        return _PLAIN
    red, green, blue = parsed.get_truecolor()
    return red / 255, green / 255, blue / 255


def _mixed(share: float) -> Colour:
    red, green, blue = (a + (b - a) * share for a, b in zip(_LOWEST, _HIGHEST))
    return red, green, blue
