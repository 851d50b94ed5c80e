"""``humanopts reproduce``: the paper's figures and tables, computed again."""

import argparse
from collections.abc import Callable, Sequence
from importlib.metadata import version
import os
from pathlib import Path
import platform
import sys
import time
from typing import Annotated, Literal

from humanopts_teach.bags.errors import BagError
from humanopts_teach.commands.ending import CommandError
from humanopts_teach.commands.options import PLAIN, SeveralValues, whole
from humanopts_teach.evaluation.summary import SummaryError
from humanopts_teach.report.words import counted, duration
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
import typer

from experiments.cells import Cell, CellStore, LIBRARIES
from experiments.figure2_section import EXPERIMENT as FIGURE_2
from experiments.figure3 import EXPERIMENT as FIGURE_3
from experiments.figure4_section import EXPERIMENT as FIGURE_4
from experiments.page import PAGE, Reproduction, write_reproduction
from experiments.people import Participant
from experiments.running import ClusterError, Outcome, run_cells
from experiments.study import Experiment, read_bag_lessons, Study
from experiments.table2_section import EXPERIMENT as TABLE_2

EXPERIMENTS: dict[str, Experiment] = {
    one.name: one for one in (FIGURE_2, FIGURE_3, FIGURE_4, TABLE_2)
}
_LINE_EVERY = 15.0  # s between lines, where there is no terminal
app = typer.Typer(**PLAIN)


@app.command(cls=SeveralValues, help="the paper's figures and tables, computed again")
def reproduce(
    what: Annotated[
        Literal['fig2', 'fig3', 'fig4', 'table2', 'all'],
        typer.Argument(metavar='WHAT', help='a figure or table: fig2, fig3, fig4, table2; or all'),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar='DIR',
            help='folder for the report; what was computed into it before is not computed again',
        ),
    ],
    participants: Annotated[
        int, typer.Option(parser=whole(1), metavar='N', help='simulated, in each group')
    ] = 6,
    seeds: Annotated[
        int, typer.Option(parser=whole(1), metavar='N', help='runs of what goes by chance')
    ] = 10,
    seed: Annotated[
        int, typer.Option(parser=whole(0), metavar='N', help='of every random draw')
    ] = 1,
    jobs: Annotated[
        int | None,
        typer.Option(parser=whole(1), metavar='N', help='processes; default: one for each core'),
    ] = None,
    dask: Annotated[
        str,
        typer.Option(
            metavar='ADDRESS',
            help='of a Dask scheduler whose workers compute instead, such as tcp://127.0.0.1:8786',
        ),
    ] = '',
    bags: Annotated[
        list[Path],
        typer.Option(
            metavar='BAG...', help='recorded lessons of people, in place of simulated ones'
        ),
    ] = [],  # noqa: B006
) -> int:
    """Compute the paper's figures and tables again."""
    return run(argparse.Namespace(**locals()))


def run(arguments: argparse.Namespace) -> int:
    """Compute what is missing, and write everything."""
    wanted = list(EXPERIMENTS) if arguments.what == 'all' else [arguments.what]
    chosen, study = [EXPERIMENTS[name] for name in wanted], _study(arguments)
    cells = [cell for experiment in chosen for cell in experiment.cells(study)]
    began = time.monotonic()
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
        with CellProgress() as progress:
            store = CellStore(arguments.out / 'cells')
            outcome = run_cells(cells, store, progress, _jobs(arguments), arguments.dask)
        _write(arguments, chosen, study, _people(cells), outcome, time.monotonic() - began)
    except (ClusterError, SummaryError) as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        raise CommandError(f'cannot write in {arguments.out}: {error.strerror}') from error
    except KeyboardInterrupt:
        text = 'interrupted; the same command goes on from here'
        print(f'humanopts reproduce: {text}', file=sys.stderr)
        return 130
    return _report(arguments.out, outcome)


def _report(folder: Path, outcome: Outcome) -> int:
    for failure in outcome.failures.values():
        print(f'humanopts reproduce: not computed: {failure}', file=sys.stderr)
    print(folder / PAGE)
    return 1 if outcome.failures else 0


def _study(arguments: argparse.Namespace) -> Study:
    try:
        bags = tuple(lesson for path in arguments.bags for lesson in read_bag_lessons(path))
    except BagError as error:
        raise CommandError(str(error)) from error
    return Study(arguments.participants, arguments.seeds, arguments.seed, bags)


def _jobs(arguments: argparse.Namespace) -> int:
    jobs: int = arguments.jobs or len(os.sched_getaffinity(0))
    return jobs


def _write(
    arguments: argparse.Namespace,
    chosen: Sequence[Experiment],
    study: Study,
    people: Sequence[Participant],
    outcome: Outcome,
    seconds: float,
) -> None:
    data = Reproduction(
        [experiment.present(study, outcome.results) for experiment in chosen],
        people,
        list(dict.fromkeys(lesson.bag for lesson in study.bags)),
        list(outcome.failures.values()),
        {
            'asked for': f'{arguments.what}, {_who(study)}, {study.seeds} seeds',
            'seed': str(study.seed),
            'cells': (
                f'{outcome.computed} computed in {duration(seconds)}, '
                f'{len(outcome.results) - outcome.computed} from an earlier run into this folder'
            ),
            'computed by': f'Dask at {arguments.dask}'
            if arguments.dask
            else _processes(arguments),
            'versions': ', '.join(
                [f'Python {platform.python_version()}', *(f'{n} {version(n)}' for n in LIBRARIES)]
            ),
        },
    )
    write_reproduction(arguments.out, data)


def _people(cells: Sequence[Cell]) -> list[Participant]:
    """Return the simulated people that teach in any of the cells."""
    sources = [{**cell.parameters, **cell.parameters.get('teacher', {})} for cell in cells]
    found = {known['person']['code']: known['person'] for known in sources if 'person' in known}
    return [Participant.from_dict(values) for values in found.values()]


def _who(study: Study) -> str:
    if study.bags:
        return counted(len({lesson.participant for lesson in study.bags}), 'person')
    return f'{counted(study.participants, "simulated participant")} in each group'


def _processes(arguments: argparse.Namespace) -> str:
    jobs = _jobs(arguments)
    return f'{jobs} processes of this machine' if jobs > 1 else 'one process of this machine'


class CellProgress:
    """A bar on a terminal, lines anywhere else, on standard error."""

    def __init__(
        self, console: Console | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = console or Console(stderr=True)
        self._clock = clock
        self._bar = Progress(
            TextColumn('{task.description}'),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn('{task.fields[left]}'),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task('', total=None, left='')
        self._began = self._told = clock()
        self._todo = self._done = 0.0  # costs
        self._count = self._over = 0

    def __enter__(self) -> 'CellProgress':
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def begin(self, cells: Sequence[Cell], left: Sequence[Cell]) -> None:
        """Take in all cells, and those that are to be computed."""
        self._began = self._told = self._clock()
        self._todo, self._count = sum(cell.cost for cell in left), len(left)
        self._bar.update(self._task, total=self._todo, description=self._text())
        self._line(f'{len(cells)} cells, {len(cells) - len(left)} of them done before')

    def done(self, cell: Cell, failed: bool) -> None:
        """Take in that a cell is over."""
        self._done, self._over = self._done + cell.cost, self._over + 1
        if failed:
            self._console.print(f'failed: {cell}', markup=False, highlight=False)
        self._bar.update(
            self._task, completed=self._done, description=self._text(), left=self.left()
        )
        if self._clock() - self._told >= _LINE_EVERY or self._over == self._count:
            self._told = self._clock()
            self._line(f'{self._text()}, {self.left()}')

    def left(self) -> str:
        """Return about how long it still takes, in words, by what the cells cost so far."""
        if self._over == self._count:
            return 'done'
        spent = self._clock() - self._began
        return f'about {duration(spent * (self._todo / self._done - 1))} left'

    def _text(self) -> str:
        return f'{self._over} of {self._count} cells'

    def _line(self, text: str) -> None:
        if not self._console.is_terminal:
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)
