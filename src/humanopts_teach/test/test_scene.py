"""A state as a picture, and as shapes on a plane for viewers."""

from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_teach.scene import (
    cell_values,
    Kind,
    layout_of,
    occupied,
    option_shape,
    scene,
    sign_colour,
    value_shapes,
    walls,
)
from humanopts_teach.state_drawing import board_svg, CELL, draw_state, notes_html, StateDrawing
import numpy as np
import pytest

NAMES = ('taxi', 'rooms', 'pacman', 'gymnasium:FrozenLake-v1', 'gymnasium:CliffWalking-v1')
LISTED = tuple(name for name in NAMES if name != 'pacman')  # whose states can be listed
NO_WALL = ('gymnasium:FrozenLake-v1', 'greenhouse')
EXAMPLE = Path(__file__).parents[3] / 'examples' / 'humanopts_greenhouse'


@pytest.fixture(params=[*NAMES, 'greenhouse'])
def domain(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Domain[Any]:
    """Each of our domains, and one of another package."""
    if request.param in NAMES:
        return make_domain(request.param, {})
    monkeypatch.syspath_prepend(str(EXAMPLE))
    from humanopts_greenhouse.greenhouse import Greenhouse

    return Greenhouse()


def some_states(domain: Domain[Any], count: int = 20) -> list[Any]:
    return domain.sample_states(generator(3, 'scene'), count)


def test_every_sign_of_every_domain_is_drawn_once_in_its_place(domain: Domain[Any]) -> None:
    where = walls(domain)
    for state in some_states(domain):
        board = draw_state(domain, state).board
        expected = {
            ((column + 0.5) / 2, len(board) - row - 0.5)
            for row, line in enumerate(board)
            for column, sign in enumerate(line)
            if sign != ' '
        }
        shapes = [s for s in scene(domain, state, where) if s.layer in ('board', 'signs')]
        lines = [s.points for s in shapes if s.kind is Kind.LINES]
        centres = {point for points in lines for point in points[::2]}
        centres |= {p for s in shapes if s.kind is not Kind.LINES for p in s.points}
        assert centres == expected
        assert all(len(s.colours) in (1, len(s.points)) for s in shapes)


def test_the_map_has_what_is_in_the_way_in_every_state(domain: Domain[Any]) -> None:
    grid = occupied(walls(domain))
    board = draw_state(domain, some_states(domain)[0]).board
    assert grid.shape == (2 * len(board), len(board[0]))
    assert grid.any() == (domain.name not in NO_WALL)
    assert not grid.all()


def test_the_walls_of_rooms_are_those_of_sutton_precup_and_singh() -> None:
    grid = occupied(walls(make_domain('rooms', {})))[::2, ::2][::-1]  # a cell, from the top
    assert grid.shape == (13, 13)
    assert np.count_nonzero(~grid) == 104  # cells of the four rooms and their four hallways
    assert not grid[3, 6]
    assert not grid[6, 2]
    assert grid[0].all()


def test_a_taxi_that_is_drawn_as_a_block_is_no_wall() -> None:
    taxi = make_domain('taxi', {})
    rows, columns = np.nonzero(walls(taxi))
    board = draw_state(taxi, some_states(taxi)[0]).board
    assert {board[row][column] for row, column in zip(rows, columns)} <= set('┏━┳┓┃╹╻┗┻┛')


@pytest.mark.parametrize('domain', [*LISTED, 'greenhouse'], indirect=True)
def test_a_value_lies_where_the_agent_is_drawn_in_its_state(domain: Domain[Any]) -> None:
    assert isinstance(domain, EnumerableDomain)
    states = np.arange(domain.n_states)
    for number, layout in enumerate(domain.board_slices()):
        cells = cell_values(domain, layout, states, states.astype(float))
        assert cells is not None
        there = {(r, c): int(s) for (r, c), s in np.ndenumerate(layout.states) if s >= 0}
        assert layout_of(domain.board_slices(), next(iter(there.values()))) == number
        found = dict(zip(map(int, cells.values), cells.points))
        assert set(found) == set(there.values())
        origin = {  # the lower left cell, from each
            (x - c * cells.size[0], y + r * cells.size[1])
            for (r, c), (x, y) in ((place, found[state]) for place, state in there.items())
        }
        assert len({(round(x, 6), round(y, 6)) for x, y in origin}) == 1


@pytest.mark.parametrize(
    ('name', 'first', 'size'),
    [('rooms', (1.5, 11.5), 1.0), ('taxi', (1.25, 9.5), 2.0), (NAMES[3], (0.5, 3.5), 1.0)],
)
def test_cells_have_their_centres_where_the_board_has_them(
    name: str, first: tuple[float, float], size: float
) -> None:
    domain = make_domain(name, {})
    assert isinstance(domain, EnumerableDomain)
    layout = domain.board_slices()[0]
    states = layout.states[layout.states >= 0].astype(np.intp)
    cells = cell_values(domain, layout, states, np.zeros(len(states)))
    assert cells is not None
    assert cells.size == (size, size)
    expected = {
        (first[0] + c * size, first[1] - r * size)
        for (r, c), state in np.ndenumerate(layout.states)
        if state >= 0
    }
    assert set(cells.points) == expected


def test_values_are_coloured_between_the_least_and_the_greatest() -> None:
    rooms = make_domain('rooms', {})
    assert isinstance(rooms, EnumerableDomain)
    (layout,) = rooms.board_slices()
    states = np.sort(layout.states[layout.states >= 0])[:3]
    cells = cell_values(rooms, layout, states, np.array([0.0, 1.0, -np.inf]))
    assert cells is not None
    tiles, legend = value_shapes(walls(rooms), cells, 'human')
    assert len(tiles.points) == 2  # an option that is not available has no value
    colours = dict(zip(cells.values, tiles.colours))
    assert colours[0.0] == pytest.approx((0.15, 0.2, 0.55))
    assert colours[1.0] == pytest.approx((0.95, 0.85, 0.2))
    assert legend.text == 'human: 0 (blue) to 1 (yellow), goal G1'
    assert cell_values(rooms, layout, states, np.full(3, -np.inf)) is None


def test_a_board_of_too_many_cells_has_no_values() -> None:
    large = make_domain('taxi', {'rows': 21, 'cols': 21})
    assert isinstance(large, EnumerableDomain)
    layout = large.board_slices()[0]
    assert cell_values(large, layout, layout.states.ravel(), np.ones(21 * 21)) is None


def test_the_option_is_written_above_the_board() -> None:
    shape = option_shape(np.zeros((4, 10), dtype=bool), 'go to passenger')
    assert (shape.layer, shape.points, shape.text) == ('option', ((2.5, 4.8),), 'go to passenger')


@pytest.mark.parametrize(
    ('style', 'colour'),
    [
        ('bold color(160)', (215 / 255, 0.0, 0.0)),
        ('dim', (0.45, 0.45, 0.45)),
        ('bold', (0.9, 0.9, 0.9)),
        ('no style', (0.9, 0.9, 0.9)),
    ],
)
def test_colours_are_those_of_the_drawing(style: str, colour: tuple[float, ...]) -> None:
    assert sign_colour(style) == colour


DOMAINS = ('taxi', 'rooms', 'pacman', 'gymnasium:FrozenLake-v1')


def parsed(drawing: StateDrawing) -> ElementTree.Element:
    """Return the picture as a tree."""
    return ElementTree.fromstring(board_svg(drawing))


def points(path: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the two ends of each stroke of a path of M, H and V."""
    found = []
    for x, y, along, to in re.findall(r'M(\d+) (\d+)([HV])(\d+)', path):
        end = (int(to), int(y)) if along == 'H' else (int(x), int(to))
        found.append(((int(x), int(y)), end))
    return found


@pytest.mark.parametrize('name', DOMAINS)
def test_each_character_of_the_board_has_its_sign_in_its_cell(name: str) -> None:
    domain: Any = make_domain(name)
    drawing = draw_state(domain, domain.reset(generator(3)))
    tree = parsed(drawing)
    columns, rows = len(drawing.board[0]), len(drawing.board)
    assert tree.get('viewBox') == f'-5 0 {10 * columns + 10} {20 * rows}'
    texts = {(t.get('x'), t.get('y')): t.text for t in tree.iter('text')}
    moved = {group.get('transform', '').split(' scale')[0] for group in tree.iter('g')}
    drawn = ' '.join(path.get('d', '') for path in tree.iter('path'))
    for row, line in enumerate(drawing.board):
        for column, character in enumerate(line):
            x, y = column * CELL[0] + 5, row * CELL[1] + 10
            if character.isalpha():
                assert texts[str(x), str(y + 6)] == character
            elif character in '☻⚑□■▒●':
                assert f'translate({x} {y})' in moved
            elif character == '·' or '─' <= character <= '╿':
                assert f'M{x} {y}' in drawn


def test_walls_that_meet_are_joined() -> None:
    tree = parsed(StateDrawing(('┏━┓', '┃ ╹', '╰─╮')))
    strokes = [points(path.get('d', '')) for path in tree.iter('path')]
    ends = {end for path in strokes for stroke in path for end in stroke}
    assert {(10, 10), (20, 10)} <= ends  # of the corners and the line between them
    assert {(5, 20), (5, 40), (25, 20)} <= ends  # down the left side; and the stub at the right
    heavy, light = (path.get('class') for path in tree.iter('path'))
    assert (heavy, light) == ('line heavy', 'line light')


def test_what_is_drawn_is_escaped() -> None:
    drawing = StateDrawing(('<&>',), ('& is "<b>"   x',), {'&': 'bold red', 'x': 'no such style'})
    assert [text.text for text in parsed(drawing).iter('text')] == ['<', '&', '>']
    assert list(notes_html(drawing)) == [
        '<b class="g1">&amp;</b> is &quot;&lt;b&gt;&quot;',
        '<b class="">x</b>',
    ]
