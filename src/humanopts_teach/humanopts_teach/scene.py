"""
A game as shapes on a plane, in metres, for viewers such as RViz and Foxglove.

The drawing of the domain is laid flat, each character 0.5 m wide and 1 m high: x goes right,
y up, and the origin is the lower left corner. So every domain that can be drawn has a scene.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
import math
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import BoardSlice, Domain, EnumerableDomain
from humanopts_env.seeding import generator
from humanopts_teach.state_drawing import arms, DOT, draw_state, StateDrawing
import numpy as np
from numpy.typing import NDArray
from rich.errors import StyleSyntaxError
from rich.style import Style

WIDTH, HEIGHT = 0.5, 1.0  # m, of a character
_BLOCKS = '█▓▒░■'  # walls, where they are in every state
_SAMPLES = 50  # states that are compared to tell walls from what moves
_MOST_CELLS = 400  # of a layout whose values are drawn; each state of it is drawn once
_CORNER = 0.3  # m, of what is drawn as a box
_PLAIN, _DIM = (0.9, 0.9, 0.9), (0.45, 0.45, 0.45)
_LOWEST, _HIGHEST = (0.15, 0.2, 0.55), (0.95, 0.85, 0.2)  # of values

Point = tuple[float, float]  # x, y in m
Colour = tuple[float, float, float]  # red, green, blue, from 0 to 1


class Kind(Enum):
    """What the points of a shape are; the values are the types of visualization_msgs/Marker."""

    LINES = 'LINE_LIST'  # two for each line
    TILES = 'CUBE_LIST'  # centres of rectangles
    DOTS = 'SPHERE_LIST'  # centres of balls
    BALL = 'SPHERE'  # the centre of one
    BOX = 'CUBE'  # the centre of one
    TEXT = 'TEXT_VIEW_FACING'  # the centre of a text


@dataclass(frozen=True)
class Shape:
    """Things of one kind and layer."""

    layer: str  # board, signs, notes, option or values; viewers can hide each
    kind: Kind
    points: tuple[Point, ...]
    colours: tuple[Colour, ...]  # of each point; one: of all
    size: Point  # m; of lines the first is the width, of texts the second is the height
    text: str = ''


@dataclass(frozen=True)
class CellValues:
    """The values of a plan in the states of one layout of the board."""

    title: str  # of the layout
    points: tuple[Point, ...]  # centres of the cells, m
    values: tuple[float, ...]  # of each, discounted return
    size: Point  # of a cell, m


def walls(domain: Domain[Any]) -> Flags:
    """
    Return where the drawing shows a wall in every state, (lines, characters) from the top.

    A wall is a line of box characters, or a block. A block that is not in every state moves.
    """
    states = domain.sample_states(generator(0, 'walls'), _SAMPLES)
    boards = [draw_state(domain, state).board for state in states]
    return np.array(
        [
            [len(set(signs)) == 1 and _is_solid(signs[0]) for signs in zip(*lines)]
            for lines in zip(*boards)
        ],
        dtype=np.bool_,
    )


def occupied(where: Flags) -> Flags:
    """Return square cells of 0.5 m, (rows, columns) from the bottom, for walls as of ``walls``."""
    return np.repeat(where, round(HEIGHT / WIDTH), axis=0)[::-1]


def scene(domain: Domain[Any], state: Any, where: Flags) -> Iterator[Shape]:
    """
    Yield the shapes of a state: walls and dots, what is on the board, and what is told below it.

    :param where: as of ``walls``.
    """
    drawing = draw_state(domain, state)
    lines: dict[Colour, list[Point]] = {}
    blocks: dict[Colour, list[Point]] = {}
    dots: list[Point] = []
    signs = []
    for row, line in enumerate(drawing.board):
        for column, sign in enumerate(line):
            centre = _centre(drawing, row, column)
            colour = sign_colour(drawing.styles.get(sign, ''))
            if reached := arms(sign)[1]:
                for arm in reached:
                    lines.setdefault(colour, []).extend([centre, _edge(centre, arm)])
            elif where[row, column]:
                blocks.setdefault(colour, []).append(centre)
            elif sign == DOT:
                dots.append(centre)
            elif sign != ' ':
                signs.append(_sign(sign, centre, colour))
    for colour, points in lines.items():
        yield Shape('board', Kind.LINES, tuple(points), (colour,), (0.08, 0.08))
    for colour, points in blocks.items():
        yield Shape('board', Kind.TILES, tuple(points), (colour,), (WIDTH, HEIGHT))
    if dots:
        yield Shape('board', Kind.DOTS, tuple(dots), (_DIM,), (0.12, 0.12))
    yield from signs
    for number, note in enumerate(drawing.notes):
        place = _width(drawing) / 2, -0.8 * (number + 1)
        yield Shape('notes', Kind.TEXT, (place,), (_PLAIN,), (0.0, 0.6), note)


def option_shape(where: Flags, text: str) -> Shape:
    """Return the text above the board that says what runs."""
    return Shape('option', Kind.TEXT, (_above(where, 0.8),), (_PLAIN,), (0.0, 0.8), text)


def layout_of(layouts: Sequence[BoardSlice], state: int) -> int:
    """Return the layout of the board, by its index, that a state is in; else the first."""
    return next((n for n, layout in enumerate(layouts) if state in layout.states), 0)


def cell_values(
    domain: EnumerableDomain[Any], layout: BoardSlice, states: Ints, values: Floats
) -> CellValues | None:
    """
    Return the values of a plan in one layout of the board.

    A cell is where the drawing of its state differs from most of the layout's others.

    :param states: (K,) indices of states.
    :param values: (K,) of these states.
    :return: None where the plan has no value in the layout, or it has more than 400 cells.
    """
    if np.count_nonzero(layout.states >= 0) > _MOST_CELLS:
        return None
    found = _cells(domain, layout.states[layout.states >= 0])
    known = {s: v for s, v in zip(states.tolist(), values.tolist()) if math.isfinite(v)}
    cells = [(place, known[state]) for state, place in found.items() if state in known]
    if not cells:
        return None
    points, worth = zip(*cells)
    size = _spacing([x for x, _ in found.values()]), _spacing([y for _, y in found.values()])
    return CellValues(layout.title, points, worth, size)


def value_shapes(where: Flags, cells: CellValues, plan: str) -> Iterator[Shape]:
    """
    Yield a tile for each cell, from blue, the least value, to yellow, the greatest, and a legend.

    :param where: as of ``walls``.
    :param plan: what the values are of, in words.
    """
    low, high = min(cells.values), max(cells.values)
    span = (high - low) or 1.0
    colours = tuple(_mixed((value - low) / span) for value in cells.values)
    yield Shape('values', Kind.TILES, cells.points, colours, cells.size)
    legend = f'{plan}: {low:.3g} (blue) to {high:.3g} (yellow), {cells.title}'
    yield Shape('values', Kind.TEXT, (_above(where, 2.0),), (_PLAIN,), (0.0, 0.6), legend)


def sign_colour(style: str) -> Colour:
    """Return the colour of a style in rich's notation."""
    try:
        parsed = Style.parse(style)
    except StyleSyntaxError:
        return _PLAIN
    if parsed.color is None or parsed.color.is_default:
        return _DIM if parsed.dim else _PLAIN
    red, green, blue = parsed.color.get_truecolor()
    return red / 255, green / 255, blue / 255


def _above(where: Flags, distance: float) -> Point:
    """Return a place so far above the middle of the board."""
    lines, characters = where.shape
    return characters * WIDTH / 2, lines * HEIGHT + distance


def _is_solid(sign: str) -> bool:
    return sign in _BLOCKS or bool(arms(sign)[1])


def _width(drawing: StateDrawing) -> float:
    return max(map(len, drawing.board), default=0) * WIDTH


def _centre(drawing: StateDrawing, row: int, column: int) -> Point:
    return (column + 0.5) * WIDTH, (len(drawing.board) - row - 0.5) * HEIGHT


def _edge(centre: Point, arm: str) -> Point:
    """Return where an arm of a box character meets the edge of its cell; arm: U, D, L or R."""
    right, up = {'U': (0, 1), 'D': (0, -1), 'L': (-1, 0), 'R': (1, 0)}[arm]
    return centre[0] + right * WIDTH / 2, centre[1] + up * HEIGHT / 2


def _sign(sign: str, centre: Point, colour: Colour) -> Shape:
    """Draw a letter as itself; RViz has no other signs, which become boxes and balls."""
    if sign.isascii():
        return Shape('signs', Kind.TEXT, (centre,), (colour,), (0.0, 0.7), sign)
    kind = Kind.BOX if sign in '□■▒⚑' else Kind.BALL
    side = _CORNER * 2 if sign in '□■▒' else _CORNER * 1.4
    return Shape('signs', kind, (centre,), (colour,), (side, side), sign)


def _cells(domain: EnumerableDomain[Any], states: NDArray[np.int32]) -> dict[int, Point]:
    """Return the centre of the cell of each state: by the first sign that few others share."""
    drawings = {int(index): draw_state(domain, domain.state_at(int(index))) for index in states}
    texts = {index: ''.join(drawing.board) for index, drawing in drawings.items()}
    usual = [Counter(signs).most_common(1)[0][0] for signs in zip(*texts.values())]
    found = {}
    for index, drawing in drawings.items():
        differing = (n for n, signs in enumerate(zip(texts[index], usual)) if len(set(signs)) > 1)
        if (first := next(differing, None)) is not None:
            found[index] = _centre(drawing, *divmod(first, len(drawing.board[0])))
    places = [x for x, _ in found.values()]
    # The cells lie in the middle of the board; a sign may stand beside the middle of its cell.
    beside = (_width(drawing) - min(places) - max(places)) / 2 if places else 0.0
    aside = beside if abs(beside) < WIDTH else 0.0
    return {index: (x + aside, y) for index, (x, y) in found.items()}


def _spacing(places: Sequence[float]) -> float:
    """Return the least distance of two different places; 1 m where there is one."""
    return float(np.diff(np.unique(places)).min(initial=math.inf)) if len(set(places)) > 1 else 1.0


def _mixed(share: float) -> Colour:
    red, green, blue = (a + (b - a) * share for a, b in zip(_LOWEST, _HIGHEST))
    return red, green, blue
