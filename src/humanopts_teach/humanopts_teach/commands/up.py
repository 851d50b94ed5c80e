"""``humanopts up DOMAIN``: launch the nodes and stay."""

import argparse

from humanopts_teach.commands.session import check_setup, session
from humanopts_teach.commands.setup import default_folder, new_name, setup_from

_A_YEAR = 365.0 * 24 * 3600


def run(arguments: argparse.Namespace) -> int:
    """Launch and stay until Ctrl-C or SIGTERM, which is the way to end it: status 0."""
    setup = setup_from(
        arguments,
        default_folder(arguments.domain),
        bag_name=new_name('bags/up'),
        record=arguments.record,
    )
    check_setup(setup)
    try:
        with session(setup, arguments.namespace) as running:
            print('ready: ' + ', '.join(running.launcher.node_names))
            print(f'logs and data in {setup.directory}; Ctrl-C stops everything', flush=True)
            running.conductor.wait(lambda: False, _A_YEAR, 'Ctrl-C')
    except KeyboardInterrupt:
        print('stopped')
    return 0
