"""Figures: SVG with the colours of the light or dark page, and separate files."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
import io
import re
from typing import Any

from humanopts_teach.report.pages import page_style
import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

# Placeholders for the colours of the page; in the SVG, CSS variables replace them.
INK, MUTED, GRID, PAPER = '#010101', '#020202', '#030303', '#040404'
SERIES = ('#0101a1', '#0101a2', '#0101a3', '#0101a4', '#0101a5', '#0101a6')
VARIABLES = {
    INK: '--ink',
    MUTED: '--muted',
    GRID: '--line',
    PAPER: '--paper',
    **{color: f'--c{number}' for number, color in enumerate(SERIES, start=1)},
}
SETTINGS: dict[Any, Any] = {
    'svg.fonttype': 'none',
    'font.family': 'sans-serif',
    'font.size': 10,
    'text.color': INK,
    'axes.edgecolor': MUTED,
    'axes.labelcolor': INK,
    'axes.facecolor': 'none',
    'axes.titlecolor': INK,
    'axes.titlesize': 10.5,
    'axes.titleweight': 'bold',
    'axes.titlelocation': 'left',
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.axisbelow': True,
    'axes.prop_cycle': cycler(color=SERIES),
    'figure.facecolor': 'none',
    'grid.color': GRID,
    'grid.linewidth': 0.8,
    'legend.frameon': False,
    'legend.fontsize': 9,
    **{f'{axis}tick.{kind}.size': 0 for axis in 'xy' for kind in ('major', 'minor')},
    'xtick.color': MUTED,
    'ytick.color': MUTED,
    'xtick.labelcolor': INK,
    'ytick.labelcolor': INK,
}


@cache
def light_colours() -> dict[str, str]:
    """Return the light-mode value of each of ``VARIABLES``."""
    first = page_style().split('@media')[0]
    values = dict(re.findall(r'(--[a-z0-9]+): (#[0-9a-f]{6})', first))
    return {colour: values[variable] for colour, variable in VARIABLES.items()}


def file_settings(name: str) -> dict[Any, Any]:
    """Return the settings of a figure in a separate file, in light-mode colours."""
    colours = light_colours()
    return {
        **{key: colours.get(str(value), value) for key, value in SETTINGS.items()},
        'axes.prop_cycle': cycler(color=[colours[color] for color in SERIES]),
        'figure.facecolor': 'white',
        'svg.fonttype': 'path',
        'svg.hashsalt': name,
    }


class Drawing:
    """One figure; ``svg`` is set when the ``with`` block of ``drawing`` ends."""

    def __init__(self, width: float, height: float) -> None:
        self.figure = Figure(figsize=(width, height), layout='constrained')
        self.svg = ''

    @property
    def axes(self) -> Axes:
        """The single plot of the figure."""
        return self.figure.axes[0] if self.figure.axes else self.figure.add_subplot()


@contextmanager
def drawing(name: str, label: str, width: float, height: float) -> Iterator[Drawing]:
    """
    Draw a figure.

    :param name: prefix that keeps the identifiers in the SVG unique on the page.
    :param label: text alternative for screen readers.
    :param width: width in inches, like ``height``; the page scales the figure.
    """
    with matplotlib.rc_context({**SETTINGS, 'svg.hashsalt': name}):
        work = Drawing(width, height)
        yield work
        work.svg = _svg(work.figure, name, label)
        work.figure.clear()  # break reference cycles, which hold a megabyte


def _svg(figure: Any, name: str, label: str) -> str:
    """Return an ``<svg>`` element that the page scales and colours."""
    file = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)  # draws once, unlike ``savefig``
    canvas.print_svg(file, metadata={'Date': None, 'Creator': None})
    text = file.getvalue()
    text = text[text.index('<svg') :]
    text = re.sub(r'<metadata>.*?</metadata>', '', text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf'\g<1>{name}-', text)
    for color, variable in VARIABLES.items():
        text = text.replace(color, f'var({variable})')
    quoted = label.replace('&', '&amp;').replace('"', '&quot;').replace('<', '&lt;')
    head, rest = text.split('>', 1)
    head = re.sub(r' (width|height|version|xmlns(:\w+)?)="[^"]*"', '', head)
    return f'{head} role="img" aria-label="{quoted}">{rest}'
