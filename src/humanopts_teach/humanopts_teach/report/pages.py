"""What all pages share: their style sheet, and how their templates are read."""

from functools import cache
from importlib.resources import files

import jinja2
from markupsafe import Markup


@cache
def page_style() -> str:
    """Return the style sheet of every page."""
    return files('humanopts_teach.report').joinpath('style.css').read_text('utf-8')


@cache
def template(package: str, name: str) -> jinja2.Template:
    """Return a template of a package; it knows ``style``, and escapes what is filled in."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals['style'] = Markup(page_style())
    return environment.from_string(files(package).joinpath(name).read_text('utf-8'))
