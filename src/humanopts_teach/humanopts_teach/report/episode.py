"""An episode as a strip of pictures of its board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import html
from itertools import groupby
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_teach.report.pages import MINUS
from humanopts_teach.report.recording import Frame
from rich.color import ColorType
from rich.errors import StyleSyntaxError
from rich.style import Style

COLOURS = 4  # of options, classes o0 to o3
MOST_PICTURES = 60  # of longer episodes only the ends of runs are shown
FIRST = 40  # of the pictures that are shown where even these are too many; the others are the last
LEAST_WIDTH = 10.6  # rem
REM = 0.49  # that a character of a board is wide, about


@dataclass(frozen=True)
class Picture:
    """One state, ready for the page."""

    number: int  # step
    board: str  # HTML
    option: str
    action: str
    reward: str
    colour: str  # CSS class, the same for the same option


@dataclass(frozen=True)
class Strip:
    """A whole episode."""

    pictures: Sequence[Picture]
    steps: int  # of the episode
    whole: bool  # every step is shown; else the ends of runs
    left_out: int  # ends of runs that are not shown
    last: int  # pictures after these
    width: float  # rem, that a board takes


def episode_strip(domain: Domain[Any], frames: Sequence[Frame]) -> Strip:
    """
    Draw an episode: every step of a short one, of a long one where runs of options ended.

    :raises StateError: a state is not of the domain.
    """
    options = list(dict.fromkeys(frame.option for frame in frames if frame.option))
    whole = len(frames) <= MOST_PICTURES
    ends = list(range(len(frames))) if whole else _ends(frames)
    last = MOST_PICTURES - FIRST
    shown = [*ends[:FIRST], *ends[-last:]] if len(ends) > MOST_PICTURES else ends
    boards = [_board(domain.render(domain.decode(frames[number].state))) for number in shown]
    pictures = []
    for before, number, board in zip([-1, *shown], shown, boards):
        frame, steps = frames[number], frames[before + 1 : number + 1]
        reward = sum(step.reward for step in steps)
        pictures.append(
            Picture(
                number,
                board_html(board, domain.glyph_styles),
                frame.option.removeprefix(PRIMITIVE_PREFIX),
                frame.action if len(steps) == 1 else f'{len(steps)} steps',
                '' if not frame.action else f'{reward:+g}'.replace('-', MINUS) if reward else '0',
                f'o{options.index(frame.option) % COLOURS}' if frame.option else '',
            )
        )
    width = REM * max((len(line) for board in boards for line in board.splitlines()), default=0)
    left_out = len(ends) - len(shown)
    return Strip(pictures, len(frames) - 1, whole, left_out, last, max(LEAST_WIDTH, width))


def _ends(frames: Sequence[Frame]) -> list[int]:
    """Return the first frame and the last of each run."""
    later = [*frames[1:], Frame('')]
    return [
        number
        for number, (frame, after) in enumerate(zip(frames, later))
        if number == 0 or frame.ends_run or frame.option != after.option
    ]


def _board(text: str) -> str:
    """Return the drawing without the words below it."""
    lines = text.splitlines()
    drawn = [number for number, line in enumerate(lines) if any('─' <= c <= '╿' for c in line)]
    return '\n'.join(lines[: drawn[-1] + 1] if drawn else lines)


def board_html(text: str, styles: Mapping[str, str]) -> str:
    """Return a drawing with its characters in the domain's colours."""
    classes = {glyph: _classes(style) for glyph, style in styles.items()}
    parts = []
    for name, run in groupby(text, lambda glyph: classes.get(glyph, '')):
        drawn = html.escape(''.join(run))
        parts.append(f'<b class="{name}">{drawn}</b>' if name else drawn)
    return ''.join(parts)


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
