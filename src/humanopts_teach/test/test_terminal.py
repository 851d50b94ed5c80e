"""The terminal: its keys, its colours, what fits into a window, and what never reaches it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
import re
from typing import Any

from humanopts_env import colours
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.options.conflicts import SAY_AGAIN, UNTOLD
from humanopts_learner.options.judge import MIN_HELD_OUT, NO_REFUSAL
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.dialogue.keys import Command, command_of, key_table, SUSPEND
from humanopts_teach.lesson.requests import LessonView, Phase
from humanopts_teach.terminal import drawing
from humanopts_teach.terminal.device import key_of, usable_colours
from humanopts_teach.terminal.drawing import frame
from prompt_toolkit.key_binding.key_processor import KeyPress
from prompt_toolkit.keys import Keys
import pytest
from rich.color import ColorType
from rich.console import Console
from rich.style import Style
from teach_support.desk import Desk

NAME = 'go to passenger and pickup'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col')
BOTTOM = '┗━━━┻━━━━━━━┻━━━━━━━┛'


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    """Somebody who demonstrates in Taxi."""
    desk = Desk(make_domain('taxi'), tmp_path)
    yield desk.teach(NAME, CHOSEN, 'taxi 2,3 passenger R destination B')
    desk.store.close()


@pytest.fixture
def pacman(tmp_path: Path) -> Iterator[Desk]:
    """Somebody who teaches Pac-Man by the direction of food alone, and has eaten some."""
    domain = make_domain('pacman')
    start = domain.encode(domain.reset(generator(0)))
    desk = Desk(domain, tmp_path / 'pacman').teach(NAME, ['food_direction'], start).press('left')
    yield desk
    desk.store.close()


def learned(features: tuple[str, ...], *values: float | None, **more: Any) -> OptionSummary:
    """Return a summary with values of the three criteria, and the thresholds of ten and 5 %."""
    names, thresholds = ('return', 'initiation', 'termination'), (10.0, 0.05, 0.05)
    criteria = tuple(map(Criterion.of, names, values, thresholds))
    return OptionSummary(
        NAME,
        'p1',
        features,
        n_demonstrations=MIN_HELD_OUT,
        criteria=criteria,
        more_needed=6,
        **more,
    )


def test_a_long_reason_leaves_the_board_whole_in_a_low_window(desk: Desk) -> None:
    desk.world.lesson = replace(desk.world.lesson, paused=30 * 'the disk is full ')
    assert BOTTOM in desk.sees(70, 20)


def test_the_fullest_screens_fit_in_80_by_24(desk: Desk, pacman: Desk) -> None:
    situation = ', '.join(f'{name.replace("_", " ")} 4' for name in CHOSEN)
    desk.world.summaries = [
        learned(
            *(CHOSEN, 0.125, 0.125, 0.125),
            mean_return_demonstrations=-5.25,
            mean_return_policy=-6.5,
            conflicts=(f'{situation}: not the end (10x), the end (2x)', 'another'),
            advice=(UNTOLD, SAY_AGAIN),
        )
    ]
    conflict = 'food direction north: cannot start here (12x), can start here (1x)'
    pacman.world.summaries = [
        learned(
            *(('food_direction',), 12.5, 0.125, None),
            mean_return_demonstrations=12.25,
            mean_return_policy=-116.5,
            conflicts=(conflict, 'another'),
        )
    ]
    for each in (desk, pacman):
        screen = each.sees()
        assert 'taller window' not in screen
        assert '…' not in screen
        said = each.see().split('\n')[2:-2]  # all words are there, however they are wrapped
        words = {word for line in said for word in line.split() if word.isalpha()}
        assert words <= set(re.findall(r'\w+', screen))


def test_advice_fits_in_80_by_24_even_if_the_criteria_do_not(pacman: Desk) -> None:
    pacman.world.summaries = [
        OptionSummary(
            NAME,
            'p1',
            ('food_direction',),
            n_demonstrations=9,
            criteria=(
                replace(Criterion.of('success', 0.991, 0.9, count=342), limit=0.949),
                Criterion.of('return', -0.0781, 0.1),
                replace(Criterion.of('initiation', None, 0.05), obstacle=NO_REFUSAL),
                Criterion.of('termination', 0.556, 0.1),
            ),
            evidence='sampled',
            ended_early=2,
            ended_late=1,
            ended_never=2,
            more_needed=41,
            conflicts=('food direction east: not the end (3x), the end (3x)', 'another'),
            advice=(UNTOLD, SAY_AGAIN),
        )
    ]
    words = ' '.join(line[41:].strip() for line in pacman.sees().split('\n'))
    assert 'choose one that changes there (e questions).' in words
    assert 'say so before you say done (s can start again at its end).' in words
    assert 'taller window' in pacman.sees()
    assert 'say so before you say done' not in pacman.press('s').see()  # the advice was followed


def test_advice_for_earlier_answers_is_not_shown(pacman: Desk) -> None:
    found = learned(('ate',), 12.5, 0.125, None, conflicts=('a conflict',), advice=(UNTOLD,))
    pacman.world.summaries = [found]
    shown = pacman.see()
    assert 'based on your earlier answers: show one more' in shown
    assert 'No chosen feature tells' not in shown
    assert 'a conflict' not in shown


def test_a_wide_board_leaves_room_for_what_is_beside_it(pacman: Desk) -> None:
    assert 'hidden: Pac-Man, the ghosts, the power pills, the fruit' in pacman.see()
    assert 'ate food (reward 10)' in pacman.see()
    screen = pacman.press('escape', 'enter').sees()
    assert '…' not in screen
    assert {'plans,', 'then', 'plays'} <= set(screen.split())


def test_a_small_window_shows_what_size_is_needed(desk: Desk) -> None:
    assert '69 x 24 characters, but 70 x 20 are needed' in desk.sees(69, 24)
    assert '80 x 19 characters, but 70 x 20 are needed' in desk.sees(80, 19)
    assert 'Teaching' in desk.sees(70, 20)


@pytest.mark.parametrize(('width', 'height'), [(80, 24), (120, 40), (70, 20)])
def test_no_line_is_wider_than_the_window(desk: Desk, width: int, height: int) -> None:
    for key in ('left', '?', 'x', 'e'):
        assert max(map(len, frame(desk.press(key).app, width, height))) <= width


@pytest.mark.parametrize('colours', [None, 'truecolor'])
def test_no_escape_sequence_of_a_message_reaches_the_terminal(desk: Desk, colours: Any) -> None:
    lesson = LessonView(Phase.NO_SESSION, budget=100, text='a\x1b[2Jb\x07', paused='c\x9b5md')
    desk.world.lesson = lesson
    desk.world.holder = 'x\x1b]0;title\x07'
    plain = frame(desk.app, 80, 30)
    assert all(line.isprintable() and len(line) <= 80 for line in plain)
    coloured = '\n'.join(frame(desk.app, 80, 30, colours))
    assert '\x1b[2J' not in coloured
    assert '\x9b' not in coloured


DONE, NOT_HERE, QUIT, ALIAS = (Command(keys, '', None) for keys in (['enter'], 'nh', 'q', ['?']))
TAKEN = [Command(key, '', None) for key in 'nqQ']


def test_a_command_moves_to_its_next_key_when_an_action_has_it() -> None:
    table = key_table([*TAKEN, DONE, NOT_HERE, QUIT, ALIAS])
    assert [table[key] for key in ('n', 'q', 'Q', 'enter', 'h')] == [*TAKEN, DONE, NOT_HERE]
    assert table['a'] is QUIT  # any key that is free
    assert len(table) == 7


def test_capitals_do_the_same_unless_they_have_a_meaning_of_their_own() -> None:
    table = key_table(TAKEN)
    assert command_of('N', table) is TAKEN[0]
    assert command_of('Q', table) is TAKEN[2]
    assert command_of('x', table) is command_of('enter', table) is None


@pytest.mark.parametrize(
    ('press', 'key'),
    [
        (Keys.Up, 'up'),
        (Keys.ControlM, 'enter'),
        (Keys.ControlJ, 'enter'),
        (Keys.ControlH, 'backspace'),
        (Keys.ControlC, 'ctrl-c'),
        ('é', 'é'),
        (Keys.ControlZ, SUSPEND),
        (Keys.F1, ''),
    ],
)
def test_terminal_keys_have_our_names(press: Keys | str, key: str) -> None:
    assert key_of(KeyPress(press)) == key


CONTRAST = 3.5


def contrasts(style: Style) -> tuple[float, float]:
    """Return the contrast of the text with black and with white, by WCAG 2."""
    assert style.color is not None
    parts = [part / 255 for part in style.color.get_truecolor()]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    found = sum(weight * c for weight, c in zip((0.2126, 0.7152, 0.0722), linear))
    return (found + 0.05) / 0.05, 1.05 / (found + 0.05)


def styles() -> Iterator[tuple[str, str]]:
    """Yield each style that is used, with where it is from."""
    yield from ((name, value) for name, value in vars(colours).items() if name.isupper())
    yield from ((str(tone), style) for tone, style in drawing.STYLES.items())
    yield 'key', drawing.KEY


@pytest.mark.parametrize(('name', 'style'), list(styles()))
def test_every_colour_can_be_read_on_black_and_on_white(name: str, style: str) -> None:
    parsed = Style.parse(style)
    assert parsed.bgcolor is None
    if parsed.color is None:
        return  # the terminal's own
    assert parsed.color.type is ColorType.EIGHT_BIT  # a theme does not change it
    assert min(contrasts(parsed)) >= CONTRAST, name


@pytest.mark.parametrize(('environment', 'colour'), [({}, True), ({'NO_COLOR': '1'}, False)])
def test_no_color_is_honoured(environment: dict[str, str], colour: bool) -> None:
    known = {'TERM': 'xterm-256color', **environment}
    console = Console(force_terminal=True, _environ=known)
    assert (usable_colours(console) is not None) == colour
