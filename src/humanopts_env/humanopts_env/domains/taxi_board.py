"""The taxi grid as text, revealing only the features that may be shown."""

from collections.abc import Mapping, Sequence

from humanopts_env.domains.base import Feature
import numpy as np
from numpy.typing import NDArray

EMPTY_TAXI, FULL_TAXI, SOME_TAXI = '□', '■', '▒'  # some: whether it is empty is not shown
PASSENGER, DESTINATION, FLOOR = '☻', '⚑', '·'
GLYPH_STYLES = {
    EMPTY_TAXI: 'bold bright_yellow',
    FULL_TAXI: 'bold bright_green',
    SOME_TAXI: 'bold bright_yellow',
    PASSENGER: 'bold bright_magenta',
    DESTINATION: 'bold bright_cyan',
    FLOOR: 'dim',
    'R': 'bold red',
    'G': 'bold green',
    'Y': 'bold yellow',
    'B': 'bold bright_blue',
}
EXPRESSED_BY = {  # what must be in the drawing for a feature to be read from it
    'taxi_row': {'taxi'},
    'taxi_col': {'taxi'},
    'passenger_row': {'passenger'},
    'passenger_col': {'passenger'},
    'destination_row': {'destination'},
    'destination_col': {'destination'},
    'passenger_in_taxi': {'taxi'},
    'taxi_at_passenger': {'taxi', 'passenger'},
    'taxi_at_destination': {'taxi', 'destination'},
    'blocked_moves': {'taxi'},
}
WALL_END = {(False, False): ' ', (True, True): '┃', (True, False): '╹', (False, True): '╻'}
Cell = tuple[int, int]  # row, column


def draw_board(
    wall_east: NDArray[np.bool_],
    landmarks: Mapping[str, Cell],
    shown: Sequence[tuple[Feature, int]],
) -> str:
    """
    Draw the grid, a legend, and in words whatever of ``shown`` the drawing cannot express.

    :param wall_east: (rows, cols), whether a wall or the edge is east of each cell.
    :param landmarks: letter and cell of each.
    :param shown: features that may be revealed, with their values; nothing else is used.
    """
    values = {feature.name: value for feature, value in shown}
    places = {
        thing: (values[f'{thing}_row'], values[f'{thing}_col'])
        for thing in ('taxi', 'passenger', 'destination')
        if f'{thing}_row' in values and f'{thing}_col' in values
    }
    taxi, taxi_text = {
        None: (SOME_TAXI, 'taxi'),
        0: (EMPTY_TAXI, 'taxi, empty'),
        1: (FULL_TAXI, 'taxi, passenger aboard'),
    }[values.get('passenger_in_taxi')]
    middle = {cell: letter for letter, cell in landmarks.items()}
    texts = {'taxi': taxi_text, 'passenger': 'passenger', 'destination': 'destination'}
    glyphs = {'taxi': taxi, 'passenger': PASSENGER, 'destination': DESTINATION}
    if 'taxi' in places:
        middle[places['taxi']] = taxi

    def cell_text(cell: Cell) -> str:
        left = PASSENGER if cell == places.get('passenger') else ' '
        right = DESTINATION if cell == places.get('destination') else ' '
        return left + middle.get(cell, FLOOR) + right

    legend = [f'{glyphs[thing]} {texts[thing]}' for thing in places]
    facts = [
        f'{feature.name.replace("_", " ")}: {feature.values[value]}'
        for feature, value in shown
        if not EXPRESSED_BY[feature.name] <= places.keys()
    ]
    rows, cols = wall_east.shape
    cells = [[cell_text((row, col)) for col in range(cols)] for row in range(rows)]
    lines = [*_grid(wall_east.tolist(), cells), '   '.join([*legend, 'R G Y B landmarks'])]
    return '\n'.join([*lines, '   '.join(facts)] if facts else lines)


def _grid(wall_east: list[list[bool]], cells: list[list[str]]) -> list[str]:
    """Frame the cells and draw the walls, with a line between every two rows."""
    lines = [_edge('┏', '┳', '┓', wall_east[0])]
    for row, (walls, texts) in enumerate(zip(wall_east, cells)):
        if row:
            ends = [WALL_END[pair] for pair in zip(wall_east[row - 1], walls)]
            lines.append('┃' + ''.join(f'   {end}' for end in ends))
        lines.append('┃' + ''.join(t + ('┃' if w else ' ') for t, w in zip(texts, walls)))
    return [*lines, _edge('┗', '┻', '┛', wall_east[-1])]


def _edge(left: str, joint: str, right: str, walls: list[bool]) -> str:
    """Draw the top or bottom edge, with a joint where a wall meets it."""
    joints = [joint if wall else '━' for wall in walls[:-1]]
    return left + '━━━' + ''.join(f'{end}━━━' for end in joints) + right
