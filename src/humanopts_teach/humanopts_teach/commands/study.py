"""``humanopts study``: participants one after the other, how far the study is, and its tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
import json
from pathlib import Path
import sys
from typing import Annotated, Any, TYPE_CHECKING

from humanopts_ros.limits import printable
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.options import (
    BrowserOption,
    HOST,
    HostOption,
    LaunchOptions,
    LINGER,
    LingerOption,
    PLAIN,
    PORT,
    PortOption,
    whole,
)
import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from humanopts_teach.commands.session import Session
    from humanopts_teach.launching.processes import Setup
    from humanopts_teach.lesson.requests import OptionStatus
    from humanopts_teach.study.plan import Condition, Part, StudyPlan
    from humanopts_teach.study.record import Participant, StudyFolder

_WATCHED = 0.15  # s between steps of the machine, while a person looks on
_ERROR_RATE = 0.02  # share of a simulated participant's steps that are wrong


class _StudyCommands(TyperGroup):
    """Commands; a first word that is none is a plan, which is run."""

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
    """Carry out a study with people: humanopts study PLAN.yaml --participant CODE."""


@app.command()
def run(
    plan: PlanArgument,
    participant: Annotated[
        str, typer.Option(metavar='CODE', help='of the person; default: ask')
    ] = '',
    simulate: Annotated[
        int,
        typer.Option(
            parser=whole(0),
            metavar='N',
            help='let N simulated participants take part, to try a plan without people',
        ),
    ] = 0,
    folder: StudyOption = None,
    namespace: Annotated[str, typer.Option(metavar='NAME', help='of the nodes')] = '/',
    browser: BrowserOption = False,
    host: HostOption = HOST,
    port: PortOption = PORT,
    linger: LingerOption = LINGER,
) -> int:
    """Take one participant through the study in this terminal, or several in browsers."""
    study = Study.open(plan, folder, namespace)
    if simulate:
        for number in range(1, simulate + 1):
            study.simulate(f'simulated-{number}')
        study.export(study.folder.path / 'tables')
        return 0
    if browser:
        from humanopts_teach.commands.browser import Address
        from humanopts_teach.commands.study_browser import study_in_browser

        return study_in_browser(study, Address(host, port), participant, linger)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CommandError(
            'a study needs a terminal for input and output, or --browser, or --simulate N'
        )
    return study.run(participant or input('code of the participant: ').strip())


@app.command()
def status(
    plan: PlanArgument,
    folder: StudyOption = None,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> int:
    """Show how far each participant is."""
    from humanopts_teach.study.tables import status_table

    study = Study.open(plan, folder)
    table = status_table(study.plan, study.folder)
    if as_json:
        print(json.dumps(table.to_dict('records'), indent=2))
    else:
        planned = f' of {study.plan.participants}' if study.plan.participants else ''
        print(f'{study.plan.name}: {len(table)}{planned} participants, in {study.folder.path}')
        print(table.to_string(index=False) if len(table) else 'nobody has taken part yet')
    return 0


@app.command()
def export(
    plan: PlanArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='for the tables; default: tables in the folder'),
    ] = None,
    folder: StudyOption = None,
) -> int:
    """Write tidy CSV tables with a codebook, and the buttons as in Table 1 of the paper."""
    study = Study.open(plan, folder)
    study.export(out or study.folder.path / 'tables')
    return 0


@dataclass(frozen=True)
class Turn:
    """What a participant does in one condition."""

    condition: 'Condition'
    left: 'Sequence[Part]'
    setup: 'Setup'


@dataclass(frozen=True)
class Study:
    """A plan and the folder of those who take part."""

    plan: 'StudyPlan'
    folder: 'StudyFolder'
    namespace: str

    @classmethod
    def open(cls, path: Path, folder: Path | None, namespace: str = '/') -> 'Study':
        """
        Read a plan.

        :raises CommandError: it cannot be used.
        """
        from humanopts_teach.study.plan import PlanFileError, read_plan
        from humanopts_teach.study.record import StudyFolder

        try:
            plan = read_plan(path)
        except PlanFileError as error:
            raise CommandError(f'{path}: {error}') from error
        return cls(plan, StudyFolder(folder or Path('runs') / plan.name), namespace)

    def run(self, code: str) -> int:
        """Take a person through all conditions that are left, in this terminal."""
        from humanopts_teach.commands.session import session, tell

        participant = self.enter(code)
        while (turn := self.next_turn(participant)) is not None:
            print('starting ...', flush=True)
            said: list[str] = []  # while the terminal is not ours
            try:
                with session(turn.setup, self.namespace, tell=said.append) as running:
                    status = running.launcher.run_terminal(running.interrupts.check)
                    running.graph.catch_up()
                    running.check_recording()
            finally:
                for line in said:
                    tell(line)
            if left := self.farewell(participant, turn):
                print(left)
                return running.end() or status
        print(self.finish(participant))
        return 0

    def simulate(self, code: str) -> None:
        """Let a simulated teacher take part, whose other answers are drawn by the seed."""
        from humanopts_teach.commands.session import NEWS_SECONDS, session, wait_until_taught
        from humanopts_teach.ros.convert import option_status_from_message
        from humanopts_teach.ros.study_events import published_record
        from humanopts_teach.study.record import TOPIC
        from humanopts_teach.study.simulated import simulated_part

        participant = self.enter(code, simulated=True)
        while (turn := self.next_turn(participant, simulated=True)) is not None:
            print(f'{code}: {turn.condition.name}', flush=True)
            with session(turn.setup, self.namespace) as running:

                def teach(running: 'Session' = running) -> 'list[OptionStatus]':
                    wait_until_taught(running)
                    return [
                        option_status_from_message(each) for _, each in running.graph.learned()
                    ]

                record = published_record(running.graph, participant.path, code)
                recorded = partial(running.graph.is_recorded, TOPIC)
                running.graph.wait(recorded, NEWS_SECONDS, f'the recorder of {TOPIC}')
                for part in turn.left:
                    simulated_part(part, record, self.plan.seed, participant.number, teach)
        self.finish(participant)

    def enter(self, code: str, *, simulated: bool = False) -> 'Participant':
        """
        Return who takes part.

        :raises CommandError: nobody can with this code, or the folder cannot be written.
        """
        from humanopts_teach.study.record import StudyError

        try:
            return self.folder.enter(self.plan, code, simulated=simulated)
        except StudyError as error:
            raise CommandError(str(error)) from error
        except OSError as error:
            raise CommandError(f'cannot write in {self.folder.path}: {error}') from error

    def next_turn(self, participant: 'Participant', *, simulated: bool = False) -> 'Turn | None':
        """
        Return the next condition of which a participant has parts left; None: there is none.

        :raises CommandError: its folder cannot be written.
        """
        from humanopts_teach.study.record import left_of, Record

        record = Record(participant.path)
        for condition, parts in self.plan.turns_of(participant.number):
            if left := left_of(parts, record):
                setup = self._setup(participant, condition, None if simulated else left)
                return Turn(condition, left, setup)
        return None

    def farewell(self, participant: 'Participant', turn: 'Turn') -> str:
        """Return why a participant does not go on after a turn; empty: the next one follows."""
        from humanopts_teach.study.record import ENDED, left_of, Record, REFUSED

        record = Record(participant.path)
        if record.refused:
            record.note(ENDED, why=REFUSED)
            return f'{participant.code} does not take part; nothing more is asked'
        if left_of(turn.left, record):
            return f'{participant.code} has not finished; the same code goes on'
        return ''

    def finish(self, participant: 'Participant') -> str:
        """Note that a participant has finished, and return it in words."""
        from humanopts_teach.study.record import ENDED, Record

        Record(participant.path).note(ENDED)
        return f'{participant.code} has finished; everything is in {self.folder.path}'

    def export(self, out: Path) -> None:
        """
        Write the tables, and Table 1 from the bags.

        :raises CommandError: the folder cannot be written.
        """
        from humanopts_teach.bags import BagError
        from humanopts_teach.bags.reader import open_bag
        from humanopts_teach.evaluation.table1 import named_options, table_text, tally
        from humanopts_teach.study.tables import tables

        named = []
        for path in sorted(self.folder.path.glob('*/*/bags/*')):
            try:
                named += named_options(open_bag(path))
            except BagError as error:
                print(printable(f'humanopts study export: left out: {error}'), file=sys.stderr)
        table_1 = table_text(tally(named, {}))
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name, table in tables(self.folder).items():
                table.to_csv(out / name, index=False)
                print(out / name)
            (out / 'table1.txt').write_text(f'{table_1}\n', encoding='utf-8')
        except OSError as error:
            raise CommandError(f'cannot write in {out}: {error.strerror}') from error
        print(printable(f'{out / "table1.txt"}\n\n{table_1}'))

    def _setup(
        self,
        participant: 'Participant',
        condition: 'Condition',
        left: 'Sequence[Part] | None' = None,
    ) -> 'Setup':
        """
        Return the launch of a condition.

        :param left: parts that a person has to do; None: a simulated teacher takes part.
        """
        from humanopts_env.domains.registry import make_domain
        from humanopts_teach.commands.demo import taught_options
        from humanopts_teach.commands.session import check_folder, new_name, setup_from
        from humanopts_teach.launching.processes import StudyTurn

        launch = LaunchOptions(
            out=self.folder.directory(participant, condition.name),
            seed=self.plan.seed + participant.number,
            strategy=condition.strategy,  # type: ignore[arg-type]  # the plan was checked
            learn=condition.learn,  # type: ignore[arg-type]
            budget=condition.budget,
            parameter=[f'{name}={value}' for name, value in condition.parameters.items()],
            namespace=self.namespace,
        )
        own: dict[str, Any] = {'taught': (), 'keyboard': True, 'step_period': _WATCHED}
        if left is None:
            domain = make_domain(condition.domain, dict(condition.parameters))
            own = {'taught': taught_options(domain), 'teacher_error_rate': _ERROR_RATE}
        parts = json.dumps([part.to_dict() for part in left or ()])
        turn = StudyTurn(self.plan.name, condition.name, parts, participant.path.absolute())
        setup = setup_from(
            condition.domain,
            launch,
            bag_name=new_name('bags/study'),
            participant=participant.code,
            ask_participant=False,
            study=turn,
            **own,
        )
        check_folder(setup)
        return setup
