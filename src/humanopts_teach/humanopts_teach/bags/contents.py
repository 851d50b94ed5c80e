"""What was recorded of a study: its domain, demonstrations, episodes, and who acted in them."""

from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.registry import domain_from_json
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
)
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import ALWAYS, Bag, Recorded
from humanopts_teach.bags.sequence_numbers import read_place, read_stamp, tells_place

DEMONSTRATION = 'humanopts_interfaces/msg/Demonstration'
DOMAIN_INFO = 'humanopts_interfaces/msg/DomainInfo'


def read_demonstrations(bag: Bag) -> list[Demonstration]:
    """
    Return the demonstrations in a bag as they were published, repetitions included.

    One of an unknown kind is left out and noted in ``bag.damage``. ``check_demonstration`` tells
    whether the others can be used.

    :raises BagError: the bag has no topic of demonstrations.
    """
    topics = bag.of_type(DEMONSTRATION)
    if not topics:
        raise BagError(f'{bag.path} has no topic of demonstrations')
    found = []
    for recorded in bag.messages(topics):
        if recorded.message is not None:
            with bag.skipping_missing_fields(recorded.topic):
                try:
                    found.append(demonstration_from_message(recorded.message))
                except DemonstrationError as error:
                    bag.note(f'a message on {recorded.topic} is left out: {error}')
    return found


def read_domain(bag: Bag) -> Domain[Any]:
    """
    Return the domain that was played.

    :raises BagError: the bag names no domain, or several, or one that is not installed here.
    """
    found = set()
    for recorded in bag.messages(bag.of_type(DOMAIN_INFO)):
        if (info := recorded.message) is not None:
            with bag.skipping_missing_fields(recorded.topic):
                found.add((info.domain, info.parameters))
    played = sorted(found)
    if not played:
        reasons = '; '.join(['no domain_info', *bag.damage.splitlines()])
        raise BagError(f'{bag.path} does not say which domain was played ({reasons})')
    if len(played) > 1:
        names = ', '.join(f'{name} {parameters}' for name, parameters in played)
        raise BagError(f'{bag.path} holds games of several domains: {names}')
    try:
        return domain_from_json(*played[0])
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error


GAME_STATE = 'humanopts_interfaces/msg/GameState'
STATE_COPY = 'current_state'  # the latched topic that repeats the last state


@dataclass(frozen=True)
class Episode:
    """The recorded states of one episode, in order."""

    topic: str
    publisher_id: str  # of the game that played it
    number: int
    transitions: tuple[Transition, ...]
    times: tuple[int, int]  # log times of the first and the last message, ns

    @property
    def complete(self) -> bool:
        """Whether it was recorded from its first state to its end without a gap."""
        numbers = [each.step for each in self.transitions]
        last = self.transitions[-1]
        return numbers == list(range(len(numbers))) and (last.terminated or last.truncated)


@dataclass
class EpisodeMessages:
    """The messages of one episode."""

    topic: str
    publisher_id: str
    number: int
    first: int  # log time, ns
    last: int = 0
    states: dict[int, bytes] = field(default_factory=dict)  # CDR by step


class EpisodeGrouping:
    """
    Groups the messages of games by episode.

    An episode is over when its game begins a later one; messages of it that come after that are
    left out.
    """

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._under_way: dict[tuple[str, str], EpisodeMessages] = {}
        self._places = {topic: tells_place(bag.topics[topic].schema) for topic in _topics(bag)}

    def add(self, recorded: Recorded) -> EpisodeMessages | None:
        """Add a state; return the episode that it shows to be over."""
        if recorded.topic not in self._places:
            return None
        place = self._place(recorded)
        if place is None or place[1] == 0:
            return None
        publisher_id, episode, step = place
        game = (recorded.topic, publisher_id)
        before = self._under_way.get(game)
        if before is not None and episode < before.number:
            self._bag.note(f'{recorded.topic}: states after a later episode are left out')
            return None
        group = before
        if group is None or episode > group.number:
            group = self._under_way[game] = EpisodeMessages(*game, episode, recorded.log_time)
        group.states[step] = recorded.data
        group.first = min(group.first, recorded.log_time)
        group.last = max(group.last, recorded.log_time)
        return None if group is before else before

    def unfinished(self) -> Iterator[EpisodeMessages]:
        """Yield the last episode of every game."""
        yield from self._under_way.values()

    def _place(self, recorded: Recorded) -> tuple[str, int, int] | None:
        """Return the publisher, episode and step of a state; None: it is damaged."""
        if not self._places[recorded.topic]:
            state = self._bag.decode(recorded.topic, recorded.data)
            if state is not None:
                with self._bag.skipping_missing_fields(recorded.topic):
                    return state.publisher_id, state.episode, state.step
            return None
        stamp, place = read_stamp(recorded.data), read_place(recorded.data)
        if stamp is None or place is None:
            self._bag.note(f'a message on {recorded.topic} does not decode')
            return None
        return stamp.publisher_id, *place


def read_episodes(
    bag: Bag,
    between: tuple[int, int] = ALWAYS,
    chosen: Callable[[EpisodeMessages], bool] = lambda _: True,
) -> Iterator[Episode]:
    """
    Yield the episodes of a bag when they are over, the last one of every game at the end.

    :param between: log times that are read, ns.
    :param chosen: tells which episodes are decoded and yielded.
    """
    for group in filter(chosen, _groups(bag, between)):
        transitions = tuple(_transitions(bag, group))
        if transitions:
            times = (group.first, group.last)
            yield Episode(group.topic, group.publisher_id, group.number, transitions, times)


class RecordedEpisodes(Sequence[Episode]):
    """The episodes of a bag in the order of ``read_episodes``, each read when it is needed."""

    def __init__(self, bag: Bag) -> None:
        """Find the episodes of which at least one state can be decoded."""
        self._bag = bag
        self._games: dict[tuple[str, str], int] = {}
        self._where = array('q')  # game, number, first and last log time, four for each episode
        for group in _groups(bag, ALWAYS):
            if next(_transitions(bag, group), None) is None:
                continue
            game = self._games.setdefault((group.topic, group.publisher_id), len(self._games))
            self._where.extend((game, group.number, group.first, group.last))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._where) // 4

    @overload
    def __getitem__(self, place: int) -> Episode: ...

    @overload
    def __getitem__(self, place: slice) -> Sequence[Episode]: ...

    def __getitem__(self, place: int | slice) -> Episode | Sequence[Episode]:
        """
        Read an episode, or several.

        :raises IndexError: there is none.
        :raises BagError: it cannot be read any more.
        """
        if isinstance(place, slice):
            return [self[each] for each in range(*place.indices(len(self)))]
        at = 4 * range(len(self))[place]
        game, number, first, last = self._where[at : at + 4]
        key = (*list(self._games)[game], number)
        found = read_episodes(
            self._bag, (first, last), lambda g: (g.topic, g.publisher_id, g.number) == key
        )
        for episode in found:
            return episode
        raise BagError(f'{self._bag.path}: episode {place + 1} cannot be read any more')


def is_ended(bag: Bag, group: EpisodeMessages) -> bool:
    """Tell whether the last recorded state of an episode is terminal or truncated."""
    last = bag.decode(group.topic, group.states[max(group.states)])
    if last is not None:
        with bag.skipping_missing_fields(group.topic):
            return bool(last.terminated or last.truncated)
    return False


def _topics(bag: Bag) -> list[str]:
    """Return the topics that carry every state of a game once."""
    return [t for t in bag.of_type(GAME_STATE) if t.rpartition('/')[2] != STATE_COPY]


def _groups(bag: Bag, between: tuple[int, int]) -> Iterator[EpisodeMessages]:
    games = EpisodeGrouping(bag)
    for recorded in bag.messages(_topics(bag), decoded=False, between=between):
        if (over := games.add(recorded)) is not None:
            yield over
    yield from games.unfinished()


def _transitions(bag: Bag, group: EpisodeMessages) -> Iterator[Transition]:
    """Yield the transitions of an episode that can be decoded, in order."""
    for step in sorted(group.states):
        state = bag.decode(group.topic, group.states[step])
        if state is not None:
            with bag.skipping_missing_fields(group.topic):
                try:
                    yield transition_from_message(state)
                except ValueError as error:
                    bag.note(f'a message on {group.topic} is left out: {error}')


ACTION_COMMAND = 'humanopts_interfaces/msg/ActionCommand'
RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
AROUND = 10 * 10**9  # ns before and after an episode, in which its commands are looked for
_REQUEST, _RESPONSE = 1, 2  # ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT; of the server
_EVENTS = '/reset_game/_service_event'


@dataclass
class _Runs:
    """Runs of consecutive commands of one actor, by their sequence numbers."""

    first: 'array[int]' = field(default_factory=lambda: array('Q'))  # ascending
    last: 'array[int]' = field(default_factory=lambda: array('Q'))
    actor: 'array[int]' = field(default_factory=lambda: array('Q'))


class Actors:
    """The option that sent each command, by the command's publisher and sequence number."""

    def __init__(self) -> None:
        self._names: dict[str, int] = {'': 0}
        self._runs: dict[str, _Runs] = {}

    def add(self, publisher_id: str, sequence: int, name: str) -> None:
        """Add a command; a repetition changes nothing."""
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
        """Return an option's name, or action:NAME; empty: a person's command, or not known."""
        runs = self._runs.get(publisher_id, _Runs())
        at = bisect_right(runs.first, sequence) - 1
        known = at >= 0 and sequence <= runs.last[at]
        return list(self._names)[runs.actor[at]] if known else ''


@dataclass(frozen=True, slots=True)
class Beginning:
    """The request to reset_game that began an episode."""

    seed: int  # of the start state, where it is drawn, and of the chance in the episode
    start_state: str  # empty: it was drawn by the seed


Beginnings = dict[tuple[str, int, str], Beginning]  # by namespace, number and first state


def namespace(topic: str) -> str:
    """Return the namespace of a topic."""
    return topic.rpartition('/')[0]


def read_actors(bag: Bag, between: tuple[int, int] = ALWAYS) -> Actors:
    """
    Return which option sent each command of a bag.

    :param between: log times that are read, ns.
    """
    actors = Actors()
    for recorded in bag.messages(bag.of_type(ACTION_COMMAND), between=between):
        if (command := recorded.message) is not None:
            name = getattr(command, 'option_name', '')  # older versions have no such field
            with bag.skipping_missing_fields(recorded.topic):
                actors.add(command.publisher_id, command.sequence, name)
    return actors


def actors_in(bag: Bag, episode: Episode) -> Actors:
    """Return which option sent each command of an episode, and of some seconds around it."""
    first, last = episode.times
    return read_actors(bag, (max(first - AROUND, 0), last + AROUND))


def actor_of(transition: Transition, actors: Actors) -> str:
    """Return the option or action:NAME whose action led to a transition; empty: a person."""
    return actors.name(transition.action_publisher_id, transition.action_sequence)


def source_of(transition: Transition) -> str:
    """Return who chose the action of a transition, in a word; empty: no action led to it."""
    return '' if transition.action_source is Source.NONE else transition.action_source.name.lower()


def read_beginnings(bag: Bag) -> Beginnings:
    """Return the requests that began episodes, where they were recorded."""
    asked: dict[tuple[Any, ...], Any] = {}
    found: Beginnings = {}
    for recorded in bag.messages(bag.of_type(RESET_EVENT)):
        if recorded.message is not None:
            with bag.skipping_missing_fields(recorded.topic):
                _take_event(recorded.topic, recorded.message, asked, found)
    return found


def _take_event(
    topic: str, event: Any, asked: dict[tuple[Any, ...], Any], found: Beginnings
) -> None:
    """Keep a request until its response comes, which names the episode."""
    call = (topic, tuple(event.info.client_gid), event.info.sequence_number)
    if event.info.event_type == _REQUEST and event.request:
        asked[call] = event.request[0]
    elif event.info.event_type == _RESPONSE and event.response and call in asked:
        request, answer = asked.pop(call), event.response[0]
        key = (topic.removesuffix(_EVENTS), answer.episode, answer.state)
        found[key] = Beginning(int(request.seed), request.start_state)
