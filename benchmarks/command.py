"""``humanopts bench``: timings, each in a group with a yardstick."""

from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from humanopts_ros.middleware import check_settings
from humanopts_teach.command_line import PLAIN, SeveralValues
from humanopts_teach.commands import CommandError
import psutil
import typer

COLUMNS = 'min,median,iqr,ops,rounds'
LARGEST, QUICK = 100, 10  # side of the largest grid
PROCESS_BYTES, STATE_BYTES = 2**30, 600  # bytes of this process, and bytes per state
INTERRUPTED, STOPPED = 130, 2  # exit statuses of this command and of pytest
app = typer.Typer(**PLAIN)


class Section(StrEnum):
    """A file of benchmarks; the last two need ROS."""

    PLANNING = 'planning'
    LEARNING = 'learning'
    GAMES = 'games'
    SCREENS = 'screens'
    GRAPH = 'graph'
    RECORDING = 'recording'


@app.command(
    cls=SeveralValues,
    help='Measure how long things take, in groups that each have a yardstick.\n\n'
    'The fastest of a group has the ratio 1.0 in brackets. Times are wall-clock times; '
    'where other programs run, compare the smallest ones.',
)
def bench(
    json: Annotated[
        Path | None, typer.Option(metavar='FILE', help='write all results to this file')
    ] = None,
    only: Annotated[
        list[Section],
        typer.Option(metavar='SECTION...', help=f'of {", ".join(Section)}; default: all'),
    ] = [],  # noqa: B006
    quick: Annotated[
        bool, typer.Option('--quick', help='run everything once, small, and measure nothing')
    ] = False,
    largest: Annotated[
        int,
        typer.Option(
            metavar='SIDE', min=QUICK, max=1000, help='side of the largest grid in planning'
        ),
    ] = LARGEST,
) -> int:
    """
    Run the chosen sections; return the exit status.

    :raises MiddlewareError: ROS, which the last two sections need, cannot start.
    """
    chosen = only or [*Section]
    for name in ('pytest', 'pytest_benchmark'):
        if find_spec(name) is None:
            raise CommandError(f'bench needs {name}: .venv/bin/pip install pytest-benchmark')
    needed, free = PROCESS_BYTES + STATE_BYTES * 20 * largest**2, psutil.virtual_memory().available
    if largest > LARGEST and needed > free:
        raise CommandError(
            f'--largest {largest} needs about {needed / 1e9:.1f} GB of memory, '
            f'and {free / 1e9:.1f} GB are free'
        )
    if {Section.GRAPH, Section.RECORDING} & {*chosen}:
        check_settings(thorough=True)
    import pytest

    here = Path(__file__).parent
    arguments = ['-c', str(here / 'pytest.ini'), *(str(here / f'{name}.py') for name in chosen)]
    arguments += [f'--largest={QUICK if quick else largest}', f'--benchmark-columns={COLUMNS}']
    arguments += ['--benchmark-group-by=group', '--benchmark-sort=name']
    if quick:
        arguments.append('--benchmark-disable')
    elif json:
        try:
            json.open('ab').close()
        except OSError as error:
            raise CommandError(f'cannot write {json}: {error.strerror}') from error
        arguments.append(f'--benchmark-json={json}')
    status = int(pytest.main(arguments))
    return INTERRUPTED if status == STOPPED else status
