"""Figures for the page, which gives them its colours, and for files, which have their own."""

from functools import cache
from pathlib import Path
import re
from typing import Any

from humanopts_teach.report.figures import Drawing, drawing, SETTINGS, VARIABLES
from humanopts_teach.report.pages import page_style
import matplotlib

from experiments.sections import Picture

DPI = 160


@cache
def light_colours() -> dict[str, str]:
    """Return what stands for each colour of ``report.figures`` on a light page."""
    first = page_style().split('@media')[0]
    values = dict(re.findall(r'(--[a-z0-9]+): (#[0-9a-f]{6})', first))
    return {colour: values[variable] for colour, variable in VARIABLES.items()}


def svg_for_page(picture: Picture) -> str:
    """Return an ``<svg>`` element that is coloured by the page."""
    with drawing(picture.name, picture.label, *picture.size) as work:
        picture.draw(work, str)
    return work.svg


def write_picture(folder: Path, picture: Picture) -> None:
    """
    Write a figure as PNG and SVG.

    :raises OSError: they cannot be written.
    """
    colours = light_colours()
    settings: dict[Any, Any] = {
        **{name: colours.get(str(value), value) for name, value in SETTINGS.items()},
        'figure.facecolor': 'white',
        'svg.fonttype': 'path',
        'svg.hashsalt': picture.name,
    }
    with matplotlib.rc_context(settings):
        work = Drawing(*picture.size)
        picture.draw(work, lambda colour: colours[colour])
        work.figure.savefig(folder / f'{picture.name}.png', dpi=DPI)
        work.figure.savefig(folder / f'{picture.name}.svg', metadata={'Date': None})
