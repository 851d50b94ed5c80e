"""The parts of a report that are read off a bag: one episode, and what of each topic is there."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag
from humanopts_teach.bags.summary import BagInfo
from humanopts_teach.report.data import Frame, TopicRow

_GAME_STATE = 'humanopts_interfaces/msg/GameState'
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'
_CURRENT = 'current_state'  # repeats game_state for displays


@dataclass(frozen=True)
class BagParts:
    """What a bag shows beside its demonstrations."""

    frames: tuple[Frame, ...]  # of the last finished episode that options drove; may be empty
    topics: tuple[TopicRow, ...]


@dataclass(frozen=True)
class _Run:
    option: str
    first_step: int
    last_step: int


def bag_parts(bag: Bag) -> BagParts:
    """Read the parts, in two passes over the bag."""
    return BagParts(tuple(_film(bag)), tuple(_topic_rows(summarise(bag))))


def _film(bag: Bag) -> list[Frame]:
    """Return the frames of the last episode that learned options brought to its end."""
    states: dict[int, list[Any]] = {}
    runs: dict[int, list[_Run]] = {}
    finished = 0
    for kind, message in _messages(bag):
        if kind == _GAME_STATE:
            states.setdefault(message.episode, []).append(message)
            continue
        first = message.first_step
        run = _Run(message.option_name, first, first + message.step_count)
        runs.setdefault(message.episode, []).append(run)
        learned = not message.option_name.startswith('action:')
        if message.terminated and learned:
            finished = message.episode
    return [_frame(state, runs[finished]) for state in states.get(finished, [])]


def _messages(bag: Bag) -> Iterator[tuple[str, Any]]:
    wanted = bag.of_type(_OPTION_RESULT)
    wanted += [name for name in bag.of_type(_GAME_STATE) if not name.endswith(_CURRENT)]
    for recorded in bag.messages(wanted):
        if recorded.message is not None:
            yield recorded.type, recorded.message


def _frame(state: Any, runs: list[_Run]) -> Frame:
    option = next((run.option for run in runs if run.first_step < state.step <= run.last_step), '')
    return Frame(state.state, state.previous_action, state.reward, option)


def _topic_rows(info: BagInfo) -> Iterator[TopicRow]:
    for topic in info.topics:
        streams = [stream for stream in info.streams if stream.topic == topic.name]
        if topic.counted:
            lost = sum(stream.missing for stream in streams)
            yield TopicRow(topic.name, topic.type, topic.messages, len(streams), lost)
        else:
            yield TopicRow(topic.name, topic.type, topic.messages)
