"""``humanopts up DOMAIN``: launch the nodes and stay."""

import argparse
from functools import partial
import sys

from humanopts_teach.commands.session import check_setup, session
from humanopts_teach.commands.setup import default_folder, new_name, setup_from
from humanopts_teach.launching.launcher import RECORDER


def run(arguments: argparse.Namespace) -> int:
    """
    Launch and stay until Ctrl-C or SIGTERM, which is the way to end it.

    :raises LaunchError: a node died, or nothing was recorded any more at the end.
    """
    setup = setup_from(
        arguments,
        default_folder(arguments.domain),
        bag_name=new_name('bags/up'),
        record=arguments.record,
    )
    check_setup(setup)
    running = None
    try:
        with session(setup, arguments.namespace) as running:
            print('ready: ' + ', '.join(running.launcher.node_names))
            print(f'logs and data in {setup.directory}; Ctrl-C stops everything', flush=True)
            check = partial(running.launcher.check, RECORDER)
            try:
                running.conductor.stay(check, partial(print, file=sys.stderr, flush=True))
            except KeyboardInterrupt:
                running.check_recording()
                raise
    except KeyboardInterrupt:
        print('stopped')
    return 1 if running is not None and running.unclean else 0
