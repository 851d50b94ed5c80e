"""
The charts of a report: learning curves, planning and its sweeps, and games.

``name`` is the prefix of the identifiers in a figure.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise, zip_longest
import math
from typing import Any, Literal

from humanopts_learner.intervals import Interval
from humanopts_learner.planning.exact import build_model, ExactPlan
from humanopts_learner.planning.value_iteration import sweep_table, SweepRow
from humanopts_teach.evaluation.bag_evaluation import CurvePoint
from humanopts_teach.evaluation.games import GamesEvaluation
from humanopts_teach.evaluation.measures import PlanningRow
from humanopts_teach.report.figures import Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.pages import number
from matplotlib.axes import Axes
from matplotlib.ticker import (
    LogLocator,
    MaxNLocator,
    NullLocator,
    PercentFormatter,
    StrMethodFormatter,
)
import numpy as np

SIZE = (5.0, 2.9)  # inches
MARGINS = {'left': 0.15, 'right': 0.985, 'bottom': 0.165, 'top': 0.9}  # shares, for six digits
MOST_MARKERS = 30  # on a curve
PANELS = (  # criterion, title, unit
    ('return', 'Return: shortfall', 'reward units'),
    ('initiation', 'Initiation: held-out error (may it start?)', 'balanced error'),
    ('termination', 'Termination: held-out error (does it end?)', 'balanced error'),
)
ACCURACIES = {
    'policy': 'policy_accuracy',
    'I': 'classification_accuracy_initiation',
    'β': 'classification_accuracy_termination',
}
CURVES: tuple[dict[str, Any], ...] = (  # curves of one chart that coincide stay visible
    {'color': SERIES[0], 'marker': 'o', 'ms': 3.5},
    {'color': SERIES[1], 'marker': 's', 'ms': 7, 'mfc': 'none', 'ls': '--', 'lw': 1.1},
    {'color': SERIES[3], 'marker': '^', 'ms': 3.5, 'ls': ':', 'lw': 1.1},
)
STAGES = (
    ('table_seconds', 'policy tables', 0),
    ('model_seconds', 'models', 1),
    ('sweep_seconds', 'sweeps', 3),
)
RETURNS = (('undiscounted', 'mean_return'), ('discounted', 'mean_discounted_return'))
MARKERS = 'osD^'
WIDTH, ROW_HEIGHT = 5.6, 0.33  # inches
CLEARED = 'cleared'
MOST_VALUES = 20_000_000  # states by sweeps, up to which plans are made again for their sweeps
ALL_ROWS, STEP = 30, 1.1  # sweeps that are all in the table; from there on each so many times on
NEAR = 1e-3  # a value so close to its end, in reward units, is settled
_Curves = Mapping[str, Mapping[int, float | None]]  # by label and demonstrations; None: not known


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


def learning_curves(points: Sequence[CurvePoint], name: str, option: str) -> list[str]:
    """
    Return one SVG for each criterion, one of the accuracies and one of the gain where known.

    :param points: in order of demonstrations; of several with equally many trajectories (between
        them came "not here" answers) the last is drawn.
    """
    drawn = {p.block.n_demonstrations: p for p in points if p.block.n_demonstrations}
    figures = []

    @contextmanager
    def chart(
        part: str, title: str, unit: str, curves: _Curves, nothing: str = ''
    ) -> Iterator[Axes]:
        axes_of: dict[str, Any] = {'title': title, 'xlabel': 'demonstrations', 'ylabel': unit}
        with _chart(f'{name}-{part}', f'{title}: {option}', **axes_of) as work:
            _draw_curves(work.axes, curves, nothing)
            yield work.axes
            work.axes.set_xlim(0, max(drawn) + 0.6)
            work.axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
            if work.axes.get_legend_handles_labels()[0]:  # else nothing is measured
                work.axes.legend(loc='best')
            work.figure.set_layout_engine(None)  # to lay out takes as long as to draw
            work.figure.subplots_adjust(**MARGINS)
        figures.append(work.svg)

    for criterion, title, unit in PANELS if drawn else ():
        known = {
            n: c for n, p in drawn.items() for c in p.judgement.criteria if c.name == criterion
        }
        curves: _Curves = {
            'measured': {n: c.value for n, c in known.items()},
            'upper limit': {n: c.high for n, c in known.items() if c.high != c.value},
        }
        with chart(criterion, title, unit, curves, list(known.values())[-1].verdict) as axes:
            limits = {n: c.threshold for n, c in known.items() if c.threshold is not None}
            if not limits:
                continue
            last, constant = list(limits.values())[-1], len(set(limits.values())) == 1
            least = min([0.0, *limits.values(), *_known(*curves.values())])
            style: dict[str, Any] = {'color': SERIES[2]}
            label = f'met at or below {last:.3g}' + ('' if constant else ' in the end')
            if constant:
                axes.axhline(last, ls='--', lw=1.4, label=label, **style)
                axes.axhspan(least, last, alpha=0.13, lw=0, **style)
            else:
                axes.plot(
                    list(limits), list(limits.values()), ls='--', lw=1.4, label=label, **style
                )
                axes.fill_between(
                    list(limits), least, list(limits.values()), alpha=0.13, lw=0, **style
                )
    curves = {
        part: {n: getattr(p.block, field) for n, p in drawn.items()}
        for part, field in ACCURACIES.items()
    }
    if _known(*curves.values()):
        title = 'Accuracy against the reference option'
        with chart('accuracy', title, 'share of states', curves) as axes:
            axes.set_ylim(top=1.03)
            axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    gains = {n: p.judgement.gain for n, p in drawn.items() if not math.isnan(p.judgement.gain.low)}
    if gains:
        curves = {'mean': {n: gain.mean for n, gain in gains.items()}}
        title = 'Return of the policy less that shown'
        with chart('gain', title, 'reward units', curves) as axes:
            _fill(axes, list(gains), list(gains.values()), SERIES[0], '95 % interval, same starts')
            axes.axhline(0, color=MUTED, lw=0.8)
    return figures


def _draw_curves(axes: Axes, curves: _Curves, nothing: str) -> None:
    """
    Draw values by demonstrations, with so few markers that they do not overlap.

    :param nothing: to write where there is no value.
    """
    for style, (label, curve) in zip(CURVES, curves.items()):
        known = {n: value for n, value in curve.items() if value is not None}
        if known:
            every = -(-len(known) // MOST_MARKERS)
            axes.plot(list(known), list(known.values()), markevery=every, label=label, **style)
    if not _known(*curves.values()):
        axes.text(0.5, 0.7, nothing, transform=axes.transAxes, ha='center')


def _known(*curves: Mapping[int, float | None]) -> list[float]:
    return [value for curve in curves for value in curve.values() if value is not None]


def _fill(
    axes: Axes, x: Sequence[float], found: Sequence[Interval], color: str, label: str | None = None
) -> None:
    """Shade intervals beside one another."""
    low, high = [each.low for each in found], [each.high for each in found]
    axes.fill_between(x, low, high, color=color, alpha=0.2, lw=0, label=label)


def planning_figures(rows: Mapping[str, PlanningRow], name: str) -> list[str]:
    """
    Return the planning time and, where it was measured, the return, by action set.

    :param rows: by the names of the plans.
    """
    returns = {called: row for called, row in rows.items() if row.mean_return is not None}
    figures = [_planning_times(rows, f'{name}-time')] if rows else []
    return [*figures, _mean_returns(returns, f'{name}-return')] if returns else figures


def _planning_times(rows: Mapping[str, PlanningRow], name: str) -> str:
    longest = max(row.seconds for row in rows.values())
    scale, unit, word = (1.0, 's', 'seconds') if longest >= 1.0 else (1e3, 'ms', 'milliseconds')
    title, size = 'Planning time', (5.0, 1.3 + 0.6 * len(rows))
    with _chart(name, f'{title} by action set', size, 'x', title=title, xlabel=word) as work:
        left = np.zeros(len(rows))
        for field, label, color in STAGES:
            values = scale * np.array([getattr(row, field) for row in rows.values()])
            told = label if values.any() else ''
            style: dict[str, Any] = {'color': SERIES[color], 'label': told}
            bars = work.axes.barh(list(rows), values, 0.55, left=left, **style)
            left += values
        work.axes.bar_label(bars, [f'{total:.3g} {unit}' for total in left], padding=5, size=9)
        work.axes.set_xlim(0, 1.22 * left.max())
        work.axes.invert_yaxis()
        work.figure.legend(loc='outside lower center', ncols=3)
    return work.svg


def _mean_returns(returns: Mapping[str, PlanningRow], name: str) -> str:
    title, size = 'Mean return of an episode, with 95 % interval', (5.0, 1.3 + 0.6 * len(returns))
    label, unit, rows = 'Mean return by action set', 'reward units', returns.values()
    with _chart(name, label, size, 'x', title=title, xlabel=unit) as work:
        for series, (kind, field) in enumerate(RETURNS):
            means = np.array([getattr(row, field) for row in rows], float)  # NaN: not measured
            work.axes.plot(means, list(returns), label=kind, ms=8, ls='', **_series(series))
        ends = np.array([(row.mean_return_low, row.mean_return_high) for row in rows], float)
        work.axes.hlines(list(returns), *ends.T, color=SERIES[0], lw=2.0, alpha=0.5)
        work.axes.axvline(0, color=MUTED, lw=0.8)
        work.axes.set_ylim(len(returns) - 0.4, -0.6)
        work.axes.xaxis.set_major_locator(MaxNLocator(6))
        work.figure.legend(loc='outside lower center', ncols=2)
    return work.svg


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
    values = [plan.domain.n_states * plan.solution.sweeps for plan in plans.values()]
    if not values or max(values) > MOST_VALUES:
        return None
    tables = {}
    for called, plan in plans.items():
        model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
        tables[called] = sweep_table(model, near=NEAR, max_sweeps=plan.solution.sweeps)
    states = next(iter(plans.values())).domain.n_states
    found = list(zip_longest(*tables.values()))
    rows = [
        (sweep, [text for row in found[sweep] for text in _cells(row, states)])
        for sweep in _shown([len(table) - 1 for table in tables.values()])
    ]
    return SweepReport(list(tables), NEAR, _residuals(tables, f'{name}-residual'), rows)


def _shown(last: Sequence[int]) -> list[int]:
    """Return the sweeps that the table shows: the first ones, fewer later on, and each last."""
    shown, sweep = set(last), 0
    while sweep <= max(last):
        shown.add(sweep)
        sweep = sweep + 1 if sweep < ALL_ROWS else math.ceil(sweep * STEP)
    return sorted(shown)


def _cells(row: SweepRow | None, states: int) -> tuple[str, str]:
    if row is None:
        return '', ''
    return (number(row.residual, 3) if row.sweep else '', f'{row.settled / states:.1%}')


def _residuals(tables: Mapping[str, Sequence[SweepRow]], name: str) -> str:
    title, unit = 'Residual of each sweep', 'reward units'
    label = 'Residual by sweep'
    with _chart(name, label, title=title, xlabel='sweep', ylabel=unit, yscale='log') as work:
        axes = work.axes
        for index, (called, rows) in enumerate(tables.items()):
            changed = [row for row in rows[1:] if row.residual > 0]  # the last may change nothing
            sweeps, residuals = [row.sweep for row in changed], [row.residual for row in changed]
            text = f'{called}: {len(rows) - 1} sweeps'
            axes.plot(sweeps, residuals, ms=3, label=text, **_series(index))
        low, high = axes.get_ylim()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc='best')
    return work.svg


def games_figures(games: GamesEvaluation, name: str) -> list[str]:
    """Return the scores, the share of mazes cleared where there are mazes, and the curves."""
    rows = [row for setting in games.settings for row in setting.rows]
    scores = [row.score for row in rows]
    figures = [_intervals(games, scores, f'{name}-score', 'Mean score', 'points')]
    if all(CLEARED in row.outcomes for row in rows):
        cleared = [row.outcomes[CLEARED] for row in rows]
        figures.append(
            _intervals(games, cleared, f'{name}-cleared', 'Mazes cleared', 'share of games')
        )
    return [*figures, _score_curves(games, f'{name}-curve')]


def _intervals(
    games: GamesEvaluation, found: Sequence[Interval], name: str, title: str, unit: str
) -> str:
    """Draw an interval for each row of each setting, the settings beside one another."""
    rows, settings = games.settings[0].rows, games.settings
    size = WIDTH, 1.2 + ROW_HEIGHT * len(rows)
    label = f'{title} by what plays, with 95 % intervals'
    with _chart(name, label, size, 'x', title=title, xlabel=f'{unit}, with 95 % interval') as work:
        axes, ends = work.axes, np.array([(each.mean, each.low, each.high) for each in found])
        for index, (setting, part) in enumerate(zip(settings, np.split(ends, len(settings)))):
            heights = np.arange(len(rows)) + 0.2 * (index - (len(settings) - 1) / 2)
            style = _series(index)
            axes.hlines(heights, part[:, 1], part[:, 2], color=style['color'], lw=2.0)
            axes.plot(part[:, 0], heights, ls='', ms=4.5, label=setting.name or None, **style)
        for row, (one, other) in enumerate(pairwise(rows)):
            if one.kind != other.kind:
                axes.axhline(row + 0.5, color=MUTED, lw=0.6, alpha=0.5)
        axes.set_yticks(range(len(rows)), [row.name for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        if unit.startswith('share'):
            axes.set_xlim(-0.02, 1.02)
            axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        if settings[0].name:
            work.figure.legend(loc='outside lower center', ncols=len(settings))
    return work.svg


def _score_curves(games: GamesEvaluation, name: str) -> str:
    where = f', {games.curve_setting}' if games.curve_setting else ''
    names = {
        'title': f'Score against planning time{where}',
        'xlabel': 'planning seconds of the processor (models counted)',
        'ylabel': 'mean score, with 95 % interval',
        'xscale': 'log',
    }
    label = f'Mean score by planning seconds{where}'
    with _chart(name, label, (WIDTH, 4.4), 'both', **names) as work:
        axes = work.axes
        for index, curve in enumerate(games.curves):
            seconds, scores = [r.seconds for r in curve.rows], [r.score for r in curve.rows]
            style = _series(index)
            _fill(axes, seconds, scores, style['color'])
            times = [f'{target:,.0f} {curve.reached(target)}' for target in games.targets]
            label = ': '.join([curve.name, ', '.join(times)] if times else [curve.name])
            axes.plot(seconds, [score.mean for score in scores], ms=4.5, label=label, **style)
        for target in games.targets:
            axes.axhline(target, color=MUTED, ls='--', lw=1.0)
            at = axes.get_yaxis_transform()
            axes.text(1.01, target, f'{target:,.0f}', transform=at, va='center', color=MUTED)
        axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        work.figure.legend(loc='outside lower left', ncols=1)
    return work.svg
