"""The charts of a report: learning curves, planning and its sweeps, and games."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from humanopts_learner.planning.evaluate import Interval
from humanopts_learner.planning.value_iteration import SweepRow
from humanopts_teach.evaluation.bag_evaluation import CurvePoint
from humanopts_teach.evaluation.comparison import ComparisonRow
from humanopts_teach.evaluation.games import Curve, GamesEvaluation, Setting
from humanopts_teach.evaluation.summary import PlanningRow
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.words import number, reached
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullLocator,
    PercentFormatter,
    StrMethodFormatter,
)

SIZE = (5.0, 2.9)  # inches
MOST_MARKERS = 30  # on a curve
PANELS = (  # criterion, title, unit
    ('return', 'Return: held-out shortfall', 'reward units'),
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


def learning_curves(points: Sequence[CurvePoint], name: str, option: str) -> list[str]:
    """
    Return one SVG for each criterion, and one of the accuracies where any could be measured.

    :param points: in order of demonstrations; of several with equally many trajectories (between
        them came "not here" answers) the last is drawn.
    :param name: prefix of the identifiers.
    """
    drawn = list({p.n_demonstrations: p for p in points if p.n_demonstrations}.values())
    if not drawn:
        return []
    figures = [_criterion_curve(drawn, f'{name}-{panel[0]}', option, panel) for panel in PANELS]
    if any(getattr(p, field) is not None for p in drawn for field, _, _ in ACCURACIES):
        figures.append(_accuracy_curves(drawn, f'{name}-accuracy', option))
    return figures


def _criterion_curve(
    points: Sequence[CurvePoint], name: str, option: str, panel: tuple[str, str, str]
) -> str:
    criterion, title, unit = panel
    known = [(p.n_demonstrations, c) for p in points for c in p.criteria if c.name == criterion]
    measured = [(n, c.value) for n, c in known if c.value is not None]
    with drawing(name, f'{title} of {option} by demonstrations', *SIZE) as work:
        axes = work.axes
        if measured:
            style: dict[str, Any] = {
                'color': SERIES[0],
                'marker': 'o',
                'ms': 3.5,
                'label': 'held out',
            }
            axes.plot(*zip(*measured), markevery=_every(measured), **style)
        if known:
            _draw_threshold(work, known[-1][1].threshold, [value for _, value in measured])
        if not measured:
            axes.text(0.5, 0.7, 'not yet measurable', transform=axes.transAxes, ha='center')
        axes.set(title=title, ylabel=unit)
        _by_demonstrations(work, points)
    return work.svg


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


def _accuracy_curves(points: Sequence[CurvePoint], name: str, option: str) -> str:
    with drawing(name, f'Accuracy of {option} by demonstrations', *SIZE) as work:
        axes = work.axes
        for field, label, style in ACCURACIES:
            curve = [(p.n_demonstrations, getattr(p, field)) for p in points]
            curve = [(n, value) for n, value in curve if value is not None]
            if curve:
                axes.plot(*zip(*curve), label=label, markevery=_every(curve), **style)
        axes.set(title='Accuracy against the reference option', ylabel='share of states')
        axes.set_ylim(top=1.03)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        _by_demonstrations(work, points)
    return work.svg


def _by_demonstrations(work: Drawing, points: Sequence[CurvePoint]) -> None:
    axes = work.axes
    axes.set_xlabel('demonstrations')
    axes.set_xlim(0, max(p.n_demonstrations for p in points) + 0.6)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    axes.grid(axis='y')
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc='best')


def _every(curve: Sequence[tuple[int, Any]]) -> int:
    """Return every how many points a marker is drawn, so that they do not overlap."""
    return -(-len(curve) // MOST_MARKERS)


def planning_figures(rows: Mapping[str, PlanningRow], name: str) -> list[CaptionedFigure]:
    """
    Return the planning time and, where it was measured, the return, by action set.

    :param rows: by what each is called.
    """
    figures = [CaptionedFigure(_planning_times(rows, f'{name}-time'))] if rows else []
    if any(row.mean_return is not None for row in rows.values()):
        figures.append(CaptionedFigure(_mean_returns(rows, f'{name}-return')))
    return figures


def _planning_times(rows: Mapping[str, PlanningRow], name: str) -> str:
    with drawing(name, 'Planning time by action set', 5.0, 1.3 + 0.6 * len(rows)) as work:
        axes = work.axes
        left = [0.0] * len(rows)
        scale, unit, word = _time_unit(rows)
        for field, label, color in STAGES:
            values = [scale * getattr(row, field) for row in rows.values()]
            if not any(values):
                continue
            axes.barh(list(rows), values, 0.55, left=left, color=SERIES[color], label=label)
            left = [a + b for a, b in zip(left, values)]
        for place, total in enumerate(left):
            _value_label(work, (total, place), f'{total:.3g} {unit}', (5, 0), 'left')
        axes.set(title='Planning time', xlabel=word)
        axes.set_xlim(0, 1.22 * max(left))
        axes.invert_yaxis()
        axes.grid(axis='x')
        work.figure.legend(loc='outside lower center', ncols=3)
    return work.svg


def _time_unit(rows: Mapping[str, PlanningRow]) -> tuple[float, str, str]:
    """Return units in a second, and what the unit is called: short, and in full."""
    longest = max(row.seconds for row in rows.values())
    return (1.0, 's', 'seconds') if longest >= 1.0 else (1e3, 'ms', 'milliseconds')


def _mean_returns(rows: Mapping[str, PlanningRow], name: str) -> str:
    with drawing(name, 'Mean return by action set', 5.0, 1.3 + 0.6 * len(rows)) as work:
        axes = work.axes
        known = {name: row for name, row in rows.items() if row.mean_return is not None}
        for place, row in enumerate(known.values()):
            values = (row.mean_return, row.mean_discounted_return)
            for value, marker, color, shift in zip(values, 'os', (0, 1), (10, -10)):
                if value is not None:
                    axes.plot(value, place, marker=marker, ms=8, color=SERIES[color], ls='')
                    _value_label(work, (value, place), number(value), (0, shift), 'center')
        axes.axvline(0, color=MUTED, lw=0.8)
        axes.set_yticks(range(len(known)), list(known))
        axes.set(title='Mean return of an episode', xlabel='reward units')
        axes.set_ylim(len(known) - 0.4, -0.6)
        axes.xaxis.set_major_locator(MaxNLocator(6))
        axes.margins(x=0.15)
        axes.grid(axis='x')
        axes.plot([], [], 'o', color=SERIES[0], label='undiscounted')
        axes.plot([], [], 's', color=SERIES[1], label='discounted')
        work.figure.legend(loc='outside lower center', ncols=2)
    return work.svg


def _value_label(
    work: Drawing, at: tuple[float, float], text: str, shift: tuple[float, float], side: str
) -> None:
    """Write a value beside its mark; ``shift`` in points."""
    place: dict[str, Any] = {
        'xytext': shift,
        'textcoords': 'offset points',
        'ha': side,
        'va': 'center',
    }
    work.axes.annotate(text, at, size=9, **place)


def sweep_figure(tables: Mapping[str, Sequence[SweepRow]], name: str) -> str:
    """
    Return the residual of each sweep.

    :param tables: the sweeps of each plan, by what it is called.
    """
    with drawing(name, 'Residual by sweep', *SIZE) as work:
        axes = work.axes
        for place, (called, rows) in enumerate(tables.items()):
            changed = [row for row in rows[1:] if row.residual > 0]  # the last may change nothing
            axes.plot(
                [row.sweep for row in changed],
                [row.residual for row in changed],
                color=SERIES[place % len(SERIES)],
                marker=MARKERS[place % len(MARKERS)],
                ms=3,
                label=f'{called}: {len(rows) - 1} sweeps',
            )
        axes.set_yscale('log')
        low, high = axes.get_ylim()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set(title='Residual of each sweep', xlabel='sweep', ylabel='reward units')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis='y')
        axes.legend(loc='best')
    return work.svg


def games_figures(games: GamesEvaluation, name: str) -> list[CaptionedFigure]:
    """
    Return the scores, the share of mazes cleared where there are mazes, and the curves.

    :param name: prefix of the identifiers.
    """
    figures = [
        _intervals(games.settings, f'{name}-score', 'Mean score', 'points', lambda row: row.score)
    ]
    if all(CLEARED in row.outcomes for setting in games.settings for row in setting.rows):
        title, unit = 'Mazes cleared', 'share of games'
        figures.append(
            _intervals(
                games.settings, f'{name}-cleared', title, unit, lambda row: row.outcomes[CLEARED]
            )
        )
    return [*map(CaptionedFigure, figures), CaptionedFigure(_score_curves(games, f'{name}-curve'))]


def _intervals(
    settings: Sequence[Setting],
    name: str,
    title: str,
    unit: str,
    value: Callable[[ComparisonRow], Interval],
) -> str:
    names = [row.name for row in settings[0].rows]
    height = 1.2 + ROW_HEIGHT * len(names)
    with drawing(name, f'{title} by what plays, with 95 % intervals', WIDTH, height) as work:
        axes = work.axes
        for place, setting in enumerate(settings):
            shift = 0.2 * (place - (len(settings) - 1) / 2)
            for row, found in enumerate(map(value, setting.rows)):
                _dot(work, found, row + shift, place, setting.name if not row else '')
        for row, (one, other) in enumerate(zip(settings[0].rows, settings[0].rows[1:])):
            if one.kind != other.kind:
                axes.axhline(row + 0.5, color=MUTED, lw=0.6, alpha=0.5)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set(title=title, xlabel=f'{unit}, with 95 % interval')
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        if unit.startswith('share'):
            axes.set_xlim(-0.02, 1.02)
            axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.grid(axis='x')
        if settings[0].name:
            work.figure.legend(loc='outside lower center', ncols=len(settings))
    return work.svg


def _dot(work: Drawing, found: Interval, height: float, place: int, label: str) -> None:
    color = SERIES[place % len(SERIES)]
    work.axes.plot([found.low, found.high], [height, height], color=color, lw=2.0)
    work.axes.plot(
        found.mean,
        height,
        color=color,
        marker=MARKERS[place % len(MARKERS)],
        ms=4.5,
        ls='',
        label=label or None,
    )


def _score_curves(games: GamesEvaluation, name: str) -> str:
    where = f', {games.curve_setting}' if games.curve_setting else ''
    with drawing(name, f'Mean score by planning seconds{where}', WIDTH, 4.4) as work:
        axes = work.axes
        for place, curve in enumerate(games.curves):
            seconds = [row.seconds for row in curve.rows]
            color, marker = SERIES[place % len(SERIES)], MARKERS[place % len(MARKERS)]
            low, high = (
                [getattr(r.score, bound) for r in curve.rows] for bound in ('low', 'high')
            )
            axes.fill_between(seconds, low, high, color=color, alpha=0.2, lw=0)
            means = [row.score.mean for row in curve.rows]
            label = _curve_label(curve, games.targets)
            axes.plot(seconds, means, color=color, marker=marker, ms=4.5, label=label)
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
        axes.set_xscale('log')
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f'{x:g}'))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set(
            title=f'Score against planning time{where}',
            xlabel='planning seconds of the processor (models counted)',
            ylabel='mean score, with 95 % interval',
        )
        axes.grid()
        work.figure.legend(loc='outside lower left', ncols=1)
    return work.svg


def _curve_label(curve: Curve, targets: Sequence[float]) -> str:
    times = [f'{target:,.0f} {reached(curve, target)}' for target in targets]
    return ': '.join([curve.name, ', '.join(times)]) if times else curve.name
