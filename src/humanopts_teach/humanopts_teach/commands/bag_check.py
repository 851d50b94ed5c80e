"""``humanopts bag check``: names what is damaged or missing, and saves the rest."""

import argparse
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
    bag = open_bag(arguments.bag)
    with progress_bar() as tell:
        check = check_bag(bag, lambda done, total: tell(done, total, 'checking'))
    if out is not None:
        try:
            with progress_bar() as tell:
                count = repair(bag, out, lambda done, total: tell(done, total, 'writing'))
        except BagWriteError as error:
            raise CommandError(str(error)) from error
        print(f'{out}: {count} messages, all that could be saved', file=sys.stderr)
    print(json.dumps(check.to_dict(), indent=2) if arguments.json else check.to_text())
    return 0 if check.whole else 1
