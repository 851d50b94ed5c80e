"""Parts shared by all pages: style sheet, templates, findings and number formatting."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
import math
from typing import Any

from humanopts_env.domains.formulas import plain_name
from humanopts_learner.intervals import Interval
import jinja2
from markupsafe import Markup

DASH = '\N{EN DASH}'  # in place of a missing number
MINUS = '\N{MINUS SIGN}'
MARKS = {True: '✓', False: '✗', None: '·'}  # good, bad, neither


@cache
def page_style() -> str:
    """Return the common style sheet of all pages."""
    return files('humanopts_teach.report').joinpath('style.css').read_text('utf-8')


def render(package: str, name: str, values: dict[str, Any]) -> str:
    """
    Render a page from a template of a package; it may extend ``base.html`` of this package.

    Templates can use the number formatters of this module, and ``markup`` for HTML or SVG. All
    other values are escaped.
    """
    return templates(package).get_template(name).render(values)


@cache
def templates(package: str) -> jinja2.Environment:
    """Return the templates of a package and of this one; see ``render``."""
    packages = dict.fromkeys((package, 'humanopts_teach.report'))
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(each, '') for each in packages]),
        autoescape=jinja2.select_autoescape(),  # for HTML, not for text
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['plain_name'] = plain_name
    environment.globals.update(
        style=Markup(page_style()),
        markup=Markup,
        counted=counted,
        number=number,
        limits=limits,
        percent=percent,
        duration=duration,
        DASH=DASH,
    )
    return environment


@dataclass(frozen=True)
class Finding:
    """One sentence, and whether the result is good; None: neither good nor bad."""

    good: bool | None
    text: str

    @property
    def mark(self) -> str:
        """A tick, a cross or a dot."""
        return MARKS[self.good]


def number(value: float | None, digits: int = 4) -> str:
    """Format a number; return a dash if it is missing."""
    if value is None or value != value:
        return DASH
    return f'{value:.{digits}g}'.replace('-', MINUS)


def limits(found: Interval, digits: int = 4) -> str:
    """Format an interval in brackets; empty if it is undefined."""
    if math.isnan(found.low):
        return ''
    return f'({number(found.low, digits)} to {number(found.high, digits)})'


def duration(seconds: float) -> str:
    """Format a duration."""
    return f'{seconds:.1f} s' if seconds < 100 else f'{seconds / 60:.1f} min'


def counted(count: int, thing: str) -> str:
    """Return a count with its noun, such as ``1 fallback`` or ``no fallbacks``."""
    return f'{count or "no"} {thing}{"" if count == 1 else "s"}'


def percent(value: float | None) -> str:
    """Format a share as a percentage; return a dash if it is missing."""
    return DASH if value is None else f'{value:.1%}'.replace('.0%', '%')
