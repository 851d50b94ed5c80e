"""
``humanopts bag``: what a recorded bag holds, what was taught in it, and its data for other tools.

What a command needs is imported when it runs, so that help and completion are quick.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
import json as json_text
import os
from pathlib import Path
import sys
import time
from typing import Annotated, Any, Literal, TextIO, TYPE_CHECKING

from humanopts_ros.limits import one_line, printable
from humanopts_ros.text_files import FileError
from humanopts_teach.command_line import (
    CommandGroup,
    ExcelOption,
    number,
    PLAIN,
    several_games,
    whole,
)
from humanopts_teach.commands import CommandError
import typer

if TYPE_CHECKING:
    from humanopts_teach.bags.reader import Bag
    from humanopts_teach.terminal.device import Device
    from humanopts_teach.terminal.replay import Replay

_LONGEST_WAIT = 0.2  # s, until a window of another size is seen

app = typer.Typer(**PLAIN, cls=CommandGroup, subcommand_metavar='COMMAND ...')
BagArgument = Annotated[Path, typer.Argument(metavar='BAG', help='a rosbag2 folder or .mcap file')]
BagArguments = Annotated[
    list[Path],
    typer.Argument(
        metavar='BAG', help='rosbag2 folders or .mcap files; each of several by itself'
    ),
]
Namespace = Annotated[
    str,
    typer.Option(
        metavar='NAME',
        show_default=False,
        help='of the graph to read, where the bag holds several; default: the one recorded',
    ),
]
Json = Annotated[bool, typer.Option('--json', help='print JSON')]
speed_factor = number('from 1/16 to 64', lambda value: 1 / 16 <= value <= 64)


@contextmanager
def progress_bar() -> Iterator[Callable[..., None]]:
    """
    Show a bar on standard error where it is a terminal.

    What is yielded takes how much is done, of how much and, where it is known, what is under way.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    progress = Progress(console=console, transient=True, disable=not console.is_terminal)
    # Where Rich before version 14 shows no bar, it still ends it with an empty line.
    with progress if console.is_terminal else nullcontext():
        task = progress.add_task('reading', total=None)

        def show(done: float, total: float, text: str = 'reading') -> None:
            progress.update(task, completed=done, total=total, description=text)

        yield show


@app.callback()
def bag() -> None:
    """Look into a recorded bag, no ROS needed."""


@app.command()
def info(bags: BagArguments, namespace: Namespace = '', json: Json = False) -> int:
    """Show what bags hold and what was lost."""
    from humanopts_teach.bags.info import summarise
    from humanopts_teach.bags.reader import open_bag

    with progress_bar() as show:
        found = [summarise(open_bag(path, show, namespace)) for path in bags]
    if json:
        listed = [each.to_dict() for each in found]
        _print(_json(listed if len(bags) > 1 else listed[0]))
    else:
        _print('\n\n\n'.join(each.to_text() for each in found))
    return 0


@app.command()
def check(
    bag: BagArgument,
    repair: Annotated[
        Path | None,
        typer.Option(metavar='OUT', help='write all that can be saved to this new folder'),
    ] = None,
    json: Json = False,
) -> int:
    """Show what is damaged or missing in a bag; status 1: something is."""
    from humanopts_teach.bags import BagWriteError
    from humanopts_teach.bags.check import check_bag
    from humanopts_teach.bags.check import repair as write_repaired
    from humanopts_teach.bags.reader import open_bag

    if repair is not None and repair.exists():
        raise CommandError(f'{repair} exists already; name a folder that does not')
    with progress_bar() as show:
        opened = open_bag(bag, partial(show, text='checking'))
        found = check_bag(opened)
    if repair is not None:
        try:
            with progress_bar() as show:
                opened.on_read = partial(show, text='writing')
                count = write_repaired(opened, repair)
        except BagWriteError as error:
            raise CommandError(one_line(str(error))) from error
        print(f'{repair}: {count} messages, all that could be saved', file=sys.stderr)
    _print(_json(found.to_dict()) if json else found.to_text())
    return 0 if found.whole else 1


@app.command('eval')
def evaluate(
    bags: BagArguments,
    html: Annotated[
        Path | None, typer.Option(metavar='FILE', help='write a report to this file')
    ] = None,
    games: Annotated[
        int,
        typer.Option(
            parser=whole(0),
            metavar='N',
            callback=several_games,
            show_default=False,
            help='also compare plans with random play and a hand-written rule in N games '
            'each, where plans are made from samples; takes minutes; default: not',
        ),
    ] = 0,
    namespace: Namespace = '',
    json: Json = False,
) -> int:
    """Learn every option again from the bag alone, and plan with it."""
    from humanopts_env.domains.base import StateError
    from humanopts_teach.bags.contents import read_domain
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.evaluation.bag_evaluation import check_games, evaluate_bag, with_games
    from humanopts_teach.evaluation.summary import SummaryError
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
    if json and len(bags) > 1:
        print(_json([{'bag': str(b.path), **e.to_dict()} for b, e in zip(opened, found)]))
    elif json:
        print(_json(found[0].to_dict()))
    else:
        heads = [f'bag {each.path}\n' if len(bags) > 1 else '' for each in opened]
        _print('\n\n'.join(head + evaluation_text(each) for head, each in zip(heads, found)))
    for each, evaluation in zip(opened, found):
        _warn('eval', each if len(bags) > 1 else None, evaluation.warnings)
    if html:
        with progress_bar() as show:
            opened[0].on_read = partial(show, text='reading for the report')
            try:
                write_evaluation_report(html, found[0], opened[0])
            except (StateError, SummaryError) as error:
                raise CommandError(one_line(f'no report: {error}')) from error
        print(f'report: {html}', file=sys.stderr)
    return 0


@app.command()
def play(
    bag: BagArgument,
    episode: Annotated[
        int, typer.Option(parser=whole(1), metavar='N', help='number of the episode in the bag')
    ] = 1,
    speed: Annotated[
        float,
        typer.Option(
            parser=speed_factor, metavar='X', help='1 is two steps a second, 2 is twice as fast'
        ),
    ] = 1.0,
    namespace: Namespace = '',
) -> int:
    """Play an episode again in this terminal; as plain text where this is no terminal."""
    from humanopts_env.domains.base import StateError
    from humanopts_teach.bags.contents import find_episodes, read_actors, read_domain
    from humanopts_teach.bags.mcap_file import ignore_progress
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.terminal.device import Device, why_not
    from humanopts_teach.terminal.replay import Replay

    with progress_bar() as show:
        opened = open_bag(bag, show, namespace)
        domain, episodes = read_domain(opened), find_episodes(opened)
        opened.on_read = ignore_progress  # the rest is read quickly, while the screen is drawn
    if episode > len(episodes):
        there = f'1 to {len(episodes)}' if episodes else 'none'
        raise CommandError(f'there is no episode {episode} in {opened.path}: {there}')
    replay = Replay(domain, episodes, partial(read_actors, opened), episode - 1, speed)
    try:
        if why_not():
            for text in replay.plain():
                _print(text)
        else:
            with Device() as device:
                _play(replay, device)
    except StateError as error:
        raise CommandError(one_line(f'{opened.path}: {error}')) from error
    return 0


@app.command()
def table1(
    bags: BagArguments,
    merge: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE',
            help='YAML: each name with the list of its wordings, which are one option',
        ),
    ] = None,
    namespace: Namespace = '',
    json: Json = False,
) -> int:
    """Count the options that people named, beside Table 1 of the paper."""
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.evaluation.table1 import (
        count_named,
        MergeError,
        named_options,
        read_merge,
        table_text,
    )

    try:
        canonical = read_merge(merge) if merge is not None else {}
    except FileError as error:
        raise CommandError(str(error)) from error
    except MergeError as error:
        raise CommandError(f'{merge}: {error}') from error
    with progress_bar() as show:
        opened = [open_bag(path, show, namespace) for path in bags]
        named = named_options(opened)
    tables = count_named(named, canonical)
    _print(_json([each.to_dict() for each in tables]) if json else table_text(tables))
    for each in opened:
        _warn('table1', each if len(bags) > 1 else None, each.notes)
        if each.graph_facts.get('teacher_error_rate', 'None') != 'None':
            _warn('table1', each, ['a simulated person taught: nobody had a wish'])
    return 0


@app.command()
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
    namespace: Namespace = '',
    excel: ExcelOption = False,
) -> int:
    """Write tables or a dataset for other tools."""
    from humanopts_env.domains.base import StateError
    from humanopts_teach.bags.reader import open_bag
    from humanopts_teach.export import minari_dataset, tables

    if excel and to != 'csv':
        raise CommandError('--excel is for --to csv')
    try:
        with progress_bar() as show:
            opened = open_bag(bag, show, namespace)
            if to == 'minari':
                dataset_id, count = minari_dataset.write_dataset(opened, out)
                written = [
                    f'{count} episodes; with {minari_dataset.FOLDER}={out} in the environment:\n'
                    f'minari.load_dataset({dataset_id!r})'
                ]
            elif to == 'files':
                written = [one_line(str(path)) for path in tables.write_attached(opened, out)]
            else:
                found = tables.bag_tables(opened)
                written = list(map(str, tables.write_tables(found, out, to, excel=excel)))
    except (tables.ExportError, StateError) as error:
        raise CommandError(one_line(str(error))) from error
    except OSError as error:
        raise CommandError(f'cannot write in {out}: {error.strerror or error}') from error
    _print('\n'.join(written))
    _warn('export', None, opened.notes)
    return 0


def _print(text: str, file: TextIO | None = None) -> None:
    """Print what a bag holds: no escape sequence in a name reaches the terminal."""
    print(printable(text), file=file)


def _json(values: Any) -> str:
    return json_text.dumps(values, indent=2)


def _warn(command: str, bag: 'Bag | None', warnings: Sequence[str]) -> None:
    """Print what was assumed or left out; of one of several bags, with its path."""
    prefix = f'{bag.path}: ' if bag is not None else ''
    for warning in warnings:
        _print(one_line(f'humanopts bag {command}: {prefix}{warning}'), sys.stderr)


def _check_report(path: Path, bags: int) -> None:
    """Refuse a report before the work for it."""
    if bags > 1:
        raise CommandError('--html reports on one bag: give one')
    if path.is_dir():
        raise CommandError(f'cannot write {path}: it is a folder')
    if not path.parent.is_dir():
        raise CommandError(f'cannot write {path}: there is no such folder')
    if not os.access(path.parent, os.W_OK):
        raise CommandError(f'cannot write {path}: the folder is not writable')


def _play(replay: 'Replay', device: 'Device') -> None:
    """Draw until the person quits or the terminal is gone."""
    from humanopts_teach.dialogue.keys import SUSPEND

    shown = time.monotonic()
    while not replay.over and not device.closed:
        if not device.ours():  # suspended
            time.sleep(_LONGEST_WAIT)
            continue
        device.draw(replay.frame)
        due = shown + replay.seconds - time.monotonic()
        device.wait(min(max(due, 0.0), _LONGEST_WAIT) if replay.running else _LONGEST_WAIT)
        for key in device.read():
            if key == SUSPEND:
                device.suspend()
                break
            replay.press(key)
            shown = time.monotonic()
        if replay.running and time.monotonic() >= shown + replay.seconds:
            replay.advance()
            shown = time.monotonic()
