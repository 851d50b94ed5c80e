"""Tables of the measurements, and the figure of planning."""

from collections.abc import Callable, Mapping, Sequence
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


def _megabytes(size: float) -> str:
    return f'{size / 1e6:.1f} MB'


def _digits(value: float) -> str:
    """Return three digits or more, without an exponent below a million."""
    return f'{value:,.0f}' if 100 <= value < 1e6 else f'{value:.3g}'


# Columns: title, key of a row, and what makes text of a number, or its format; '': it is text.
_Column = tuple[str, str, Callable[[Any], str] | str]
_RATIOS: list[_Column] = [
    ('ratio on the wall', 'wall_ratio', ratio_interval),
    ('ratio of processor', 'processor_ratio', ratio_interval),
]
_COMPARISON: list[_Column] = [
    ('what', 'what', ''),
    ('median', 'seconds', duration),
    ('processor', 'processor_seconds', duration),
    ('99 %', 'slow_seconds', duration),
    ('a second', 'per_second', _rate),
    ('wanted', 'target', _rate),
    ('yardstick', 'yardstick', ''),
    ('median', 'yardstick_seconds', duration),
    ('processor', 'yardstick_processor_seconds', duration),
    ('99 %', 'yardstick_slow_seconds', duration),
]
_COLUMNS: dict[str, list[_Column]] = {
    'planning': [
        ('states', 'n_states', ','),
        ('solver', 'solver', ''),
        ('is given', 'obtained', ''),
        ('cost', 'obtained_seconds', duration),
        ('tables', 'table_seconds', duration),
        ('models', 'model_seconds', duration),
        ('sweeping', 'sweep_seconds', duration),
        ('all', 'seconds', duration),
        ('processor', 'processor_seconds', duration),
        ('sweeps', 'sweeps', 'd'),
        ('error', 'error', lambda error: f'{error:.0e}' if error else '0'),
        ('compiling', 'compile_seconds', duration),
        ('bytes a state', 'bytes_a_state', ',.0f'),
    ],
    'recording': [
        ('messages', 'load', ''),
        ('reader', 'what', ''),
        ('sent', 'sent', ','),
        ('lost', 'lost', ','),
        ('a second', 'per_second', _rate),
        ('throughput', 'throughput', '.2f'),
        ('processor', 'processor', '.0%'),
        ('memory', 'memory', _megabytes),
        ('grown', 'grown', _megabytes),
        ('waited', 'waited', duration),
    ],
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
    columns = [*_COLUMNS.get(name, _COMPARISON), *_RATIOS]
    columns = [one for one in columns if any(row.get(one[1]) is not None for row in rows)]
    table = Table(title=_TITLES[name], title_justify='left', box=SIMPLE, pad_edge=False)
    for title, _, text in columns:
        if text:
            table.add_column(title, justify='right', no_wrap=True)
        else:
            table.add_column(title, min_width=_LEAST)
    parts = [row.get(_PARTS.get(name, '')) for row in rows]
    for row, part, following in zip(rows, parts, [*parts[1:], None]):
        texts = [_text(row.get(key), text) for _, key, text in columns]
        table.add_row(*texts, end_section=part != following)
    return table


def _text(value: Any, text: Callable[[Any], str] | str) -> str:
    if value is None:
        return ''
    return format(value, text) if isinstance(text, str) else text(value)


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
