"""``humanopts up`` and ``humanopts teach``: a graph that stays until somebody ends it."""

from functools import partial
import sys

from humanopts_teach.commands.ending import CommandError
from humanopts_teach.commands.options import LaunchOptions
from humanopts_teach.commands.session import (
    check_setup,
    default_folder,
    new_name,
    session,
    setup_from,
)
from humanopts_teach.launching.processes import RECORDER
from humanopts_teach.lesson.store import CODE, CODE_RULE

_WATCHED = 0.15  # s between steps of the machine, while a person looks on


def stay_up(domain: str, launch: LaunchOptions, *, record: bool) -> int:
    """
    Launch and stay until Ctrl-C or SIGTERM, which is the way to end it.

    :return: exit status, 1 where a node did not end cleanly.
    :raises LaunchError: a node died, or nothing was recorded any more at the end.
    """
    setup = setup_from(
        domain, launch, default_folder(domain), bag_name=new_name('bags/up'), record=record
    )
    check_setup(setup)
    running = None
    try:
        with session(setup, launch.namespace) as running:
            print('ready: ' + ', '.join(running.launcher.node_names))
            print(f'logs and data in {setup.directory}; Ctrl-C stops everything', flush=True)
            check = partial(running.launcher.check, RECORDER)
            try:
                running.graph.stay(check, partial(print, file=sys.stderr, flush=True))
            except KeyboardInterrupt:
                running.check_recording()
                raise
    except KeyboardInterrupt:
        print('stopped')
    return 1 if running is not None and running.unclean else 0


def teach_here(domain: str, launch: LaunchOptions, participant: str) -> int:
    """
    Launch the graph and give the terminal to the person until they quit.

    :return: exit status, 1 where a node did not end cleanly.
    :raises LaunchError: a node died, or nothing was recorded any more when they quit.
    """
    if not CODE.fullmatch(participant):
        raise CommandError(f'--participant {participant!r} is not a code: {CODE_RULE}')
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CommandError('teaching needs a terminal for input and output')
    setup = setup_from(
        domain,
        launch,
        default_folder(domain),
        bag_name=new_name('bags/teach'),
        participant=participant,
        keyboard=True,
        step_period=_WATCHED,
    )
    check_setup(setup)
    print('starting ...', flush=True)
    with session(setup, launch.namespace) as running:
        status = running.launcher.run_terminal()
        print(f'demonstrations and options are in {setup.directory}')
        print(f'the bag is {setup.bag}')
        running.graph.catch_up()
        running.check_recording()
    return status or (1 if running.unclean else 0)
