"""The contents of a bag: its domain, demonstrations, episodes, and who acted in them."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
from sys import intern
from typing import Any

from humanopts_env.domains.base import ActableDomain, Domain, DomainError
from humanopts_env.domains.described import described_domain
from humanopts_env.domains.names import is_registered
from humanopts_env.domains.registry import domain_from_json
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
)
from humanopts_ros.limits import parse_json
from humanopts_teach.bags import BagError
from humanopts_teach.bags.reader import (
    ALWAYS,
    Bag,
    DEMONSTRATION,
    DOMAIN_INFO,
    GAME_STATE,
    Recorded,
)
from humanopts_teach.bags.sequence_numbers import has_step, read_stamp


def read_demonstrations(bag: Bag) -> list[Demonstration]:
    """
    Return the demonstrations in a bag as they were published, repetitions included.

    One of another game is left out, and one of an unknown kind, which ``bag.damage`` notes.
    ``check_demonstration`` decides whether the others can be used.

    :raises BagError: the bag has no topic of demonstrations.
    """
    if not bag.of_type(DEMONSTRATION):
        raise BagError(f'{bag.path} has no topic of demonstrations')
    is_of_game = of_the_game(bag)
    found = []
    for recorded in bag.genuine(DEMONSTRATION):
        demo = bag.convert(recorded.topic, recorded.data, demonstration_from_message)
        if demo is not None and is_of_game(recorded, demo):
            found.append(demo)
    return found


def of_the_game(bag: Bag) -> Callable[[Recorded, Demonstration], bool]:
    """
    Return a predicate: whether a demonstration is of the game that was played, as learners ask.

    One that is not is left out of everything that is read of the bag.
    """
    played = domains_played(bag)
    known = [(name, _read_parameters(parameters)) for name, parameters in played]

    def is_of_game(recorded: Recorded, demo: Demonstration) -> bool:
        parameters = _read_parameters(demo.domain_parameters)
        if not played or parameters is None or (demo.domain, parameters) in known:
            return True
        stamp = read_stamp(recorded.data)
        sender = '' if stamp is None else stamp.publisher_id
        bag.leave_out(recorded, f'of another game than {_named(played)}', sender)
        return False

    return is_of_game


def _read_parameters(text: str) -> Any:
    """Return the parameters of a game; None: they cannot be read, which is said elsewhere."""
    try:
        return parse_json(text)
    except ValueError:
        return None


def domains_played(bag: Bag) -> list[tuple[str, str]]:
    """
    Return name and parameters (JSON) of the domains that were played, sorted.

    As for the nodes of the graph, what a process announces first is its game.
    """
    games: dict[str, dict[tuple[str, str], None]] = {}  # by publisher_id, in order
    announced: list[tuple[Recorded, str, tuple[str, str]]] = []
    for recorded in bag.genuine(DOMAIN_INFO):
        game = bag.convert(recorded.topic, recorded.data, lambda i: (i.domain, i.parameters))
        stamp = read_stamp(recorded.data)
        if game is None or stamp is None:
            continue
        known = games.setdefault(stamp.publisher_id, {})
        if not known or not stamp.publisher_id:  # older programs do not sign
            known[game] = None
        announced.append((recorded, stamp.publisher_id, game))
    played = {game for known in games.values() for game in known}
    for recorded, publisher, game in announced:
        if game not in played:
            bag.leave_out(recorded, f'another game than {_named(played)}', publisher)
    return sorted(played)


def _named(games: Collection[tuple[str, str]]) -> str:
    return ', '.join(f'{name} {parameters}' for name, parameters in sorted(games))


def read_domain(bag: Bag) -> Domain[Any]:
    """
    Return the domain that was played.

    :raises BagError: the bag names no domain, or several, or one that is not installed here.
    """
    try:
        return domain_from_json(*_played(bag))
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error


def read_description(bag: Bag) -> ActableDomain:
    """
    Return the domain that was played, also one of which only the bag knows.

    :raises BagError: the bag names no domain, or several, or it cannot be used.
    """
    name, _ = _played(bag)
    if is_registered(name):
        return read_domain(bag)
    infos = (each.message for each in bag.genuine(DOMAIN_INFO) if each.message is not None)
    try:
        return next(described_domain(info) for info in infos if info.domain == name)
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error


def _played(bag: Bag) -> tuple[str, str]:
    """
    Return name and parameters (JSON) of the domain that was played.

    :raises BagError: the bag names none, or several.
    """
    played = domains_played(bag)
    if not played:
        reasons = '; '.join(['no domain_info', *bag.notes])
        raise BagError(f'{bag.path} does not say which domain was played ({reasons})')
    if len(played) > 1:
        raise BagError(f'{bag.path} holds games of several domains: {_named(played)}')
    return played[0]


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

    def transitions(self, bag: Bag) -> Iterator[Transition]:
        """Yield the transitions that can be decoded, in order."""
        for step in sorted(self.states):
            found = bag.convert(self.topic, self.states[step], transition_from_message)
            if found is not None:
                yield found


def state_topics(bag: Bag) -> set[str]:
    """Return the topics of game states, without those that repeat the last state."""
    states = [name for name in bag.of_type(GAME_STATE) if name.rpartition('/')[2] != STATE_COPY]
    topics = {name for name in states if has_step(bag.topics[name].schema)}
    for name in sorted({*states} - topics):
        bag.note(f'{name} is left out: its messages do not begin with their place')
    return topics


def group_episodes(bag: Bag, between: tuple[int, int] = ALWAYS) -> Iterator[EpisodeMessages]:
    """
    Yield the messages of each episode, once its game begins a later one or the bag ends.

    Messages of an episode that come after that are left out.
    """
    under_way: dict[tuple[str, str], EpisodeMessages] = {}
    for recorded in filter(bag.is_genuine, bag.messages(state_topics(bag), between)):
        stamp = read_stamp(recorded.data, with_step=True)
        if stamp is None:
            bag.note(f'a message on {recorded.topic} does not decode')
        elif stamp.episode:
            game = (recorded.topic, stamp.publisher_id)
            group = under_way.get(game)
            if group is not None and stamp.episode < group.number:
                bag.note(f'{recorded.topic}: states after a later episode are left out')
                continue
            if group is None or stamp.episode > group.number:
                if group is not None:
                    yield group
                group = EpisodeMessages(*game, stamp.episode, recorded.log_time)
                under_way[game] = group
            group.states[stamp.step] = recorded.data
            group.last = recorded.log_time
    yield from under_way.values()


def read_episodes(
    bag: Bag,
    between: tuple[int, int] = ALWAYS,
    chosen: Callable[[EpisodeMessages], bool] = lambda _: True,
) -> Iterator[Episode]:
    """
    Yield the episodes of a bag when they are over, the last one of every game at the end.

    :param between: log times that are read, ns.
    :param chosen: predicate of the episodes that are decoded and yielded.
    """
    for group in filter(chosen, group_episodes(bag, between)):
        if transitions := tuple(group.transitions(bag)):
            times = (group.first, group.last)
            yield Episode(group.topic, group.publisher_id, group.number, transitions, times)


def find_episodes(bag: Bag) -> list[Callable[[], Episode]]:
    """
    Return a function for each episode of ``read_episodes``, in that order, which reads it.

    It raises ``BagError`` where the episode cannot be read any more.
    """

    def read_again(group: EpisodeMessages) -> Episode:
        key = (group.topic, group.publisher_id, group.number)
        times = (group.first, group.last)
        for episode in read_episodes(bag, times):
            if (episode.topic, episode.publisher_id, episode.number) == key:
                return episode
        raise BagError(f'{bag.path}: episode {group.number} cannot be read any more')

    found: list[Callable[[], Episode]] = []
    for group in group_episodes(bag):
        if next(group.transitions(bag), None) is not None:
            group.states.clear()
            found.append(partial(read_again, group))
    return found


ACTION_COMMAND = 'humanopts_interfaces/msg/ActionCommand'
RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
AROUND = 10 * 10**9  # ns before and after an episode, in which its commands are looked for
_REQUEST, _RESPONSE = 1, 2  # ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT; of the server
_EVENTS = '/reset_game/_service_event'


Actors = dict[tuple[str, int], str]  # option by publisher and sequence number of a command
Beginnings = dict[tuple[str, int, str], Any]  # by namespace, number and first state


def namespace(topic: str) -> str:
    """Return the namespace of a topic."""
    return topic.rpartition('/')[0]


def read_actors(bag: Bag, between: tuple[int, int] = ALWAYS) -> Actors:
    """Return which option sent each command of a bag, between two log times, ns."""
    commands = bag.converted(
        ACTION_COMMAND, lambda sent: (sent.publisher_id, sent.sequence, sent.option_name), between
    )
    return {
        (intern(sender), sequence): intern(name) for sender, sequence, name in commands if name
    }


def actors_in(bag: Bag, episode: Episode) -> Actors:
    """Return which option sent each command of an episode, and of some seconds around it."""
    first, last = episode.times
    return read_actors(bag, (max(first - AROUND, 0), last + AROUND))


def actor_of(transition: Transition, actors: Actors) -> str:
    """Return the option or action:NAME whose action led to a transition; empty: a person."""
    return actors.get((transition.action_publisher_id, transition.action_sequence), '')


def source_of(transition: Transition) -> str:
    """Return who chose the action of a transition, in a word; empty: no action led to it."""
    return '' if transition.action_source is Source.NONE else transition.action_source.name.lower()


def read_beginnings(bag: Bag) -> Beginnings:
    """Return the requests to reset_game that began episodes, where they were recorded."""
    requests: dict[tuple[Any, ...], Any] = {}  # that have no response yet, which names the episode
    found: Beginnings = {}

    def add(topic: str, event: Any) -> None:
        call = (topic, tuple(event.info.client_gid), event.info.sequence_number)
        if event.info.event_type == _REQUEST and event.request:
            requests[call] = event.request[0]
        elif event.info.event_type == _RESPONSE and event.response and call in requests:
            answer = event.response[0]
            key = (topic.removesuffix(_EVENTS), answer.episode, answer.state)
            found[key] = requests.pop(call)

    for recorded in bag.messages(bag.of_type(RESET_EVENT)):
        bag.convert(recorded.topic, recorded.data, partial(add, recorded.topic))
    return found
