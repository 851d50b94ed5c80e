"""
The humanopts command line: a function for each command, whose signature is its options.

The work is imported when a command runs, so that help and completion are quick.
"""

from collections.abc import Sequence
import importlib
from importlib.metadata import version
from importlib.util import find_spec
import os
from pathlib import Path
import sys
from typing import Annotated, Any, Literal

from humanopts_teach.bags.errors import BagError
from humanopts_teach.commands.ending import CommandError, interruptible
from humanopts_teach.commands.options import (
    LaunchOptions,
    number,
    PLAIN,
    share,
    whole,
    with_launch_options,
)
from humanopts_teach.launching import LaunchError
import typer
from typer.core import TyperCommand, TyperGroup

NAME = 'humanopts'
COMPLETE = '_HUMANOPTS_COMPLETE'  # set by the shell, for a list of completions
OUTSIDE = {  # commands of the repository: the module that has the Typer app, and a line of help
    'bench': ('benchmarks.command', 'how long things take, each beside a yardstick'),
    'reproduce': ('experiments.command', "the paper's figures and tables, computed again"),
}

speed = number('from 1/16 to 64', lambda value: 1 / 16 <= value <= 64)


class OutsideCommand(TyperCommand):
    """A command of the repository; what it needs is imported when it runs, or shows its help."""

    def make_context(
        self, info_name: str | None, args: list[str], *others: Any, **more: Any
    ) -> Any:
        """Let the command itself read its words."""
        module = importlib.import_module(OUTSIDE[str(self.name)][0])
        command = typer.main.get_command(module.app)
        return command.make_context(info_name, args, *others, **more)


class Commands(TyperGroup):
    """The commands; unknown ones are refused with the names of those that there are."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        if self.name == NAME:
            for name, (module, text) in OUTSIDE.items():
                if find_spec(module.partition('.')[0]):
                    self.add_command(OutsideCommand(name, help=text))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first word names."""
        if not args[0].startswith('-') and args[0] not in self.commands:
            ctx.fail(f'there is no command {args[0]!r}; there are {", ".join(self.commands)}')
        return super().resolve_command(ctx, args)


SETTINGS: dict[str, Any] = {**PLAIN, 'cls': Commands, 'subcommand_metavar': 'COMMAND ...'}
app = typer.Typer(**{**SETTINGS, 'add_completion': True}, name=NAME)
bag_app = typer.Typer(**SETTINGS)
app.add_typer(bag_app, name='bag', help='look into a recorded bag, no ROS needed')

DomainArgument = Annotated[str, typer.Argument(metavar='DOMAIN')]
BagArgument = Annotated[Path, typer.Argument(metavar='BAG', help='a rosbag2 folder or .mcap file')]
Json = Annotated[bool, typer.Option('--json', help='print JSON')]


def _version(asked: bool) -> None:
    if asked:
        print(version('humanopts_teach'))
        raise typer.Exit


def _games(count: int) -> int:
    if count == 1:
        raise typer.BadParameter('one game has no interval; give 0, or 2 or more')
    return count


@app.callback()
def humanopts(
    version: Annotated[
        bool, typer.Option('--version', callback=_version, is_eager=True, help='show it, and end')
    ] = False,
) -> None:
    """Teach options to a game-playing agent, and plan with them."""


@app.command(help='the whole graph with a simulated teacher: bag, options, report')
@with_launch_options
def demo(
    launch: LaunchOptions,
    domain: str = 'taxi',
    episodes: Annotated[
        int | None,
        typer.Option(
            parser=whole(1),
            metavar='N',
            help='to play live; default: 100, or 5 where plans are made from samples',
        ),
    ] = None,
    games: Annotated[
        int,
        typer.Option(
            parser=whole(0),
            metavar='N',
            callback=_games,
            help='that each way to play is judged by where plans are made from samples; 0: leave '
            'the comparison out',
        ),
    ] = 1000,
    error_rate: Annotated[
        float,
        typer.Option(
            parser=share,
            metavar='SHARE',
            help="share of the simulated teacher's steps that are wrong",
        ),
    ] = 0.02,
) -> int:
    """Teach, plan, play, evaluate the bag and report."""
    from humanopts_teach.commands.demo import run_demo

    return run_demo(domain, launch, episodes, games, error_rate)


@app.command(help='launch the nodes and stay until Ctrl-C')
@with_launch_options
def up(
    launch: LaunchOptions,
    domain: DomainArgument,
    no_record: Annotated[bool, typer.Option('--no-record', help='do not write a bag')] = False,
) -> int:
    """Launch the nodes and stay."""
    from humanopts_teach.commands.launch import stay_up

    return stay_up(domain, launch, record=not no_record)


@app.command(help="launch, and teach from this terminal's keyboard")
@with_launch_options
def teach(
    launch: LaunchOptions,
    domain: DomainArgument,
    participant: Annotated[
        str,
        typer.Option(
            metavar='CODE', help='of the person: letters, digits, - and _, at most 60 of them'
        ),
    ] = 'p1',
) -> int:
    """Launch the graph and give the terminal to the person."""
    from humanopts_teach.commands.launch import teach_here

    return teach_here(domain, launch, participant)


@bag_app.callback()
def bag() -> None:
    """Look into a recorded bag."""


@bag_app.command(help='what a bag holds, and what of it was lost')
def info(bag: BagArgument, json: Json = False) -> int:
    """Show what a bag holds."""
    from humanopts_teach.commands.bag import show_info

    return show_info(bag, as_json=json)


@bag_app.command(help='what of a bag is damaged or missing; status 1: something is')
def check(
    bag: BagArgument,
    repair: Annotated[
        Path | None,
        typer.Option(metavar='OUT', help='write all that can be saved to this new folder'),
    ] = None,
    json: Json = False,
) -> int:
    """Check a bag, and repair it where that is asked."""
    from humanopts_teach.commands.bag import check

    return check(bag, repair, as_json=json)


@bag_app.command('eval', help='learn every option again from the bag alone')
def evaluate(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG', help='rosbag2 folders or .mcap files; each of several by itself'
        ),
    ],
    html: Annotated[
        Path | None, typer.Option(metavar='FILE', help='write a report to this file')
    ] = None,
    games: Annotated[
        int,
        typer.Option(
            parser=whole(0),
            metavar='N',
            callback=_games,
            show_default=False,
            help='also compare plans with random play and a hand-written rule in so many games '
            'each, where plans are made from samples; takes minutes; default: not',
        ),
    ] = 0,
    json: Json = False,
) -> int:
    """Evaluate bags, and report on one."""
    from humanopts_teach.commands.bag_evaluation import evaluate

    return evaluate(bags, html, games, as_json=json)


@bag_app.command(help='what differs between two lessons; status 1: it does')
def diff(
    a: Annotated[Path, typer.Argument(metavar='A', help='a rosbag2 folder or .mcap file')],
    b: Annotated[Path, typer.Argument(metavar='B', help='another one')],
    json: Json = False,
) -> int:
    """Compare two bags."""
    from humanopts_teach.commands.bag_evaluation import show_differences

    return show_differences(a, b, as_json=json)


@bag_app.command(help='an episode again, as text, in this terminal')
def play(
    bag: BagArgument,
    episode: Annotated[
        int,
        typer.Option(parser=whole(1), metavar='N', help='counted from the first in the bag'),
    ] = 1,
    speed: Annotated[
        float,
        typer.Option(
            parser=speed, metavar='X', help='1 is two steps a second, 2 is twice as fast'
        ),
    ] = 1.0,
) -> int:
    """Play an episode."""
    from humanopts_teach.commands.bag import play

    return play(bag, episode, speed)


@bag_app.command(help='tables or a dataset for other tools')
def export(
    bag: BagArgument,
    to: Annotated[
        Literal['csv', 'parquet', 'minari', 'files'],
        typer.Option(
            help='parquet needs pyarrow; minari needs minari[arrow]; files are those attached to '
            'the bag, such as option files'
        ),
    ],
    out: Annotated[Path, typer.Option(metavar='DIR', help='folder for the files')],
) -> int:
    """Write a bag for other tools."""
    from humanopts_teach.commands.bag_export import export

    return export(bag, to, out)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status: 0, 1 for a failure, 2 for bad input."""
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
        place = getattr(error, 'ctx', None)  # of every usage error
        path = place.command_path if place else NAME
        text = ' '.join(error.format_message().split()).rstrip('.')
        return _complain(path, f'{text[:1].lower()}{text[1:]}; see {path} --help', 2)
    except (CommandError, BagError) as error:
        return _complain(_named(context), str(error), 2)
    except LaunchError as error:
        return _complain(_named(context), str(error), 1)
    except KeyboardInterrupt:
        return _complain(_named(context), 'interrupted; everything is stopped', 130)
    except BrokenPipeError:  # nobody reads on, as in "humanopts bag info BAG | head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return status


def _named(context: Any) -> str:
    """Return what the command line is called in messages: humanopts and its first word."""
    called = context.invoked_subcommand if context is not None else None
    return f'{NAME} {called}' if called else NAME


def _complain(path: str, text: str, status: int) -> int:
    print(f'{path}: {text}', file=sys.stderr)
    return status


if __name__ == '__main__':
    sys.exit(main())
