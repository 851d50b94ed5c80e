"""Colours of the terminal can be read on black and on white, and can be left out."""

from collections.abc import Iterator
from pathlib import Path
import re

from humanopts_env import colours
from humanopts_env.domains.registry import make_domain
from humanopts_teach.terminal import drawing
from humanopts_teach.terminal.device import usable_colours
import pytest
from rich.color import ColorType
from rich.console import Console
from rich.style import Style

DOMAINS = ('taxi', 'rooms', 'pacman', 'gymnasium:FrozenLake-v1', 'gymnasium:CliffWalking-v1')
CONTRAST = 3.5


def luminance(red: float, green: float, blue: float) -> float:
    """Return the relative luminance of WCAG 2 of a colour with parts from 0 to 255."""
    parts = [c / 255 for c in (red, green, blue)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrasts(style: Style) -> tuple[float, float]:
    """Return the contrast of the text with black and with white."""
    assert style.color is not None
    found = luminance(*style.color.get_truecolor())
    return (found + 0.05) / 0.05, 1.05 / (found + 0.05)


def styles() -> Iterator[tuple[str, str]]:
    """Yield each style that is used, with where it is from."""
    yield from ((name, value) for name, value in vars(colours).items() if name.isupper())
    yield from ((str(tone), style) for tone, style in drawing.STYLES.items())
    yield 'key', drawing.KEY
    for name in DOMAINS:
        yield from ((f'{name} {g}', s) for g, s in make_domain(name).glyph_styles.items())


@pytest.mark.parametrize(('name', 'style'), list(styles()))
def test_every_colour_can_be_read_on_black_and_on_white(name: str, style: str) -> None:
    parsed = Style.parse(style)
    assert parsed.bgcolor is None
    if parsed.color is None:
        return  # the terminal's own
    assert parsed.color.type is ColorType.EIGHT_BIT  # a theme does not change it
    assert min(contrasts(parsed)) >= CONTRAST, name


def test_no_colour_of_a_theme_is_used_in_the_terminal() -> None:
    folder = Path(drawing.__file__).parent
    named = re.compile(
        r"'[a-z ]*\b(white|yellow|cyan|red|green|blue|magenta|bright_\w+)\b[a-z ]*'"
    )
    for file in folder.glob('*.py'):
        assert not named.search(file.read_text()), file.name


@pytest.mark.parametrize(('environment', 'colour'), [({}, True), ({'NO_COLOR': '1'}, False)])
def test_no_color_is_honoured(environment: dict[str, str], colour: bool) -> None:
    known = {'TERM': 'xterm-256color', **environment}
    console = Console(force_terminal=True, _environ=known)
    assert (usable_colours(console) is not None) == colour
