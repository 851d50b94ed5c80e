"""Steps per episode while learning, by action set."""

from collections.abc import Mapping

from humanopts_learner.qlearning.curves import Band
from humanopts_teach.report.figures import CaptionedFigure, drawing, SERIES
from matplotlib.ticker import MaxNLocator
import numpy as np

STYLES = ('-', '--', '-.', ':', (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))  # by series


def steps_figure(curves: Mapping[str, Band], name: str, title: str) -> CaptionedFigure:
    """
    Draw the mean steps of every episode, and their 95 % intervals (paper, figure 4).

    :param curves: by action set, at most six.
    :param name: prefix of the identifiers.
    """
    with drawing(name, f'Steps per episode by action set: {title}', 6.4, 3.8) as work:
        axes = work.axes
        for (called, band), color, style in zip(curves.items(), SERIES, STYLES, strict=False):
            episode = np.arange(1, len(band.mean) + 1)
            axes.fill_between(episode, band.low, band.high, color=color, alpha=0.18, lw=0)
            axes.plot(episode, band.mean, color=color, ls=style, lw=1.4, label=called)
        axes.set(title=title, xlabel='episode', ylabel='steps per episode')
        axes.set_ylim(bottom=0)
        axes.margins(x=0.01)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        axes.grid(axis='y')
        axes.tick_params(length=0)
        work.figure.legend(loc='outside lower center', ncols=3)
    return CaptionedFigure(work.svg, 'Mean of all runs; shaded: its 95 % interval.')
