"""Opening bags, and reading the messages that the nodes of their graph would accept."""

from collections import Counter
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from humanopts_ros.limits import parse_json, shown
from humanopts_ros.recording import INTERFACES, own_name
from humanopts_ros.senders import GAME_TOPICS, sender_of, signer
from humanopts_teach.bags import BagError
from humanopts_teach.bags.mcap_file import ALWAYS, ignore_progress, open_file, ReadCallback
from humanopts_teach.bags.recording import Recorded, Recording
from humanopts_teach.bags.rosbag2 import COMPRESSED, convert, find_files
from humanopts_teach.bags.sequence_numbers import read_stamp
from humanopts_teach.bags.writer import GAME, GAME_IDS, is_being_written, NAMESPACE, RECORD

BEING_RECORDED = 'the bag is being recorded: this is what it holds so far'
MAX_OMITTED = 100  # kinds of omitted messages, by topic and sender
DEMONSTRATION = f'{INTERFACES}msg/Demonstration'
DOMAIN_INFO = f'{INTERFACES}msg/DomainInfo'
GAME_STATE = f'{INTERFACES}msg/GameState'
LESSON_STATE = f'{INTERFACES}msg/LessonState'
T = TypeVar('T')


class Bag(Recording):
    """
    A recording and the selected graph in it.

    :ivar chosen: namespace chosen by the caller; empty: the bag's own.
    """

    chosen = ''

    def __init__(self, *recording: Any) -> None:
        super().__init__(*recording)
        self._allowed: dict[str, tuple[str, ...]] = {}  # by topic; see ``_allowed_on``
        # Omitted messages by topic and reason: count, and position of the newest one.
        self._omitted: dict[tuple[str, str], tuple[int, tuple[int, int]]] = {}

    @property
    def namespaces(self) -> list[str]:
        """The namespaces of the graphs in the bag, sorted."""
        kinds = (DOMAIN_INFO, GAME_STATE, DEMONSTRATION, LESSON_STATE)
        names = [topic.name for topic in self.topics.values() if topic.type in kinds]
        return sorted({name.rpartition('/')[0] or '/' for name in names})

    @cached_property
    def namespace(self) -> str:
        """
        The namespace of the selected graph; bags from other programs can contain several.

        :raises BagError: the chosen graph does not exist, or there are several and none is chosen.
        """
        found, own = self.namespaces, self.facts.get(NAMESPACE, '')
        if self.chosen and self.chosen not in found:
            there = ', '.join(found) or 'none'
            raise BagError(f'{self.path} holds no graph of namespace {self.chosen}: {there}')
        if not (self.chosen or own) and len(found) > 1:
            raise BagError(
                f'{self.path} holds the graphs of several namespaces: {", ".join(found)}; '
                'choose one with --namespace'
            )
        return self.chosen or own or next(iter(found), '/')

    @property
    def reads_own(self) -> bool:
        """Whether the selected graph is the recorder's own, as far as known."""
        return self.namespace == self.facts.get(NAMESPACE, self.namespace)

    @property
    def graph_facts(self) -> dict[str, str]:
        """The facts about the selected graph; empty if it is not the recorder's own."""
        return self.facts if self.reads_own else {}

    @cached_property
    def game_ids(self) -> tuple[str, ...]:
        """
        The publisher ids of the game, one per start; empty: unknown.

        The humanopts recorder stores the ids of its graph. In other graphs, the game is the node
        that announced a game and published the most states.
        """
        kept = self.metadata.get(GAME, {}) if self.reads_own else {}
        try:
            ids = parse_json(kept.get(GAME_IDS, '[]'))
        except ValueError:
            ids = None
        if not isinstance(ids, list):
            self.note(f'the record {GAME} is damaged')
        elif ids:
            return tuple(map(str, ids))

        def publishers(type_name: str) -> Iterator[str]:
            for recorded in self.messages(self.of_type(type_name)):
                stamp = read_stamp(recorded.data)
                yield '' if stamp is None else stamp.publisher_id

        states = Counter(publishers(GAME_STATE))
        announced = dict.fromkeys(publishers(DOMAIN_INFO))
        games = [each for each in announced if each in states or not states]
        by_node = Counter[str]()
        for each in games:
            by_node[signer(each)] += states[each]
        # In a tie, use the first in the bag; without publisher ids, any node may be the game.
        best = max(by_node, key=by_node.__getitem__, default='')
        return tuple(each for each in games if best and signer(each) == best)

    def of_type(self, type_name: str) -> list[str]:
        """Return the topic names of a type in the bag's namespace, sorted."""
        return [
            topic.name
            for topic in self.topics.values()
            if topic.type == type_name and own_name(topic.name, self.namespace)
        ]

    def genuine(self, type_name: str, between: tuple[int, int] = ALWAYS) -> Iterator[Recorded]:
        """Yield the genuine messages of a type, in order of log time."""
        return filter(self.is_genuine, self.messages(self.of_type(type_name), between))

    def converted(
        self, type_name: str, convert: Callable[[Any], T], between: tuple[int, int] = ALWAYS
    ) -> Iterator[T]:
        """Yield the converted genuine messages of a type, in order; omit failed conversions."""
        found = (recorded.convert(convert) for recorded in self.genuine(type_name, between))
        return (each for each in found if each is not None)

    def is_genuine(self, recorded: Recorded) -> bool:
        """
        Return whether the nodes of the graph would accept a message.

        Such a message is in the bag's namespace and comes from a permitted publisher. Other
        messages are listed in ``omitted``.
        """
        return not self.is_foreign(recorded) and own_name(recorded.topic, self.namespace) != ''

    def is_foreign(self, recorded: Recorded) -> bool:
        """
        Return whether a message comes from a node that is not permitted to publish on its topic.

        If the bag contains several graphs and none is chosen, every message is permitted.
        """
        if recorded.topic not in self._allowed:
            self._allowed[recorded.topic] = self._allowed_on(recorded.topic)
        allowed = self._allowed[recorded.topic]
        stamp = read_stamp(recorded.data) if allowed else None
        if stamp is None:
            return False
        sender = signer(stamp.publisher_id)
        if stamp.publisher_id in allowed or sender in allowed:
            return False
        nodes = sorted({signer(each) or each for each in allowed})
        old = 'which was not the game' if sender in nodes else f'not from {" or ".join(nodes)}'
        self.omit(recorded, old)
        return True

    def _allowed_on(self, topic: str) -> tuple[str, ...]:
        """
        Return the nodes, or publisher ids of the game, that are permitted to publish on a topic.

        Empty: any node is permitted, or the topic belongs to another graph.
        """
        try:
            name = own_name(topic, self.namespace)
        except BagError:
            return ()
        owner = sender_of(topic, self.namespace)
        return self.game_ids if name in GAME_TOPICS else (owner,) if owner else ()

    def omit(self, recorded: Recorded, why: str) -> None:
        """Record an omitted message, only once even if the bag is read several times."""
        stamp = read_stamp(recorded.data)
        sender = shown(stamp.publisher_id, 80) if stamp else ''
        key = recorded.topic, f'from {sender or "no node"}, {why}'
        if key not in self._omitted and len(self._omitted) >= MAX_OMITTED:
            key = recorded.topic, 'from other nodes'
        count, newest = self._omitted.get(key, (0, (-1, 0)))
        if (place := (recorded.log_time, recorded.sequence)) > newest:
            self._omitted[key] = count + 1, place

    @property
    def strangers(self) -> list[str]:
        """Descriptions of messages omitted because of their publisher."""
        return [
            f'{count} message{"s"[: count > 1]} on {topic}: {why}'
            for (topic, why), (count, _) in self._omitted.items()
        ]

    @property
    def omitted(self) -> list[str]:
        """Descriptions of all omitted messages read so far."""
        others = [name for name in self.namespaces if name != self.namespace]
        graphs = f'the graph of {", ".join(others)}: the graph of {self.namespace} is read'
        return [*([graphs] if others else []), *self.strangers]

    @property
    def notes(self) -> list[str]:
        """Warnings for the user: bag still being recorded, omitted messages, damage."""
        return [
            *([BEING_RECORDED] if self.growing else []),
            *(f'left out: {text}' for text in self.omitted),
            *self.damage.splitlines(),
        ]


def open_bag(
    path: Path | str, on_read: ReadCallback = ignore_progress, namespace: str = ''
) -> Bag:
    """
    Open a rosbag2 directory or an MCAP file.

    The complete chunks of a truncated or unclosed file are read; ``Bag.damage`` describes the
    damage. A file that is being recorded is read up to its state on disk.

    :param on_read: progress callback for every pass over the bag, given the amount read and the
        total; the first pass scans files without an index.
    :param namespace: namespace of the graph, if the bag contains several; empty: the bag's own.
    :raises BagError: the bag does not exist, is empty, is in another format, or has no humanopts
        topics and was not written by the humanopts recorder.
    """
    path = Path(path)
    paths, information, damage = find_files(path)
    files, errors = [], []
    for file in paths:
        try:
            growing = is_being_written(file)  # checked first, since it may be closed soon
            files.append(open_file(file, on_read, growing=growing))
        except BagError as error:
            errors.append(error)
    if not files:
        raise errors[0]
    bag = Bag(path, files, information, [*damage, *map(str, errors)])
    bag.chosen = namespace
    if not bag.topics and RECORD not in bag.metadata:  # e.g. the recorder was killed early
        raise BagError(f'{path} holds no messages{"; ".join(["", *bag.damage.splitlines()])}')
    if bag.topics and NAMESPACE not in bag.facts:
        if not any(topic.type.startswith(INTERFACES) for topic in bag.topics.values()):
            raise BagError(
                f'{path} holds no humanopts topics: it is a recording of something else'
            )
        first = next(bag.messages(), None)
        if first is not None and first.data.startswith(COMPRESSED['.zst'].magic):
            raise BagError(f'each message of {path} is compressed; {convert(path)}')
    bag.on_read = on_read
    return bag
