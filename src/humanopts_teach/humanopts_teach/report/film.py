"""An episode as a strip of boards."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import html
from itertools import groupby
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_teach.report.data import Frame
from rich.color import ColorType
from rich.errors import StyleSyntaxError
from rich.style import Style

MINUS = '\N{MINUS SIGN}'
COLOURS = 4  # of options, classes o0 to o3
MOST_FRAMES = 60  # of longer episodes only the ends of runs are shown
LEAST_WIDTH = 10.6  # rem
REM = 0.49  # that a character of a board is wide, about
FIRST_SHARE = 2 / 3  # of those shown, where even these are too many; the others are the last


@dataclass(frozen=True)
class Film:
    """A whole strip."""

    frames: list['FilmFrame']
    steps: int  # of the episode
    whole: bool  # every step is shown; else the ends of runs
    left_out: int  # ends of runs that are not shown
    last: int  # pictures after these
    width: float  # rem, that a board takes


@dataclass(frozen=True)
class FilmFrame:
    """One picture, ready for the page."""

    number: int  # step
    board: str  # HTML
    option: str
    action: str
    reward: str
    colour: str  # CSS class, the same for the same option


def filmstrip(domain: Domain[Any], frames: Sequence[Frame]) -> Film:
    """
    Draw an episode: every step of a short one, of a long one where runs of options ended.

    :raises StateError: a state is not of the domain.
    """
    options = list(dict.fromkeys(frame.option for frame in frames if frame.option))
    ends = range(len(frames)) if len(frames) <= MOST_FRAMES else _ends(frames)
    first = round(MOST_FRAMES * FIRST_SHARE)
    some = len(ends) > MOST_FRAMES
    shown = [*ends[:first], *ends[first - MOST_FRAMES :]] if some else list(ends)
    film, width = [], 0
    for before, number in zip([-1, *shown], shown):
        frame = frames[number]
        board = _picture(domain.render(domain.decode(frame.state)))
        width = max(width, *map(len, board.splitlines()))
        steps = frames[before + 1 : number + 1]
        film.append(
            FilmFrame(
                number,
                board_html(board, domain.glyph_styles),
                frame.option.removeprefix(PRIMITIVE_PREFIX),
                _action(steps),
                _signed(sum(step.reward for step in steps)) if frame.action else '',
                f'o{options.index(frame.option) % COLOURS}' if frame.option else '',
            )
        )
    left_out = len(ends) - len(shown)
    whole, last = len(ends) == len(frames), MOST_FRAMES - first
    return Film(film, len(frames) - 1, whole, left_out, last, max(LEAST_WIDTH, REM * width))


def _ends(frames: Sequence[Frame]) -> list[int]:
    """Return the first frame and the last of each run."""
    later = [*frames[1:], Frame('')]
    return [
        number
        for number, (frame, after) in enumerate(zip(frames, later))
        if number == 0 or frame.ends_run or frame.option != after.option
    ]


def _action(steps: Sequence[Frame]) -> str:
    """Say what was done since the last picture."""
    return steps[0].action if len(steps) == 1 else f'{len(steps)} steps'


def board_html(text: str, styles: Mapping[str, str]) -> str:
    """Return a drawing with its characters in the domain's colours."""
    classes = {glyph: _classes(style) for glyph, style in styles.items()}
    parts = []
    for name, run in groupby(text, lambda glyph: classes.get(glyph, '')):
        drawn = html.escape(''.join(run))
        parts.append(f'<b class="{name}">{drawn}</b>' if name else drawn)
    return ''.join(parts)


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
