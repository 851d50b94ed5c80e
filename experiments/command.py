"""``humanopts reproduce``: recompute the paper's figures and tables."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import platform
import sys
import time
from types import ModuleType
from typing import Annotated, Literal

from humanopts_env.domains.pacman.maze import load_maze, MazeError
from humanopts_teach.bags import BagError
from humanopts_teach.command_line import PLAIN, SeveralValues, whole
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.bag import progress_bar
from humanopts_teach.evaluation import ProgressCallback
from humanopts_teach.evaluation.summary import SummaryError
from humanopts_teach.report.pages import counted, duration
import pandas as pd
import typer

from experiments import (
    battery,
    demonstrations,
    figure2,
    figure3,
    figure4,
    judging,
    power,
    rover,
    table1,
    table2,
    transfer,
    worlds,
)
from experiments.people import Participant, read_bag_lessons, Study
from experiments.report import PAGE, Reproduction, Section, write_reproduction
from experiments.trials import ClusterError, LIBRARIES, Rows, run_trials, Trial

_LINE_EVERY = 15.0  # s between progress lines without a terminal
app = typer.Typer(**PLAIN)
# Each module has ``NAME`` (its name on the command line), ``TITLE``, ``trials``, which returns the
# trials of a study, and ``present``, which makes a report section from their rows.
PAPER: list[ModuleType] = [figure2, figure3, figure4, table2]
BEYOND = [transfer, demonstrations, worlds, judging, battery, rover, power]
EXPERIMENTS = {each.NAME: each for each in (*PAPER, *BEYOND)}


@app.command(cls=SeveralValues, help="Recompute the paper's figures and tables.")
def reproduce(
    what: Annotated[
        Literal[
            'fig2',
            'fig3',
            'fig4',
            'table2',
            'all',
            'transfer',
            'demonstrations',
            'worlds',
            'judging',
            'battery',
            'rover',
            'power',
        ],
        typer.Argument(
            metavar='WHAT',
            help='a figure or table: fig2, fig3, fig4, table2; or all of them; or, beyond '
            'the paper, transfer: options of one maze in others; or demonstrations: how many an '
            'option takes, by learning method; or worlds: options taught in MiniGrid, LunarLander '
            'and others; or judging: whether what a lesson calls learned is right; or battery: '
            'plans in a world that cannot be simulated; or rover: options taught to a robot; '
            'or power: how many participants a study needs',
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar='DIR',
            help='folder for the report; results that are already there are not computed again; '
            'default: runs/reproduce-WHAT',
        ),
    ] = None,
    participants: Annotated[
        int | None,
        typer.Option(
            parser=whole(1),
            metavar='N',
            help='number of simulated participants in each group; default: '
            f'{Study.participants}, and '
            f'{worlds.LESSONS} for worlds and rover, {judging.LESSONS} for judging and '
            f'{battery.LESSONS} for battery, where each gives one lesson in each environment or '
            f'row, and {power.LESSONS} for power',
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(parser=whole(1), metavar='N', help='runs of whatever depends on chance')
    ] = 10,
    seed: Annotated[
        int, typer.Option(parser=whole(0), metavar='N', help='seed of every random draw')
    ] = 1,
    jobs: Annotated[
        int | None,
        typer.Option(
            parser=whole(1), metavar='N', help='number of processes; default: one for each core'
        ),
    ] = None,
    dask: Annotated[
        str,
        typer.Option(
            metavar='ADDRESS',
            help='address of a Dask scheduler whose workers compute instead, such as '
            'tcp://127.0.0.1:8786',
        ),
    ] = '',
    bags: Annotated[
        list[Path],
        typer.Option(
            metavar='BAG...', help='recorded lessons of people, in place of simulated ones'
        ),
    ] = [],  # noqa: B006
    mazes: Annotated[
        list[str],
        typer.Option(
            metavar='MAZE...',
            help="files in Berkeley's notation, to transfer to instead of randomly drawn mazes",
        ),
    ] = [],  # noqa: B006
) -> int:
    """Compute the missing trials, and write the report; return the exit status."""
    try:
        lessons = tuple(lesson for bag in bags for lesson in read_bag_lessons(bag))
        own_mazes = tuple(load_maze(source).text for source in mazes)
    except (BagError, MazeError) as error:
        raise CommandError(str(error)) from error
    lessons_each = {each.NAME: each.LESSONS for each in (worlds, judging, battery, rover, power)}
    usual = lessons_each.get(what, Study.participants)
    study = Study(participants or usual, seeds, seed, lessons, own_mazes)
    out = out or Path('runs') / f'reproduce-{what}'
    wanted = PAPER if what == 'all' else [EXPERIMENTS[what]]
    trials = {each: each.trials(study) for each in wanted}
    every = [trial for each in wanted for trial in trials[each]]
    jobs = jobs or len(os.sched_getaffinity(0))
    began = time.monotonic()
    try:
        out.mkdir(parents=True, exist_ok=True)
        with trial_progress() as progress:
            outcome = run_trials(every, out / 'trials', progress, jobs, dask)
        where = f'{jobs} processes of this machine' if jobs > 1 else 'one process of this machine'
        facts = {
            'asked for': f'{what}, {_who(study)}, {seeds} seeds',
            'seed': str(seed),
            'trials': (
                f'{outcome.computed} computed in {duration(time.monotonic() - began)}, '
                f'{len(outcome.results) - outcome.computed} from an earlier run into this folder'
            ),
            'computed by': f'Dask at {dask}' if dask else where,
            'versions': ', '.join(
                f'{n} {v}' for n, v in {'Python': platform.python_version(), **LIBRARIES}.items()
            ),
        }
        sections = [section_of(each, outcome.rows_of(trials[each])) for each in wanted]
        sections[:0] = [table1.present()] if what == 'all' else []
        missing = list(outcome.failures.values())
        write_reproduction(out, Reproduction(sections, _people(every), study, missing, facts))
    except (ClusterError, SummaryError) as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        raise CommandError(f'cannot write in {out}: {error.strerror}') from error
    except KeyboardInterrupt:
        text = 'interrupted; the same command continues from here'
        print(f'humanopts reproduce: {text}', file=sys.stderr)
        return 130
    for failure in missing:
        print(f'humanopts reproduce: not computed: {failure}', file=sys.stderr)
    print(out / PAGE)
    return 1 if missing else 0


def section_of(experiment: ModuleType, rows: Rows) -> Section:
    """Return the report section of an experiment; it is empty if no trial has a result."""
    if not rows:
        return Section(experiment.NAME, experiment.TITLE)
    section: Section = experiment.present(pd.DataFrame(rows))
    return section


def _who(study: Study) -> str:
    if study.bags:
        return counted(len({lesson.participant for lesson in study.bags}), 'person')
    return f'{counted(study.participants, "simulated participant")} in each group'


def _people(trials: Sequence[Trial]) -> list[Participant]:
    """Return the simulated people who teach in any of the trials."""
    sources = [{**trial.parameters, **trial.parameters.get('teacher', {})} for trial in trials]
    found = {known['person']['code']: known['person'] for known in sources if 'person' in known}
    return [Participant(**values) for values in found.values()]


@contextmanager
def trial_progress(clock: Callable[[], float] = time.monotonic) -> Iterator[ProgressCallback]:
    """Show progress on standard error: a bar on a terminal, otherwise lines."""
    next_line = clock()

    def show(done: float, total: float, text: str) -> None:
        nonlocal next_line
        bar(done, total, text)
        if not sys.stderr.isatty() and (clock() >= next_line or done == total):
            next_line = clock() + _LINE_EVERY
            print(text, file=sys.stderr)

    with progress_bar() as bar:
        yield show
