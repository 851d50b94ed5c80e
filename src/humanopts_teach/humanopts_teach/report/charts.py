"""
The charts of a report: learning curves, planning and its sweeps, and games.

``name`` is the prefix of the identifiers in a figure.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import math
from typing import Any, Literal

from humanopts_env.arrays import Floats
from humanopts_learner.planning.exact_plan import build_model, ExactPlan
from humanopts_learner.planning.solve import value_history
from humanopts_teach.evaluation.bag_evaluation import OptionEvaluation
from humanopts_teach.evaluation.tables import SECONDS
from humanopts_teach.report.figures import Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.pages import number
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
MARGINS = {'left': 0.15, 'right': 0.985, 'bottom': 0.165, 'top': 0.9}  # shares, for six digits
MAX_MARKERS = 30  # on a curve
CRITERIA = (  # criterion, title, unit
    ('return', 'Return: shortfall', 'reward units'),
    ('initiation', 'Initiation: held-out error (may it start?)', 'balanced error'),
    ('termination', 'Termination: held-out error (does it end?)', 'balanced error'),
)
ACCURACIES = {
    'policy_accuracy': 'policy',
    'classification_accuracy_initiation': 'I',
    'classification_accuracy_termination': 'β',
}
CURVES: tuple[dict[str, Any], ...] = (  # curves of one chart that coincide stay visible
    {'color': SERIES[0], 'marker': 'o', 'ms': 3.5},
    {'color': SERIES[1], 'marker': 's', 'ms': 7, 'mfc': 'none', 'ls': '--', 'lw': 1.1},
    {'color': SERIES[3], 'marker': '^', 'ms': 3.5, 'ls': ':', 'lw': 1.1},
)
STAGES = dict(zip(SECONDS, (('policy tables', 0), ('models', 1), ('sweeps', 3))))
RETURNS = (('undiscounted', 'mean_return'), ('discounted', 'mean_discounted_return'))
MARKERS = 'osD^'
WIDTH, ROW_HEIGHT = 5.6, 0.33  # inches
CLEARED = 'cleared'
MAX_VALUES = 20_000_000  # states by sweeps, up to which plans are made again for their sweeps
ALL_ROWS, STEP = 30, 1.1  # sweeps that are all in the table; ratio of the later ones
NEAR = 1e-3  # a value so close to its end, in reward units, is settled


@contextmanager
def _chart(
    name: str,
    label: str,
    size: tuple[float, float] = SIZE,
    grid: Literal['x', 'y', 'both'] = 'y',
    **axes: Any,
) -> Iterator[Drawing]:
    """
    Draw a figure of one plot.

    :param label: what it shows, for people who do not see it.
    :param grid: axis that has lines.
    :param axes: title and names of the axes.
    """
    with drawing(name, label, *size) as work:
        work.axes.set(**axes)
        work.axes.grid(axis=grid)
        yield work


def _series(index: int) -> dict[str, Any]:
    """Return colour and marker of one of several series."""
    return {'color': SERIES[index % len(SERIES)], 'marker': MARKERS[index % len(MARKERS)]}


def learning_curves(option: OptionEvaluation, name: str) -> list[str]:
    """
    Return one SVG for each criterion, one of the accuracies and one of the gain where known.

    Of several rows with as many trajectories (between them came "not here" answers) the last is
    drawn.
    """
    points = option.learning[option.learning['n_demonstrations'] > 0]
    points = points.drop_duplicates('n_demonstrations', keep='last').set_index('n_demonstrations')
    if points.empty:
        return []
    last, figures = int(points.index.max()), []

    @contextmanager
    def chart(part: str, title: str, unit: str, curves: pd.DataFrame) -> Iterator[Drawing]:
        """Draw curves with so few markers that they do not overlap."""
        labels: dict[str, Any] = {'title': title, 'xlabel': 'demonstrations', 'ylabel': unit}
        with _chart(f'{name}-{part}', f'{title}: {option.option.name}', **labels) as work:
            axes = work.axes
            for style, (label, curve) in zip(CURVES, curves.items()):
                known = curve.dropna()
                if len(known):
                    every = -(-len(known) // MAX_MARKERS)
                    axes.plot(known.index, known, markevery=every, label=str(label), **style)
            yield work
            axes.set_xlim(0, last + 0.6)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
            if axes.get_legend_handles_labels()[0]:  # else nothing is measured
                axes.legend(loc='best')
            work.figure.set_layout_engine(None)  # to lay out takes as long as to draw
            work.figure.subplots_adjust(**MARGINS)
        figures.append(work.svg)

    verdicts = {criterion.name: criterion.verdict for criterion in option.summary.criteria}
    for criterion, title, unit in CRITERIA:
        curves = pd.DataFrame({'measured': points[criterion]})
        if criterion == 'return':
            high = points['return_high']
            curves['upper limit'] = high.where(high != points[criterion])
        with chart(criterion, title, unit, curves) as work:
            if curves.isna().all(axis=None):
                where = work.axes.transAxes
                work.axes.text(0.5, 0.7, verdicts[criterion], transform=where, ha='center')
            limits = points[f'{criterion}_threshold'].reindex(range(last + 1)).bfill().ffill()
            if limits.notna().any():
                constant = '' if limits.nunique() == 1 else ' in the end'
                label = f'met at or below {limits[last]:.3g}{constant}'
                least = min(0.0, limits.min(), curves.min().min())
                style: dict[str, Any] = {'color': SERIES[2]}
                work.axes.plot(limits.index, limits, ls='--', lw=1.4, label=label, **style)
                work.axes.fill_between(limits.index, least, limits, alpha=0.13, lw=0, **style)
    accuracies = points[[*ACCURACIES]].rename(columns=ACCURACIES)
    if accuracies.notna().any(axis=None):
        title = 'Accuracy against the reference option'
        with chart('accuracy', title, 'share of states', accuracies) as work:
            work.axes.set_ylim(top=1.03)
            work.axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    gains = points[points['gain_low'].notna()]
    if len(gains):
        title = 'Return of the policy less that shown'
        curves = gains[['gain']].rename(columns={'gain': 'mean'})
        with chart('gain', title, 'reward units', curves) as work:
            label = '95 % interval, same starts'
            _fill(work, gains.index, gains['gain_low'], gains['gain_high'], SERIES[0], label)
            work.axes.axhline(0, color=MUTED, lw=0.8)
    return figures


def _fill(work: Drawing, x: Any, low: Any, high: Any, color: str, label: str) -> None:
    """Shade intervals beside one another."""
    work.axes.fill_between(x, low, high, color=color, alpha=0.2, lw=0, label=label)


def planning_figures(plans: pd.DataFrame, name: str) -> list[str]:
    """
    Return the planning time and, where it was measured, the return, by action set.

    :param plans: by name; columns ``PLANS``.
    """
    if plans.empty:
        return []
    figures, longest = [], plans[[*SECONDS]].sum(axis=1).max()
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
    figures.append(work.svg)
    judged = plans[plans['mean_return'].notna()]
    if judged.empty:
        return figures
    title = 'Mean return of an episode, with 95 % interval'
    size, label, names = (
        (5.0, 1.3 + 0.6 * len(judged)),
        'Mean return by action set',
        list(judged.index),
    )
    with _chart(f'{name}-return', label, size, 'x', title=title, xlabel='reward units') as work:
        for series, (kind, field) in enumerate(RETURNS):
            work.axes.plot(judged[field], names, label=kind, ms=8, ls='', **_series(series))
        ends = judged['mean_return_low'], judged['mean_return_high']
        work.axes.hlines(names, *ends, color=SERIES[0], lw=2.0, alpha=0.5)
        work.axes.axvline(0, color=MUTED, lw=0.8)
        work.axes.set_ylim(len(judged) - 0.4, -0.6)
        work.axes.xaxis.set_major_locator(MaxNLocator(6))
        work.figure.legend(loc='outside lower center', ncols=2)
    return [*figures, work.svg]


@dataclass(frozen=True)
class SweepReport:
    """What each sweep of value iteration brought, plan beside plan."""

    names: list[str]
    near: float
    figure: str  # SVG
    rows: list[tuple[int, list[str]]]  # sweep; residual and share settled of each plan


def sweep_report(plans: Mapping[str, ExactPlan], name: str) -> SweepReport | None:
    """
    Make the plans again, sweep by sweep; None where that would take long, or there are none.

    :param plans: with exact models, by name.
    """
    if (
        not plans
        or max(p.domain.n_states * p.solution.sweeps for p in plans.values()) > MAX_VALUES
    ):
        return None
    values = {}  # (sweeps + 1, S) of each plan
    for called, plan in plans.items():
        model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
        values[called] = value_history(model, max_sweeps=plan.solution.sweeps)
    rows = [
        (sweep, [text for history in values.values() for text in _cells(history, sweep)])
        for sweep in _shown([len(history) - 1 for history in values.values()])
    ]
    return SweepReport(list(values), NEAR, _residuals(values, f'{name}-residual'), rows)


def _shown(last: Sequence[int]) -> list[int]:
    """Return the sweeps that the table shows: the first ones, fewer later on, and each last."""
    shown, sweep = set(last), 0
    while sweep <= max(last):
        shown.add(sweep)
        sweep = sweep + 1 if sweep < ALL_ROWS else math.ceil(sweep * STEP)
    return sorted(shown)


def _cells(history: Floats, sweep: int) -> tuple[str, str]:
    if sweep >= len(history):
        return '', ''
    settled = (np.abs(history[sweep] - history[-1]) <= NEAR).mean()
    residual = np.abs(history[sweep] - history[sweep - 1]).max()
    return number(residual, 3) if sweep else '', f'{settled:.1%}'


def _residuals(values: Mapping[str, Floats], name: str) -> str:
    title, unit = 'Residual of each sweep', 'reward units'
    label = 'Residual by sweep'
    with _chart(name, label, title=title, xlabel='sweep', ylabel=unit, yscale='log') as work:
        axes = work.axes
        for index, (called, history) in enumerate(values.items()):
            residual = np.abs(np.diff(history, axis=0)).max(axis=1)
            changed = np.flatnonzero(residual)  # the last sweep may change nothing
            text = f'{called}: {len(residual)} sweeps'
            axes.plot(1 + changed, residual[changed], ms=3, label=text, **_series(index))
        low, high = axes.get_ylim()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc='best')
    return work.svg


def games_figures(rows: pd.DataFrame, name: str) -> list[str]:
    """Return the scores and, where there are mazes, the share of mazes cleared."""
    score = rows[['score', 'score_low', 'score_high']].to_numpy()
    figures = [_intervals(rows, score, f'{name}-score', 'Mean score', 'points')]
    if all(CLEARED in outcomes for outcomes in rows['outcomes']):
        cleared = np.array([list(each[CLEARED].values()) for each in rows['outcomes']])
        figures.append(
            _intervals(rows, cleared, f'{name}-cleared', 'Mazes cleared', 'share of games')
        )
    return figures


def _intervals(rows: pd.DataFrame, ends: Any, name: str, title: str, unit: str) -> str:
    """
    Draw an interval for each policy, the settings beside one another.

    :param ends: mean, low and high of each row, (N, 3).
    """
    names, settings = list(rows['name'].unique()), list(rows['setting'].unique())
    size = WIDTH, 1.2 + ROW_HEIGHT * len(names)
    label = f'{title} by policy, with 95 % intervals'
    with _chart(name, label, size, 'x', title=title, xlabel=f'{unit}, with 95 % interval') as work:
        axes = work.axes
        for index, setting in enumerate(settings):
            own = (rows['setting'] == setting).to_numpy()
            heights = rows['name'][own].map(names.index) + 0.2 * (index - (len(settings) - 1) / 2)
            mean, low, high = ends[own].T
            style = _series(index)
            axes.hlines(heights, low, high, color=style['color'], lw=2.0)
            axes.plot(mean, heights, ls='', ms=4.5, label=setting or None, **style)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        if unit.startswith('share'):
            axes.set_xlim(-0.02, 1.02)
            axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        if settings[0]:
            work.figure.legend(loc='outside lower center', ncols=len(settings))
    return work.svg
