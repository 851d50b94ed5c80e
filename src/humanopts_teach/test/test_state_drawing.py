"""A state as a picture: every sign stands where the domain's text has it."""

import re
from typing import Any
from xml.etree import ElementTree

from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_teach.state_drawing import board_svg, CELL, draw_state, notes_html, StateDrawing
import pytest

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
