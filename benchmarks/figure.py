"""Planning time against the number of states, for every solver, on two logarithmic axes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from benchmarks.results import Planned

SUFFIXES = ('.svg', '.png')
MARKERS = 'osD^vP'
COLORS = ('#0072b2', '#56b4e9', '#009e73', '#d55e00', '#000000', '#cc79a7')  # Okabe and Ito
_SETTINGS: dict[Any, Any] = {
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.axisbelow': True,
    'axes.titlelocation': 'left',
    'axes.titleweight': 'bold',
    'axes.titlesize': 10.5,
    'grid.color': '#dddddd',
    'legend.frameon': False,
    'legend.fontsize': 9,
    'svg.fonttype': 'none',
    'svg.hashsalt': 'bench',
}


def write_figure(path: Path, rows: Sequence[Planned]) -> None:
    """
    Draw the figure.

    :param path: ends in one of ``SUFFIXES``.
    :raises OSError: it cannot be written.
    """
    with matplotlib.rc_context(_SETTINGS):
        figure = Figure(figsize=(6.5, 5.0), layout='constrained')
        axes = figure.add_subplot()
        for number, solver in enumerate(dict.fromkeys(row.row.solver for row in rows)):
            own = [row.row for row in rows if row.row.solver == solver]
            axes.loglog(
                [row.n_states for row in own],
                [row.seconds for row in own],
                marker=MARKERS[number],
                color=COLORS[number],
                label=solver,
            )
        axes.set(
            title='Planning time on Taxi grids', xlabel='states', ylabel='seconds, median of runs'
        )
        sizes = sorted({row.row.n_states for row in rows})
        axes.xaxis.set_major_locator(FixedLocator(sizes))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda size, _: f'{size:,.0f}'))
        axes.grid(which='major')
        figure.legend(loc='outside lower center', ncols=2)
        figure.savefig(path, dpi=150, metadata={'Date': None} if path.suffix == '.svg' else {})
