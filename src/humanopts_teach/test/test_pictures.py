"""Worlds that draw themselves: in terminals and on pages, beside a table of features."""

from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
import re

from humanopts_env.board import Board, Image
from humanopts_env.domains.capabilities import board_of, pictured_board_of
from humanopts_env.seeding import generator
from humanopts_learner.summary import OptionSummary
from humanopts_teach.board_html import board_html
from humanopts_teach.browser.markup import parts
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.menu import to_lesson
from humanopts_teach.dialogue.panel import Features
from humanopts_teach.dialogue.view import view
from humanopts_teach.launching.processes import processes, recorded_facts, Setup
from humanopts_teach.report.episode import episode_strip, Frame
from humanopts_teach.terminal.drawing import board_texts, drawn, frame, HalfBlocks
import numpy as np
from PIL import Image as Pillow
import pytest
from rich.color import Color
from rich.console import Console
from rich.segment import Segment
from teach_support.desk import Desk
from teach_support.orchard import Field, Orchard

RED, BLUE, BLACK = (248, 0, 0), (0, 0, 248), (0, 0, 0)
SIDE = 8  # pixels of a cell


class DrawnField(Field):
    """A field that draws the picker in red; it always returns the same array."""

    canvas = np.zeros((8 * SIDE, 8 * SIDE, 3), dtype=np.uint8)

    def picture(self) -> object:
        top, left = (SIDE * part for part in self.picker)
        self.canvas[:] = 0
        self.canvas[top : top + SIDE, left : left + SIDE] = RED
        return self.canvas


class DrawnOrchard(Orchard):
    def make_world(self) -> Field:
        return DrawnField()


def drawn_by(picture: object) -> Orchard:
    """Return an orchard in a world with another picture; an exception is raised."""

    class Other(Field):
        def picture(self) -> object:
            if isinstance(picture, Exception):
                raise picture
            return picture

    class OtherOrchard(Orchard):
        def make_world(self) -> Field:
            return Other()

    return OtherOrchard()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    """Somebody who demonstrates in the orchard, by one of its three features."""
    desk = Desk(DrawnOrchard(), tmp_path)
    yield desk.teach('fill', ['apple_direction'], '').press('left')
    desk.store.close()


def lines(image: Image, width: int, height: int) -> list[list[Segment]]:
    """Return the segments of each line of an image."""
    console = Console(width=200)
    return console.render_lines(HalfBlocks(image, width, height), pad=False)


def pixels(line: list[Segment]) -> list[tuple[int, Color | None, Color | None]]:
    """Return runs of equal half blocks: their number, and their upper and lower pixel."""
    assert {*''.join(each.text for each in line)} == {'▀'}
    return [(len(text), style.color, style.bgcolor) for text, style, _ in line if style]


def test_a_half_block_is_two_pixels_and_each_the_mean_of_its_area() -> None:
    image = np.array([[RED, BLUE], [BLUE, BLUE], [RED, BLACK], [RED, BLACK]], dtype=np.uint8)
    red, blue, black, mean = (Color.from_rgb(*c) for c in (RED, BLUE, BLACK, (120, 0, 120)))
    first, second = map(pixels, lines(image, 80, 2))
    assert first == [(1, red, blue), (1, blue, blue)]
    assert second == [(1, red, red), (1, black, black)]
    assert [*map(pixels, lines(image[:2], 1, 9))] == [[(1, mean, blue)]]
    assert [*map(pixels, lines(image[1:2], 8, 9))] == [[(8, blue, blue)]] * 2


@pytest.mark.parametrize('size', [(64, 64), (400, 600), (600, 100), (1, 1)])
@pytest.mark.parametrize('room', [(40, 19), (60, 10), (70, 40)])
def test_an_image_fills_its_room_and_keeps_its_shape(
    size: tuple[int, int], room: tuple[int, int]
) -> None:
    image = np.zeros((*size, 3), np.uint8)
    rows = lines(image, *room)
    width, height = sum(len(each.text) for each in rows[0]), len(rows)
    assert (width <= room[0], height <= room[1]) == (True, True)
    assert width == room[0] or height == room[1]
    assert width == pytest.approx(2 * height * size[1] / size[0], abs=2)
    assert [*map(pixels, lines(image, 1, 1))] == [[(1, *2 * [Color.from_rgb(*BLACK)])]]


def test_a_lesson_shows_the_picture_and_a_table_and_says_that_it_shows_more(desk: Desk) -> None:
    shown = view(desk.app)
    assert shown.board is not None
    assert shown.board.image is not None
    (table,) = [block for block in shown.panel.beside if isinstance(block, Features)]
    game = desk.game.transition
    way = desk.app.domain.features[0].text(game.features[0])
    assert table.shown == [('apple direction', way)]
    assert table.hidden == 'the picture shows more than the option sees'
    screen = frame(desk.app, 80, 24, 'truecolor')
    assert sum('▀' in line for line in screen) == 18
    assert re.search(r'apple direction .*' + way, '\n'.join(screen))


def test_an_image_is_smaller_where_the_text_needs_more_room(desk: Desk) -> None:
    wide = max(line.count('▀') for line in frame(desk.app, 80, 24, 'truecolor'))
    conflict = 30 * 'apple direction north: not the end (10x), '
    found = OptionSummary('fill', 'p1', ('apple_direction',), conflicts=(conflict[:300],))
    desk.world.summaries = [found]
    screen = frame(desk.app, 80, 24, 'truecolor')
    assert max(line.count('▀') for line in screen) == 26 < wide
    assert 'taller window' not in '\n'.join(screen)


def test_before_any_are_chosen_all_features_are_in_the_table(desk: Desk) -> None:
    desk.press('escape', 'enter')
    (table,) = [block for block in view(desk.app).panel.below if isinstance(block, Features)]
    names = [feature.name.replace('_', ' ') for feature in desk.app.domain.features]
    assert ([name for name, _ in table.shown], table.title) == (names, 'features')


def test_a_long_formula_leaves_its_value_visible() -> None:
    formula = 'clip(0.5 * x + x_speed, -0.4, 0.4) - angle - 2 * angular_speed'
    table, console = Features([(formula, '0.25'), ('x', '1')], in_rows=True), Console(width=40)
    with console.capture() as printed:
        console.print(drawn(table))
    assert [line.split()[-1] for line in printed.get().splitlines()[-2:]] == ['0.25', '1']


def test_a_terminal_without_colours_says_that_it_shows_no_picture(desk: Desk) -> None:
    screen = desk.sees()
    assert 'No picture: it needs a terminal with colours.' in screen
    assert 'all else is hidden' in screen
    assert '▀' not in screen


def test_without_pictures_only_the_chosen_features_are_seen(desk: Desk, tmp_path: Path) -> None:
    desk.app.pictures = False
    assert view(desk.app).board is None
    assert '<img' not in ''.join(parts(view(desk.app)).values())
    screen = '\n'.join(frame(desk.app, 80, 24, 'truecolor'))
    assert 'all else is hidden' in screen
    assert 'picture' not in screen


def test_a_page_has_every_pixel(desk: Desk) -> None:
    board = view(desk.app).board
    assert board is not None
    found = re.search(r'src="data:image/png;base64,([^"]+)"', parts(view(desk.app))['board'])
    assert found is not None
    pixels = np.asarray(Pillow.open(BytesIO(b64decode(found[1]))))
    assert np.array_equal(pixels, np.asarray(board.image))


def test_every_state_is_drawn_as_it_was_and_drawing_changes_none() -> None:
    domain, rng = DrawnOrchard(), generator(0, 'pictures')
    state = domain.reset(rng)
    states = [state]
    images = [domain.picture(state)]
    while not state.over:
        state = domain.step(state, int(rng.integers(4)), rng).state
        states.append(state)
        images.append(domain.picture(state))
    again = DrawnOrchard()
    for number in (len(states) - 1, 0, len(states) // 2):
        state = states[number]
        assert np.array_equal(np.asarray(again.picture(state)), np.asarray(images[number]))
        assert again.decode(domain.encode(state)) == state
    assert not np.array_equal(np.asarray(images[0]), np.asarray(images[-1]))


def test_a_text_is_drawn_as_it_is_and_a_failure_is_shown_instead_of_the_picture() -> None:
    def drawn(picture: object) -> Board:
        domain = drawn_by(picture)
        return pictured_board_of(domain, domain.reset(generator(0, 'text')))

    assert drawn('a <b>\nc').picture == 'a <b>\nc'
    assert drawn('\x1b[43ma\x1b[0mb\x1b[1mc\n').picture == '█bc'
    assert not drawn(None).drawn
    assert drawn(RuntimeError('no pygame')).picture == 'no picture: no pygame'
    assert drawn(np.zeros((2, 2), np.uint8)).picture == (
        'no picture: orchard draws uint8 (2, 2), not an RGB image'
    )


def test_a_picture_is_no_part_of_the_board_that_hides_features() -> None:
    domain = drawn_by(RuntimeError('drawn'))
    state = domain.reset(generator(0, 'hidden'))
    board = board_of(domain, state, ['basket'])
    assert board == Board(notes=('basket: 0',))
    listed, _ = board_texts(replace(board, image=DrawnField.canvas), 40, 10, None)
    assert str(listed) == 'basket: 0'
    assert board_html(board) == ''


def test_a_launch_without_pictures_tells_the_screen_and_the_bag(tmp_path: Path) -> None:
    for pictures, recorded in ((True, {}), (False, {'picture': 'no'})):
        setup = Setup(domain='taxi', directory=tmp_path, keyboard=True, pictures=pictures)
        (spec,) = [spec for spec in processes(setup) if spec.terminal]
        assert spec.parameters['pictures'] is pictures
        assert recorded.items() <= recorded_facts(setup).items()
    assert 'picture' not in recorded_facts(replace(setup, pictures=True))


def test_past_states_are_looked_at_picture_by_picture(desk: Desk) -> None:
    states = [desk.game.transition.state]
    images = [desk.app.domain.picture(desk.app.domain.decode(states[0]))]  # type: ignore[attr-defined]
    desk.press('right')
    states.append(desk.game.transition.state)
    images.append(desk.app.domain.picture(desk.app.domain.decode(states[1])))  # type: ignore[attr-defined]
    desk.app.show(ListScreen('Which?', [Item('way', '', to_lesson, states)]))
    for image in images:
        board = view(desk.app).board
        assert board is not None
        assert np.array_equal(np.asarray(board.image), np.asarray(image))
        desk.press('right')
    assert not np.array_equal(*map(np.asarray, images))


def test_the_strip_of_a_report_has_the_pictures(desk: Desk) -> None:
    strip = episode_strip(DrawnOrchard(), [Frame(desk.game.transition.state)])
    assert strip.pictures[0].board == board_html(view(desk.app).board or Board())
    assert strip.pictures[0].board.startswith('<img')
