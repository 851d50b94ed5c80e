"""Who acted in the episodes of a bag, and how each episode was begun."""

from array import array
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

from humanopts_env.game import Source, Transition
from humanopts_teach.bags.episodes import Episode
from humanopts_teach.bags.mcap_file import ALWAYS
from humanopts_teach.bags.reader import Bag

ACTION_COMMAND = 'humanopts_interfaces/msg/ActionCommand'
RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
AROUND = 10 * 10**9  # ns before and after an episode, in which its commands are looked for
_REQUEST, _RESPONSE = 1, 2  # ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT; of the server
_EVENTS = '/reset_game/_service_event'


@dataclass
class _Runs:
    """Numbers of commands that follow each other and are of one actor."""

    first: 'array[int]' = field(default_factory=lambda: array('Q'))  # ascending
    last: 'array[int]' = field(default_factory=lambda: array('Q'))
    actor: 'array[int]' = field(default_factory=lambda: array('Q'))


class Actors:
    """Whose each command was, by its publisher and number."""

    def __init__(self) -> None:
        self._names: dict[str, int] = {'': 0}
        self._runs: dict[str, _Runs] = {}

    def add(self, publisher_id: str, sequence: int, name: str) -> None:
        """Take in a command, once."""
        runs = self._runs.setdefault(publisher_id, _Runs())
        actor = self._names.setdefault(name, len(self._names))
        at = bisect_right(runs.first, sequence)
        before = runs.last[at - 1] if at else -1
        if at and before == sequence - 1 and runs.actor[at - 1] == actor:
            runs.last[at - 1] = sequence
        elif before < sequence:
            runs.first.insert(at, sequence)
            runs.last.insert(at, sequence)
            runs.actor.insert(at, actor)

    def name(self, publisher_id: str, sequence: int) -> str:
        """Return an option, or action:NAME; empty: a person, or it is not known."""
        runs = self._runs.get(publisher_id, _Runs())
        at = bisect_right(runs.first, sequence) - 1
        known = at >= 0 and sequence <= runs.last[at]
        return list(self._names)[runs.actor[at]] if known else ''


@dataclass(frozen=True, slots=True)
class Beginning:
    """What reset_game was asked when an episode was begun."""

    seed: int  # of the start state, where it is drawn, and of the chance in the episode
    start_state: str  # empty: it was drawn by the seed


Beginnings = dict[tuple[str, int, str], Beginning]  # by namespace, number and first state


def namespace(topic: str) -> str:
    """Return what stands before the last part of a name."""
    return topic.rpartition('/')[0]


def read_actors(bag: Bag, between: tuple[int, int] = ALWAYS) -> Actors:
    """
    Return whose the commands in a bag were.

    :param between: log times that are read, ns.
    """
    actors = Actors()
    for recorded in bag.messages(bag.of_type(ACTION_COMMAND), between=between):
        if (command := recorded.message) is not None:
            name = getattr(command, 'option_name', '')  # older versions have no such field
            with bag.taking(recorded.topic):
                actors.add(command.publisher_id, command.sequence, name)
    return actors


def actors_in(bag: Bag, episode: Episode) -> Actors:
    """Return whose the commands in an episode were; topics may come a little apart."""
    first, last = episode.times
    return read_actors(bag, (max(first - AROUND, 0), last + AROUND))


def actor_of(moment: Transition, actors: Actors) -> str:
    """Return the option or action:NAME whose action led to a moment; empty: a person's."""
    return actors.name(moment.action_publisher_id, moment.action_sequence)


def source_of(moment: Transition) -> str:
    """Return who chose the action that led to a moment, in a word; empty: nobody."""
    return '' if moment.action_source is Source.NONE else moment.action_source.name.lower()


def read_beginnings(bag: Bag) -> Beginnings:
    """Return how episodes were begun, where it is known."""
    asked: dict[tuple[Any, ...], Any] = {}
    found: Beginnings = {}
    for recorded in bag.messages(bag.of_type(RESET_EVENT)):
        if recorded.message is not None:
            with bag.taking(recorded.topic):
                _take_event(recorded.topic, recorded.message, asked, found)
    return found


def _take_event(
    topic: str, event: Any, asked: dict[tuple[Any, ...], Any], found: Beginnings
) -> None:
    """Keep a request until it is answered."""
    call = (topic, tuple(event.info.client_gid), event.info.sequence_number)
    if event.info.event_type == _REQUEST and event.request:
        asked[call] = event.request[0]
    elif event.info.event_type == _RESPONSE and event.response and call in asked:
        request, answer = asked.pop(call), event.response[0]
        key = (topic.removesuffix(_EVENTS), answer.episode, answer.state)
        found[key] = Beginning(int(request.seed), request.start_state)
