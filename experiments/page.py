"""What a reproduction leaves: figures, tables, and one page that needs no other file."""

from collections.abc import Mapping, Sequence
import csv
from dataclasses import dataclass
import io
import json
from pathlib import Path
from typing import Any

from humanopts_teach.evaluation.summary import write_text
from humanopts_teach.report.pages import template
from humanopts_teach.report.words import Finding, number, percent
from markupsafe import Markup

from experiments import paper
from experiments.people import Participant
from experiments.pictures import svg_for_page, write_picture
from experiments.sections import Section, Table, Value, Verdict

PAGE = 'report.html'


@dataclass(frozen=True)
class Reproduction:
    """Everything that the page says."""

    sections: Sequence[Section]
    people: Sequence[Participant]  # empty: those in bags taught
    bags: Sequence[str]
    missing: Sequence[str]  # cells that failed, in words
    provenance: Mapping[str, str]


def write_reproduction(folder: Path, data: Reproduction) -> None:
    """
    Write page, figures (PNG, SVG) and tables (CSV, and JSON for each section).

    :raises SummaryError: the folder cannot be written.
    :raises OSError: a figure cannot be written.
    """
    for section in data.sections:
        for picture in section.pictures:
            write_picture(folder, picture)
        for table in section.tables:
            write_text(folder / f'{table.name}.csv', csv_text(table))
        write_text(folder / f'{section.name}.json', json_text(section))
    write_text(folder / PAGE, render(data))


def csv_text(table: Table) -> str:
    """Return a table as CSV; an empty field is no number."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator='\n')
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    return file.getvalue()


def json_text(section: Section) -> str:
    """Return comparisons and tables of a section as JSON; null is no number."""
    found: dict[str, Any] = {
        'title': section.title,
        **section.facts,
        'comparisons': [
            {'said': c.said, 'where': c.where, 'found': c.found, 'verdict': c.verdict.value}
            for c in section.comparisons
        ],
        'tables': {table.name: table.records() for table in section.tables},
    }
    return json.dumps(found, indent=1, allow_nan=False) + '\n'


def render(data: Reproduction) -> str:
    """Return the page."""
    values: dict[str, Any] = {
        'paper': paper.TITLE,
        'sections': data.sections,
        'people': data.people,
        'bags': data.bags,
        'findings': _findings(data),
        'svg': lambda picture: Markup(svg_for_page(picture)),
        'written': _written,
        'percent': percent,
        'provenance': data.provenance,
    }
    return template('experiments', 'page.html').render(values)


def _findings(data: Reproduction) -> list[Finding]:
    """Count the verdicts, and name the cells that failed."""
    verdicts = [c.verdict for section in data.sections for c in section.comparisons]
    words = {
        Verdict.AGREES: 'statements of the paper agree with what was found here',
        Verdict.DIFFERS: 'do not agree',
        Verdict.NOT_COMPARABLE: 'cannot be compared',
        Verdict.MET: 'of our own goals are met',
        Verdict.MISSED: 'of our own goals are missed',
    }
    counted = [
        Finding(verdict.good, f'{verdicts.count(verdict)} {text}.')
        for verdict, text in words.items()
        if verdict in verdicts
    ]
    return [*counted, *(Finding(False, f'Not computed: {text}') for text in data.missing)]


def _written(value: Value) -> str:
    """Return a value for people."""
    if isinstance(value, float) and abs(value) >= 1000:
        return f'{value:,.0f}'
    if isinstance(value, float) or value is None:
        return number(value)
    return str(value)
