"""A board as a picture on a page, and as shapes on a plane for viewers."""

from xml.etree import ElementTree

from humanopts_env.board import Board, FLAG, Mark, PERSON
from humanopts_env.colours import RED
from humanopts_env.domains.base import BoardSlice
from humanopts_env.domains.capabilities import board_of
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_teach.board_html import board_html, notes_html
from humanopts_teach.scene import (
    Kind,
    layout_of,
    occupied,
    RESOLUTION,
    scene,
    text_above,
    value_shapes,
)
import numpy as np
import pytest

NAMES = ('taxi', 'rooms', 'pacman', 'gymnasium:FrozenLake-v1')
# Two cells with a wall between them above a block and a cell with two marks.
BOARD = Board(
    2,
    2,
    blocks=((1, 0),),
    walls=((0, 1, 1, 1),),
    marks=(Mark((1, 1), PERSON, 'agent', RED), Mark((1, 1), 'G', 'goal'), Mark((0, 0), FLAG, 'f')),
    notes=('row: 1',),
)


def a_board(name: str) -> Board:
    domain = make_domain(name)
    return board_of(domain, domain.reset(generator(3)))


def test_shapes_lie_where_the_board_says() -> None:
    shapes = {(s.layer, s.kind, s.text): s for s in scene(BOARD)}
    walls = shapes['board', Kind.LINES, ''].points
    frame = {((0, 2), (2, 2)), ((0, 0), (2, 0)), ((0, 2), (0, 0)), ((2, 2), (2, 0))}
    assert set(zip(walls[::2], walls[1::2])) == {*frame, ((1, 2), (1, 1))}
    assert shapes['board', Kind.TILES, ''].points == ((0.5, 0.5),)
    assert shapes['board', Kind.DOTS, ''].points == ((1.5, 1.5),)  # the empty cell
    agent, goal = shapes['signs', Kind.BALL, PERSON], shapes['signs', Kind.TEXT, 'G']
    assert (agent.points, goal.points) == (((1.25, 0.5),), ((1.75, 0.5),))
    assert agent.colours == ((215 / 255, 0.0, 0.0),)
    assert shapes['signs', Kind.BOX, FLAG].points == ((0.5, 1.5),)
    notes = [text for layer, _, text in shapes if layer == 'notes']
    assert notes == [f'{PERSON} agent   G goal   {FLAG} f', 'row: 1']


@pytest.mark.parametrize('name', NAMES)
def test_every_mark_is_a_shape_in_its_cell(name: str) -> None:
    board = a_board(name)
    signs = [shape for shape in scene(board) if shape.layer == 'signs']
    found = {
        (shape.text, int(board.rows - y), int(x))
        for s in signs
        for shape, (x, y) in [(s, s.points[0])]
    }
    assert found == {(mark.kind, *mark.cell) for mark in board.marks}
    assert all(len(s.colours) in (1, len(s.points)) for s in scene(board))


def test_the_map_has_walls_and_blocks() -> None:
    grid = occupied(BOARD)[::-1]  # from the top
    side = round(1 / RESOLUTION)
    assert grid.shape == (2 * side + 1, 2 * side + 1)
    assert grid[: side + 1, side].all()
    assert not grid[side + 1 : -1, side + 1 : -1].any()
    assert grid[side:, : side + 1].all()
    assert grid[[0, -1]].all()


def test_the_walls_of_rooms_are_those_of_sutton_precup_and_singh() -> None:
    side = round(1 / RESOLUTION)
    cells = occupied(a_board('rooms'))[::-1][side // 2 :: side, side // 2 :: side]
    assert np.count_nonzero(~cells) == 104  # cells of the four rooms and their four hallways
    assert not cells[2, 5]
    assert not cells[5, 1]


def test_values_are_coloured_between_the_least_and_the_greatest() -> None:
    layout = BoardSlice('goal G1', np.array([[4, 5], [-1, 6]], dtype=np.int32))
    tiles, legend = value_shapes(
        BOARD, layout, np.array([4, 5, 6]), np.array([0.0, 1.0, -np.inf]), 'human'
    )
    assert tiles.points == ((0.5, 1.5), (1.5, 1.5))  # an option that is not available has no value
    assert tiles.colours[0] == pytest.approx((0.15, 0.2, 0.55))
    assert tiles.colours[1] == pytest.approx((0.95, 0.85, 0.2))
    assert legend.text == 'human: 0 (blue) to 1 (yellow), goal G1'
    assert not list(value_shapes(BOARD, layout, np.array([4]), np.array([-np.inf]), 'human'))
    large = BoardSlice('large', np.arange(441, dtype=np.int32).reshape(21, 21))
    assert not list(value_shapes(BOARD, large, np.arange(441), np.ones(441), 'human'))
    assert layout_of([layout, large], 100) is large
    assert layout_of([layout, large], 1000) is layout


def test_the_option_is_written_above_the_board() -> None:
    shape = text_above(BOARD, 'go to passenger', 'option', 0.6, 0.6)
    assert (shape.layer, shape.points, shape.text) == ('option', ((1.0, 2.6),), 'go to passenger')


@pytest.mark.parametrize('name', NAMES)
def test_a_picture_has_every_mark_in_its_cell(name: str) -> None:
    board = a_board(name)
    tree = ElementTree.fromstring(board_html(board))
    assert tree.get('viewBox') == f'-3 -3 {40 * board.cols + 6} {40 * board.rows + 6}'
    moved = [group.get('transform', '').split(')')[0][10:].split() for group in tree.iter('g')]
    cells = [(int(float(y) // 40), int(float(x) // 40)) for x, y in moved]
    assert sorted(cells) == sorted(mark.cell for mark in board.marks)
    letters = sorted(mark.kind for mark in board.marks if mark.kind.isalpha())
    assert (
        sorted(text.text or '' for text in tree.iter('text') if (text.text or '').isalpha())
        == letters
    )


def test_walls_are_lines_of_the_picture() -> None:
    paths = [path.get('d') for path in ElementTree.fromstring(board_html(BOARD)).iter('path')]
    assert paths[:3] == ['M0 40h40v40h-40z', 'M0 0H80V80H0zM40 0L40 40', 'M60 20h0']


def test_what_is_drawn_is_escaped() -> None:
    board = Board(1, 1, marks=(Mark((0, 0), '<', 'a <b>', RED),), notes=('"x" & y',))
    assert [text.text for text in ElementTree.fromstring(board_html(board)).iter('text')] == ['<']
    assert notes_html(board) == [
        '<b class="g1">&lt;</b> a &lt;b&gt;',
        '&quot;x&quot; &amp; y',
    ]
    assert board_html(Board(picture='<a>')) == (
        '<pre class="board" role="img" aria-label="the board">&lt;a&gt;</pre>'
    )
    assert board_html(Board(notes=('row: 1',))) == ''
