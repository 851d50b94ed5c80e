"""
Boards as text, and what a board reveals where only some features are shown.

``boards.txt`` has the boards; ``python test_board.py`` writes it anew, to be read before it is
committed.
"""

from pathlib import Path

from humanopts_env.board import Board, board_text, caption, DOT, Mark, runs
from humanopts_env.domains.capabilities import board_of
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
import pytest

MAZE = '%%%%%%%\n%P...o%\n%.%%%.%\n%.G  G%\n%%%%%%%'
PACMAN = (
    'pacman 2,0 ghost 2,3 heading west scared 7 ghost 0,3 heading east scared 0 food 0d '
    'pills 0 fruit 0,1 for 3 lives 2 score 360 ate food+ghost'
)
TAXI, WAITING = 'taxi 2,3 passenger R destination B', 'passenger_in_taxi'
ABOARD = 'taxi 2,3 passenger aboard destination G'
CELL, PASSENGER = ('taxi_row', 'taxi_col'), ('passenger_row', 'passenger_col')
FOOD = ('pacman_row', 'pacman_col', 'food_row', 'food_col', 'food_direction', 'prey_distance')
GHOST = ('ghost_1_row', 'ghost_1_col')
CASES = [  # domain, parameters, state, features that are shown; None: all
    ('taxi', {}, TAXI, None),
    ('taxi', {}, 'taxi 0,0 passenger R destination B', None),
    ('taxi', {}, ABOARD, None),
    ('taxi', {}, ABOARD, ()),
    ('taxi', {}, ABOARD, CELL),
    ('taxi', {}, ABOARD, (*CELL, WAITING)),
    ('taxi', {}, ABOARD, (*CELL, *PASSENGER, WAITING)),
    ('taxi', {}, ABOARD, (*PASSENGER, WAITING)),
    ('taxi', {}, ABOARD, (*CELL, 'taxi_at_destination')),
    ('taxi', {}, ABOARD, ('destination_row', 'destination_col')),
    ('taxi', {}, ABOARD, ('taxi_row',)),
    ('taxi', {'rows': 10, 'cols': 10}, 'taxi 0,0 passenger R destination B', ()),
    ('rooms', {}, 'cell 2,5', None),
    ('rooms', {}, 'cell 6,8', None),
    ('rooms', {}, 'cell 2,5', ('row', 'doorway')),
    ('pacman', {}, '', None),
    ('pacman', {'maze': MAZE}, '', None),
    ('pacman', {'maze': MAZE}, PACMAN, None),
    ('pacman', {'maze': MAZE}, PACMAN.replace('ghost 2,3', 'ghost 0,3'), None),
    ('pacman', {'maze': MAZE}, PACMAN, FOOD),
    ('pacman', {'maze': MAZE}, PACMAN, GHOST),
    ('pacman', {'maze': MAZE}, PACMAN, (*GHOST, 'ghost_1_scared')),
    ('gymnasium:FrozenLake-v1', {}, 'row 0, col 0', None),
    ('gymnasium:FrozenLake-v1', {}, 'row 0, col 0', ('row',)),
    ('gymnasium:CliffWalking-v1', {}, 'row 0, col 0', None),
]
SNAPSHOT = Path(__file__).with_name('boards.txt')


def drawn() -> str:
    """Return all boards as text."""
    parts = []
    for name, parameters, text, shown in CASES:
        domain = make_domain(name, parameters)
        state = domain.decode(text) if text else domain.reset(generator(0, 'board'))
        what = 'everything' if shown is None else ', '.join(shown) or 'nothing'
        title = f'{name} {"x".join(map(str, parameters.values()))}'.split('%')[0].rstrip()
        parts += [
            f'{title}: {text or "start"}',
            f'({what})',
            board_text(board_of(domain, state, shown)),
            '',
        ]
    return '\n'.join(parts)


def test_boards_are_drawn_as_they_were() -> None:
    assert drawn() == SNAPSHOT.read_text('utf-8')


def test_a_world_without_a_board_lists_its_features() -> None:
    class Undrawn:
        features = make_domain('rooms').features

        def feature_values(self, state: object) -> object:
            return make_domain('rooms').feature_values(state)

    domain, state = Undrawn(), make_domain('rooms').decode('cell 2,5')
    listed = ('row: 2', 'doorway: north')
    assert board_of(domain, state, ('row', 'doorway')) == Board(notes=listed)  # type: ignore[arg-type]
    assert board_text(Board(notes=listed)) == 'row: 2   doorway: north'


@pytest.mark.parametrize('name', ['taxi', 'pacman', 'gymnasium:FrozenLake-v1'])
def test_only_signs_are_coloured(name: str) -> None:
    domain = make_domain(name)
    board = board_of(domain, domain.reset(generator(0)))
    styled = [text for line in caption(board) for text, style in runs(line) if style]
    assert {*styled} == {mark.kind for mark in board.marks} - {DOT}


def test_what_does_not_fit_into_a_cell_is_named() -> None:
    marks = tuple(
        Mark((0, 0), kind, name) for kind, name in zip('abcd', ('one', 'two', 'three', 'four'))
    )
    assert board_text(Board(1, 1, marks=marks)).splitlines()[1] == '┃ab┃'
    wide = Board(1, 2, walls=((0, 1, 1, 1),), marks=marks)
    assert board_text(wide).splitlines()[:2] == ['┏━━━┳━━━┓', '┃abc┃ · ┃']
    assert board_text(wide).endswith('hidden: four in row 0, column 0')


if __name__ == '__main__':
    SNAPSHOT.write_text(drawn(), 'utf-8')
