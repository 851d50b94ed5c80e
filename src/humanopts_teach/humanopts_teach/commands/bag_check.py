"""``humanopts bag check``: names what is damaged or missing, and saves the rest."""

import argparse
from functools import partial
import json
import sys

from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.repair import repair
from humanopts_teach.commands.bar import progress_bar
from humanopts_teach.commands.errors import CommandError


def run(arguments: argparse.Namespace) -> int:
    """
    Check a bag, and repair it where that is asked.

    :raises BagError: there is no bag.
    """
    out = arguments.repair
    if out is not None and out.exists():
        raise CommandError(f'{out} exists already; name a folder that does not')
    with progress_bar() as tell:
        bag = open_bag(arguments.bag, partial(tell, text='checking'))
        check = check_bag(bag)
    if out is not None:
        try:
            with progress_bar() as tell:
                bag.on_read = partial(tell, text='writing')
                count = repair(bag, out)
        except BagWriteError as error:
            raise CommandError(str(error)) from error
        print(f'{out}: {count} messages, all that could be saved', file=sys.stderr)
    print(json.dumps(check.to_dict(), indent=2) if arguments.json else check.to_text())
    return 0 if check.whole else 1
