"""The report of a reproduction: the paper's claims and our results, tables and figures."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
import json
import math
from pathlib import Path
from typing import Any

from humanopts_learner.intervals import Interval
from humanopts_learner.spreadsheet import csv_of
from humanopts_teach.evaluation.summary import write_text
from humanopts_teach.evaluation.tables import records
from humanopts_teach.report.figures import Drawing, drawing, file_settings
from humanopts_teach.report.pages import Finding, number, render
from markupsafe import Markup
import matplotlib
from matplotlib.axes import Axes
import numpy as np
import pandas as pd

from experiments import paper
from experiments.paper import Statement
from experiments.people import Participant, Study
from experiments.trials import code_version

PAGE = 'report.html'
TITLE = 'The paper\N{RIGHT SINGLE QUOTATION MARK}s figures and tables, reproduced'
DPI = 160
OURS = 'goal of this project'


class Mark(Enum):
    """The verdict on a claim."""

    AGREES = 'agrees'
    DIFFERS = 'does not agree'
    UNDECIDED = 'not distinguishable'  # the interval is inconclusive or missing
    NOT_COMPARABLE = 'not comparable'
    NO_COUNTERPART = 'no counterpart'  # nothing comparable is computed here
    MET = 'met'  # a goal of this project, not of the paper
    MISSED = 'missed'

    @property
    def good(self) -> bool | None:
        """Whether the mark is good; None: neither good nor bad."""
        good = {Mark.AGREES: True, Mark.MET: True, Mark.DIFFERS: False, Mark.MISSED: False}
        return good.get(self)


@dataclass(frozen=True)
class Comparison:
    """One claim and our results."""

    said: str
    where: str  # section, figure or table of the paper; or OURS
    found: str
    mark: Mark


def compare(
    claim: Statement | str,
    verdict: bool | Mark | None,
    case: str = '',
    values: Mapping[Any, Interval | float | str] | None = None,
    style: str = '',
    why: str = '',
) -> Comparison:
    """
    Compare a claim with our results.

    :param claim: statement of the paper, or a goal of this project as text.
    :param verdict: whether the claim holds; None: the data are inconclusive.
    :param case: case to which the values belong.
    :param values: values that decide the claim, by name.
    :param style: format of the values, see ``written``.
    :param why: explanation that follows the values.
    """
    statement = Statement(claim, OURS) if isinstance(claim, str) else claim
    if not isinstance(verdict, Mark):
        ours = statement.where == OURS
        yes, no = (Mark.MET, Mark.MISSED) if ours else (Mark.AGREES, Mark.DIFFERS)
        verdict = {True: yes, False: no, None: Mark.UNDECIDED}[verdict]
    found = '; '.join(f'{name} {written(each, style)}' for name, each in (values or {}).items())
    found = '; '.join(filter(None, (f'{case}: {found}' if found else '', why)))
    return Comparison(statement.text, statement.where, found, verdict)


def written(value: Interval | float | str, style: str = '') -> str:
    """
    Format a value, with its limits if it has any.

    :param style: number format; empty: four significant digits; no decimals from 100 on.
    """
    if isinstance(value, str):
        return value
    mean = value.mean if isinstance(value, Interval) else value
    style = style or (',.0f' if abs(mean) >= 100 else '.4g')
    if not isinstance(value, Interval) or math.isnan(value.low):
        return f'{mean:{style}}'
    return f'{mean:{style}} ({value.low:{style}} to {value.high:{style}})'


@dataclass(frozen=True)
class Picture:
    """One figure, drawn for the page and for files."""

    name: str  # of the files, without suffix
    caption: str  # also the alternative text for screen readers
    size: tuple[float, float]  # inches
    draw: Callable[[Drawing], None]  # uses the series colours C0, C1, ...

    @property
    def svg(self) -> Markup:
        """The figure as an ``<svg>`` element in the colours of the page."""
        with drawing(self.name, self.caption, *self.size) as work:
            self.draw(work)
        return Markup(work.svg)


@dataclass(frozen=True)
class Table:
    """A table on the page and in a CSV file; a missing value is an empty field."""

    name: str  # of the file, without suffix
    title: str
    frame: pd.DataFrame
    shown: bool = True  # on the page; every table has a file

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows as JSON data: a missing value is None."""
        return records(self.frame)


@dataclass(frozen=True)
class Section:
    """The part of the report about one experiment."""

    name: str
    title: str
    comparisons: Sequence[Comparison] = ()
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)  # method parameters, for JSON


@dataclass(frozen=True)
class Reproduction:
    """The content of the page."""

    sections: Sequence[Section]
    people: Sequence[Participant]  # simulated teachers; empty: the teachers are in bags
    study: Study
    missing: Sequence[str]  # failed trials, in words
    provenance: Mapping[str, str]


def mean_intervals(
    frame: pd.DataFrame,
    by: Sequence[str],
    value: str,
    least: float = -np.inf,
    most: float = np.inf,
) -> pd.DataFrame:
    """
    Return means over independent people or runs, with 95 % Student's t intervals.

    :param by: columns to group by; the rows of a group are averaged.
    :param least: smallest possible value; limits are clipped to ``least`` and ``most``.
    :return: ``by``, count (of values that are not NaN), mean, low, high; undefined numbers, such
        as the limits for a single value, are NaN.
    """
    groups = frame.groupby(list(by), sort=False)[value]
    found = groups.agg('count').to_frame('count')
    samples = (values.to_numpy() for _, values in groups)
    intervals = [Interval.of(values[~np.isnan(values)]) for values in samples]
    for name in ('mean', 'low', 'high'):
        found[name] = np.array([getattr(interval, name) for interval in intervals], dtype=float)
    found['low'], found['high'] = found['low'].clip(lower=least), found['high'].clip(upper=most)
    return found.reset_index()


def grouped(
    frame: pd.DataFrame, by: Sequence[str]
) -> Iterator[tuple[tuple[str, ...], pd.DataFrame]]:
    """Yield the groups of rows that agree in text columns, in order of first appearance."""
    groups: Any = frame.groupby(list(by), sort=False)
    yield from groups


def draw_curves(
    axes: Axes,
    curves: pd.DataFrame,
    by: str,
    x: str,
    lines: Mapping[str, str],
    **style: Any,
) -> None:
    """
    Draw means and their limits, if any.

    :param curves: columns ``by``, ``x``, mean, low, high; one curve per value of ``by``.
    :param lines: matplotlib format of each curve (colour, line, marker), such as ``C1--o``.
    :param style: matplotlib style of all curves.
    """
    for (name,), curve in grouped(curves, [by]):
        axes.plot(curve[x], curve['mean'], lines[name], label=name, **style)
        if curve['low'].notna().any():
            band: Any = {'color': lines[name][:2], 'alpha': 0.15, 'lw': 0}
            axes.fill_between(curve[x], curve['low'], curve['high'], **band)
    axes.grid(axis='y')


def draw_samples(
    axes: Axes,
    rows: pd.DataFrame,
    by: str,
    value: str,
    series: str,
    centre: Callable[[Any], Interval],
    **style: Any,
) -> None:
    """
    Draw single values as dots, one row of the figure per value of ``by``.

    :param series: column with the name of the series; each has its own colour and offset.
    :param centre: function from the values of a series to the mean and limits that its bar shows.
    :param style: style of the dots.
    """
    names, several = list(rows[by].unique()), list(rows[series].unique())
    for index, (called, mine) in enumerate(rows.groupby(series, sort=False)):
        for place, name in enumerate(names):
            height = place + 0.3 * (index - (len(several) - 1) / 2)
            values, color = mine.loc[mine[by] == name, value].dropna(), f'C{index}'
            middle = centre(values)
            axes.plot([middle.low, middle.high], [height, height], color='C1', lw=2)
            ink = color if len(several) > 1 else 'C1'
            (bar,) = axes.plot(middle.mean, height, '|', color=ink, ms=14, mew=2)
            axes.plot(values, [height] * len(values), 'o', color=color, **style)
        bar.set_label(str(called))
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis='x')


def write_reproduction(folder: Path, data: Reproduction) -> None:
    """
    Write page, figures (PNG, SVG) and tables (CSV, and JSON for each section).

    :raises SummaryError: the folder cannot be written.
    :raises OSError: a figure cannot be written.
    """
    for section in data.sections:
        for picture in section.pictures:
            with matplotlib.rc_context(file_settings(picture.name)):
                picture.draw(work := Drawing(*picture.size))
                work.figure.savefig(folder / f'{picture.name}.png', dpi=DPI)
                work.figure.savefig(folder / f'{picture.name}.svg', metadata={'Date': None})
        for table in section.tables:
            write_text(folder / f'{table.name}.csv', csv_of(table.frame))
        values: dict[str, Any] = {
            'title': section.title,
            'code': code_version(),
            **section.facts,
            'comparisons': [
                {'said': c.said, 'where': c.where, 'found': c.found, 'verdict': c.mark.value}
                for c in section.comparisons
            ],
            'tables': {table.name: table.rows for table in section.tables},
        }
        text = json.dumps(values, indent=1, allow_nan=False) + '\n'
        write_text(folder / f'{section.name}.json', text)
    write_text(folder / PAGE, page_of(data))


def verdicts(sections: Sequence[Section]) -> dict[tuple[str, str, str], Counter[Mark]]:
    """Count the marks of each statement of the paper, by section and place."""
    found: dict[tuple[str, str, str], Counter[Mark]] = {}
    for section in sections:
        for c in section.comparisons:
            if c.where != OURS:
                found.setdefault((section.name, c.said, c.where), Counter()).update([c.mark])
    return found


def page_of(data: Reproduction) -> str:
    """Return the page as HTML."""
    marks = Counter(c.mark for section in data.sections for c in section.comparisons)
    findings = [
        *(Finding(mark.good, f'{mark.value}: {marks[mark]}') for mark in Mark if mark in marks),
        *(Finding(False, f'Not computed: {text}') for text in data.missing),
    ]
    values: dict[str, Any] = {
        **vars(data),
        'paper': paper.TITLE,
        'verdicts': verdicts(data.sections),
        'bags': list(dict.fromkeys(lesson.bag for lesson in data.study.bags)),
        'findings': findings,
        'title': TITLE,
        'written': _cell,
    }
    return render('experiments', 'page.html', values)


def _cell(value: Any) -> str:
    """Format a value of a table."""
    if isinstance(value, float) and abs(value) >= 1000:
        return f'{value:,.0f}'
    if isinstance(value, int) and value >= 10_000:
        return f'{value:,}'
    return number(value) if isinstance(value, float) or value is None else str(value)
