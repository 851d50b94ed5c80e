"""One part of a reproduction's report: comparisons, figures, tables."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from humanopts_teach.report.figures import Drawing

Paint = Callable[[str], str]  # from a colour of report.figures to the one to draw with
Value = str | int | float | bool | None


class Verdict(Enum):
    """How what was found stands to what was said."""

    AGREES = 'agrees'
    DIFFERS = 'does not agree'
    NOT_COMPARABLE = 'not comparable'
    MET = 'met'  # a goal of this project, not of the paper
    MISSED = 'missed'

    @property
    def good(self) -> bool | None:
        """Whether it is as one would wish; None: neither."""
        known = {Verdict.AGREES: True, Verdict.MET: True, Verdict.NOT_COMPARABLE: None}
        return known.get(self, False)


def agreement(agrees: bool) -> Verdict:
    """Return the verdict on a statement of the paper."""
    return Verdict.AGREES if agrees else Verdict.DIFFERS


def goal(met: bool) -> Verdict:
    """Return the verdict on a goal of this project."""
    return Verdict.MET if met else Verdict.MISSED


@dataclass(frozen=True)
class Comparison:
    """What the paper says, or what we aimed at, beside what was found."""

    said: str
    where: str  # section, figure or table of the paper; or whose goal it is
    found: str
    verdict: Verdict


@dataclass(frozen=True)
class Picture:
    """One figure; it is drawn for the page and for files."""

    name: str  # of the files, without suffix
    label: str  # what it shows, for people who do not see it
    size: tuple[float, float]  # inches
    draw: Callable[[Drawing, Paint], None]
    caption: str = ''


@dataclass(frozen=True)
class Table:
    """Rows of plain values; None where there is no number."""

    name: str  # of the file, without suffix
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Value]]
    shown: bool = True  # on the page; all are in files

    def records(self) -> list[dict[str, Value]]:
        """Return the rows as JSON data."""
        return [dict(zip(self.columns, row)) for row in self.rows]


@dataclass(frozen=True)
class Section:
    """What the report says of one figure or table of the paper."""

    name: str
    title: str
    text: Sequence[str]  # paragraphs: how it was done, and where that differs from the paper
    comparisons: Sequence[Comparison]
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)  # parameters of the method, for JSON
