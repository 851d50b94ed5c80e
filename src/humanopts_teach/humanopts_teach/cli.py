"""The humanopts command line."""

import argparse
from collections.abc import Sequence
import importlib
from pathlib import Path
import sys

from humanopts_teach.commands.errors import CommandError
from humanopts_teach.launching.launcher import LaunchError

STRATEGIES = ('random', 'coverage', 'failures')


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog='humanopts', description='Teach options to a game-playing agent, and plan with them.'
    )
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    demo = commands.add_parser(
        'demo', help='the whole graph with a simulated teacher: a bag, options and a report'
    )
    demo.add_argument('--domain', default='taxi', help='default: %(default)s')
    demo.add_argument(
        '--episodes', type=_positive, default=100, help='to play; default: %(default)s'
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
    up.add_argument(
        '--step-period',
        type=float,
        default=0.0,
        help='seconds between steps of the machine, to watch it; default: %(default)s',
    )
    teach = commands.add_parser('teach', help="launch, and teach from this terminal's keyboard")
    teach.add_argument('domain', metavar='DOMAIN')
    teach.add_argument(
        '--participant', default='p1', help='code of the person; default: %(default)s'
    )
    for command in (demo, up, teach):
        _add_launch_options(command)
    _add_bag_commands(commands.add_parser('bag', help='look into a recorded bag, no ROS needed'))
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status: 0, 1 for a failure, 2 for bad input."""
    arguments = build_parser().parse_args(argv)
    module = importlib.import_module(f'humanopts_teach.commands.{arguments.command}')
    try:
        status: int = module.run(arguments)
    except CommandError as error:
        print(f'humanopts {arguments.command}: {error}', file=sys.stderr)
        return 2
    except LaunchError as error:
        print(f'humanopts {arguments.command}: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(
            f'humanopts {arguments.command}: interrupted; everything is stopped', file=sys.stderr
        )
        return 130
    except BrokenPipeError:
        return 0
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
    for command in (info, evaluate):
        command.add_argument(
            'bag', type=Path, metavar='BAG', help='a rosbag2 folder or .mcap file'
        )
        command.add_argument('--json', action='store_true', help='print JSON')


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f'{value} is below 0')
    return value


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'{value} is below 1')
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1:
        raise argparse.ArgumentTypeError(f'{value} is not from 0 to below 1')
    return value


if __name__ == '__main__':
    sys.exit(main())
