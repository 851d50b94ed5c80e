"""The episodes in a bag, of which only those are held that are under way."""

from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import overload

from humanopts_env.game import moment_from_message, Transition
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.mcap_file import ALWAYS
from humanopts_teach.bags.reader import Bag, Recorded
from humanopts_teach.bags.stamps import read_place, read_stamp, tells_place

GAME_STATE = 'humanopts_interfaces/msg/GameState'
STATE_COPY = 'current_state'  # the latched topic that repeats the last state


@dataclass(frozen=True)
class Episode:
    """The recorded states of one episode, in order."""

    topic: str
    publisher_id: str  # of the game that played it
    number: int
    moments: tuple[Transition, ...]
    times: tuple[int, int]  # log times of the first and the last message, ns

    @property
    def complete(self) -> bool:
        """Whether it was recorded from its first state to its end without a gap."""
        numbers = [moment.step for moment in self.moments]
        last = self.moments[-1]
        return numbers == list(range(len(numbers))) and (last.terminated or last.truncated)


@dataclass
class Group:
    """The messages of one episode."""

    topic: str
    publisher_id: str
    number: int
    first: int  # log time, ns
    last: int = 0
    states: dict[int, bytes] = field(default_factory=dict)  # CDR by step


class Games:
    """
    Groups the states of games by episode.

    An episode is over when its game begins a later one; what comes after that is left out.
    """

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._under_way: dict[tuple[str, str], Group] = {}
        self._places = {topic: tells_place(bag.topics[topic].schema) for topic in _topics(bag)}

    def add(self, recorded: Recorded) -> Group | None:
        """Take in a state; return the episode that is over by it."""
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
            group = self._under_way[game] = Group(*game, episode, recorded.log_time)
        group.states[step] = recorded.data
        group.first = min(group.first, recorded.log_time)
        group.last = max(group.last, recorded.log_time)
        return None if group is before else before

    def rest(self) -> Iterator[Group]:
        """Yield the last episode of every game."""
        yield from self._under_way.values()

    def _place(self, recorded: Recorded) -> tuple[str, int, int] | None:
        """Return who sent a state, its episode and step; None: it is damaged."""
        if not self._places[recorded.topic]:
            state = self._bag.decode(recorded.topic, recorded.data)
            if state is not None:
                with self._bag.taking(recorded.topic):
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
    chosen: Callable[[Group], bool] = lambda _: True,
) -> Iterator[Episode]:
    """
    Yield the episodes in a bag as they are over, the last of every game at the end.

    :param between: log times that are read, ns.
    :param chosen: which are decoded.
    """
    for group in filter(chosen, _groups(bag, between)):
        moments = tuple(_moments(bag, group))
        if moments:
            times = (group.first, group.last)
            yield Episode(group.topic, group.publisher_id, group.number, moments, times)


class Played(Sequence[Episode]):
    """The episodes in a bag in the order of ``read_episodes``, each read when it is asked for."""

    def __init__(self, bag: Bag) -> None:
        """Read where the episodes are of which something can be read."""
        self._bag = bag
        self._games: dict[tuple[str, str], int] = {}
        self._where = array('q')  # game, number, first and last log time, four for each episode
        for group in _groups(bag, ALWAYS):
            if next(_moments(bag, group), None) is None:
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


def is_ended(bag: Bag, group: Group) -> bool:
    """Tell whether the last state of an episode, as far as it can be read, is its end."""
    last = bag.decode(group.topic, group.states[max(group.states)])
    if last is not None:
        with bag.taking(group.topic):
            return bool(last.terminated or last.truncated)
    return False


def _topics(bag: Bag) -> list[str]:
    """Return the topics that every state of a game is on once."""
    return [t for t in bag.of_type(GAME_STATE) if t.rpartition('/')[2] != STATE_COPY]


def _groups(bag: Bag, between: tuple[int, int]) -> Iterator[Group]:
    games = Games(bag)
    for recorded in bag.messages(_topics(bag), decoded=False, between=between):
        if (over := games.add(recorded)) is not None:
            yield over
    yield from games.rest()


def _moments(bag: Bag, group: Group) -> Iterator[Transition]:
    """Yield what of an episode can be decoded, in order."""
    for step in sorted(group.states):
        state = bag.decode(group.topic, group.states[step])
        if state is not None:
            with bag.taking(group.topic):
                try:
                    yield moment_from_message(state)
                except ValueError as error:
                    bag.note(f'a message on {group.topic} is left out: {error}')
