"""What planning cost and what it brought, by action set."""

from collections.abc import Mapping
from typing import Any

from humanopts_teach.evaluation.summary import PlanningRow
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.words import number
from matplotlib.ticker import MaxNLocator

STAGES = (
    ('table_seconds', 'policy tables', 0),
    ('model_seconds', 'models', 1),
    ('sweep_seconds', 'sweeps', 3),
)


def planning_figures(rows: Mapping[str, PlanningRow], name: str) -> list[CaptionedFigure]:
    """
    Return the planning time and, where it was measured, the return, by action set.

    :param rows: by what each is called.
    """
    figures = [CaptionedFigure(_times(rows, f'{name}-time'))] if rows else []
    if any(row.mean_return is not None for row in rows.values()):
        figures.append(CaptionedFigure(_returns(rows, f'{name}-return')))
    return figures


def _times(rows: Mapping[str, PlanningRow], name: str) -> str:
    with drawing(name, 'Planning time by action set', 5.0, 1.3 + 0.6 * len(rows)) as work:
        axes = work.axes
        left = [0.0] * len(rows)
        scale, unit, word = _unit(rows)
        for field, label, color in STAGES:
            values = [scale * getattr(row, field) for row in rows.values()]
            if not any(values):
                continue
            axes.barh(list(rows), values, 0.55, left=left, color=SERIES[color], label=label)
            left = [a + b for a, b in zip(left, values)]
        for place, total in enumerate(left):
            _label(work, (total, place), f'{total:.3g} {unit}', (5, 0), 'left')
        axes.set(title='Planning time', xlabel=word)
        axes.set_xlim(0, 1.22 * max(left))
        axes.invert_yaxis()
        axes.grid(axis='x')
        axes.tick_params(length=0)
        work.figure.legend(loc='outside lower center', ncols=3)
    return work.svg


def _unit(rows: Mapping[str, PlanningRow]) -> tuple[float, str, str]:
    """Return units in a second, and what the unit is called: short, and in full."""
    longest = max(row.seconds for row in rows.values())
    return (1.0, 's', 'seconds') if longest >= 1.0 else (1e3, 'ms', 'milliseconds')


def _returns(rows: Mapping[str, PlanningRow], name: str) -> str:
    with drawing(name, 'Mean return by action set', 5.0, 1.3 + 0.6 * len(rows)) as work:
        axes = work.axes
        known = {name: row for name, row in rows.items() if row.mean_return is not None}
        for place, row in enumerate(known.values()):
            values = (row.mean_return, row.mean_discounted_return)
            for value, marker, color, shift in zip(values, 'os', (0, 1), (10, -10)):
                if value is not None:
                    axes.plot(value, place, marker=marker, ms=8, color=SERIES[color], ls='')
                    _label(work, (value, place), number(value), (0, shift), 'center')
        axes.axvline(0, color=MUTED, lw=0.8)
        axes.set_yticks(range(len(known)), list(known))
        axes.set(title='Mean return of an episode', xlabel='reward units')
        axes.set_ylim(len(known) - 0.4, -0.6)
        axes.xaxis.set_major_locator(MaxNLocator(6))
        axes.margins(x=0.15)
        axes.grid(axis='x')
        axes.tick_params(length=0)
        axes.plot([], [], 'o', color=SERIES[0], label='undiscounted')
        axes.plot([], [], 's', color=SERIES[1], label='discounted')
        work.figure.legend(loc='outside lower center', ncols=2)
    return work.svg


def _label(
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
