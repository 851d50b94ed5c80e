"""The report of a reproduction: the paper's claims beside what was found, tables, figures."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
import json
import math
from pathlib import Path
from typing import Any

from humanopts_learner.intervals import Interval
from humanopts_teach.evaluation.summary import write_text
from humanopts_teach.report.figures import Drawing, drawing, file_settings
from humanopts_teach.report.pages import Finding, number
from humanopts_teach.report.pages import render as render_page
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


# Parameters and results of the trials that have one.
Done = Sequence[tuple[Mapping[str, Any], Any]]


class Mark(Enum):
    """How what was found compares with what was claimed."""

    AGREES = 'agrees'
    DIFFERS = 'does not agree'
    UNDECIDED = 'not distinguishable'  # the interval says neither, or there is none
    NOT_COMPARABLE = 'not comparable'
    NO_COUNTERPART = 'no counterpart'  # nothing like it is computed here
    MET = 'met'  # a goal of this project, not of the paper
    MISSED = 'missed'

    @property
    def good(self) -> bool | None:
        """Whether the mark is a good one; None: neither good nor bad."""
        if self in (Mark.UNDECIDED, Mark.NOT_COMPARABLE, Mark.NO_COUNTERPART):
            return None
        return self in (Mark.AGREES, Mark.MET)


SUMMARY = {  # text after the number of comparisons with each mark, at the top of the page
    Mark.AGREES: 'comparisons with the paper agree with what it says',
    Mark.DIFFERS: 'do not agree',
    Mark.UNDECIDED: 'comparisons and goals are not decided by the intervals',
    Mark.NOT_COMPARABLE: 'cannot be compared',
    Mark.NO_COUNTERPART: 'statements of the paper have no counterpart here',
    Mark.MET: 'of our own goals are met',
    Mark.MISSED: 'of our own goals are missed',
}


@dataclass(frozen=True)
class Comparison:
    """One claim, beside the numbers that were found."""

    said: str
    where: str  # section, figure or table of the paper; or OURS
    found: str
    mark: Mark


def compared(statement: Statement, found: str, agrees: bool | None) -> Comparison:
    """Return a statement of the paper beside what was found; None: the data do not decide it."""
    mark = {True: Mark.AGREES, False: Mark.DIFFERS, None: Mark.UNDECIDED}[agrees]
    return Comparison(statement.text, statement.where, found, mark)


def goal(said: str, found: str, met: bool | None) -> Comparison:
    """Return a goal of this project beside what was found; None: the data do not decide it."""
    mark = {True: Mark.MET, False: Mark.MISSED, None: Mark.UNDECIDED}[met]
    return Comparison(said, OURS, found, mark)


@dataclass(frozen=True)
class Picture:
    """One figure; it is drawn for the page and for files."""

    name: str  # of the files, without suffix
    label: str  # description for people who do not see the figure
    size: tuple[float, float]  # inches
    draw: Callable[[Drawing], None]  # series have the colours C0, C1, ...
    caption: str = ''


@dataclass(frozen=True)
class Table:
    """A table of the page and a CSV file; a missing value is an empty field."""

    name: str  # of the file, without suffix
    title: str
    frame: pd.DataFrame
    shown: bool = True  # on the page; all are in files

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows as JSON data: a missing value is None."""
        plain = self.frame.astype(object)
        rows: Any = plain.where(plain.notna(), None).to_dict('records')
        return list(rows)


@dataclass(frozen=True)
class Section:
    """The part of the report about one figure or table of the paper."""

    name: str
    title: str
    comparisons: Sequence[Comparison]
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)  # parameters of the method, for JSON


@dataclass(frozen=True)
class Reproduction:
    """The content of the page."""

    sections: Sequence[Section]
    people: Sequence[Participant]  # empty: those in bags taught
    study: Study
    missing: Sequence[str]  # trials that failed, in words
    provenance: Mapping[str, str]


def mean_intervals(
    frame: pd.DataFrame,
    by: Sequence[str],
    value: str,
    least: float = -np.inf,
    most: float = np.inf,
) -> pd.DataFrame:
    """
    Return means over independent people or runs, with 95 % intervals by Student's t.

    :param by: columns whose values make a group; the other rows of a group are averaged.
    :param least: what a value can be at least; limits are cut off there, and at ``most``.
    :return: ``by``, count (of values that are not NaN), mean, low, high; NaN where there is none,
        as the limits of a single value.
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
    """Yield the rows that agree in some columns of text, in the order of their first rows."""
    groups: Any = frame.groupby(list(by), sort=False)
    yield from groups


def listed(values: Mapping[Any, str]) -> str:
    """Return names and values as one line."""
    return '; '.join(f'{name} {value}' for name, value in values.items())


def written(found: Interval, style: str = ',.2f') -> str:
    """Return an estimate with its limits; of one person or run, the estimate alone."""
    mean, low, high = (f'{value:{style}}' for value in (found.mean, found.low, found.high))
    return mean if math.isnan(found.low) else f'{mean} ({low} to {high})'


def draw_curves(
    axes: Axes,
    curves: pd.DataFrame,
    by: str,
    x: str,
    styles: Mapping[str, Sequence[Any]],
    **style: Any,
) -> None:
    """
    Draw means and, where there are any, their limits.

    :param curves: columns ``by``, ``x``, mean, low, high; a curve for each value of ``by``.
    :param styles: colour, line and, where there are any, marker of each curve.
    :param style: of all of them.
    """
    for (name,), curve in grouped(curves, [by]):
        color, *_ = styles[name]
        own = dict(zip(('color', 'ls', 'marker'), styles[name]))
        axes.plot(curve[x], curve['mean'], label=name, **own, **style)
        if curve['low'].notna().any():
            axes.fill_between(curve[x], curve['low'], curve['high'], color=color, alpha=0.15, lw=0)
    axes.grid(axis='y')


def write_reproduction(folder: Path, data: Reproduction) -> None:
    """
    Write page, figures (PNG, SVG) and tables (CSV, and JSON for each section).

    :raises SummaryError: the folder cannot be written.
    :raises OSError: a figure cannot be written.
    """
    for section in data.sections:
        for picture in section.pictures:
            _write_picture(folder, picture)
        for table in section.tables:
            write_text(folder / f'{table.name}.csv', table.frame.to_csv(index=False))
        write_text(folder / f'{section.name}.json', section_json(section))
    write_text(folder / PAGE, render(data))


def section_json(section: Section) -> str:
    """Return comparisons and tables of a section as JSON; null is a missing number."""
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
    return json.dumps(values, indent=1, allow_nan=False) + '\n'


@dataclass(frozen=True)
class Verdict:
    """One statement of the paper, and how often each mark was given to it."""

    said: str
    where: str
    section: str  # name of the section that has the numbers
    marks: Counter[Mark]


def verdicts(sections: Sequence[Section]) -> list[Verdict]:
    """Return every statement of the paper once, in the order of the sections."""
    found: dict[tuple[str, str], Verdict] = {}
    for section in sections:
        for c in section.comparisons:
            if c.where != OURS:
                one = Verdict(c.said, c.where, section.name, Counter())
                marks = found.setdefault((section.name, c.said), one).marks
                marks.update([c.mark])
    return list(found.values())


def render(data: Reproduction) -> str:
    """Return the page."""
    marks = [c.mark for section in data.sections for c in section.comparisons]
    findings = [
        Finding(mark.good, f'{marks.count(mark)} {text}.')
        for mark, text in SUMMARY.items()
        if mark in marks
    ]
    values: dict[str, Any] = {
        'paper': paper.TITLE,
        'sections': data.sections,
        'verdicts': verdicts(data.sections),
        'people': data.people,
        'study': data.study,
        'bags': list(dict.fromkeys(lesson.bag for lesson in data.study.bags)),
        'findings': findings + [Finding(False, f'Not computed: {x}') for x in data.missing],
        'title': TITLE,
        'svg_of': _svg_for_page,
        'written': _of_table,
        'provenance': data.provenance,
    }
    return render_page('experiments', 'page.html', values)


def _of_table(value: Any) -> str:
    """Return a value of a table for people."""
    if isinstance(value, float) and abs(value) >= 1000:
        return f'{value:,.0f}'
    if isinstance(value, int) and value >= 10_000:
        return f'{value:,}'
    if isinstance(value, float) or value is None:
        return number(value)
    return str(value)


def _svg_for_page(picture: Picture) -> Markup:
    """Return an ``<svg>`` element that is coloured by the page."""
    with drawing(picture.name, picture.label, *picture.size) as work:
        picture.draw(work)
    return Markup(work.svg)


def _write_picture(folder: Path, picture: Picture) -> None:
    """
    Write a figure as PNG and SVG.

    :raises OSError: they cannot be written.
    """
    with matplotlib.rc_context(file_settings(picture.name)):
        work = Drawing(*picture.size)
        picture.draw(work)
        work.figure.savefig(folder / f'{picture.name}.png', dpi=DPI)
        work.figure.savefig(folder / f'{picture.name}.svg', metadata={'Date': None})
