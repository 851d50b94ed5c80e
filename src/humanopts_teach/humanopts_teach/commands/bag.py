"""``humanopts bag info``, ``check`` and ``play``: what a recorded bag holds."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
import json
from pathlib import Path
import sys
import time
from typing import Protocol

from humanopts_env.domains.base import StateError
from humanopts_teach.bags.check import check_bag, repair
from humanopts_teach.bags.contents import actors_in, find_episodes, read_domain
from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import ignore_progress, open_bag
from humanopts_teach.commands.ending import CommandError
from humanopts_teach.terminal.device import Device, why_not
from humanopts_teach.terminal.replay import Replay
from rich.console import Console
from rich.progress import Progress

_PERIOD = 0.1  # s between two drawings of the same work
_LONGEST_WAIT = 0.2  # s, until a window of another size is seen


class ProgressCallback(Protocol):
    """Shows how far work is."""

    def __call__(self, done: float, total: float, text: str = 'reading') -> None:
        """Show how much is done, of how much, and what is under way."""
        ...


@contextmanager
def progress_bar() -> Iterator[ProgressCallback]:
    """Show a bar on standard error where it is a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task('reading', total=None)
        shown, due = '', 0.0

        def show(done: float, total: float, text: str = 'reading') -> None:
            nonlocal shown, due
            if text != shown or time.monotonic() >= due:
                shown, due = text, time.monotonic() + _PERIOD
                progress.update(task, completed=done, total=total, description=text)

        yield show


def show_info(path: Path, *, as_json: bool) -> int:
    """Print what a bag holds."""
    with progress_bar() as show:
        info = summarise(open_bag(path, show))
    print(json.dumps(info.to_dict(), indent=2) if as_json else info.to_text())
    return 0


def check(path: Path, out: Path | None, *, as_json: bool) -> int:
    """
    Print what is damaged or missing in a bag, and save the rest.

    :param out: new folder for all that can be saved; None: it is not asked for.
    :return: exit status, 1 for a damaged bag.
    :raises BagError: there is no bag.
    """
    if out is not None and out.exists():
        raise CommandError(f'{out} exists already; name a folder that does not')
    with progress_bar() as show:
        bag = open_bag(path, partial(show, text='checking'))
        found = check_bag(bag)
    if out is not None:
        try:
            with progress_bar() as show:
                bag.on_read = partial(show, text='writing')
                count = repair(bag, out)
        except BagWriteError as error:
            raise CommandError(str(error)) from error
        print(f'{out}: {count} messages, all that could be saved', file=sys.stderr)
    print(json.dumps(found.to_dict(), indent=2) if as_json else found.to_text())
    return 0 if found.whole else 1


def play(path: Path, episode: int, speed: float) -> int:
    """
    Play an episode in this terminal; as plain text where this is none.

    :param episode: counted from 1.
    :param speed: 1 is two steps a second.
    :raises BagError: there is no bag, or it has no domain.
    """
    with progress_bar() as show:
        bag = open_bag(path, show)
        domain, episodes = read_domain(bag), find_episodes(bag)
        bag.on_read = ignore_progress  # what follows is read quickly, while the screen is drawn
    if not 1 <= episode <= len(episodes):
        there = f'1 to {len(episodes)}' if episodes else 'none'
        raise CommandError(f'there is no episode {episode} in {bag.path}: {there}')
    replay = Replay(domain, episodes, partial(actors_in, bag), episode - 1, speed)
    try:
        if why_not():
            for text in replay.plain():
                print(text)
        else:
            with Device() as device:
                _play(replay, device)
    except StateError as error:
        raise CommandError(f'{bag.path}: {error}') from error
    return 0


def _play(replay: Replay, device: Device) -> None:
    """Draw until the person quits or the terminal is gone."""
    shown = time.monotonic()
    while not replay.over and not device.closed:
        device.draw(replay.frame)
        due = shown + replay.seconds - time.monotonic()
        device.wait(min(max(due, 0.0), _LONGEST_WAIT) if replay.running else _LONGEST_WAIT)
        for key in device.read():
            replay.press(key)
            shown = time.monotonic()
        if replay.running and time.monotonic() >= shown + replay.seconds:
            replay.advance()
            shown = time.monotonic()
