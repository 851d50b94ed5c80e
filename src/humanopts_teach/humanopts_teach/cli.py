"""The humanopts command line."""

import argparse
from collections.abc import Sequence
import importlib
import os
from pathlib import Path
import sys
from typing import NoReturn

from humanopts_teach.bags.provenance import software
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.commands.recording import add_recording_options
from humanopts_teach.commands.signals import interruptible
from humanopts_teach.demos.store import CODE, CODE_RULE
from humanopts_teach.launching.launcher import LaunchError

REPRODUCED = ('fig2', 'fig3', 'fig4', 'table2', 'all')
SECTIONS = ('planning', 'learning', 'games', 'graph', 'recording')
EXPORTED = ('csv', 'parquet', 'minari', 'files')
OUTSIDE = {'bench': 'benchmarks.command', 'reproduce': 'experiments.command'}  # of the repository
STRATEGIES = ('random', 'coverage', 'failures')


class Parser(argparse.ArgumentParser):
    """A parser that refuses bad input in one line."""

    def error(self, message: str) -> NoReturn:
        """End with status 2."""
        self.exit(2, f'{self.prog}: {message}; see {self.prog} --help\n')


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog='humanopts', description='Teach options to a game-playing agent, and plan with them.'
    )
    parser.add_argument('--version', action='version', version=software()['humanopts_version'])
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    demo = commands.add_parser(
        'demo', help='the whole graph with a simulated teacher: a bag, options and a report'
    )
    demo.add_argument('--domain', default='taxi', help='default: %(default)s')
    demo.add_argument(
        '--episodes',
        type=_positive,
        help='to play live; default: 100, or 5 where plans are made from samples',
    )
    demo.add_argument(
        '--games',
        type=_games,
        default=1000,
        help='that each way to play is judged by where plans are made from samples; 0: leave the '
        'comparison out; default: %(default)s',
    )
    demo.add_argument(
        '--error-rate',
        type=_share,
        default=0.02,
        help="share of the simulated teacher's steps that are wrong; default: %(default)s",
    )
    up = commands.add_parser('up', help='launch the nodes and stay until Ctrl-C')
    up.add_argument('domain', metavar='DOMAIN')
    up.add_argument('--no-record', dest='record', action='store_false', help='do not write a bag')
    teach = commands.add_parser('teach', help="launch, and teach from this terminal's keyboard")
    teach.add_argument('domain', metavar='DOMAIN')
    teach.add_argument(
        '--participant',
        type=_code,
        default='p1',
        help=f'code of the person: {CODE_RULE}; default: %(default)s',
    )
    for command in (demo, up, teach):
        _add_launch_options(command)
        add_recording_options(command)
        command.add_argument(
            '--step-period',
            type=_seconds,
            default=0.0,
            help='seconds between steps of the machine, to watch it; default: %(default)s',
        )
    teach.set_defaults(step_period=0.15)
    demo.set_defaults(step_period=0.02 if sys.stdout.isatty() else 0.0)
    _add_bench_options(
        commands.add_parser('bench', help='how long things take, each beside a yardstick')
    )
    _add_bag_commands(commands.add_parser('bag', help='look into a recorded bag, no ROS needed'))
    _add_reproduce_options(
        commands.add_parser('reproduce', help="the paper's figures and tables, computed again")
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status: 0, 1 for a failure, 2 for bad input."""
    arguments = build_parser().parse_args(argv)
    try:
        name = OUTSIDE.get(arguments.command, f'humanopts_teach.commands.{arguments.command}')
        with interruptible():
            module = importlib.import_module(name)
            status: int = module.run(arguments)
            sys.stdout.flush()
    except CommandError as error:
        return _complain(arguments.command, str(error), 2)
    except LaunchError as error:
        return _complain(arguments.command, str(error), 1)
    except KeyboardInterrupt:
        return _complain(arguments.command, 'interrupted; everything is stopped', 130)
    except BrokenPipeError:  # nobody reads on, as in "humanopts bag info BAG | head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return status


def _complain(command: str, text: str, status: int) -> int:
    print(f'humanopts {command}: {text}', file=sys.stderr)
    return status


def _add_launch_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        '--out',
        type=Path,
        help='folder for bags, options and logs; default: runs/DOMAIN, and a new one for demo',
    )
    command.add_argument('--seed', type=_natural, default=1, help='default: %(default)s')
    command.add_argument(
        '--strategy',
        choices=STRATEGIES,
        default='failures',
        help='how start states are chosen; default: %(default)s',
    )
    command.add_argument(
        '--budget',
        type=_positive,
        default=150,
        help='most start states shown for an option; default: %(default)s',
    )
    for name, kind, what in (
        ('return-delta', _number, 'reward units by which its held-out return may fall short'),
        ('initiation-error', _share, 'share that its held-out I may get wrong'),
        ('termination-error', _share, 'share that its held-out β may get wrong'),
    ):
        command.add_argument(
            f'--{name}', type=kind, help=f'of an option: {what}; default: usual in the domain'
        )
    command.add_argument(
        '--parameter',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='a parameter of the domain, such as rows=7; may be repeated',
    )
    command.add_argument('--namespace', default='/', help='of the nodes; default: %(default)s')


def _add_bag_commands(bag: argparse.ArgumentParser) -> None:
    commands = bag.add_subparsers(dest='bag_command', required=True, metavar='COMMAND')
    info = commands.add_parser('info', help='what a bag holds, and what of it was lost')
    evaluate = commands.add_parser('eval', help='learn every option again from the bag alone')
    evaluate.add_argument('--html', type=Path, help='write a report to this file')
    evaluate.add_argument(
        '--games',
        type=_games,
        default=0,
        help='also compare plans with chance and a hand-written rule in so many games each, where '
        'plans are made from samples; takes minutes; default: not',
    )
    check = commands.add_parser(
        'check', help='what of a bag is damaged or missing; status 1: something is'
    )
    check.add_argument(
        '--repair', type=Path, metavar='OUT', help='write all that can be saved to this new folder'
    )
    differ = commands.add_parser(
        'diff', help='what differs between two lessons; status 1: it does'
    )
    play = commands.add_parser('play', help='an episode again, as text, in this terminal')
    play.add_argument(
        '--episode',
        type=_positive,
        default=1,
        metavar='N',
        help='counted from the first in the bag; default: %(default)s',
    )
    play.add_argument(
        '--speed',
        type=_speed,
        default=1.0,
        metavar='X',
        help='2 is twice as fast; default: %(default)s, two steps a second',
    )
    export = commands.add_parser('export', help='tables or a dataset for other tools')
    export.add_argument(
        '--to',
        choices=EXPORTED,
        required=True,
        help='csv; parquet, which needs pyarrow; minari, which needs minari[arrow]; files, which '
        'are those attached to the bag, such as option files',
    )
    export.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='folder for the files'
    )
    what = 'a rosbag2 folder or .mcap file'
    for command in (info, check, play, export):
        command.add_argument('bag', type=Path, metavar='BAG', help=what)
    for name in ('a', 'b'):
        differ.add_argument(name, type=Path, metavar=name.upper(), help=what)
    evaluate.add_argument(
        'bags', type=Path, nargs='+', metavar='BAG', help=f'{what}; each of several by itself'
    )
    for command in (info, check, evaluate, differ):
        command.add_argument('--json', action='store_true', help='print JSON')


def _add_reproduce_options(reproduce: argparse.ArgumentParser) -> None:
    reproduce.add_argument('what', choices=REPRODUCED, help='a figure or table, or all of them')
    reproduce.add_argument(
        '--out',
        type=Path,
        required=True,
        metavar='DIR',
        help='folder for the report; what was computed into it before is not computed again',
    )
    reproduce.add_argument(
        '--participants',
        type=_positive,
        default=6,
        metavar='N',
        help='simulated, in each group; default: %(default)s',
    )
    reproduce.add_argument(
        '--seeds',
        type=_positive,
        default=10,
        metavar='N',
        help='runs of what goes by chance; default: %(default)s',
    )
    reproduce.add_argument('--seed', type=_natural, default=1, help='default: %(default)s')
    reproduce.add_argument(
        '--jobs', type=_positive, metavar='N', help='processes; default: one for each core'
    )
    reproduce.add_argument(
        '--dask',
        default='',
        metavar='ADDRESS',
        help='of a Dask scheduler whose workers compute instead, such as tcp://127.0.0.1:8786',
    )
    reproduce.add_argument(
        '--bags',
        type=Path,
        nargs='+',
        default=[],
        metavar='BAG',
        help='recorded lessons of people, in place of simulated ones',
    )


def _add_bench_options(bench: argparse.ArgumentParser) -> None:
    bench.add_argument('--json', type=Path, metavar='FILE', help='write everything to this file')
    bench.add_argument(
        '--figure',
        type=Path,
        metavar='FILE',
        help='draw planning time against states to this file, .svg or .png',
    )
    bench.add_argument(
        '--only',
        type=_sections,
        default=SECTIONS,
        metavar='NAME,NAME',
        help=f'sections to measure, of {", ".join(SECTIONS)}; default: all',
    )
    bench.add_argument(
        '--quick', action='store_true', help='small sizes, to see that it works; times mean little'
    )


def _sections(text: str) -> tuple[str, ...]:
    names = text.split(',')
    for name in names:
        if name not in SECTIONS:
            raise argparse.ArgumentTypeError(f'{name!r} is none of {", ".join(SECTIONS)}')
    return tuple(name for name in SECTIONS if name in names)


def _natural(text: str) -> int:
    return _whole(text, 0)


def _positive(text: str) -> int:
    return _whole(text, 1)


def _games(text: str) -> int:
    count = _natural(text)
    if count == 1:
        raise argparse.ArgumentTypeError('one game has no interval; give 0, or 2 or more')
    return count


def _whole(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not a whole number') from None
    if not least <= value < 2**31:
        raise argparse.ArgumentTypeError(f'{text} is not from {least} to {2**31 - 1}')
    return value


def _share(text: str) -> float:
    value = _number(text)
    if not 0 <= value < 1:
        raise argparse.ArgumentTypeError(f'{text} is not from 0 to below 1')
    return value


def _speed(text: str) -> float:
    value = _number(text)
    if not 1 / 16 <= value <= 64:
        raise argparse.ArgumentTypeError(f'{text} is not from 1/16 to 64')
    return value


def _seconds(text: str) -> float:
    value = _number(text)
    if not 0 <= value <= 60:
        raise argparse.ArgumentTypeError(f'{text} is not from 0 to 60')
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not a number') from None


def _code(text: str) -> str:
    if not CODE.fullmatch(text):
        raise argparse.ArgumentTypeError(f'{text!r} is not a code: {CODE_RULE}')
    return text


if __name__ == '__main__':
    sys.exit(main())
