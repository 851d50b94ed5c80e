"""The last episode of a bag as a strip of board pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.board import signs
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import pictured_board_of
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_teach.bags.contents import (
    actor_of,
    Actors,
    Episode,
    read_actors,
    read_episodes,
)
from humanopts_teach.bags.reader import Bag
from humanopts_teach.board_html import board_html
from humanopts_teach.report.pages import MINUS

COLOURS = 4  # for options, CSS classes o0 to o3
MAX_PICTURES = 60  # longer episodes show only the ends of option runs
FIRST = 40  # leading pictures of a longer selection; the last ones follow
MIN_WIDTH = 10.6  # minimum width of a board, rem
REM = 0.49  # rem, width per character of a board
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'


@dataclass(frozen=True)
class Frame:
    """One step of an episode."""

    state: str  # in the domain's notation
    action: str = ''  # action before this state; empty in the first frame
    reward: float = 0.0
    option: str = ''  # running option; empty: none
    ends_run: bool = False  # whether the option's run ended here


def read_last_episode(bag: Bag) -> list[Frame]:
    """Return the last episode completed by learned options; empty: none."""
    under_way, results = 0, list[Any]()  # current episode, its results
    number, runs = 0, list[Any]()
    for recorded in bag.genuine(_OPTION_RESULT):
        message = recorded.message
        if message is None or not message.episode:  # damaged or refused
            continue
        if under_way != message.episode:
            under_way, results = message.episode, []
        results.append(message)
        if message.terminated and not message.option_name.startswith(PRIMITIVE_PREFIX):
            number, runs = under_way, results
    played = [each for each in read_episodes(bag) if each.number == number and each.complete]
    if not played:
        return []
    modules = any(not run.option_name for run in runs)
    return _frames(played[-1], runs, read_actors(bag, played[-1]) if modules else Actors())


def _frames(episode: Episode, runs: Sequence[Any], actors: Actors) -> list[Frame]:
    """
    Return the frames, step by step.

    :param runs: OptionResult messages; those without an option name come from modules.
    :param actors: module that sent each command.
    """
    frames = []
    for at in episode.transitions:
        run = next((r for r in runs if 0 < at.step - r.first_step <= r.step_count), None)
        option = (run.option_name or actor_of(at, actors)) if run else ''
        ended = run is not None and at.step - run.first_step == run.step_count
        frames.append(Frame(at.state, at.previous_action, at.reward, option, ended))
    return frames


@dataclass(frozen=True)
class ShownFrame:
    """One state, formatted for the page."""

    number: int  # step
    board: str  # HTML
    option: str
    action: str
    reward: str
    colour: str  # CSS class, the same for equal options


@dataclass(frozen=True)
class Strip:
    """A whole episode."""

    pictures: Sequence[ShownFrame]
    steps: int  # of the whole episode
    whole: bool  # whether every step is shown, not only those that end runs
    omitted: int  # omitted ends of runs
    last: int  # pictures after the omitted ones
    width: float  # width of a board, rem


def episode_strip(domain: Domain, frames: Sequence[Frame]) -> Strip:
    """
    Draw an episode: every step if it is short, otherwise the ends of runs.

    :raises StateError: a state is not a state of the domain.
    """
    options = list(dict.fromkeys(frame.option for frame in frames if frame.option))
    whole = len(frames) <= MAX_PICTURES
    ends = list(range(len(frames))) if whole else _ends(frames)
    last = MAX_PICTURES - FIRST
    shown = [*ends[:FIRST], *ends[-last:]] if len(ends) > MAX_PICTURES else ends
    boards = [pictured_board_of(domain, domain.decode(frames[number].state)) for number in shown]
    pictures = []
    for before, number, board in zip([-1, *shown], shown, boards):
        frame, steps = frames[number], frames[before + 1 : number + 1]
        reward = sum(step.reward for step in steps)
        pictures.append(
            ShownFrame(
                number,
                board_html(board),
                frame.option.removeprefix(PRIMITIVE_PREFIX),
                frame.action if len(steps) == 1 else f'{len(steps)} steps',
                '' if not frame.action else f'{reward:+g}'.replace('-', MINUS) if reward else '0',
                f'o{options.index(frame.option) % COLOURS}' if frame.option else '',
            )
        )
    width = REM * max((len(line) for board in boards for line in signs(board)), default=0)
    omitted = len(ends) - len(shown)
    return Strip(pictures, len(frames) - 1, whole, omitted, last, max(MIN_WIDTH, width))


def _ends(frames: Sequence[Frame]) -> list[int]:
    """Return the indices of the first frame and each run's last frame."""
    later = [*frames[1:], Frame('')]
    return [
        number
        for number, (frame, after) in enumerate(zip(frames, later))
        if number == 0 or frame.ends_run or frame.option != after.option
    ]
