"""Steps per episode while learning, by action set."""

from collections.abc import Callable, Mapping

from humanopts_learner.qlearning.curves import Band
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing, SERIES
from matplotlib.ticker import MaxNLocator
import numpy as np

SIZE = (6.4, 3.8)  # inches
STYLES = ('-', '--', '-.', ':', (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))  # by series


def steps_figure(curves: Mapping[str, Band], name: str, title: str) -> CaptionedFigure:
    """
    Draw the mean steps of every episode, and their 95 % intervals (paper, figure 4).

    :param curves: by action set, at most six.
    :param name: prefix of the identifiers.
    """
    with drawing(name, f'Steps per episode by action set: {title}', *SIZE) as work:
        draw_steps(work, curves, title)
    return CaptionedFigure(work.svg, 'Mean of all runs; shaded: its 95 % interval.')


def draw_steps(
    work: Drawing, curves: Mapping[str, Band], title: str, paint: Callable[[str], str] = str
) -> None:
    """
    Draw into a figure under way; see ``steps_figure``.

    :param paint: makes a colour of ``SERIES`` the one to draw with.
    """
    axes = work.axes
    for (called, band), color, style in zip(curves.items(), SERIES, STYLES, strict=False):
        episode, own = np.arange(1, len(band.mean) + 1), paint(color)
        axes.fill_between(episode, band.low, band.high, color=own, alpha=0.18, lw=0)
        axes.plot(episode, band.mean, color=own, ls=style, lw=1.4, label=called)
    axes.set(title=title, xlabel='episode', ylabel='steps per episode')
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    axes.grid(axis='y')
    axes.tick_params(length=0)
    work.figure.legend(loc='outside lower center', ncols=3)
