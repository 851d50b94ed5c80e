"""``humanopts bag check``: names what is damaged or missing, and saves the rest."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import json
import sys

from humanopts_teach.bags.check import check_bag, OnProgress
from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.repair import repair
from humanopts_teach.commands.errors import CommandError
from rich.console import Console
from rich.progress import Progress


def run(arguments: argparse.Namespace) -> int:
    """
    Check a bag, and repair it where that is asked.

    :raises BagError: there is no bag.
    """
    out = arguments.repair
    if out is not None and out.exists():
        raise CommandError(f'{out} exists already; name a folder that does not')
    bag = open_bag(arguments.bag)
    with _progress('checking') as tell:
        check = check_bag(bag, tell)
    if out is not None:
        try:
            with _progress('writing') as tell:
                count = repair(bag, out, tell)
        except BagWriteError as error:
            raise CommandError(str(error)) from error
        print(f'{out}: {count} messages, all that could be saved', file=sys.stderr)
    print(json.dumps(check.to_dict(), indent=2) if arguments.json else check.to_text())
    return 0 if check.whole else 1


@contextmanager
def _progress(text: str) -> Iterator[OnProgress]:
    """Show a bar on standard error where it is a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(text, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
