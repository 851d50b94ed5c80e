"""An episode as a strip of boards."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import html
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_teach.report.data import Frame
from rich.color import ColorType
from rich.errors import StyleSyntaxError
from rich.style import Style

MINUS = '\N{MINUS SIGN}'
COLOURS = 4  # of options, classes o0 to o3


@dataclass(frozen=True)
class FilmFrame:
    """One picture, ready for the page."""

    number: int
    board: str  # HTML
    option: str
    action: str
    reward: str
    colour: str  # CSS class, the same for the same option


def filmstrip(domain: Domain[Any], frames: Sequence[Frame]) -> list[FilmFrame]:
    """
    Draw an episode.

    :raises StateError: a state is not of the domain.
    """
    options = list(dict.fromkeys(frame.option for frame in frames if frame.option))
    film = []
    for number, frame in enumerate(frames):
        board = domain.render(domain.decode(frame.state))
        film.append(
            FilmFrame(
                number,
                board_html(_picture(board), domain.glyph_styles),
                frame.option,
                frame.action,
                _signed(frame.reward) if frame.action else '',
                f'o{options.index(frame.option) % COLOURS}' if frame.option else '',
            )
        )
    return film


def board_html(text: str, styles: Mapping[str, str]) -> str:
    """Return a drawing with its characters in the domain's colours."""
    classes = {glyph: _classes(style) for glyph, style in styles.items()}
    return ''.join(
        f'<b class="{classes[glyph]}">{html.escape(glyph)}</b>'
        if classes.get(glyph)
        else html.escape(glyph)
        for glyph in text
    )


def _picture(board: str) -> str:
    """Return the drawing without the words below it."""
    lines = board.splitlines()
    drawn = [number for number, line in enumerate(lines) if any('─' <= c <= '╿' for c in line)]
    return '\n'.join(lines[: drawn[-1] + 1] if drawn else lines)


def _classes(style: str) -> str:
    """Return CSS classes for a style in rich's notation; colours outside the 16 are left out."""
    try:
        parsed = Style.parse(style)
    except StyleSyntaxError:
        return ''
    names = ['dim'] if parsed.dim else []
    if parsed.color is not None and parsed.color.type is ColorType.STANDARD:
        names.append(f'g{(parsed.color.number or 0) % 8}')
    return ' '.join(names)


def _signed(reward: float) -> str:
    return f'{reward:+g}'.replace('-', MINUS) if reward else '0'
