"""The contents of a bag: domain, demonstrations, episodes and their actors."""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from sys import intern
from typing import Any

from humanopts_env.domains.base import ActableDomain, Domain, DomainError
from humanopts_env.domains.described import described_domain
from humanopts_env.domains.names import is_registered
from humanopts_env.domains.registry import domain_from_json
from humanopts_env.game import Source, Transition, transition_from_message
from humanopts_learner.demonstrations import Demonstration, demonstration_from_message
from humanopts_ros.limits import parse_json
from humanopts_ros.recording import INTERFACES
from humanopts_teach.bags import BagError
from humanopts_teach.bags.mcap_file import ALWAYS
from humanopts_teach.bags.reader import Bag, DEMONSTRATION, DOMAIN_INFO, GAME_STATE
from humanopts_teach.bags.recording import Recorded
from humanopts_teach.bags.sequence_numbers import has_step, read_stamp


def read_demonstrations(bag: Bag) -> list[Demonstration]:
    """
    Return the demonstrations in a bag as published, including repetitions.

    Demonstrations of other games or of an unknown kind are omitted; the latter are reported in
    ``bag.damage``. ``check_demonstration`` decides whether the others are valid.

    :raises BagError: the bag has no demonstration topic.
    """
    if not bag.of_type(DEMONSTRATION):
        raise BagError(f'{bag.path} has no topic of demonstrations')
    decode = demonstration_decoder(bag)
    return [demo for each in bag.genuine(DEMONSTRATION) if (demo := decode(each)) is not None]


def demonstration_decoder(bag: Bag) -> Callable[[Recorded], Demonstration | None]:
    """
    Return a function that decodes demonstrations of the recorded game.

    It returns None for demonstrations of other games, which learners ignore too.
    """
    played = domains_played(bag)
    known = [(name, _parsed(parameters)) for name, parameters in played]

    def decode(recorded: Recorded) -> Demonstration | None:
        demo = recorded.convert(demonstration_from_message)
        if demo is None or not played:
            return demo
        parameters = _parsed(demo.domain_parameters)
        if parameters is None or (demo.domain, parameters) in known:
            return demo
        bag.omit(recorded, f'of another game than {_named(played)}')
        return None

    return decode


def _parsed(parameters: str) -> Any:
    """Return the parameters of a game; None: invalid; reported elsewhere."""
    try:
        return parse_json(parameters)
    except ValueError:
        return None


def domains_played(bag: Bag) -> list[tuple[str, str]]:
    """
    Return the names and parameters (JSON) of the recorded domains, sorted.

    The first announcement of a process determines its game, as in the nodes of the graph.
    """
    first: dict[str, tuple[str, str]] = {}  # by publisher_id
    played = set[tuple[str, str]]()
    announced = []
    for recorded in bag.genuine(DOMAIN_INFO):
        game = recorded.convert(lambda info: (info.domain, info.parameters))
        stamp = read_stamp(recorded.data)
        if game is not None and stamp is not None:
            # Programs without publisher ids can announce several games.
            played.add(first.setdefault(stamp.publisher_id, game) if stamp.publisher_id else game)
            announced.append((recorded, game))
    for recorded, game in announced:
        if game not in played:
            bag.omit(recorded, f'another game than {_named(played)}')
    return sorted(played)


def _named(games: Collection[tuple[str, str]]) -> str:
    return ', '.join(map(' '.join, sorted(games)))


def read_domain(bag: Bag) -> Domain:
    """
    Return the recorded domain.

    :raises BagError: the bag contains no domain, several, or one that is not installed.
    """
    name, parameters = _played(bag)
    if 'world_file' in bag.facts and not is_registered(name):
        raise BagError(
            f'{bag.path}: {name} is a robot; this command needs a domain that '
            'can be simulated; bag info shows what was learned, and bag export writes its tables'
        )
    try:
        return domain_from_json(name, parameters)
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error


def read_description(bag: Bag) -> ActableDomain:
    """
    Return the recorded domain, even if it is described only in the bag.

    :raises BagError: the bag contains no domain, several, or an invalid one.
    """
    name, _ = _played(bag)
    if is_registered(name):
        return read_domain(bag)
    infos = bag.converted(DOMAIN_INFO, lambda info: info)
    try:
        return next(described_domain(info) for info in infos if info.domain == name)
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error


def _played(bag: Bag) -> tuple[str, str]:
    """
    Return the name and parameters (JSON) of the recorded domain.

    :raises BagError: the bag contains no domain, or several.
    """
    played = domains_played(bag)
    if not played:
        reasons = '; '.join(['no domain_info', *bag.notes])
        raise BagError(f'{bag.path} does not say which domain was played ({reasons})')
    if len(played) > 1:
        raise BagError(f'{bag.path} holds games of several domains: {_named(played)}')
    return played[0]


STATE_COPY = 'current_state'  # latched topic that repeats the last state


@dataclass(frozen=True)
class Episode:
    """
    The recorded states of one episode, in order.

    :ivar publisher_id: publisher id of the game.
    :ivar times: log times of the first and last message, ns.
    :ivar read: function that decodes the transitions.
    """

    topic: str
    publisher_id: str
    number: int
    times: tuple[int, int]
    read: Callable[[], Iterable[Transition]]

    @property
    def key(self) -> tuple[str, str, int]:
        """The key of the episode, unique in the bag."""
        return self.topic, self.publisher_id, self.number

    @cached_property
    def transitions(self) -> tuple[Transition, ...]:
        """The decodable transitions, in order."""
        return tuple(self.read())

    @property
    def has_gaps(self) -> bool:
        """Whether steps are missing before the last one."""
        return [each.step for each in self.transitions] != list(range(len(self.transitions)))

    @property
    def complete(self) -> bool:
        """Whether the episode was recorded from its first state to its end without gaps."""
        if not self.transitions or self.has_gaps:
            return False
        return self.transitions[-1].terminated or self.transitions[-1].truncated


def state_topics(bag: Bag) -> set[str]:
    """Return the topics of game states, except latched copies of the last state."""
    states = [name for name in bag.of_type(GAME_STATE) if name.rpartition('/')[2] != STATE_COPY]
    topics = {name for name in states if has_step(bag.topics[name].schema)}
    for name in sorted({*states} - topics):
        bag.note(f'{name} is left out: its messages do not begin with episode and step')
    return topics


def _group_episodes(bag: Bag, between: tuple[int, int] = ALWAYS) -> Iterator[Episode]:
    """
    Yield each episode when its game begins a later one, or at the end; decode it on demand.

    Messages of an episode after the start of a later one are omitted. A refreshed state replaces
    the earlier state of its step.
    """

    def episode(game: tuple[str, str], number: int, states: dict[int, Recorded]) -> Episode:
        def read() -> Iterator[Transition]:
            for step in sorted(states):
                if (found := states[step].convert(transition_from_message)) is not None:
                    yield found

        times = [recorded.log_time for recorded in states.values()]
        return Episode(*game, number, (min(times), max(times)), read)

    under_way: dict[tuple[str, str], tuple[int, dict[int, Recorded]]] = {}
    for recorded in filter(bag.is_genuine, bag.messages(state_topics(bag), between)):
        stamp = read_stamp(recorded.data, with_step=True)
        if stamp is None:
            bag.note(f'a message on {recorded.topic} does not decode')
        elif stamp.episode:
            game = (recorded.topic, stamp.publisher_id)
            number, states = under_way.get(game, (0, {}))
            if stamp.episode < number:
                bag.note(f'{recorded.topic}: states after a later episode are left out')
                continue
            if stamp.episode > number:
                if states:
                    yield episode(game, number, states)
                states = {}
                under_way[game] = stamp.episode, states
            states[stamp.step] = recorded
    for game, (number, states) in under_way.items():
        yield episode(game, number, states)


def read_episodes(bag: Bag, between: tuple[int, int] = ALWAYS) -> Iterator[Episode]:
    """
    Yield the episodes of a bag when they are over, and the last one of each game at the end.

    :param between: range of log times to read, ns.
    """
    return (each for each in _group_episodes(bag, between) if any(True for _ in each.read()))


def find_episodes(bag: Bag) -> list[Episode]:
    """
    Return the episodes of ``read_episodes``, in the same order, without transitions.

    Transitions are read from the bag on demand; this raises ``BagError`` if no longer possible.
    """

    def again(key: tuple[str, str, int], times: tuple[int, int]) -> Iterable[Transition]:
        for episode in _group_episodes(bag, times):
            if episode.key == key:
                return episode.transitions
        raise BagError(f'{bag.path}: episode {key[-1]} can no longer be read')

    return [
        replace(episode, read=partial(again, episode.key, episode.times))
        for episode in read_episodes(bag)
    ]


ACTION_COMMAND = f'{INTERFACES}msg/ActionCommand'
AROUND = 10 * 10**9  # ns before and after an episode to search for its commands
Actors = dict[tuple[str, int], str]  # option, by publisher id and sequence number of a command


def read_actors(bag: Bag, episode: Episode | None = None) -> Actors:
    """
    Return the option that sent each command.

    :param episode: episode of the commands; None: all commands in the bag.
    """
    first, last = (0, ALWAYS[1]) if episode is None else episode.times
    commands = bag.converted(
        ACTION_COMMAND,
        lambda sent: (sent.publisher_id, sent.sequence, sent.option_name),
        (max(first - AROUND, 0), last + AROUND),
    )
    return {
        (intern(sender), sequence): intern(name) for sender, sequence, name in commands if name
    }


def actor_of(transition: Transition, actors: Actors) -> str:
    """Return the option or action:NAME that caused a transition; empty: a person."""
    return actors.get((transition.action_publisher_id, transition.action_sequence), '')


def source_of(transition: Transition) -> str:
    """Return the source of a transition's action as one word; empty: no action."""
    return '' if transition.action_source is Source.NONE else transition.action_source.name.lower()
