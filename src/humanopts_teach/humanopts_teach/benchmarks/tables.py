"""What was measured, as tables for people."""

from collections.abc import Sequence

from humanopts_learner.benchmarks.measured import Comparison
from humanopts_teach.benchmarks.results import Planned, Rows, YARDSTICK
from rich.table import Table

TITLES = {
    'planning': 'Planning on Taxi, beside primitive value iteration',
    'learning': 'Learning "go to passenger and pickup" (Taxi) again after a demonstration',
    'games': 'Game steps, many games at once',
    'graph': 'The ROS graph, on processes of its own',
}
_UNITS = ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs'), (1e-9, 'ns'))


def section_table(name: str, rows: Rows) -> Table:
    """Return the table of a section."""
    planned = [row for row in rows if isinstance(row, Planned)]
    if planned:
        return _planning_table(TITLES[name], planned)
    return _comparison_table(TITLES[name], [row for row in rows if isinstance(row, Comparison)])


def _planning_table(title: str, rows: Sequence[Planned]) -> Table:
    table = _table(title, 'grid', 'solver', 'is given', right=_PLANNING)
    for planned in rows:
        row = planned.row
        first = row.solver == rows[0].row.solver
        table.add_row(
            f'{row.side} x {row.side}, {row.n_states:,} states' if first else '',
            row.solver,
            row.obtained,
            *map(duration, (row.table_seconds, row.model_seconds, row.sweep_seconds, row.seconds)),
            str(row.sweeps),
            f'{row.error:.1g}',
            '' if row.solver == YARDSTICK else ratio(planned.ratio),
            end_section=planned is rows[-1] or rows[rows.index(planned) + 1].row.side != row.side,
        )
    return table


_PLANNING = ('tables', 'models', 'sweeps', 'all', 'sweeps made', 'true error', 'ratio')


def _comparison_table(title: str, rows: Sequence[Comparison]) -> Table:
    table = _table(
        title,
        'what',
        right=('median', '99 % within', 'a second', 'wanted'),
        then=('yardstick',),
        last=('median', '99 % within', 'ratio'),
    )
    for row in rows:
        table.add_row(
            _with_facts(row),
            duration(row.seconds),
            duration(row.slow_seconds),
            _rate(row.per_second),
            '' if row.target is None else _rate(row.target),
            row.yardstick,
            duration(row.yardstick_seconds),
            duration(row.yardstick_slow_seconds),
            ratio(row.ratio),
        )
    return table


def _with_facts(row: Comparison) -> str:
    """Return what was measured; for the recorder, with what it lost."""
    if 'lost' not in row.facts:
        return row.what
    return f'{row.what} ({row.facts["recorded"]:,} recorded, {row.facts["lost"]} lost)'


def _table(
    title: str,
    *left: str,
    right: Sequence[str],
    then: Sequence[str] = (),
    last: Sequence[str] = (),
) -> Table:
    """Begin a table; columns of numbers, ``right`` and ``last``, are never broken."""
    table = Table(title=title, title_justify='left', box=None, pad_edge=False)
    for names, numbers in ((left, False), (right, True), (then, False), (last, True)):
        for name in names:
            table.add_column(name, justify='right' if numbers else 'left', no_wrap=numbers)
    return table


def duration(seconds: float | None) -> str:
    """Return seconds in a unit that suits them; '' for None."""
    if seconds is None:
        return ''
    if seconds == 0.0:
        return '0'
    scale, unit = next((u for u in _UNITS if seconds >= u[0]), _UNITS[-1])
    return f'{_digits(seconds / scale)} {unit}'


def ratio(value: float) -> str:
    """Return a ratio of times in words."""
    if value >= 1.0:
        return f'{_digits(value)} x as long'
    return f'{_digits(1.0 / value)} x faster'


def _rate(value: float) -> str:
    return f'{float(f"{value:.3g}"):,.0f}' if value >= 10 else f'{value:.1f}'


def _digits(value: float) -> str:
    """Return three digits, and no exponent."""
    return f'{value:,.0f}' if value >= 100 else f'{value:.3g}'
