"""The figures of the report of a study: one colour per condition, one thin line per person."""

from collections.abc import Sequence
from typing import Any

from humanopts_teach.report.figures import Drawing, drawing, SERIES
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
import numpy as np
import pandas as pd

SIZE = (5.0, 3.1)  # inches
_SHORT = 20  # maximum name length in a legend with two columns, characters
STYLES = ('-', '--', ':', '-.')
_PERSON: dict[str, Any] = {'lw': 0.8, 'alpha': 0.45}
_BELOW: dict[str, Any] = {'loc': 'upper center', 'bbox_to_anchor': (0.5, -0.18)}
_MEAN: dict[str, Any] = {'lw': 2.4}


def progress_figure(given: pd.DataFrame, options: pd.DataFrame, conditions: Sequence[str]) -> str:
    """
    Return a figure of the number of options learned by number of demonstrations; empty: no data.

    A learned option counts from its last demonstration.

    :param given: the table of demonstrations, without withdrawn ones.
    :param options: the table of options.
    """
    learned = options[options['learned'] == 'yes']
    known = set(learned[['participant', 'condition', 'option']].itertuples(index=False, name=None))
    curves: dict[str, list[pd.Series]] = {}
    for (name, person), own in given[given['kind'] == 'demonstration'].groupby(
        ['condition', 'participant'], sort=False
    ):
        last = {option: number for number, option in enumerate(own['option'], start=1)}
        done = [number for option, number in last.items() if (person, name, option) in known]
        steps = np.bincount(done, minlength=len(own) + 1).cumsum()
        curves.setdefault(str(name), []).append(pd.Series(steps))
    return _curves(
        curves,
        conditions,
        name='progress',
        title='Options learned',
        xlabel='demonstrations',
        ylabel='options',
    )


def pace_figure(given: pd.DataFrame, conditions: Sequence[str]) -> str:
    """Return a figure of the duration of each demonstration; empty: no data."""
    curves: dict[str, list[pd.Series]] = {}
    for (name, _), own in given[given['kind'] == 'demonstration'].groupby(
        ['condition', 'participant'], sort=False
    ):
        seconds = own['seconds'].set_axis(range(1, len(own) + 1))
        curves.setdefault(str(name), []).append(seconds)
    return _curves(
        curves,
        conditions,
        name='pace',
        title='Time for a demonstration',
        xlabel='demonstration',
        ylabel='s',
        carried=False,
    )


def accuracy_figure(points: pd.DataFrame, measure: str, title: str, paper: int) -> str:
    """
    Return a figure of one accuracy measure of a game's options by number of demonstrations.

    :param points: columns option, participant, condition, demonstrations and the measure, a share.
    :param paper: number of demonstrations to mark.
    """
    curves: dict[str, list[pd.Series]] = {}
    people = ['option', 'participant', 'condition']
    for (name, *_), own in points.groupby(people, sort=False):
        curves.setdefault(str(name), []).append(own.set_index('demonstrations')[measure])
    return _curves(
        curves,
        [*curves],
        name=f'accuracy-{measure}',
        title=title,
        xlabel='demonstrations',
        ylabel='share of states',
        carried=False,
        mark=(paper, f'paper: {paper}'),
        top=1.03,
    )


def _curves(
    curves: dict[str, list[pd.Series]],
    conditions: Sequence[str],
    *,
    name: str,
    carried: bool = True,
    mark: tuple[float, str] | None = None,
    top: float | None = None,
    **axes: str,
) -> str:
    """
    Draw one curve per person, and the means.

    :param carried: whether ended curves keep their last value in the mean; otherwise, it is
        taken only where at least two curves continue (one, if there is only one person).
    :param mark: value of x to mark, with its label.
    :param top: upper end of the y axis; None: automatic.
    """
    if not curves:
        return ''
    label = (
        f'{axes["title"]} by {axes["xlabel"]}: {", ".join(curves)}; thin lines are individual '
        'people'
    )
    with drawing(name, label, *SIZE) as work:
        plot, steps = _axes(work, **axes), 'steps-post' if carried else 'default'
        for color, style, condition in _styles(conditions):
            people = curves.get(condition, [])
            for curve in people:
                plot.plot(curve.index, curve, color=color, ls=style, drawstyle=steps, **_PERSON)
            if people:
                frame = pd.concat(people, axis=1)
                frame = (
                    frame.ffill()
                    if carried
                    else frame[frame.notna().sum(axis=1) >= min(2, len(people))]
                )
                mean = frame.mean(axis=1)
                text = f'{condition}: mean of {len(people)}'
                line: dict[str, Any] = {
                    'color': color,
                    'ls': style,
                    'drawstyle': steps,
                    'label': text,
                }
                plot.plot(mean.index, mean, **line, **_MEAN)
        if mark is not None:
            plot.axvline(mark[0], color='#888', ls=':', lw=1.2, label=mark[1])
        plot.set_xlim(left=0)
        plot.set_ylim(0, top)
        for axis in (plot.xaxis, *([plot.yaxis] if carried else [])):
            axis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        narrow = max(map(len, curves)) <= _SHORT
        plot.legend(**_BELOW, ncols=2 if narrow else 1)
    return work.svg


def outcome_figure(
    rows: pd.DataFrame, outcome: str, title: str, unit: str, conditions: Sequence[str]
) -> str:
    """
    Return a figure of an outcome by condition, with a thin line for each person.

    :param rows: columns participant, condition and the outcome.
    """
    values = rows.pivot(index='participant', columns='condition', values=outcome)
    values = values[[name for name in conditions if name in values]]
    label = f'{title} by condition; thin lines are individual people'
    with drawing(f'outcome-{outcome}', label, *SIZE) as work:
        plot = _axes(work, title=title, ylabel=unit)
        places = np.arange(values.shape[1])
        for _, person in values.iterrows():
            plot.plot(places, person, color=SERIES[0], marker='o', ms=2.5, **_PERSON)
        plot.plot(places, values.mean(), color=SERIES[1], marker='s', ms=6, label='mean', **_MEAN)
        plot.set_xticks(places, list(values.columns))
        plot.set_xlim(-0.4, len(places) - 0.6)
        plot.set_ylim(bottom=0)
        plot.legend(**_BELOW)
    return work.svg


def _axes(work: Drawing, **axes: str) -> Axes:
    work.axes.set(**axes)
    work.axes.grid(axis='y')
    return work.axes


def _styles(conditions: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return the colour, line style and name of each condition."""
    return [
        (SERIES[index % len(SERIES)], STYLES[index % len(STYLES)], name)
        for index, name in enumerate(conditions)
    ]
