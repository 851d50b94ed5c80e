"""What a screen reader says about boards and steps."""

from humanopts_env.board import Board
from humanopts_env.domains.capabilities import board_of
from humanopts_env.domains.registry import make_domain
from humanopts_teach.browser.speech import board_words, changes
from humanopts_teach.dialogue.panel import Features, Line, Panel, ScreenView
from humanopts_teach.language import speaking
import numpy as np

TAXI = make_domain('taxi')


def drawn(state: str) -> Board:
    return board_of(TAXI, TAXI.decode(f'taxi {state} passenger R destination B'))


def view(*lines: str, board: Board | None = None, plays: bool = True) -> ScreenView:
    return ScreenView((), Panel(tuple(map(Line, lines))), board=board, plays=plays)


def test_the_words_of_a_board_name_its_marks_and_the_walls_next_to_the_first() -> None:
    words = board_words(drawn('0,1'))
    assert words.startswith('The board. 5 rows and 5 columns, counted from 0 at the top left.')
    assert 'taxi, empty: row 0, column 1.' in words
    assert 'landmarks: R row 0, column 0; G row 0, column 4;' in words
    assert words.endswith('walls next to taxi, empty: north, east')
    assert board_words(drawn('2,2')).endswith('no wall next to taxi, empty')
    with speaking('de'):
        assert board_words(drawn('2,2')).startswith('Das Spielfeld. 5 Zeilen')


def test_many_marks_are_counted_and_a_picture_has_only_its_notes() -> None:
    pacman = make_domain('pacman')
    words = board_words(board_of(pacman, pacman.reset(np.random.default_rng(1))))
    assert 'food: in ' in words
    assert board_words(Board(picture='#', notes=('row: 1',))) == 'The board. row: 1'


def test_a_step_announces_what_it_moved_and_a_new_page_its_lines() -> None:
    first, second = drawn('0,1'), drawn('1,1')
    start = view('start 1, step 0', board=first)
    assert changes(start, None) == 'start 1, step 0'
    moved = changes(view('start 1, step 1', board=second), start)
    assert moved == 'taxi, empty row 1, column 1. walls next to taxi, empty: east'
    blocked = changes(view('start 1, step 1', board=first), start)
    assert blocked == 'no change on the board'
    assert changes(start, start) == ''
    assert changes(view('Like it?', 'Enter.', plays=False), start) == 'Like it? Enter'


def test_without_a_board_the_changed_features_are_announced() -> None:
    def table(value: str) -> ScreenView:
        rows = Features([('lane', value), ('speed', '1')], in_rows=True)
        return ScreenView((), Panel((rows,)), plays=True)

    assert changes(table('3'), table('2')) == 'lane 3'
