"""Tables of the measurements, and the figure of planning."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from benchmarks.measure import Row

_LEAST = 14  # characters of a column of text
_UNITS = ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs'), (1e-9, 'ns'))
SUFFIXES = ('.svg', '.png')
MARKERS = 'osD^vP'


def duration(seconds: float) -> str:
    """Return seconds in a unit that suits them."""
    if seconds == 0.0:
        return '0'
    scale, unit = next((u for u in _UNITS if seconds >= u[0]), _UNITS[-1])
    return f'{_digits(seconds / scale)} {unit}'


def ratio(value: float) -> str:
    """Return a ratio of times for reading, below 1 as 1/N."""
    if value >= 1.0:
        return _digits(value)
    part = _digits(1.0 / value)
    return part if part == '1' else f'1/{part}'


def ratio_interval(found: Mapping[str, float | None]) -> str:
    """Return a ratio with the limits of its interval; of one turn, the ratio alone."""
    mean, low, high = (found[name] for name in ('mean', 'low', 'high'))
    if mean is None or low is None or high is None:
        return '' if mean is None else ratio(mean)
    return f'{ratio(mean)} ({ratio(low)} to {ratio(high)})'


def _rate(value: float) -> str:
    return f'{float(f"{value:.3g}"):,.0f}' if value >= 10 else f'{value:.1f}'


def _whole(value: int) -> str:
    return f'{value:,}'


def _megabytes(size: float) -> str:
    return f'{size / 1e6:.1f} MB'


def _digits(value: float) -> str:
    """Return three digits, and no exponent."""
    return f'{value:,.0f}' if value >= 100 else f'{value:.3g}'


@dataclass(frozen=True)
class _Column:
    """One column of a table."""

    title: str
    key: str  # of a row
    text: Callable[[Any], str] | None = None  # None: it is text; else a number, to the right


_RATIOS = (
    _Column('ratio on the wall', 'wall_ratio', ratio_interval),
    _Column('ratio of processor', 'processor_ratio', ratio_interval),
)
_COMPARISON = (
    _Column('what', 'what'),
    _Column('median', 'seconds', duration),
    _Column('processor', 'processor_seconds', duration),
    _Column('99 %', 'slow_seconds', duration),
    _Column('a second', 'per_second', _rate),
    _Column('wanted', 'target', _rate),
    _Column('yardstick', 'yardstick'),
    _Column('median', 'yardstick_seconds', duration),
    _Column('processor', 'yardstick_processor_seconds', duration),
    _Column('99 %', 'yardstick_slow_seconds', duration),
    *_RATIOS,
)
_COLUMNS = {
    'planning': (
        _Column('states', 'n_states', _whole),
        _Column('solver', 'solver'),
        _Column('is given', 'obtained'),
        _Column('cost', 'obtained_seconds', duration),
        _Column('tables', 'table_seconds', duration),
        _Column('models', 'model_seconds', duration),
        _Column('sweeping', 'sweep_seconds', duration),
        _Column('all', 'seconds', duration),
        _Column('processor', 'processor_seconds', duration),
        _Column('sweeps', 'sweeps', str),
        _Column('error', 'error', lambda error: f'{error:.0e}' if error else '0'),
        _Column('compiling', 'compile_seconds', duration),
        _Column('bytes a state', 'bytes_a_state', lambda size: f'{size:,.0f}'),
        *_RATIOS,
    ),
    'learning': _COMPARISON,
    'games': _COMPARISON,
    'graph': _COMPARISON,
    'recording': (
        _Column('messages', 'load'),
        _Column('reader', 'what'),
        _Column('sent', 'sent', _whole),
        _Column('lost', 'lost', _whole),
        _Column('a second', 'per_second', _rate),
        _Column('throughput', 'throughput', lambda share: f'{share:.2f}'),
        _Column('processor', 'processor', lambda share: f'{share:.0%}'),
        _Column('memory', 'memory', _megabytes),
        _Column('grown', 'grown', _megabytes),
        _Column('waited', 'waited', duration),
        *_RATIOS,
    ),
}
_TITLES = {
    'planning': 'Planning on Taxi, beside primitive value iteration',
    'learning': 'Learning "go to passenger and pickup" (Taxi) again after a demonstration',
    'games': 'Game steps, many games at once',
    'graph': 'The ROS graph, on processes of its own',
    'recording': 'Messages recorded, beside readers that write nothing',
}
_PARTS = {'planning': 'n_states', 'recording': 'load'}  # a line is drawn where these change


def section_table(name: str, rows: Sequence[Row]) -> Table:
    """Return the table of a section; columns without any value are left out."""
    columns = [
        column for column in _COLUMNS[name] if any(row.get(column.key) is not None for row in rows)
    ]
    table = Table(title=_TITLES[name], title_justify='left', box=SIMPLE, pad_edge=False)
    for column in columns:
        if column.text is None:
            table.add_column(column.title, min_width=_LEAST)
        else:
            table.add_column(column.title, justify='right', no_wrap=True)
    parts = [row.get(_PARTS.get(name, '')) for row in rows]
    for row, part, following in zip(rows, parts, [*parts[1:], None]):
        cells = [(column.text or str, row.get(column.key)) for column in columns]
        texts = ['' if value is None else text(value) for text, value in cells]
        table.add_row(*texts, end_section=part != following)
    return table


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return in words what rows say beside their numbers, such as losses."""
    return [
        f'{row["load"]}: {row["what"]} {row["remark"]}.' for row in rows if row.get('remark', '')
    ]


def write_figure(path: Path, rows: Sequence[Row]) -> None:
    """
    Draw the figure.

    :param path: ends in one of ``SUFFIXES``.
    :raises OSError: it cannot be written.
    """
    from humanopts_teach.report.figures import file_settings
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    solved = [row for row in rows if row.get('sweeps') is not None]  # not single sweeps
    with matplotlib.rc_context({**file_settings('bench'), 'svg.fonttype': 'none'}):
        figure = Figure(figsize=(6.5, 5.0), layout='constrained')
        axes = figure.add_subplot()
        for number, solver in enumerate(dict.fromkeys(row['solver'] for row in solved)):
            own = [(row['n_states'], row['seconds']) for row in solved if row['solver'] == solver]
            axes.loglog(*zip(*own), marker=MARKERS[number], label=solver)
        axes.set(
            title='Planning time on Taxi grids', xlabel='states', ylabel='seconds, median of runs'
        )
        sizes = sorted({row['n_states'] for row in solved})
        axes.xaxis.set_major_locator(FixedLocator(sizes))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda size, _: f'{size:,.0f}'))
        axes.grid(which='major')
        figure.legend(loc='outside lower center', ncols=2)
        figure.savefig(path, dpi=150, metadata={'Date': None} if path.suffix == '.svg' else {})
