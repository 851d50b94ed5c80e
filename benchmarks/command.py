"""``humanopts bench``: how long things take, each beside a yardstick of the same run."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from json import dumps
from pathlib import Path
import sys
from typing import Annotated

from humanopts_ros.middleware import check_settings
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.bag import progress_bar
from humanopts_teach.commands.options import PLAIN
import psutil
from rich.console import Console
import typer

from benchmarks.measure import machine_facts, Row
from benchmarks.show import remarks, section_table, SUFFIXES, write_figure

FORMAT, VERSION = 'humanopts-bench', 1  # of the JSON file
# Modules, each with a function ``measure`` and its quick sizes, ``QUICK``; only those that are
# measured are imported, since the last two need ROS.
SECTIONS = ('planning', 'learning', 'games', 'graph', 'recording')
_LEAST_WIDTH = 160  # of tables; narrower ones would leave numbers out
_FILE_WIDTH = 220
app = typer.Typer(**PLAIN)


def _sections(text: str) -> list[str]:
    names = text.split(',')
    for name in names:
        if name not in SECTIONS:
            text = f'{name!r} is none of {", ".join(SECTIONS)}'
            raise typer.BadParameter(text, param_hint="'--only'")
    return [name for name in SECTIONS if name in names]


@app.command(
    help='how long things take, each beside a yardstick\n\nTimes are those of a clock on the wall '
    'and of the processor. Each thing and its yardstick take turns, and their ratio has a 95 % '
    'interval over the turns.'
)
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
    largest: Annotated[
        int | None,
        typer.Option(
            metavar='SIDE',
            min=101,
            max=1000,
            show_default=False,
            help='side of the largest grid in planning, up to 1000; default: 100',
        ),
    ] = None,
) -> int:
    """
    Measure the chosen sections, and show and write what was found.

    :raises MiddlewareError: ROS, which the last two need, cannot start.
    :raises LaunchError: a process of the graph died, or is not done in time.
    """
    chosen = _sections(only)
    _check(chosen, json, figure)
    if {'graph', 'recording'} & {*chosen}:
        check_settings(thorough=True)
    larger = _larger_sides(chosen, quick, largest)
    measured: dict[str, list[Row]] = {}
    with progress_bar(lines=True) as bar:

        def show(name: str, share: float, text: str) -> None:
            bar(len(measured) + share, len(chosen), f'{name}: {text}')

        for name in chosen:
            section = import_module(f'benchmarks.{name}')
            sizes = section.QUICK if quick else larger.get(name, ())
            measured[name] = section.measure(partial(show, name), *sizes)
            show(name, 0.0, 'done')
    machine = machine_facts()
    console = Console(highlight=False)
    console.width = max(console.width, _LEAST_WIDTH) if console.is_terminal else _FILE_WIDTH
    for name, rows in measured.items():
        console.print(section_table(name, rows))
        for line in remarks(rows):
            console.print(line)
        console.print()
    console.print(', '.join(f'{name} {value}' for name, value in machine.items()))
    if json:
        with _written(json):
            data = {'format': FORMAT, 'version': VERSION, 'quick': quick, 'machine': machine}
            json.write_text(dumps({**data, **measured}, indent=2) + '\n', 'utf-8')
        print(f'results: {json}', file=sys.stderr)
    if figure:
        with _written(figure):
            write_figure(figure, measured['planning'])
        print(f'figure: {figure}', file=sys.stderr)
    return 0


def _check(chosen: Sequence[str], json: Path | None, figure: Path | None) -> None:
    """Refuse what could not be written, before anything is measured."""
    if figure and figure.suffix not in SUFFIXES:
        raise CommandError(f'--figure {figure} does not end in {" or ".join(SUFFIXES)}')
    if figure and 'planning' not in chosen:
        raise CommandError('--figure draws planning, which --only leaves out')
    for path in filter(None, (json, figure)):
        new = not path.exists()
        with _written(path):
            path.open('ab').close()
            if new:
                path.unlink()


def _larger_sides(
    chosen: Sequence[str], quick: bool, largest: int | None
) -> dict[str, tuple[Sequence[int]]]:
    """Return the sizes of planning up to the largest side, which must fit into the memory."""
    if largest is None:
        return {}
    if 'planning' not in chosen:
        raise CommandError('--largest is a size of planning, which --only leaves out')
    if quick:
        raise CommandError('--largest and --quick exclude each other')
    from benchmarks.planning import memory_needed, sides_up_to

    needed, free = memory_needed(largest), psutil.virtual_memory().available
    if needed > free:
        raise CommandError(
            f'--largest {largest} needs about {needed / 1e9:.1f} GB of memory, '
            f'and {free / 1e9:.1f} GB are free'
        )
    return {'planning': (sides_up_to(largest),)}


@contextmanager
def _written(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CommandError(f'cannot write {path}: {error.strerror}') from error
