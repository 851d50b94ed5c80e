"""
The charts of a report: learning curves, planning and its sweeps, and games.

``name`` is the prefix of the identifiers in a figure.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise, zip_longest
import math
from typing import Any, Literal

from humanopts_learner.intervals import Interval
from humanopts_learner.planning.exact import build_model, ExactPlan
from humanopts_learner.planning.value_iteration import sweep_table, SweepRow
from humanopts_teach.evaluation.bag_evaluation import CurvePoint
from humanopts_teach.evaluation.games import ComparisonRow, GamesEvaluation, Setting
from humanopts_teach.evaluation.measures import PlanningRow
from humanopts_teach.report.figures import Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.findings import reached
from humanopts_teach.report.pages import number
from matplotlib.ticker import (
    LogLocator,
    MaxNLocator,
    NullLocator,
    PercentFormatter,
    StrMethodFormatter,
)

SIZE = (5.0, 2.9)  # inches
MOST_MARKERS = 30  # on a curve
PANELS = (  # criterion, title, unit
    ('return', 'Return: shortfall', 'reward units'),
    ('initiation', 'Initiation: held-out error (may it start?)', 'balanced error'),
    ('termination', 'Termination: held-out error (does it end?)', 'balanced error'),
)
ACCURACIES: tuple[tuple[str, str, dict[str, Any]], ...] = (  # curves that coincide stay visible
    ('policy_accuracy', 'policy', {'color': SERIES[0], 'marker': 'o', 'ms': 3.5}),
    (
        'classification_accuracy_initiation',
        'I',
        {'color': SERIES[1], 'marker': 's', 'ms': 7, 'mfc': 'none', 'ls': '--', 'lw': 1.1},
    ),
    (
        'classification_accuracy_termination',
        'β',
        {'color': SERIES[3], 'marker': '^', 'ms': 3.5, 'ls': ':', 'lw': 1.1},
    ),
)
STAGES = (
    ('table_seconds', 'policy tables', 0),
    ('model_seconds', 'models', 1),
    ('sweep_seconds', 'sweeps', 3),
)
MARKERS = 'osD^'
WIDTH, ROW_HEIGHT = 5.6, 0.33  # inches
CLEARED = 'cleared'
MOST_VALUES = 20_000_000  # states by sweeps, up to which plans are made again for their sweeps
ALL_ROWS, STEP = 30, 1.1  # sweeps that are all in the table; from there on each so many times on
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


def learning_curves(points: Sequence[CurvePoint], name: str, option: str) -> list[str]:
    """
    Return one SVG for each criterion, and one of the accuracies where any could be measured.

    :param points: in order of demonstrations; of several with equally many trajectories (between
        them came "not here" answers) the last is drawn.
    """
    drawn = {p.block.n_demonstrations: p for p in points if p.block.n_demonstrations}
    if not drawn:
        return []
    figures = [_criterion_curve(drawn, f'{name}-{panel[0]}', option, panel) for panel in PANELS]
    curves = {
        field: {n: getattr(point.block, field) for n, point in drawn.items()}
        for field, _, _ in ACCURACIES
    }
    if any(value is not None for curve in curves.values() for value in curve.values()):
        label = f'Accuracy of {option} by demonstrations'
        title, unit = 'Accuracy against the reference option', 'share of states'
        with _chart(f'{name}-accuracy', label, title=title, ylabel=unit) as work:
            for field, part, style in ACCURACIES:
                _curve(work, curves[field], label=part, **style)
            work.axes.set_ylim(top=1.03)
            work.axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
            _by_demonstrations(work, drawn)
        figures.append(work.svg)
    gains = {n: p.judgement.gain for n, p in drawn.items() if not math.isnan(p.judgement.gain.low)}
    return [*figures, _gain_curve(gains, f'{name}-gain', option, drawn)] if gains else figures


def _gain_curve(
    gains: Mapping[int, Interval], name: str, option: str, points: Mapping[int, CurvePoint]
) -> str:
    """Draw the return of the policy less that of the demonstrations, with its interval."""
    title, unit = 'Return of the policy less that shown', 'reward units'
    with _chart(name, f'{title}: {option}', title=title, ylabel=unit) as work:
        means = {n: gain.mean for n, gain in gains.items()}
        low, high = ([getattr(gain, end) for gain in gains.values()] for end in ('low', 'high'))
        limits = '95 % interval, same starts'
        work.axes.fill_between(
            list(gains), low, high, color=SERIES[0], alpha=0.2, lw=0, label=limits
        )
        _curve(work, means, label='mean', color=SERIES[0], marker='o', ms=3.5)
        work.axes.axhline(0, color=MUTED, lw=0.8)
        _by_demonstrations(work, points)
    return work.svg


def _criterion_curve(
    points: Mapping[int, CurvePoint], name: str, option: str, panel: tuple[str, str, str]
) -> str:
    criterion, title, unit = panel
    known = {n: c for n, p in points.items() for c in p.judgement.criteria if c.name == criterion}
    label = f'{title} of {option} by demonstrations'
    with _chart(name, label, title=title, ylabel=unit) as work:
        values = {n: c.value for n, c in known.items()}
        style: dict[str, Any] = {'color': SERIES[0], 'marker': 'o', 'ms': 3.5}
        measured = _curve(work, values, label='measured', **style)
        limits = {n: c.high for n, c in known.items() if c.high != c.value}
        dotted: dict[str, Any] = {'color': SERIES[0], 'ls': ':', 'lw': 1.1}
        drawn = measured + _curve(work, limits, label='upper limit', **dotted)
        _draw_threshold(work, list(known.values())[-1].threshold, drawn)
        if not measured:
            middle = work.axes.transAxes
            work.axes.text(0.5, 0.7, 'not yet measurable', transform=middle, ha='center')
        _by_demonstrations(work, points)
    return work.svg


def _curve(work: Drawing, curve: Mapping[int, float | None], **style: Any) -> list[float]:
    """
    Draw values by demonstrations, with so few markers that they do not overlap.

    :return: the values that are known.
    """
    known = {n: value for n, value in curve.items() if value is not None}
    if known:
        every = -(-len(known) // MOST_MARKERS)
        work.axes.plot(list(known), list(known.values()), markevery=every, **style)
    return list(known.values())


def _draw_threshold(work: Drawing, threshold: float, values: Sequence[float]) -> None:
    """Shade what meets the criterion."""
    axes, spread = work.axes, [threshold, 0.0, *values]
    margin = 0.08 * (max(spread) - min(spread) or 1.0)
    low, high = min(spread) - margin, max(spread) + 2 * margin
    axes.axhspan(low, threshold, color=SERIES[2], alpha=0.13, lw=0)
    axes.axhline(
        threshold, color=SERIES[2], ls='--', lw=1.4, label=f'met at or below {threshold:g}'
    )
    axes.set_ylim(low, high)


def _by_demonstrations(work: Drawing, points: Mapping[int, CurvePoint]) -> None:
    work.axes.set_xlabel('demonstrations')
    work.axes.set_xlim(0, max(points) + 0.6)
    work.axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    work.axes.legend(loc='best')


def planning_figures(rows: Mapping[str, PlanningRow], name: str) -> list[str]:
    """
    Return the planning time and, where it was measured, the return, by action set.

    :param rows: by the names of the plans.
    """
    returns = {called: row for called, row in rows.items() if row.mean_return is not None}
    figures = [_planning_times(rows, f'{name}-time')] if rows else []
    return [*figures, _mean_returns(returns, f'{name}-return')] if returns else figures


def _planning_times(rows: Mapping[str, PlanningRow], name: str) -> str:
    left = [0.0] * len(rows)
    longest = max(row.seconds for row in rows.values())
    scale, unit, word = (1.0, 's', 'seconds') if longest >= 1.0 else (1e3, 'ms', 'milliseconds')
    title, size = 'Planning time', (5.0, 1.3 + 0.6 * len(rows))
    with _chart(name, f'{title} by action set', size, 'x', title=title, xlabel=word) as work:
        for field, label, color in STAGES:
            values = [scale * getattr(row, field) for row in rows.values()]
            if any(values):
                work.axes.barh(
                    list(rows), values, 0.55, left=left, color=SERIES[color], label=label
                )
                left = [a + b for a, b in zip(left, values)]
        for index, total in enumerate(left):
            _value_label(work, (total, index), f'{total:.3g} {unit}', (5, 0), 'left')
        work.axes.set_xlim(0, 1.22 * max(left))
        work.axes.invert_yaxis()
        work.figure.legend(loc='outside lower center', ncols=3)
    return work.svg


def _mean_returns(returns: Mapping[str, PlanningRow], name: str) -> str:
    title, size = 'Mean return of an episode, with 95 % interval', (5.0, 1.3 + 0.6 * len(returns))
    label, unit = 'Mean return by action set', 'reward units'
    with _chart(name, label, size, 'x', title=title, xlabel=unit) as work:
        for series, (kind, shift) in enumerate((('undiscounted', 10), ('discounted', -10))):
            style = {**_series(series), 'ms': 8, 'ls': ''}
            work.axes.plot([], [], label=kind, **style)
            for index, row in enumerate(returns.values()):
                value = (row.mean_return, row.mean_discounted_return)[series]
                if value is None:
                    continue
                work.axes.plot(value, index, **style)
                _value_label(work, (value, index), number(value), (0, shift), 'center')
        for index, row in enumerate(returns.values()):
            if row.mean_return_low is not None and row.mean_return_high is not None:
                ends = row.mean_return_low, row.mean_return_high
                work.axes.hlines(index, *ends, color=SERIES[0], lw=2.0, alpha=0.5)
        work.axes.axvline(0, color=MUTED, lw=0.8)
        work.axes.set_yticks(range(len(returns)), list(returns))
        work.axes.set_ylim(len(returns) - 0.4, -0.6)
        work.axes.xaxis.set_major_locator(MaxNLocator(6))
        work.axes.margins(x=0.15)
        work.figure.legend(loc='outside lower center', ncols=2)
    return work.svg


def _value_label(
    work: Drawing, at: tuple[Any, float], text: str, shift: tuple[float, float], side: Any
) -> None:
    """Write a value beside its mark; ``shift`` in points."""
    work.axes.annotate(text, at, shift, textcoords='offset points', ha=side, va='center', size=9)


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
    settings = games.settings
    figures = [_intervals(settings, f'{name}-score', 'Mean score', 'points', lambda r: r.score)]
    if all(CLEARED in row.outcomes for setting in settings for row in setting.rows):
        title, unit = 'Mazes cleared', 'share of games'
        figures.append(
            _intervals(settings, f'{name}-cleared', title, unit, lambda r: r.outcomes[CLEARED])
        )
    return [*figures, _score_curves(games, f'{name}-curve')]


def _intervals(
    settings: Sequence[Setting],
    name: str,
    title: str,
    unit: str,
    value: Callable[[ComparisonRow], Interval],
) -> str:
    rows = settings[0].rows
    size = WIDTH, 1.2 + ROW_HEIGHT * len(rows)
    label = f'{title} by what plays, with 95 % intervals'
    with _chart(name, label, size, 'x', title=title, xlabel=f'{unit}, with 95 % interval') as work:
        axes = work.axes
        for index, setting in enumerate(settings):
            found = [value(row) for row in setting.rows]
            shift = 0.2 * (index - (len(settings) - 1) / 2)
            heights = [row + shift for row in range(len(found))]
            style = _series(index)
            low, high = [each.low for each in found], [each.high for each in found]
            axes.hlines(heights, low, high, color=style['color'], lw=2.0)
            means = [each.mean for each in found]
            axes.plot(means, heights, ls='', ms=4.5, label=setting.name or None, **style)
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
    with _chart(
        name, f'Mean score by planning seconds{where}', (WIDTH, 4.4), 'both', **names
    ) as work:
        axes = work.axes
        for index, curve in enumerate(games.curves):
            seconds, scores = [r.seconds for r in curve.rows], [r.score for r in curve.rows]
            style = _series(index)
            low, high = [score.low for score in scores], [score.high for score in scores]
            axes.fill_between(seconds, low, high, color=style['color'], alpha=0.2, lw=0)
            times = [f'{target:,.0f} {reached(curve, target)}' for target in games.targets]
            label = ': '.join([curve.name, ', '.join(times)] if times else [curve.name])
            axes.plot(seconds, [score.mean for score in scores], ms=4.5, label=label, **style)
        for target in games.targets:
            axes.axhline(target, color=MUTED, ls='--', lw=1.0)
            axes.annotate(
                f'{target:,.0f}',
                (1.0, target),
                xycoords=('axes fraction', 'data'),
                xytext=(3, 0),
                textcoords='offset points',
                va='center',
                size=8.5,
                color=MUTED,
            )
        axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        work.figure.legend(loc='outside lower left', ncols=1)
    return work.svg
