"""``humanopts teach DOMAIN``: launch, and teach from this terminal's keyboard."""

import argparse
import sys

from humanopts_teach.commands.errors import CommandError
from humanopts_teach.commands.session import check_setup, session
from humanopts_teach.commands.setup import default_folder, new_name, setup_from


def run(arguments: argparse.Namespace) -> int:
    """
    Launch the graph and give the terminal to the person until they quit.

    :raises LaunchError: a node died, or nothing was recorded any more when they quit.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CommandError('teaching needs a terminal for input and output')
    setup = setup_from(
        arguments,
        default_folder(arguments.domain),
        bag_name=new_name('bags/teach'),
        participant=arguments.participant,
        keyboard=True,
    )
    check_setup(setup)
    print('starting ...', flush=True)
    with session(setup, arguments.namespace) as running:
        status = running.launcher.run_terminal()
        print(f'demonstrations and options are in {setup.directory}')
        print(f'the bag is {setup.bag}')
        running.conductor.catch_up()
        running.check_recording()
    return status or (1 if running.unclean else 0)
