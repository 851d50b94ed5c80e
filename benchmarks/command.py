"""``humanopts bench``: how long things take, each beside a yardstick of the same run."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
import json
from pathlib import Path
import sys
from typing import Annotated

from humanopts_teach.commands.ending import CommandError
from humanopts_teach.commands.options import PLAIN
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
import typer

from benchmarks.figure import SUFFIXES, write_figure
from benchmarks.machine import machine_facts
from benchmarks.results import Planned, results_to_dict, Rows, run_section, SECTIONS
from benchmarks.tables import section_table

_LEAST_WIDTH = 120  # of tables; narrower ones would leave numbers out
_FILE_WIDTH = 200
app = typer.Typer(**PLAIN)


def _sections(text: str) -> tuple[str, ...]:
    names = text.split(',')
    for name in names:
        if name not in SECTIONS:
            text = f'{name!r} is none of {", ".join(SECTIONS)}'
            raise typer.BadParameter(text, param_hint="'--only'")
    return tuple(name for name in SECTIONS if name in names)


@app.command(help='how long things take, each beside a yardstick')
def bench(
    json: Annotated[
        Path | None, typer.Option(metavar='FILE', help='write everything to this file')
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE',
            help='draw planning time against states to this file, .svg or .png',
        ),
    ] = None,
    only: Annotated[
        str,
        typer.Option(
            metavar='NAME,NAME',
            show_default=False,
            help=f'sections to measure, of {", ".join(SECTIONS)}; default: all',
        ),
    ] = ','.join(SECTIONS),
    quick: Annotated[
        bool,
        typer.Option('--quick', help='small sizes, to see that it works; times mean little'),
    ] = False,
) -> int:
    """Measure the chosen sections."""
    chosen = _sections(only)
    return run(argparse.Namespace(json=json, figure=figure, only=chosen, quick=quick))


def run(arguments: argparse.Namespace) -> int:
    """Measure the chosen sections, and show and write what was found."""
    _check(arguments)
    sections: dict[str, Rows] = {}
    with _progress() as tell:
        for name in arguments.only:
            on_measured = partial(tell, name)
            sections[name] = run_section(name, quick=arguments.quick, progress=on_measured)
            tell(name, 1.0, 'done')
    machine = machine_facts()
    _show(sections, machine)
    _write(arguments, sections, machine)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what could not be written, before anything is measured."""
    if arguments.figure and arguments.figure.suffix not in SUFFIXES:
        raise CommandError(f'--figure {arguments.figure} does not end in {" or ".join(SUFFIXES)}')
    if arguments.figure and 'planning' not in arguments.only:
        raise CommandError('--figure draws planning, which --only leaves out')
    for path in filter(None, (arguments.json, arguments.figure)):
        new = not path.exists()
        with _written(path):
            path.open('ab').close()
            if new:
                path.unlink()


def _show(sections: dict[str, Rows], machine: dict[str, str | int]) -> None:
    console = Console(highlight=False)
    console.width = max(console.width, _LEAST_WIDTH) if console.is_terminal else _FILE_WIDTH
    for name, rows in sections.items():
        console.print(section_table(name, rows))
        console.print()
    console.print(', '.join(f'{name} {value}' for name, value in machine.items()))


def _write(
    arguments: argparse.Namespace, sections: dict[str, Rows], machine: dict[str, str | int]
) -> None:
    if arguments.json:
        data = results_to_dict(sections, machine, quick=arguments.quick)
        with _written(arguments.json):
            arguments.json.write_text(json.dumps(data, indent=2) + '\n', 'utf-8')
        print(f'results: {arguments.json}', file=sys.stderr)
    if arguments.figure:
        rows = [row for row in sections['planning'] if isinstance(row, Planned)]
        with _written(arguments.figure):
            write_figure(arguments.figure, rows)
        print(f'figure: {arguments.figure}', file=sys.stderr)


@contextmanager
def _written(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CommandError(f'cannot write {path}: {error.strerror}') from error


@contextmanager
def _progress() -> Iterator[Callable[[str, float, str], None]]:
    """Show on standard error how far each section is: as bars on a terminal, else as lines."""
    console = Console(stderr=True, highlight=False)
    columns = (TextColumn('{task.fields[name]:8}'), BarColumn(), TimeElapsedColumn())
    bars = Progress(*columns, TextColumn('{task.description}'), console=console, transient=True)
    if not console.is_terminal:
        yield _lines()
        return
    tasks: dict[str, TaskID] = {}

    def tell(name: str, share: float, text: str) -> None:
        if name not in tasks:
            tasks[name] = bars.add_task('', total=1.0, name=name)
        bars.update(tasks[name], completed=share, description=text)

    with bars:
        yield tell


def _lines() -> Callable[[str, float, str], None]:
    said: list[str] = []

    def tell(name: str, share: float, text: str) -> None:
        line = f'{name}: {text}'
        if line not in said:
            said.append(line)
            print(f'{line} ({share:.0%})', file=sys.stderr, flush=True)

    return tell
