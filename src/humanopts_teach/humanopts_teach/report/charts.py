"""
The charts of a report: learning curves, planning and its sweeps, and games.

``name`` is the prefix of the identifiers in a figure.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

from humanopts_learner.planning.exact_plan import build_model, ExactPlan
from humanopts_learner.planning.solve import value_history
from humanopts_learner.summary import Criterion
from humanopts_teach.evaluation.bag_evaluation import OptionEvaluation
from humanopts_teach.evaluation.tables import SECONDS
from humanopts_teach.report.figures import Drawing, drawing, MUTED, SERIES
from matplotlib.axes import Axes
from matplotlib.ticker import (
    LogLocator,
    MaxNLocator,
    NullLocator,
    PercentFormatter,
    StrMethodFormatter,
)
import numpy as np
import pandas as pd

SIZE = (5.0, 2.9)  # inches
MARGINS = {'left': 0.15, 'right': 0.985, 'bottom': 0.165, 'top': 0.9}  # shares; six digits fit
MAX_MARKERS = 30  # per curve
LEARNING = {  # title and unit of each chart
    'success': ('Success: reaches an end like a demonstrated one', 'share of starts'),
    'return': ('Return: shortfall', 'share of its range'),
    'initiation': ('Initiation: held-out error (can it start?)', 'balanced error'),
    'termination': ('Termination: held-out error (does it end?)', 'share of demonstrations'),
    'accuracy': ('Accuracy against the reference option', 'share of states'),
    'gain': ('Return of the policy minus that shown', 'reward units'),
}
ACCURACIES = {
    'policy_accuracy': 'policy',
    'classification_accuracy_initiation': 'I',
    'classification_accuracy_termination': 'β',
}
CURVES: tuple[dict[str, Any], ...] = (  # coinciding curves stay visible
    {'color': SERIES[0], 'marker': 'o', 'ms': 3.5},
    {'color': SERIES[1], 'marker': 's', 'ms': 7, 'mfc': 'none', 'ls': '--', 'lw': 1.1},
    {'color': SERIES[3], 'marker': '^', 'ms': 3.5, 'ls': ':', 'lw': 1.1},
)
STAGES = dict(zip(SECONDS, (('policy tables', 0), ('models', 1), ('sweeps', 3))))
MARKERS = 'osD^'
WIDTH, ROW_HEIGHT = 5.6, 0.33  # inches
CLEARED = 'cleared'
MAX_VALUES = 20_000_000  # maximum of states times sweeps for recomputing sweeps


@contextmanager
def _chart(
    name: str,
    label: str,
    size: tuple[float, float] = SIZE,
    grid: Literal['x', 'y', 'both'] = 'y',
    **axes: Any,
) -> Iterator[Drawing]:
    """
    Draw a figure with a single plot.

    :param label: text alternative for screen readers.
    :param grid: axis with grid lines.
    :param axes: title and axis labels.
    """
    with drawing(name, label, *size) as work:
        work.axes.set(**axes)
        work.axes.grid(axis=grid)
        yield work


def learning_curves(option: OptionEvaluation, name: str) -> list[str]:
    """
    Return one SVG per criterion and, if known, one of the accuracies and one of the gain.

    "Not here" answers yield several rows with the same number of trajectories; the last is drawn.
    """
    points = option.learning[option.learning['n_demonstrations'] > 0]
    points = points.drop_duplicates('n_demonstrations', keep='last').set_index('n_demonstrations')
    if points.empty:
        return []
    limit = points['return_limit'].where(points['return_limit'] != points['return'])
    of: dict[str, pd.DataFrame] = {
        'success': pd.DataFrame(
            {'measured': points['success'], 'lower limit': points['success_limit']}
        ),
        'return': pd.DataFrame({'measured': points['return'], 'upper limit': limit}),
        'initiation': points[['initiation']].set_axis(['measured'], axis=1),
        'termination': points[['termination']].set_axis(['measured'], axis=1),
        'accuracy': points[[*ACCURACIES]].rename(columns=ACCURACIES),
        'gain': points[points['gain_low'].notna()][['gain']].set_axis(['mean'], axis=1),
    }
    criteria = {criterion.name: criterion for criterion in option.summary.criteria}
    figures = []
    for part, (title, unit) in LEARNING.items():
        curves = of[part]
        if part not in criteria and not curves.notna().any(axis=None):
            continue
        labels: dict[str, Any] = {'title': title, 'xlabel': 'demonstrations', 'ylabel': unit}
        with _chart(f'{name}-{part}', f'{title}: {option.option.name}', **labels) as work:
            axes = work.axes
            for style, (label, curve) in zip(CURVES, curves.items()):
                if len(known := curve.dropna()):
                    every = -(-len(known) // MAX_MARKERS)  # limits the markers
                    axes.plot(known.index, known, markevery=every, label=str(label), **style)
            if part in criteria:
                if curves.isna().all(axis=None):
                    verdict = criteria[part].verdict
                    axes.text(0.5, 0.7, verdict, transform=axes.transAxes, ha='center')
                _draw_threshold(axes, criteria[part], curves)
            elif part == 'accuracy':
                axes.set_ylim(top=1.03)
                axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
            else:
                ends = (points.loc[curves.index, end] for end in ('gain_low', 'gain_high'))
                band: dict[str, Any] = {'color': SERIES[0], 'alpha': 0.2, 'lw': 0}
                axes.fill_between(curves.index, *ends, label='95 % interval, same starts', **band)
                axes.axhline(0, color=MUTED, lw=0.8)
            axes.set_xlim(0, points.index.max() + 0.6)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
            if axes.get_legend_handles_labels()[0]:  # empty if nothing was measured
                axes.legend(loc='best')
            work.figure.set_layout_engine(None)  # layout would take as long as drawing
            work.figure.subplots_adjust(**MARGINS)
        figures.append(work.svg)
    return figures


def _draw_threshold(axes: Axes, criterion: Criterion, values: pd.DataFrame) -> None:
    """Draw the threshold of a criterion, and shade the region in which it is met."""
    limit = criterion.threshold
    if limit is not None:
        side = 'above' if criterion.at_least else 'below'
        style: dict[str, Any] = {'color': SERIES[2]}
        axes.axhline(limit, ls='--', lw=1.4, label=f'met at or {side} {limit:.3g}', **style)
        end = 1.0 if criterion.at_least else np.nanmin([0.0, limit, values.min().min()])
        axes.axhspan(*sorted((end, limit)), alpha=0.13, lw=0, **style)


def planning_figures(plans: pd.DataFrame, name: str) -> list[str]:
    """
    Return figures of the planning time and, if measured, of the return, by action set.

    :param plans: table by name, columns ``PLANS``.
    """
    if plans.empty:
        return []
    longest = plans[[*SECONDS]].sum(axis=1).max()
    scale, unit, word = (1.0, 's', 'seconds') if longest >= 1.0 else (1e3, 'ms', 'milliseconds')
    title, size = 'Planning time', (5.0, 1.3 + 0.6 * len(plans))
    label = f'{title} by action set'
    with _chart(f'{name}-time', label, size, 'x', title=title, xlabel=word) as work:
        left = np.zeros(len(plans))
        for field, (stage, color) in STAGES.items():
            values = scale * plans[field].to_numpy()
            style: dict[str, Any] = {
                'color': SERIES[color],
                'label': stage if values.any() else '',
            }
            bars = work.axes.barh(list(plans.index), values, 0.55, left=left, **style)
            left += values
        work.axes.bar_label(bars, [f'{total:.3g} {unit}' for total in left], padding=5, size=9)
        work.axes.set_xlim(0, 1.22 * left.max())
        work.axes.invert_yaxis()
        work.figure.legend(loc='outside lower center', ncols=3)
    judged = plans[plans['mean_return'].notna()]
    kinds = {
        'undiscounted': ['mean_return', 'mean_return_low', 'mean_return_high'],
        'discounted': ['mean_discounted_return'],
    }
    ends = [
        judged[columns]
        .set_axis(['mean', 'low', 'high'][: len(columns)], axis=1)
        .assign(series=kind)
        for kind, columns in kinds.items()
    ]
    title, unit = 'Mean return of an episode', 'reward units'
    figure = _intervals(pd.concat(ends), f'{name}-return', title, unit, 0.6)
    return [work.svg, *([figure] if len(judged) else [])]


def games_figures(games: pd.DataFrame, name: str) -> list[str]:
    """Return figures of the scores and, for games with mazes, of the share cleared."""
    rows = games.set_index('name').rename(columns={'setting': 'series', 'score': 'mean'})
    score = rows.rename(columns={'score_low': 'low', 'score_high': 'high'})
    figures = [_intervals(score, f'{name}-score', 'Mean score', 'points')]
    if all(CLEARED in outcomes for outcomes in rows['outcomes']):
        shares = pd.DataFrame([each[CLEARED] for each in rows['outcomes']], rows.index)
        cleared = shares.assign(series=rows['series'].to_numpy())
        figures.append(_intervals(cleared, f'{name}-cleared', 'Mazes cleared', 'share of games'))
    return figures


def _intervals(
    rows: pd.DataFrame, name: str, title: str, unit: str, row_height: float = ROW_HEIGHT
) -> str:
    """
    Draw means and their intervals, if any, by name and series.

    :param rows: table by name: mean, low, high, series.
    """
    names, series = list(rows.index.unique()), list(rows['series'].unique())
    size = WIDTH, 1.2 + row_height * len(names)
    label = f'{title} by policy, with 95 % intervals'
    with _chart(name, label, size, 'x', title=title, xlabel=f'{unit}, with 95 % interval') as work:
        axes = work.axes
        for index, called in enumerate(series):
            own = rows[rows['series'] == called]
            heights = own.index.map(names.index) + 0.2 * (index - (len(series) - 1) / 2)
            style = _style(index)
            axes.hlines(heights, own['low'], own['high'], color=style['color'], lw=2.0)
            axes.plot(own['mean'], heights, ls='', ms=4.5, label=called or None, **style)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        low, high = axes.get_xlim()
        axes.set_xlim(min(0.0, low), max(0.0, high))
        axes.xaxis.set_major_locator(MaxNLocator(6))
        if unit.startswith('share'):
            axes.set_xlim(-0.02, 1.02)
            axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        if series[0]:
            work.figure.legend(loc='outside lower center', ncols=len(series))
    return work.svg


def _style(index: int) -> dict[str, Any]:
    """Return the colour and marker of a series."""
    return {'color': SERIES[index % len(SERIES)], 'marker': MARKERS[index % len(MARKERS)]}


def sweep_figure(plans: Mapping[str, ExactPlan], name: str) -> str:
    """
    Return a figure of the residual of each sweep; empty without plans or if computing takes long.

    :param plans: plans with exact models, by name; each is recomputed sweep by sweep.
    """
    sizes = [plan.domain.n_states * plan.solution.sweeps for plan in plans.values()]
    if max(sizes, default=MAX_VALUES + 1) > MAX_VALUES:
        return ''
    title, unit = 'Residual of each sweep', 'reward units'
    with _chart(name, title, title=title, xlabel='sweep', ylabel=unit, yscale='log') as work:
        axes = work.axes
        for index, (called, plan) in enumerate(plans.items()):
            model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
            history = value_history(model, max_sweeps=plan.solution.sweeps)  # (sweeps + 1, S)
            residual = np.abs(np.diff(history, axis=0)).max(axis=1)
            changed = np.flatnonzero(residual)  # the last residual can be 0
            text = f'{called}: {len(residual)} sweeps'
            axes.plot(1 + changed, residual[changed], ms=3, label=text, **_style(index))
        low, high = axes.get_ylim()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc='best')
    return work.svg
