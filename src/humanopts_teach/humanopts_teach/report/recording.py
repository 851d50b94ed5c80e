"""What a report shows of a recording beside its lesson: its topics, and one episode."""

from collections.abc import Sequence
from dataclasses import dataclass

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

_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'


@dataclass(frozen=True)
class TopicRow:
    """One recorded topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: unknown


def read_topics(bag: Bag) -> list[TopicRow]:
    """Return the topics of a bag, by name, and what was lost on each."""
    info = summarise(bag)
    rows = []
    for topic in sorted(info.topics, key=lambda topic: topic.name):
        missing = [stream.missing for stream in info.streams if stream.topic == topic.name]
        loss = (len(missing), sum(missing)) if topic.counted else ()
        rows.append(TopicRow(topic.name, topic.type, topic.messages, *loss))
    return rows


@dataclass(frozen=True)
class Frame:
    """One step of an episode."""

    state: str  # in the domain's notation
    action: str = ''  # that led here; empty in the first frame
    reward: float = 0.0
    option: str = ''  # that was running; empty: none
    ends_run: bool = False  # the option's run ended here


@dataclass(frozen=True)
class _Run:
    option: str  # empty: modules
    first_step: int
    last_step: int


def read_last_episode(bag: Bag) -> list[Frame]:
    """Return the last episode that learned options brought to its end; empty: there is none."""
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


def _frames(episode: Episode, runs: Sequence[_Run], actors: Actors) -> list[Frame]:
    """
    Return what is seen, step by step.

    :param actors: the modules that sent the commands.
    """
    frames = []
    for at in episode.transitions:
        run = next((run for run in runs if run.first_step < at.step <= run.last_step), None)
        option = (run.option or actor_of(at, actors)) if run else ''
        ended = run is not None and run.last_step == at.step
        frames.append(Frame(at.state, at.previous_action, at.reward, option, ended))
    return frames
