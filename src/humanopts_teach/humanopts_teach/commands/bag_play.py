"""``humanopts bag play``: an episode again, in this terminal or as text."""

import argparse
from functools import partial
import time

from humanopts_env.domains.base import StateError
from humanopts_teach.bags.demonstrations import read_domain
from humanopts_teach.bags.episodes import Played
from humanopts_teach.bags.order import silent
from humanopts_teach.bags.played import actors_in
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.commands.bar import progress_bar
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.terminal.device import Device, why_not
from humanopts_teach.terminal.replay import Replay

LONGEST_WAIT = 0.2  # seconds, until a window of another size is seen


def run(arguments: argparse.Namespace) -> int:
    """Play the episode; plain text where this is no terminal."""
    with progress_bar() as tell:
        bag = open_bag(arguments.bag, tell)
        domain, episodes = read_domain(bag), Played(bag)
        bag.on_read = silent  # what follows is read quickly, while the screen is drawn
    if not 1 <= arguments.episode <= len(episodes):
        there = f'1 to {len(episodes)}' if episodes else 'none'
        raise CommandError(f'there is no episode {arguments.episode} in {bag.path}: {there}')
    place = arguments.episode - 1
    replay = Replay(domain, episodes, partial(actors_in, bag), place, arguments.speed)
    try:
        if why_not():
            for text in replay.plain():
                print(text)
        else:
            with Device() as device:
                _show(replay, device)
    except StateError as error:
        raise CommandError(f'{bag.path}: {error}') from error
    return 0


def _show(replay: Replay, device: Device) -> None:
    """Draw until the person quits or the terminal is gone."""
    shown = time.monotonic()
    while not replay.over and not device.closed:
        device.draw(replay.frame)
        due = shown + replay.seconds - time.monotonic()
        device.wait(min(max(due, 0.0), LONGEST_WAIT) if replay.running else LONGEST_WAIT)
        for key in device.read():
            replay.press(key)
            shown = time.monotonic()
        if replay.running and time.monotonic() >= shown + replay.seconds:
            replay.advance()
            shown = time.monotonic()
