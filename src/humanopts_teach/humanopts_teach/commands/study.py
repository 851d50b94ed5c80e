"""``humanopts study``: running participants, the progress of the study, and its tables."""

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
from humanopts_teach.commands import CommandError, confirmed, refusing
from humanopts_teach.launching.job import fork_launch
import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from humanopts_teach.study.plan import StudyPlan
    from humanopts_teach.study.protocol import Protocol
    from humanopts_teach.study.record import StudyFolder


class _StudyCommands(TyperGroup):
    """Commands; a first word that is not a command is the plan to run."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command named by the first word, or else ``run``."""
        named = args[0] in self.commands or args[0].startswith('-')
        return super().resolve_command(ctx, args if named else ['run', *args])


app = typer.Typer(**PLAIN, cls=_StudyCommands, subcommand_metavar='[COMMAND] PLAN.yaml ...')
_RUNS = Path('runs')
PilotOption = Annotated[
    bool, flag('--pilot', 'use the pilot: a separate study, in the folder pilot of the study')
]
PlanArgument = Annotated[Path, typer.Argument(metavar='PLAN.yaml')]
StudyOption = Annotated[
    Path | None,
    typer.Option('--study', metavar='DIR', help='folder of the study; default: runs/STUDY'),
]

MergeOption = Annotated[
    Path | None,
    option('FILE.yaml', 'file of button wordings with the same meaning, by name'),
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
    pilot: PilotOption = False,
    namespace: Annotated[str, option('NAME', 'namespace of the nodes')] = '/',
    accept_changes: Annotated[
        bool,
        flag(
            '--accept-changes',
            'accept a plan changed since the study began; it applies to new participants only',
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
    study = Study(*_open(plan, folder, pilot), namespace)
    study.check_plan(accept=accept_changes)
    if simulate:
        for number in range(1, simulate + 1):
            study.simulate(f'simulated-{number}')
        _export(study.folder, study.folder.path / 'tables')
        _report(study.folder, study.folder.path / 'report.html')
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
    pilot: PilotOption = False,
    as_json: Annotated[bool, flag('--json', 'print JSON')] = False,
) -> int:
    """Show the progress of each participant, and the places of each order."""
    from humanopts_teach.study.log import StudyLog
    from humanopts_teach.study.progress import participants_table, places_table
    from humanopts_teach.study.protocol import SHOWN_DIGEST

    study, study_folder, protocol = _kept('status', plan, folder, pilot)
    records, problems = study_folder.records()
    log, now = StudyLog(study_folder.path), time.time()
    _warn('status', [*problems, *log.problems])
    running = study_folder.running()
    people = participants_table(protocol, records, running, study.return_within, now)
    places = places_table(study, records, now)
    counts = {event: log.people(event) for event in ('declined', 'withdrawn', 'full')}
    if as_json:
        tables = {'participants': people.to_dict('records'), 'places': places.to_dict('records')}
        print(json.dumps({**tables, **counts}, indent=2))
        return 0
    planned = f', {study.participants} places' if study.participants else ''
    print(one_line(f'{study.study}: {len(people)} participants{planned}, in {study_folder.path}'))
    for version in protocol.versions:
        when = time.strftime('%Y-%m-%d %H:%M', time.localtime(version.time))
        print(one_line(f'{version.event} on {when}: {version.digest[:SHOWN_DIGEST]}'))
    for title, table in (('', people), ('\nplaces', places)):
        rows = table.to_string(index=False) if len(people) else 'no one has taken part yet'
        print(printable(f'{title}\n{rows}' if title else rows))
        if not len(people):
            break
    others = {
        'declined': 'declined',
        'withdrawn': 'withdrew',
        'full': 'came when all places were taken',
    }
    lines = [f'{counts[event]} {words}' for event, words in others.items() if counts[event]]
    print('; '.join(lines), end='\n' if lines else '')
    return 0


@app.command()
def withdraw(
    plan: PlanArgument,
    code: Annotated[str, typer.Argument(metavar='CODE')],
    folder: StudyOption = None,
    pilot: PilotOption = False,
    yes: Annotated[bool, flag('--yes', 'delete without asking')] = False,
) -> int:
    """Delete everything about a participant, and log the deletion without the code."""
    from humanopts_teach.study.record import StudyError

    _, study_folder, _ = _kept('withdraw', plan, folder, pilot)
    with refusing(StudyError):
        files = len(study_folder.files_of(code))
        question = f'Delete {files} files of {code} in {study_folder.path} permanently?'
        if not (yes or confirmed(question)):
            raise CommandError('nothing was deleted; y or --yes confirms')
        study_folder.withdraw(code)
    print(printable(f'{files} files of {code} have been deleted. Tables and reports made'))
    print('earlier still contain this participant: delete them, or export them again.')
    return 0


@app.command()
def check(
    plan: PlanArgument,
    language: Annotated[
        str, option('LANGUAGE', 'language of the screens; default: that of the plan')
    ] = '',
) -> int:
    """Show all screens in order, with estimated times; a simulated participant answers."""
    from tempfile import TemporaryDirectory

    from humanopts_teach.commands.study_check import PlanCheck
    from humanopts_teach.language import LanguageError, read_language

    study, _ = _open(plan, None, False)
    language = language or study.language
    with refusing(LanguageError):
        read_language(language)
    with TemporaryDirectory(prefix='humanopts-') as place:
        for text in PlanCheck(study, Path(place), language).run():
            print(printable(text), flush=True)
    return 0


@app.command()
def export(
    plan: PlanArgument,
    out: Annotated[
        Path | None,
        option('DIR', 'folder for the tables; default: tables in the study folder'),
    ] = None,
    folder: StudyOption = None,
    pilot: PilotOption = False,
    excel: ExcelOption = False,
    merge: MergeOption = None,
) -> int:
    """Write tidy CSV tables with a codebook, and the buttons as in Table 1 of the paper."""
    _, study_folder, _ = _kept('export', plan, folder, pilot)
    if not study_folder.path.exists():
        raise CommandError(
            f'no one has taken part yet in {study_folder.path}; --study DIR names another'
        )
    _export(study_folder, out or study_folder.path / 'tables', merge, excel=excel)
    return 0


@app.command()
def report(
    plan: PlanArgument,
    out: Annotated[
        Path | None,
        option('FILE.html', 'file to write; default: report.html in the study folder'),
    ] = None,
    folder: StudyOption = None,
    pilot: PilotOption = False,
    merge: MergeOption = None,
) -> int:
    """Write a report: participants, learning curves, effects, buttons, times, questionnaires."""
    _, study_folder, _ = _kept('report', plan, folder, pilot)
    _report(study_folder, out or study_folder.path / 'report.html', merge)
    return 0


def _open(path: Path, folder: Path | None, pilot: bool) -> 'tuple[StudyPlan, StudyFolder]':
    """
    Read a plan; return it and the folder of the study.

    :raises CommandError: the plan cannot be used.
    """
    from humanopts_teach.study.plan import PlanFileError, read_plan

    with refusing(PlanFileError, what=f'{path}: '):
        plan = read_plan(path)
    return plan, _folder(folder or _RUNS / plan.study, pilot)


def _folder(path: Path, pilot: bool) -> 'StudyFolder':
    from humanopts_teach.study.record import PILOT, StudyFolder

    return StudyFolder(path / PILOT if pilot else path)


def _kept(
    command: str, path: Path, folder: Path | None, pilot: bool
) -> 'tuple[StudyPlan, StudyFolder, Protocol]':
    """
    Return the plan stored in the folder of a study, even if the file has changed since.

    Before the first participant, return the plan in the file.

    :raises CommandError: no plan is stored, and the file cannot be used.
    """
    from humanopts_teach.study.plan import PlanFileError, read_name, read_plan
    from humanopts_teach.study.protocol import Protocol

    with refusing(PlanFileError, what=f'{path}: '):
        study_folder = _folder(folder or _RUNS / read_name(path), pilot)
    protocol = Protocol(study_folder.path)
    missing = study_folder.missing_plan(protocol)
    _warn(command, [*protocol.problems, *filter(None, [missing])])
    if protocol.plan is None:
        return (*_open(path, study_folder.path, False), protocol)
    try:
        changed = 'it has been changed' if read_plan(path) != protocol.plan else ''
    except PlanFileError as error:
        changed = str(error)
    if changed:
        _warn(command, [f'{path}: {changed}; the plan kept in {study_folder.path} is used'])
    return protocol.plan, study_folder, protocol


def _export(
    folder: 'StudyFolder', out: Path, merge: Path | None = None, *, excel: bool = False
) -> None:
    """Write the tables, and print Table 1."""
    from humanopts_teach.commands.study_report import merged_wordings
    from humanopts_teach.evaluation.table1 import table_text
    from humanopts_teach.study.export import suggested, write_study
    from humanopts_teach.study.tables import read_study

    data, problems = read_study(folder, time.time(), merged_wordings(merge))
    _warn('export', problems)
    for path in write_study(data, out, excel=excel):
        print(printable(str(path)))
    print(printable(f'\n{table_text(suggested(data))}'))


def _report(folder: 'StudyFolder', out: Path, merge: Path | None = None) -> None:
    from humanopts_teach.commands.study_report import write_report

    _warn('report', write_report(folder, out, merge))
    print(printable(str(out)))


def _warn(command: str, problems: Iterable[str]) -> None:
    """Print warnings about omissions."""
    for problem in problems:
        print(one_line(f'humanopts study {command}: {problem}'), file=sys.stderr)
