"""Shared parts of all pages: style sheet, templates, findings, and numbers as text."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
import math
from typing import Any

from humanopts_learner.intervals import Interval
import jinja2
from markupsafe import Markup

DASH = '\N{EN DASH}'  # no number
MINUS = '\N{MINUS SIGN}'
MARKS = {True: '✓', False: '✗', None: '·'}  # of what is good, bad, or neither


@cache
def page_style() -> str:
    """Return the style sheet of every page."""
    return files('humanopts_teach.report').joinpath('style.css').read_text('utf-8')


def render(package: str, name: str, values: dict[str, Any]) -> str:
    """
    Return a page from a template of a package, which may extend ``base.html`` of this one.

    Templates have the functions of this module that write numbers, and ``markup`` for HTML or SVG;
    all other values are escaped.
    """
    return templates(package).get_template(name).render(values)


@cache
def templates(package: str) -> jinja2.Environment:
    """Return the templates of a package, and of this one, as ``render`` describes them."""
    packages = dict.fromkeys((package, 'humanopts_teach.report'))
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(each, '') for each in packages]),
        autoescape=jinja2.select_autoescape(),  # HTML, not text
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        style=Markup(page_style()),
        markup=Markup,
        number=number,
        limits=limits,
        percent=percent,
        duration=duration,
        DASH=DASH,
    )
    return environment


@dataclass(frozen=True)
class Finding:
    """One sentence, and whether it is a good result; None: neither good nor bad."""

    good: bool | None
    text: str

    @property
    def mark(self) -> str:
        """A tick, a cross or a dot."""
        return MARKS[self.good]


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people; a dash where there is none."""
    if value is None or value != value:
        return DASH
    return f'{value:.{digits}g}'.replace('-', MINUS)


def limits(found: Interval) -> str:
    """Return an interval in brackets; empty where there is none."""
    if math.isnan(found.low):
        return ''
    return f'({number(found.low)} to {number(found.high)})'


def duration(seconds: float) -> str:
    """Return a time for people."""
    return f'{seconds:.1f} s' if seconds < 100 else f'{seconds / 60:.1f} min'


def counted(count: int, thing: str) -> str:
    """Return such as ``1 fallback`` or ``no fallbacks``."""
    return f'{count or "no"} {thing}{"" if count == 1 else "s"}'


def percent(value: float | None) -> str:
    """Return a share for people; a dash where there is none."""
    return DASH if value is None else f'{value:.1%}'.replace('.0%', '%')
