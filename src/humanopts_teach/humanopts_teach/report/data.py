"""What a report is made of: an evaluation, and what is read off a bag beside it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_teach.bags.contents import (
    actor_of,
    Actors,
    actors_in,
    Episode,
    namespace,
    read_episodes,
)
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag
from humanopts_teach.bags.summary import BagInfo
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.summary import Summary

_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'


@dataclass(frozen=True)
class Frame:
    """One step of an episode."""

    state: str  # in the domain's notation
    action: str = ''  # that led here; empty in the first frame
    reward: float = 0.0
    option: str = ''  # that was running; empty: none
    ends_run: bool = False  # the option's run ended here


@dataclass(frozen=True)
class TopicRow:
    """One recorded topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: unknown


@dataclass(frozen=True)
class ReportData:
    """One report. Parts that are empty are left out of it."""

    title: str
    evaluation: BagEvaluation
    summary: Summary | None = None  # what was seen live
    frames: Sequence[Frame] = ()  # one episode
    topics: Sequence[TopicRow] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)  # name -> text, such as versions


@dataclass(frozen=True)
class BagParts:
    """What a bag shows beside its demonstrations."""

    frames: tuple[Frame, ...]  # of the last finished episode that options drove; may be empty
    topics: tuple[TopicRow, ...]


@dataclass(frozen=True)
class _Run:
    option: str  # empty: modules
    first_step: int
    last_step: int


def bag_parts(bag: Bag) -> BagParts:
    """Read the parts, in a few passes over the bag."""
    return BagParts(tuple(_film(bag)), tuple(_topic_rows(summarise(bag))))


def _film(bag: Bag) -> list[Frame]:
    """Return the frames of the last episode that learned options brought to its end."""
    under_way: dict[str, tuple[int, list[_Run]]] = {}  # episode and its runs, of each game
    game, number, runs = '', 0, list[_Run]()
    for recorded in bag.messages(bag.of_type(_OPTION_RESULT)):
        message = recorded.message
        if message is None or not message.episode:  # damaged, or refused
            continue
        topic_game, first = namespace(recorded.topic), message.first_step
        if under_way.get(topic_game, (0,))[0] != message.episode:
            under_way[topic_game] = (message.episode, [])
        run = _Run(message.option_name, first, first + message.step_count)
        under_way[topic_game][1].append(run)
        if message.terminated and not message.option_name.startswith(PRIMITIVE_PREFIX):
            game, (number, runs) = topic_game, under_way[topic_game]
    found = read_episodes(bag, chosen=lambda g: (namespace(g.topic), g.number) == (game, number))
    played = [episode for episode in found if episode.complete]
    if not played:
        return []
    modules = any(not run.option for run in runs)
    return _frames(played[-1], runs, actors_in(bag, played[-1]) if modules else Actors())


def _frames(episode: Episode, runs: list[_Run], actors: Actors) -> list[Frame]:
    """
    Return what is seen, step by step.

    :param actors: the modules that sent the commands.
    """
    frames = []
    for at in episode.transitions:
        run = next((run for run in runs if run.first_step < at.step <= run.last_step), None)
        frames.append(
            Frame(
                at.state,
                at.previous_action,
                at.reward,
                (run.option or actor_of(at, actors)) if run else '',
                run is not None and run.last_step == at.step,
            )
        )
    return frames


def _topic_rows(info: BagInfo) -> Iterator[TopicRow]:
    for topic in info.topics:
        streams = [stream for stream in info.streams if stream.topic == topic.name]
        if topic.counted:
            lost = sum(stream.missing for stream in streams)
            yield TopicRow(topic.name, topic.type, topic.messages, len(streams), lost)
        else:
            yield TopicRow(topic.name, topic.type, topic.messages)
