"""Learning curves of one option, with the criteria drawn in."""

from collections.abc import Sequence
from typing import Any

from humanopts_teach.evaluation.bag_evaluation import CurvePoint
from humanopts_teach.report.figures import Drawing, drawing, SERIES
from matplotlib.ticker import MaxNLocator, PercentFormatter

SIZE = (5.0, 2.9)
MOST_MARKERS = 30  # on a curve
PANELS = (  # criterion, title, unit
    ('return', 'Held-out return shortfall', 'reward units'),
    ('initiation', 'Held-out error of I (may it start?)', 'balanced error'),
    ('termination', 'Held-out error of β (does it end?)', 'balanced error'),
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
    figures = [_criterion(drawn, f'{name}-{panel[0]}', option, panel) for panel in PANELS]
    if any(getattr(p, field) is not None for p in drawn for field, _, _ in ACCURACIES):
        figures.append(_accuracies(drawn, f'{name}-accuracy', option))
    return figures


def _criterion(
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
            _threshold(work, known[-1][1].threshold, [value for _, value in measured])
        if not measured:
            axes.text(0.5, 0.7, 'not yet measurable', transform=axes.transAxes, ha='center')
        axes.set(title=title, ylabel=unit)
        _by_demonstrations(work, points)
    return work.svg


def _threshold(work: Drawing, threshold: float, values: Sequence[float]) -> None:
    """Shade what meets the criterion."""
    axes, spread = work.axes, [threshold, 0.0, *values]
    margin = 0.08 * (max(spread) - min(spread) or 1.0)
    low, high = min(spread) - margin, max(spread) + 2 * margin
    axes.axhspan(low, threshold, color=SERIES[2], alpha=0.13, lw=0)
    axes.axhline(
        threshold, color=SERIES[2], ls='--', lw=1.4, label=f'met at or below {threshold:g}'
    )
    axes.set_ylim(low, high)


def _accuracies(points: Sequence[CurvePoint], name: str, option: str) -> str:
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
    axes.tick_params(length=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc='best')


def _every(curve: Sequence[tuple[int, Any]]) -> int:
    """Return every how many points a marker is drawn, so that they do not overlap."""
    return -(-len(curve) // MOST_MARKERS)
