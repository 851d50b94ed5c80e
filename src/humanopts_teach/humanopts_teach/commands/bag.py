"""
``humanopts bag``: the contents of a bag, the lessons in it, and its export to other tools.

Commands import modules when they run, so that help and completion are quick.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from functools import partial
import json as json_text
import os
from pathlib import Path
import sys
import time
from typing import Annotated, Any, Literal, TYPE_CHECKING

from humanopts_ros.limits import one_line, printable
from humanopts_teach.command_line import (
    CommandGroup,
    ExcelOption,
    flag,
    number,
    option,
    PLAIN,
    SegmentOptions,
    several_games,
    whole,
    with_options,
)
from humanopts_teach.commands import CommandError, refusing
import typer

if TYPE_CHECKING:
    from humanopts_teach.bags.reader import Bag
    from humanopts_teach.terminal.device import Device
    from humanopts_teach.terminal.replay import Replay

_MAX_WAIT = 0.2  # s until a window resize is detected

app = typer.Typer(**PLAIN, cls=CommandGroup, subcommand_metavar='COMMAND ...')
BagArgument = Annotated[Path, typer.Argument(metavar='BAG', help='a rosbag2 folder or .mcap file')]
BagArguments = Annotated[
    list[Path],
    typer.Argument(
        metavar='BAG', help='rosbag2 folders or .mcap files, each processed separately'
    ),
]
Namespace = Annotated[
    str,
    option(
        'NAME',
        'namespace of the graph to read, if the bag holds several; default: the recorded one',
        show_default=False,
    ),
]
Json = Annotated[bool, flag('--json', 'print JSON')]
speed_factor = number('from 1/16 to 64', lambda value: 1 / 16 <= value <= 64)


@contextmanager
def progress_bar() -> Iterator[Callable[..., None]]:
    """
    Show a progress bar on standard error, if that is a terminal.

    Yields a progress callback with arguments done, total and, optionally, the current task.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    progress = Progress(console=console, transient=True, disable=not console.is_terminal)
    # Without a terminal, Rich before version 14 would still print an empty line.
    with progress if console.is_terminal else nullcontext():
        task = progress.add_task('reading', total=None)

        def show(done: float, total: float, text: str = 'reading') -> None:
            progress.update(task, completed=done, total=total, description=text)

        yield show


@app.callback()
def bag() -> None:
    """Inspect and evaluate recorded bags; needs no ROS."""


@app.command()
def info(bags: BagArguments, namespace: Namespace = '', json: Json = False) -> int:
    """Show what bags hold and what was lost."""
    from humanopts_teach.bags.info import summarise
    from humanopts_teach.bags.reader import open_bag

    with progress_bar() as show:
        found = [summarise(open_bag(path, show, namespace)) for path in bags]
    if json:
        _print_json(*(each.to_dict() for each in found))
    else:
        _print('\n\n\n'.join(each.to_text() for each in found))
    return 0


@app.command()
def check(
    bag: BagArgument,
    repair: Annotated[
        Path | None,
        option('OUT', 'write everything that can be saved to this new folder'),
    ] = None,
    json: Json = False,
) -> int:
    """Show damaged and missing data in a bag; exit with status 1 if any."""
    from humanopts_teach.bags import BagWriteError
    from humanopts_teach.bags.check import check_bag
    from humanopts_teach.bags.check import repair as write_repaired
    from humanopts_teach.bags.reader import open_bag

    if repair is not None and repair.exists():
        raise CommandError(f'{repair} already exists; choose a new folder')
    with progress_bar() as show:
        opened = open_bag(bag, partial(show, text='checking'))
        found = check_bag(opened)
    if repair is not None:
        with refusing(BagWriteError), progress_bar() as show:
            opened.on_read = partial(show, text='writing')
            count = write_repaired(opened, repair)
        print(f'{repair}: {count} messages, all that could be saved', file=sys.stderr)
    if json:
        _print_json(found.to_dict())
    else:
        _print(found.to_text())
    return 0 if found.whole else 1


@app.command('eval')
def evaluate(
    bags: BagArguments,
    html: Annotated[Path | None, option('FILE', 'write a report to this file')] = None,
    games: Annotated[
        int,
        option(
            'N',
            'for sampled plans: compare them with random play and a hand-written rule in N '
            'games each; takes minutes; default: no comparison',
            whole(0),
            callback=several_games,
            show_default=False,
        ),
    ] = 0,
    namespace: Namespace = '',
    json: Json = False,
) -> int:
    """Learn every option again from the bag alone, and plan with it."""
    from humanopts_teach.bags.contents import read_domain
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.evaluation.bag_evaluation import check_games, evaluate_bag, with_games
    from humanopts_teach.evaluation.text import evaluation_text
    from humanopts_teach.report.write import write_evaluation_report

    if html:
        _check_report(html, len(bags))
    with progress_bar() as show:
        opened = [open_bag(path, show, namespace) for path in bags]
        for each in opened if games else ():
            check_games(read_domain(each))
        found = []
        for each in opened:
            evaluation = evaluate_bag(each, show)
            found.append(with_games(evaluation, games, show) if games else evaluation)
    if json:
        one = len(bags) == 1
        _print_json(
            *(
                {**({} if one else {'bag': str(b.path)}), **e.to_dict()}
                for b, e in zip(opened, found)
            )
        )
    else:
        heads = [f'bag {each.path}\n' if len(bags) > 1 else '' for each in opened]
        _print('\n\n'.join(head + evaluation_text(each) for head, each in zip(heads, found)))
    for each, evaluation in zip(opened, found):
        _warn('eval', each if len(bags) > 1 else None, evaluation.warnings)
    if html:
        with progress_bar() as show:
            opened[0].on_read = partial(show, text='reading for the report')
            write_evaluation_report(html, found[0], opened[0])
        print(f'report: {html}', file=sys.stderr)
    return 0


@app.command()
def play(
    bag: BagArgument,
    episode: Annotated[int, option('N', 'number of the episode in the bag', whole(1))] = 1,
    speed: Annotated[
        float,
        option('X', '1: two steps per second; 2: twice as fast', speed_factor),
    ] = 1.0,
    namespace: Namespace = '',
) -> int:
    """Replay an episode in this terminal, or as plain text without one."""
    from humanopts_teach.bags.contents import find_episodes, read_actors, read_domain
    from humanopts_teach.bags.mcap_file import ignore_progress
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.terminal.device import Device, why_not
    from humanopts_teach.terminal.replay import Replay

    with progress_bar() as show:
        opened = open_bag(bag, show, namespace)
        domain, episodes = read_domain(opened), find_episodes(opened)
        opened.on_read = ignore_progress  # later reads are short; the terminal is in use
    if episode > len(episodes):
        there = f'1 to {len(episodes)}' if episodes else 'none'
        raise CommandError(f'there is no episode {episode} in {opened.path}: {there}')
    replay = Replay(domain, episodes, partial(read_actors, opened), episode - 1, speed)
    if why_not():
        for text in replay.plain():
            _print(text)
    else:
        with Device() as device:
            _play(replay, device)
    return 0


@app.command()
def table1(
    bags: BagArguments,
    merge: Annotated[
        Path | None,
        option('FILE', 'YAML file with each option name and the list of its other wordings'),
    ] = None,
    namespace: Namespace = '',
    json: Json = False,
) -> int:
    """Count the options that people named, next to Table 1 of the paper."""
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.evaluation.table1 import (
        count_named,
        MergeError,
        named_options,
        read_merge,
        table_text,
    )

    with refusing(MergeError, what=f'{merge}: '):
        canonical = read_merge(merge) if merge is not None else {}
    with progress_bar() as show:
        opened = [open_bag(path, show, namespace) for path in bags]
        named = named_options(opened)
    tables = count_named(named, canonical)
    _print(_json([asdict(each) for each in tables]) if json else table_text(tables))
    for each in opened:
        _warn('table1', each if len(bags) > 1 else None, each.notes)
        if each.graph_facts.get('teacher_error_rate', 'None') != 'None':
            _warn(
                'table1', each, ['a simulated person taught it, who named no options of their own']
            )
    return 0


@app.command()
@with_options
def segment(
    bag: BagArgument,
    episode: Annotated[
        list[int],
        option('N', 'number of an episode to cut; may be repeated; default: all', whole(1)),
    ] = [],  # noqa: B006
    namespace: Namespace = '',
    *,
    cutting: SegmentOptions,
) -> int:
    """Cut whole plays into segments, and turn the named ones into demonstrations."""
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.commands.segments import cut_plays
    from humanopts_teach.plays import plays_in_bag

    with progress_bar() as show:
        opened = open_bag(bag, show, namespace)
        domain, plays = plays_in_bag(opened, episode)
    _print(cut_plays(domain, plays, cutting))
    _warn('segment', None, opened.notes)
    return 0


@app.command()
def export(
    bag: BagArgument,
    to: Annotated[
        Literal['csv', 'parquet', 'minari', 'files', 'runs'],
        typer.Option(
            help='parquet needs pyarrow; minari needs minari[arrow]; files: those attached to the '
            'bag, such as option files; runs: option runs, added to the file of the planner'
        ),
    ],
    out: Annotated[Path, option('DIR', 'folder for the files')],
    namespace: Namespace = '',
    excel: ExcelOption = False,
) -> int:
    """Write tables or a dataset for other tools."""
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.export import minari_dataset, option_runs, tables

    if excel and to != 'csv':
        raise CommandError('--excel is for --to csv')
    with refusing(OSError, what=f'cannot write in {out}: '), progress_bar() as show:
        opened = open_bag(bag, show, namespace)
        if to == 'minari':
            dataset_id, count = minari_dataset.write_dataset(opened, out)
            written = [
                f'{count} episodes; with {minari_dataset.FOLDER}={out} in the environment:\n'
                f'minari.load_dataset({dataset_id!r})'
            ]
        elif to == 'runs':
            path, count = option_runs.write_option_runs(opened, out)
            written = [f'{path}: {count} runs added']
        elif to == 'files':
            written = [one_line(str(path)) for path in tables.write_attached(opened, out)]
        else:
            found = tables.bag_tables(opened)
            written = list(map(str, tables.write_tables(found, out, to, excel=excel)))
    _print('\n'.join(written))
    _warn('export', None, opened.notes)
    return 0


def _print(text: str) -> None:
    """Print a text without the escape sequences that names in a bag may contain."""
    print(printable(text))


def _json(values: Any) -> str:
    return json_text.dumps(values, indent=2)


def _print_json(*values: Any) -> None:
    """Print the data of one bag, or a list for several, as JSON."""
    _print(_json(values[0] if len(values) == 1 else values))


def _warn(command: str, bag: 'Bag | None', warnings: Sequence[str]) -> None:
    """Print warnings, with the path of the bag if there are several bags."""
    prefix = f'{bag.path}: ' if bag is not None else ''
    for warning in warnings:
        line = one_line(f'humanopts bag {command}: {prefix}{warning}')
        print(printable(line), file=sys.stderr)


def _check_report(path: Path, bags: int) -> None:
    """Reject a report that cannot be written, before the evaluation starts."""
    if bags > 1:
        raise CommandError('--html reports on one bag: give one')
    if path.is_dir():
        raise CommandError(f'cannot write {path}: it is a folder')
    if not path.parent.is_dir():
        raise CommandError(f'cannot write {path}: there is no such folder')
    if not os.access(path.parent, os.W_OK):
        raise CommandError(f'cannot write {path}: the folder is not writable')


def _play(replay: 'Replay', device: 'Device') -> None:
    """Show a replay until the person quits or the terminal closes."""
    from humanopts_teach.dialogue.keys import SUSPEND

    shown = time.monotonic()
    while not replay.over and not device.closed:
        if not device.has_terminal():  # the process is suspended
            time.sleep(_MAX_WAIT)
            continue
        device.draw(replay.frame)
        due = shown + replay.seconds - time.monotonic()
        device.wait(min(max(due, 0.0), _MAX_WAIT) if replay.running else _MAX_WAIT)
        for key in device.read():
            if key == SUSPEND:
                device.suspend()
                break
            replay.press(key)
            shown = time.monotonic()
        if replay.running and time.monotonic() >= shown + replay.seconds:
            replay.advance()
            shown = time.monotonic()
