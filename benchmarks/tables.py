"""What was measured, as tables for people."""

from collections.abc import Callable, Sequence

from rich.box import SIMPLE
from rich.table import Table

from benchmarks.measured import Comparison
from benchmarks.recording import RecordingRow
from benchmarks.results import Planned, Rows

TITLES = {
    'planning': 'Planning on Taxi, beside primitive value iteration',
    'learning': 'Learning "go to passenger and pickup" (Taxi) again after a demonstration',
    'games': 'Game steps, many games at once',
    'graph': 'The ROS graph, on processes of its own',
    'recording': 'Messages recorded, beside readers that write nothing',
}
_TEXTS = ('what', 'yardstick', 'solver', 'is given', 'messages', 'reader')
_PARTS = ('obtained_', 'table_', 'model_', 'sweep_', '')
_LEAST = 14  # characters of a column of text
_UNITS = ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs'), (1e-9, 'ns'))


def section_table(name: str, rows: Rows) -> Table:
    """Return the table of a section; ratios are of times, below 1 as 1/N."""
    planned = [row for row in rows if isinstance(row, Planned)]
    if planned:
        return _planning_table(TITLES[name], planned)
    recorded = [row for row in rows if isinstance(row, RecordingRow)]
    if recorded:
        return _recording_table(TITLES[name], recorded)
    return _comparison_table(TITLES[name], [row for row in rows if isinstance(row, Comparison)])


def _planning_table(title: str, rows: Sequence[Planned]) -> Table:
    numbers = ('cost', 'tables', 'models', 'sweeping', 'all', 'sweeps', 'error', 'ratio')
    table = _table(title, 'states', 'solver', 'is given', *numbers)
    sides = [planned.row.side for planned in rows]
    for planned, following in zip(rows, [*sides[1:], 0]):
        row = planned.row
        table.add_row(
            f'{row.n_states:,}',
            row.solver,
            row.obtained,
            *(duration(getattr(row, f'{part}seconds')) for part in _PARTS),
            str(row.sweeps),
            f'{row.error:.0e}' if row.error else '0',
            ratio(planned.ratio),
            end_section=row.side != following,
        )
    return table


def _comparison_table(title: str, rows: Sequence[Comparison]) -> Table:
    """Leave out columns that no row has anything for."""
    slow = any(row.slow_seconds is not None for row in rows)
    wanted = any(row.target is not None for row in rows)
    columns: list[tuple[str, bool, Callable[[Comparison], str]]] = [
        ('what', True, lambda row: row.what),
        ('median', True, lambda row: duration(row.seconds)),
        ('99 %', slow, lambda row: duration(row.slow_seconds)),
        ('a second', True, lambda row: _rate(row.per_second)),
        ('wanted', wanted, lambda row: _rate(row.target)),
        ('yardstick', True, lambda row: row.yardstick),
        ('median', True, lambda row: duration(row.yardstick_seconds)),
        ('99 %', slow, lambda row: duration(row.yardstick_slow_seconds)),
        ('ratio', True, lambda row: ratio(row.ratio)),
    ]
    shown = [column for column in columns if column[1]]
    table = _table(title, *(name for name, _, _ in shown))
    for row in rows:
        table.add_row(*(text(row) for _, _, text in shown))
    return table


def _recording_table(title: str, rows: Sequence[RecordingRow]) -> Table:
    numbers = ('sent', 'lost', 'a second', 'throughput', 'processor', 'memory', 'grown', 'waited')
    table = _table(title, 'messages', 'reader', *numbers)
    loads = [row.load for row in rows]
    for row, following in zip(rows, [*loads[1:], '']):
        table.add_row(
            row.load,
            row.what,
            f'{row.sent:,}',
            f'{row.lost:,}',
            _rate(row.per_second),
            f'{row.throughput:.2f}',
            f'{row.processor:.0%}',
            _megabytes(row.memory),
            _megabytes(row.grown),
            duration(row.waited),
            end_section=row.load != following,
        )
    return table


def _table(title: str, *columns: str) -> Table:
    """Begin a table; numbers are to the right, and never broken."""
    table = Table(title=title, title_justify='left', box=SIMPLE, pad_edge=False)
    for name in columns:
        if name in _TEXTS:
            table.add_column(name, min_width=_LEAST)
        else:
            table.add_column(name, justify='right', no_wrap=True)
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
    """Return a ratio for reading, below 1 as 1/N."""
    if value >= 1.0:
        return _digits(value)
    part = _digits(1.0 / value)
    return part if part == '1' else f'1/{part}'


def _rate(value: float | None) -> str:
    if value is None:
        return ''
    return f'{float(f"{value:.3g}"):,.0f}' if value >= 10 else f'{value:.1f}'


def _megabytes(size: float) -> str:
    return f'{size / 1e6:.1f} MB'


def _digits(value: float) -> str:
    """Return three digits, and no exponent."""
    return f'{value:,.0f}' if value >= 100 else f'{value:.3g}'
