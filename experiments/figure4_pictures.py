"""The drawings of Figure 4: all action sets, and those of the paper on its axis."""

from collections.abc import Mapping, Sequence

from humanopts_teach.report.figures import Drawing, SERIES
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
import numpy as np

from experiments import paper
from experiments.bands import Band
from experiments.sections import Paint

SIZE = (6.4, 3.8)  # inches
STYLES = ('-', '--', '-.', ':', (0, (5, 1, 1, 1, 1, 1)))  # by series


def draw_all(bands: Mapping[str, Band], title: str, work: Drawing, paint: Paint) -> None:
    """Draw every action set, steps on a logarithmic axis."""
    _draw(bands, list(bands), title, work, paint)
    means = [value for found in bands.values() for value in (found.mean.min(), found.mean.max())]
    work.axes.set_yscale('log')
    work.axes.set_ylim(0.8 * min(means), 1.25 * max(means))
    work.axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))


def draw_papers(bands: Mapping[str, Band], title: str, work: Drawing, paint: Paint) -> None:
    """Draw the three action sets of the paper as far up as its axis goes."""
    _draw(bands, [name for name in paper.CURVES if name in bands], title, work, paint)
    work.axes.set_ylim(0, paper.MOST_STEPS)


def _draw(
    bands: Mapping[str, Band], shown: Sequence[str], title: str, work: Drawing, paint: Paint
) -> None:
    axes = work.axes
    for (name, found), color, style in zip(bands.items(), SERIES, STYLES, strict=False):
        if name in shown:
            episode, own = np.arange(1, len(found.mean) + 1), paint(color)
            axes.fill_between(episode, found.low, found.high, color=own, alpha=0.18, lw=0)
            axes.plot(episode, found.mean, color=own, ls=style, lw=1.4, label=name)
    axes.set(title=title, xlabel='episode', ylabel='steps per episode')
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    axes.grid(axis='y')
    axes.tick_params(length=0)
    work.figure.legend(loc='outside lower center', ncols=3)
