"""
The humanopts command line: one function per command, with its options as parameters.

Commands import their dependencies when they run, so that help and completion are fast.
"""

from collections.abc import Sequence
import errno
import importlib
from importlib.metadata import version
from importlib.util import find_spec
import os
import sys
from typing import Annotated, Any, Literal, TYPE_CHECKING

from humanopts_ros.environment import use_own_ros
from humanopts_ros.limits import accept_any_text, one_line, printable
from humanopts_teach.command_line import (
    CommandGroup,
    flag,
    LaunchOptions,
    OnlyOption,
    option,
    PageOptions,
    PLAIN,
    several_games,
    share,
    whole,
    with_options,
)
from humanopts_teach.commands import CommandError, interruptible
from humanopts_teach.commands.bag import app as bag_app
from humanopts_teach.commands.output import open_streams, silence
from humanopts_teach.commands.segments import app as import_app
from humanopts_teach.commands.study import app as study_app
from humanopts_teach.launching import LaunchError, OccupiedError
from humanopts_teach.launching.job import fork_launch
import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from humanopts_teach.launching.processes import Setup

NAME = 'humanopts'
COMPLETE = '_HUMANOPTS_COMPLETE'  # set by the shell to get completions
_UNWRITABLE = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO  # errors of standard output
# Optional module: extra of the package humanopts that installs it.
_EXTRAS = {
    'humanopts_interfaces': 'ros',
    'nicegui': 'browser',
    'fastapi': 'browser',
    'pyreadstat': 'study',
    'statsmodels': 'study',
    'gymnasium': 'worlds',
}
OUTSIDE = {  # commands available only in the repository: module of the Typer app, and help
    'bench': ('benchmarks.command', 'Run the benchmarks, each with a yardstick.'),
    'reproduce': ('experiments.command', "Recompute the paper's figures and tables."),
}


class OutsideCommand(TyperCommand):
    """A command of the repository, imported when it runs or shows its help."""

    def make_context(
        self, info_name: str | None, args: list[str], *others: Any, **more: Any
    ) -> Any:
        """Delegate argument parsing to the command."""
        module = importlib.import_module(OUTSIDE[str(self.name)][0])
        command = typer.main.get_command(module.app)
        return command.make_context(info_name, args, *others, **more)


class Commands(CommandGroup):
    """All commands, including those of the repository if available."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, (module, text) in OUTSIDE.items():
            if find_spec(module.partition('.')[0]):
                self.add_command(OutsideCommand(name, help=text))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command named by the first word."""
        if args[0] in OUTSIDE.keys() - self.commands:
            ctx.fail(f'{args[0]} needs a clone of the repository: run ./humanopts {args[0]} there')
        return super().resolve_command(ctx, args)


app = typer.Typer(
    **{**PLAIN, 'add_completion': True},
    name=NAME,
    cls=Commands,
    subcommand_metavar='COMMAND ...',
)
app.add_typer(bag_app, name='bag')
app.add_typer(import_app, name='import')
app.add_typer(study_app, name='study')


class DomainCommand(TyperCommand):
    """A command with a domain argument; its help lists the domains."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Add the list of domains; they are looked up only when help is shown."""
        from humanopts_env.domains.names import domain_names, GYMNASIUM, ROBOT

        known = ', '.join([*domain_names(), f'{GYMNASIUM}ENV_ID'])
        self.epilog = f'DOMAIN is one of {known}, or {ROBOT}FILE.yaml for a robot.'
        super().format_help(ctx, formatter)


DomainArgument = Annotated[str, typer.Argument(metavar='DOMAIN')]


def _version(asked: bool) -> None:
    if asked:
        print(version('humanopts_teach'))
        raise typer.Exit


@app.callback()
def humanopts(
    version: Annotated[
        bool, flag('--version', 'show the version and exit', callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Teach options to a game-playing agent, and plan with them."""


@app.command(cls=DomainCommand)
@with_options
def demo(
    domain: Annotated[str, typer.Argument(metavar='DOMAIN')] = 'taxi',
    option_domain: Annotated[str, typer.Option('--domain', hidden=True)] = '',
    episodes: Annotated[
        int | None,
        option('N', 'number of live episodes; default: 100, or 5 with sampled plans', whole(1)),
    ] = None,
    games: Annotated[
        int | None,
        option(
            'N',
            'number of games in which each policy is evaluated, with sampled plans; 0: '
            'no comparison; '
            'default: 1000, or 100 in worlds that are restored by replay',
            whole(0),
            callback=several_games,
        ),
    ] = None,
    game_steps: Annotated[
        int | None,
        option(
            'N',
            'number of game steps from which each sampled plan is made; default: '
            '800000, or 10000 in worlds '
            'that are restored by replay',
            whole(1),
        ),
    ] = None,
    error_rate: Annotated[
        float, option('SHARE', 'share of wrong steps of the simulated teacher', share)
    ] = 0.02,
    *,
    launch: LaunchOptions,
) -> int:
    """Run the whole graph with a simulated teacher, and report on the recorded bag."""
    from humanopts_teach.launching.forks import prepare

    prepare(option_domain or domain)
    from humanopts_teach.commands.demo import run_demo

    return run_demo(option_domain or domain, launch, episodes, games, game_steps or 0, error_rate)


def up_setup(
    domain: str, no_record: bool, only: str, taught: list[str], launch: LaunchOptions
) -> 'Setup':
    """Return the setup of ``up``; raise CommandError if an argument is invalid."""
    from humanopts_teach.commands.session import new_name, setup_from

    return setup_from(
        domain,
        launch,
        bag_name=new_name('bags/up'),
        record=not no_record,
        only=only,
        taught=tuple(taught),
    )


@app.command(cls=DomainCommand)
@with_options
def up(
    domain: DomainArgument,
    no_record: Annotated[bool, flag('--no-record', 'do not write a bag')] = False,
    only: OnlyOption = '',
    taught: Annotated[
        list[str],
        option('NAME', 'option that a simulated teacher teaches; may be repeated'),
    ] = [],  # noqa: B006
    *,
    launch: LaunchOptions,
) -> int:
    """Launch the nodes and run until Ctrl-C."""
    from humanopts_teach.launching.forks import prepare

    prepare(domain)
    from humanopts_teach.commands.session import print_line, run_until_interrupt, Session

    def started(running: Session) -> None:
        print('ready: ' + ', '.join(running.launcher.node_names))
        print(f'logs and data in {running.setup.directory}; Ctrl-C stops everything', flush=True)

    status = run_until_interrupt(
        up_setup(domain, no_record, only, taught, launch), started, print_line
    )
    print('stopped')
    return status


@app.command(cls=DomainCommand)
@with_options
def teach(
    domain: DomainArgument,
    participant: Annotated[
        str,
        option(
            'CODE',
            'code of the person: letters, digits, - and _, at most 60; default: ask',
            show_default=False,
        ),
    ] = '',
    picture: Annotated[
        Literal['yes', 'no'],
        typer.Option(help='no: show only a table of features, since a picture cannot hide any'),
    ] = 'yes',
    *,
    pages: PageOptions,
    only: OnlyOption = '',
    launch: LaunchOptions,
) -> int:
    """Launch the nodes, and teach from this terminal or from browsers."""
    from humanopts_teach.launching.forks import prepare
    from humanopts_teach.lesson.store import CODE, CODE_RULE
    from humanopts_teach.terminal.device import why_not

    if participant and not CODE.fullmatch(participant):
        raise CommandError(f'--participant {participant!r} is not a valid code: {CODE_RULE}')
    if pages.browser and only:
        raise CommandError('--only is not for --browser, where each page has nodes of its own')
    if not pages.browser:
        if fault := why_not():
            raise CommandError(f'{fault}; or teach in a browser: --browser')
        if (status := fork_launch()) is not None:
            return status
    prepare(domain)
    from humanopts_teach.commands.session import (
        check_folder,
        default_folder,
        known_code,
        new_name,
        run_in_terminal,
        Session,
        setup_from,
        WATCHED,
    )

    if participant and not pages.browser:
        folder = (launch.out or default_folder(domain)) / 'demonstrations'
        participant = known_code(participant, [each.stem for each in folder.glob('*.jsonl')])
    setup = setup_from(
        domain,
        launch,
        bag_name=new_name('bags/teach'),
        participant=participant or 'p1',
        ask_participant=not participant,
        keyboard=True,
        pictures=picture == 'yes',
        step_period=WATCHED,
        only=only,
    )
    if pages.browser:
        from humanopts_teach.commands.browser import teach_in_browser

        check_folder(setup)
        return teach_in_browser(setup, pages, participant)

    def print_paths(running: Session) -> None:
        print(f'demonstrations and options are in {setup.directory}')
        print(f'the bag is {running.bags[-1]}')

    return run_in_terminal(setup, print_paths)


@app.command()
def status(
    namespace: Annotated[str, option('NAME', 'namespace of the nodes; begins with /')] = '/',
    json: Annotated[bool, flag('--json', 'print JSON')] = False,
) -> int:
    """Show the status of a running graph: nodes, rates, recorder, restarts."""
    import json as json_text

    from humanopts_teach.commands.session import check_place
    from humanopts_teach.ros.graph_probe import probe_graph

    check_place(namespace)
    report = probe_graph(namespace)
    print(json_text.dumps(report.to_dict(), indent=2) if json else report.to_text())
    return report.status


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 for a failure, 2 for invalid input."""
    use_own_ros()
    open_streams()
    accept_any_text()
    words = list(sys.argv[1:] if argv is None else argv)
    command = typer.main.get_command(app)
    if COMPLETE in os.environ:
        command.main(words, prog_name=NAME)
    context = None
    try:
        with interruptible(), command.make_context(NAME, words) as context:
            status: int = command.invoke(context)
            sys.stdout.flush()
    except typer.Exit as end:
        return end.exit_code
    except typer.TyperException as error:
        usage = getattr(error, 'ctx', None)  # set for every usage error
        path = usage.command_path if usage else NAME
        text = ' '.join(error.format_message().split()).rstrip('.')
        return _complain(path, f'{text[:1].lower()}{text[1:]}; see {path} --help', 2)
    except KeyboardInterrupt:
        return _complain(_named(context), 'interrupted; everything is stopped', 130)
    except BrokenPipeError:  # the reader has exited, as in "humanopts bag info BAG | head"
        silence(sys.stdout)
        return 1
    except ModuleNotFoundError as error:
        extra = _EXTRAS.get(str(error.name).partition('.')[0])
        if extra is None:
            raise
        text = f"{error.name} is not installed; install it with: pip install 'humanopts[{extra}]'"
        return _complain(_named(context), text, 2)
    except Exception as error:
        if type(error).__module__.startswith('humanopts_'):  # its message explains the problem
            failed = isinstance(error, LaunchError) and not isinstance(error, OccupiedError)
            several = isinstance(error, LaunchError | CommandError)  # multi-line messages
            text = str(error) if several else one_line(str(error))
            return _complain(_named(context), text, 1 if failed else 2)
        if isinstance(error, OSError) and error.filename:
            text = one_line(f'cannot use {error.filename}: {error.strerror}')
            return _complain(_named(context), text, 2)
        if not isinstance(error, OSError) or error.errno not in _UNWRITABLE:
            raise
        silence(sys.stdout)
        return _complain(_named(context), f'cannot write its output: {error.strerror}', 1)
    return status


def _named(context: Any) -> str:
    """Return the command name for messages: humanopts and the subcommand."""
    called = context.invoked_subcommand if context is not None else None
    return f'{NAME} {called}' if called else NAME


def _complain(path: str, text: str, status: int) -> int:
    try:
        print(printable(f'{path}: {text}'), file=sys.stderr, flush=True)
    except OSError:  # no reader, or a full disk; the exit status is still returned
        silence(sys.stderr)
    return status
