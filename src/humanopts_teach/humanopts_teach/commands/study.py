"""``humanopts study``: participants one after the other, how far the study is, and its tables."""

from collections.abc import Iterable
import json
from pathlib import Path
import sys
import time
from typing import Annotated, Any, TYPE_CHECKING

from humanopts_ros.limits import one_line, printable
from humanopts_teach.command_line import (
    ExcelOption,
    flag,
    option,
    PageOptions,
    PLAIN,
    whole,
    with_options,
)
from humanopts_teach.commands import CommandError, refusing
from humanopts_teach.launching.job import fork_launch
import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from humanopts_teach.study.plan import StudyPlan
    from humanopts_teach.study.protocol import Protocol
    from humanopts_teach.study.record import StudyFolder


class _StudyCommands(TyperGroup):
    """Commands; a first word that is no command is a plan to run."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first word names, or the one that runs a plan."""
        named = args[0] in self.commands or args[0].startswith('-')
        return super().resolve_command(ctx, args if named else ['run', *args])


app = typer.Typer(**PLAIN, cls=_StudyCommands, subcommand_metavar='[COMMAND] PLAN.yaml ...')
PlanArgument = Annotated[Path, typer.Argument(metavar='PLAN.yaml')]
StudyOption = Annotated[
    Path | None,
    typer.Option('--study', metavar='DIR', help='folder of the study; default: runs/STUDY'),
]


@app.callback()
def study() -> None:
    """Run a study with people: humanopts study PLAN.yaml --participant CODE."""


@app.command()
@with_options
def run(
    plan: PlanArgument,
    participant: Annotated[str, option('CODE', 'code of the person; default: ask')] = '',
    simulate: Annotated[
        int,
        option('N', 'number of simulated participants, to try a plan without people', whole(0)),
    ] = 0,
    folder: StudyOption = None,
    namespace: Annotated[str, option('NAME', 'namespace of the nodes')] = '/',
    accept_changes: Annotated[
        bool,
        flag(
            '--accept-changes',
            'accept a plan that was changed since the study began, for those who begin now',
        ),
    ] = False,
    *,
    pages: PageOptions,
) -> int:
    """Take one participant through the study in this terminal, or several in browsers."""
    from humanopts_teach.terminal.device import why_not

    fault = '' if simulate or pages.browser else why_not()
    if not (simulate or pages.browser or fault) and (status := fork_launch()) is not None:
        return status
    from humanopts_teach.commands.session import check_place
    from humanopts_teach.commands.study_session import Study

    check_place(namespace)
    study = Study(*_open(plan, folder), namespace)
    study.check_plan(accept=accept_changes)
    if simulate:
        for number in range(1, simulate + 1):
            study.simulate(f'simulated-{number}')
        _export(study.folder, study.folder.path / 'tables')
        return 0
    if pages.browser:
        from humanopts_teach.commands.browser import study_in_browser

        return study_in_browser(study, pages, participant)
    if fault:
        raise CommandError(f'{fault}; or take --browser, or --simulate N')
    return study.run(participant or input('code of the participant: ').strip())


@app.command()
def status(
    plan: PlanArgument,
    folder: StudyOption = None,
    as_json: Annotated[bool, flag('--json', 'print JSON')] = False,
) -> int:
    """Show the progress of each participant."""
    from humanopts_teach.study.protocol import SHOWN_DIGEST
    from humanopts_teach.study.tables import status_table

    study, study_folder, protocol = _kept('status', plan, folder)
    records, problems = study_folder.records()
    _warn('status', problems)
    table = status_table(protocol, records)
    if as_json:
        print(json.dumps(table.to_dict('records'), indent=2))
    else:
        planned = f' of {study.participants}' if study.participants else ''
        print(
            one_line(f'{study.study}: {len(table)}{planned} participants, in {study_folder.path}')
        )
        for version in protocol.versions:
            when = time.strftime('%Y-%m-%d %H:%M', time.localtime(version.time))
            print(one_line(f'{version.event} on {when}: {version.digest[:SHOWN_DIGEST]}'))
        rows = table.to_string(index=False) if len(table) else 'no one has taken part yet'
        print(printable(rows))
    return 0


@app.command()
def export(
    plan: PlanArgument,
    out: Annotated[
        Path | None,
        option('DIR', 'for the tables; default: tables in the folder'),
    ] = None,
    folder: StudyOption = None,
    excel: ExcelOption = False,
) -> int:
    """Write tidy CSV tables with a codebook, and the buttons as in Table 1 of the paper."""
    _, study_folder, _ = _kept('export', plan, folder)
    if not study_folder.path.exists():
        raise CommandError(
            f'no one has taken part yet in {study_folder.path}; --study DIR names another'
        )
    _export(study_folder, out or study_folder.path / 'tables', excel=excel)
    return 0


def _open(path: Path, folder: Path | None) -> 'tuple[StudyPlan, StudyFolder]':
    """
    Read a plan; return it, and the folder of the participants.

    :raises CommandError: the plan cannot be used.
    """
    from humanopts_teach.study.plan import PlanFileError, read_plan
    from humanopts_teach.study.record import StudyFolder

    with refusing(PlanFileError, what=f'{path}: '):
        plan = read_plan(path)
    return plan, StudyFolder(folder or Path('runs') / plan.study)


def _kept(
    command: str, path: Path, folder: Path | None
) -> 'tuple[StudyPlan, StudyFolder, Protocol]':
    """
    Return the plan in the folder of a study, which is valid whatever the file now says.

    Before the first participant it is the plan of the file.

    :raises CommandError: there is neither.
    """
    from humanopts_teach.study.plan import PlanFileError, read_name, read_plan
    from humanopts_teach.study.protocol import Protocol
    from humanopts_teach.study.record import StudyFolder

    with refusing(PlanFileError, what=f'{path}: '):
        study_folder = StudyFolder(folder or Path('runs') / read_name(path))
    protocol = Protocol(study_folder.path)
    missing = study_folder.missing_plan(protocol)
    _warn(command, [*protocol.problems, *filter(None, [missing])])
    if protocol.plan is None:
        return (*_open(path, study_folder.path), protocol)
    try:
        changed = 'it has been changed' if read_plan(path) != protocol.plan else ''
    except PlanFileError as error:
        changed = str(error)
    if changed:
        _warn(command, [f'{path}: {changed}; the plan kept in {study_folder.path} is used'])
    return protocol.plan, study_folder, protocol


def _export(folder: 'StudyFolder', out: Path, *, excel: bool = False) -> None:
    """Write the tables, and print Table 1."""
    from humanopts_teach.evaluation.table1 import table_text
    from humanopts_teach.study.export import suggested, write_study
    from humanopts_teach.study.tables import read_study

    data, problems = read_study(folder, time.time())
    _warn('export', problems)
    for path in write_study(data, out, excel=excel):
        print(printable(str(path)))
    print(printable(f'\n{table_text(suggested(data))}'))


def _warn(command: str, problems: Iterable[str]) -> None:
    """Print what was left out."""
    for problem in problems:
        print(one_line(f'humanopts study {command}: {problem}'), file=sys.stderr)
