"""Open rosbag2 directories and MCAP files, whole or damaged."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from humanopts_ros.limits import parse_json, shown
from humanopts_ros.recording import INTERFACES, own_name
from humanopts_ros.senders import GAME_TOPICS, sender_of, signer
from humanopts_ros.text_files import FileError, parse_yaml
from humanopts_teach.bags import BagError
from humanopts_teach.bags.mcap_file import (
    check_bytes,
    DAMAGE,
    ignore_progress,
    McapFile,
    open_file,
    read_attachment,
    ReadCallback,
    ZSTD_MAGIC,
)
from humanopts_teach.bags.rosbag2 import (
    check_information,
    convert,
    find_files,
    Information,
    Topic,
)
from humanopts_teach.bags.schemas import Decoder, make_decoder
from humanopts_teach.bags.sequence_numbers import read_stamp
from humanopts_teach.bags.writer import (
    GAME,
    GAME_IDS,
    is_being_written,
    NAMESPACE,
    RECORD,
    SELF,
    SELF_TEXT,
)
from mcap.records import Attachment, Message

ALWAYS = (0, 2**64)  # first and last log time
BEING_RECORDED = 'the bag is being recorded: this is what it holds so far'
MAX_STRANGERS = 1000  # publishers that are counted, topic by topic, of messages left out
MAX_LEFT_OUT = 100_000  # messages of one publisher on a topic that are counted
DEMONSTRATION = f'{INTERFACES}msg/Demonstration'
DOMAIN_INFO = f'{INTERFACES}msg/DomainInfo'
GAME_STATE = f'{INTERFACES}msg/GameState'
LESSON_STATE = f'{INTERFACES}msg/LessonState'
MAX_NOTES = 1000  # kinds of damage that are kept
_UNDECODABLE = (*DAMAGE, IndexError, TypeError, AttributeError)  # what bytes of another type raise
T = TypeVar('T')


class Recorded(NamedTuple):
    """One message of a bag."""

    topic: str
    type: str
    log_time: int  # when it was received, ns since the epoch
    publish_time: int  # when it was sent, ns since the epoch
    sequence: int  # as the program that wrote the file numbered it; see ``Bag.numbered``
    data: bytes  # CDR, as received
    bag: 'Bag'  # that it is in

    @property
    def message(self) -> Any:
        """The decoded message; None: its bytes are damaged, which ``Bag.damage`` then says."""
        return self.bag.decode(self.topic, self.data)


class Bag:
    """
    A bag that was opened; it can be read any number of times.

    :ivar information: what metadata.yaml says; None: it is missing or damaged.
    :ivar on_read: called in every pass.
    :ivar files: the MCAP files.
    :ivar metadata: the MCAP metadata records by name.
    :ivar recording: it was being recorded when it was opened; it holds what was written by then.
    :ivar attachments: the attached files by name, of which ``attached`` has the contents.
    :ivar numbered: our recorder wrote the bag, which numbers the messages of a topic from 1.
    :ivar topics: the topics by name, sorted.
    :ivar chosen: the namespace that the caller chose; empty: the bag's own.
    """

    def __init__(
        self, path: Path, files: list[McapFile], information: Information | None, damage: list[str]
    ) -> None:
        self.path = path
        self.information = information
        self.on_read: ReadCallback = ignore_progress
        self.files = [file.path for file in files]
        self.metadata = {name: each for file in files for name, each in file.metadata.items()}
        self.attachments = {
            each.name: each for file in files for each in file.summary.attachment_indexes
        }
        self.numbered = all(RECORD in file.metadata for file in files)
        self.recording = any(file.growing for file in files)
        self._files = files
        self._damage = dict.fromkeys([*damage, *(text for file in files for text in file.damage)])
        self._decoders: dict[str, Decoder] = {}
        self.topics = self._find_topics()
        self.chosen = ''
        self._allowed: dict[str, tuple[str, ...]] = {}  # by topic; see ``_allowed_on``
        self._left_out: dict[tuple[str, str, str], set[int]] = {}  # log times; see ``leave_out``
        if self.numbered:
            self._compare_facts()

    @property
    def damage(self) -> str:
        """What is wrong with the bag, as far as it was read, a line each; empty: nothing."""
        return '\n'.join(self._damage)

    @property
    def notes(self) -> list[str]:
        """What its reader must know: that it is being recorded, what is left out, its damage."""
        return [
            *([BEING_RECORDED] if self.recording else []),
            *(f'left out: {text}' for text in self.left_out),
            *self._damage,
        ]

    @property
    def left_out(self) -> list[str]:
        """What was not read because it is not of the graph, in words, as far as it was read."""
        return [*self._other_graphs(), *self.strangers]

    @property
    def facts(self) -> dict[str, str]:
        """What our recorder was given to keep of the recording, by name."""
        return self.metadata.get(RECORD, {})

    @property
    def reads_own(self) -> bool:
        """Whether the graph that is read is the recorder's own, as far as is known."""
        return self.namespace == self.facts.get(NAMESPACE, self.namespace)

    @property
    def graph_facts(self) -> dict[str, str]:
        """The facts about the graph that is read: of another than the recorder's, none."""
        return self.facts if self.reads_own else {}

    @property
    def n_messages(self) -> int:
        """Number of messages that can be read."""
        return sum(topic.messages for topic in self.topics.values())

    def attached(self) -> Iterator[Attachment]:
        """Yield the attached files that are whole; ``damage`` then says which are not."""
        for file in self._files:
            for index in file.summary.attachment_indexes:
                try:
                    yield read_attachment(file.path, index)
                except BagError as error:
                    self.note(str(error))

    def compare_bytes(self) -> None:
        """Compare every file with the checksum over it; ``damage`` says where they differ."""
        for file in self._files:
            closed = not (file.growing or file.damage)  # else there is no checksum to compare with
            if closed and (fault := check_bytes(file.path, self.on_read)):
                self.note(f'{file.path.name}: {fault}')

    @property
    def namespaces(self) -> list[str]:
        """The namespaces of the graphs in the bag, sorted."""
        kinds = (DOMAIN_INFO, GAME_STATE, DEMONSTRATION, LESSON_STATE)
        names = [topic.name for topic in self.topics.values() if topic.type in kinds]
        return sorted({name.rpartition('/')[0] or '/' for name in names})

    @cached_property
    def namespace(self) -> str:
        """
        The namespace of the graph that is read; a bag of another program may hold several.

        :raises BagError: there is none of that name, or there are several and none is chosen.
        """
        found, own = self.namespaces, self.facts.get(NAMESPACE, '')
        if self.chosen:
            if self.chosen not in found:
                there = ', '.join(found) or 'none'
                raise BagError(f'{self.path} holds no graph of namespace {self.chosen}: {there}')
            return self.chosen
        if own or len(found) < 2:
            return own or next(iter(found), '/')
        raise BagError(
            f'{self.path} holds the graphs of several namespaces: {", ".join(found)}; '
            'choose one with --namespace'
        )

    def of_type(self, type_name: str) -> list[str]:
        """Return the names of the topics of a type in the bag's namespace, sorted."""
        return sorted(
            topic.name
            for topic in self.topics.values()
            if topic.type == type_name and own_name(topic.name, self.namespace)
        )

    @cached_property
    def game_ids(self) -> tuple[str, ...]:
        """
        The publisher ids of the game, one after each start of it; none: not known.

        Our recorder keeps those of its graph. In other graphs, the game is the node that announced
        one and published most states.
        """
        record = self.metadata.get(GAME, {}) if self.reads_own else {}
        kept = record.get(GAME_IDS, '')
        try:
            ids = parse_json(kept) if kept else []
        except ValueError:
            ids = None
        if isinstance(ids, list) and ids:
            return tuple(map(str, ids))
        if ids != []:
            self.note(f'the record {GAME} is damaged')
        announced = dict.fromkeys(self._publisher_ids(DOMAIN_INFO))
        played = Counter(self._publisher_ids(GAME_STATE))
        games = [each for each in announced if each in played or not played]
        states = Counter[str]()
        for each in games:
            states[signer(each)] += played[each]
        # Of equal ones, the first in the bag; without a signature, any node may be the game.
        best = max(states, key=states.__getitem__, default='')
        return tuple(each for each in games if best and signer(each) == best)

    def is_genuine(self, recorded: Recorded) -> bool:
        """
        Return whether a message counts: the nodes of the graph would take it.

        It is in the bag's namespace, and from the node that may publish there. ``left_out`` says
        what does not count because of its publisher.
        """
        if self.is_strange(recorded):
            return False
        return own_name(recorded.topic, self.namespace) != ''

    def is_strange(self, recorded: Recorded) -> bool:
        """
        Return whether a message is from a node that may not publish on its topic.

        Where the bag holds several graphs and none is chosen, none is known to be so.
        """
        if recorded.topic not in self._allowed:
            self._allowed[recorded.topic] = self._allowed_on(recorded.topic)
        allowed = self._allowed[recorded.topic]
        stamp = read_stamp(recorded.data) if allowed else None
        if stamp is None:
            return False
        publisher_id, sender = stamp.publisher_id, signer(stamp.publisher_id)
        if publisher_id in allowed or sender in allowed:
            return False
        nodes = sorted({signer(each) or each for each in allowed})
        if sender in nodes:  # of the same name
            self.leave_out(recorded, 'which was not the game', publisher_id)
        else:
            self.leave_out(recorded, f'not from {" or ".join(nodes)}', sender or publisher_id)
        return True

    def _allowed_on(self, topic: str) -> tuple[str, ...]:
        """
        Return the nodes, or publisher ids of the game, that may publish on a topic.

        ``()``: any may, or it is a topic of another graph.
        """
        try:
            name = own_name(topic, self.namespace)
        except BagError:
            return ()
        if name in GAME_TOPICS:
            return self.game_ids
        owner = sender_of(topic, self.namespace)
        return (owner,) if owner else ()

    def leave_out(self, recorded: Recorded, why: str, sender: str) -> None:
        """Count a message that does not count, once, however often the bag is read."""
        key = recorded.topic, why, shown(sender, 80)
        if key in self._left_out or len(self._left_out) < MAX_STRANGERS:
            times = self._left_out.setdefault(key, set())
            if len(times) < MAX_LEFT_OUT:
                times.add(recorded.log_time)

    def genuine(self, type_name: str, between: tuple[int, int] = ALWAYS) -> Iterator[Recorded]:
        """Yield the messages of a type that count, in order of log time."""
        return filter(self.is_genuine, self.messages(self.of_type(type_name), between))

    def _publisher_ids(self, type_name: str) -> Iterator[str]:
        """Yield the publisher id of each message of a type."""
        for recorded in self.messages(self.of_type(type_name)):
            stamp = read_stamp(recorded.data)
            yield '' if stamp is None else stamp.publisher_id

    def messages(
        self,
        topics: Collection[str] | None = None,
        between: tuple[int, int] = ALWAYS,
    ) -> Iterator[Recorded]:
        """
        Yield messages in order of log time.

        Where chunks overlap in time, the messages of several are held.

        :param topics: names; None: all.
        :param between: first and last log time, ns.
        """
        wanted = [
            {
                channel.id: self.topics[channel.topic]
                for channel in file.summary.channels.values()
                if channel.topic in self.topics and (topics is None or channel.topic in topics)
            }
            for file in self._files
        ]
        with ExitStack() as stack:
            batches = [
                ((start, number, offset), read)
                for number, file in enumerate(self._files)
                for start, offset, read in file.batches(stack, wanted[number], between)
            ]
            batches.sort(key=itemgetter(0))
            starts = [*(start for start, _ in batches[1:]), (ALWAYS[1], 0, 0)]
            held: list[tuple[int, int, int, int, Message]] = []  # time, file, offset, place in it
            for place, ((_, number, offset), read) in enumerate(batches):
                self.on_read(place, len(batches))
                messages = []
                try:
                    messages = read()
                except DAMAGE as error:
                    what = f'the chunk at byte {offset} is damaged and left out: {error}'
                    self.note(f'{self.files[number].name}: {what}')
                held += (
                    (message.log_time, number, offset, order, message)
                    for order, message in enumerate(messages)
                    if message.channel_id in wanted[number]
                    and between[0] <= message.log_time <= between[1]
                )
                held.sort()
                due = bisect_left(held, starts[place])
                for _, file_number, _, _, message in held[:due]:
                    topic = wanted[file_number][message.channel_id]
                    yield Recorded(
                        topic.name,
                        topic.type,
                        message.log_time,
                        message.publish_time,
                        message.sequence,
                        message.data,
                        self,
                    )
                del held[:due]

    def decode(self, topic: str, data: bytes) -> Any:
        """Decode a message of a topic; None: its bytes are damaged, which ``damage`` then says."""
        return self.convert(topic, data, lambda message: message)

    def convert(self, topic: str, data: bytes, convert: Callable[[Any], T]) -> T | None:
        """
        Decode a message of a topic, and make something of it.

        :param convert: may raise ValueError where a value is wrong, and AttributeError where the
            recorded type lacks a field.
        :return: None: either was not possible, which ``damage`` then says.
        """
        try:
            if topic not in self._decoders:
                entry = self.topics[topic]
                self._decoders[topic] = make_decoder(entry.type, entry.schema)
            message = self._decoders[topic](data)
        except _UNDECODABLE as error:
            self.note(f'a message on {topic} is left out: it does not decode: {error}')
            return None
        try:
            return convert(message)
        except (AttributeError, ValueError) as error:
            self.note(f'a message on {topic} is left out: {error}')
            return None

    def converted(
        self, type_name: str, convert: Callable[[Any], T], between: tuple[int, int] = ALWAYS
    ) -> Iterator[T]:
        """Yield what ``convert`` makes of the messages of a type, where it can, in order."""
        for recorded in self.genuine(type_name, between):
            made = self.convert(recorded.topic, recorded.data, convert)
            if made is not None:
                yield made

    def note(self, damage: str) -> None:
        """Keep a description of damage, once."""
        self._damage[damage if len(self._damage) < MAX_NOTES else 'and more of the kind'] = None

    def _other_graphs(self) -> list[str]:
        """Say which graphs are in the bag and not read."""
        others = [name for name in self.namespaces if name != self.namespace]
        there = f'the graph of {", ".join(others)}: the graph of {self.namespace} is read'
        return [there] if others else []

    @property
    def strangers(self) -> list[str]:
        """Messages that do not count because of their publisher, in words."""
        found: dict[tuple[str, str], list[tuple[str, int]]] = {}
        for (topic, why, sender), times in self._left_out.items():
            found.setdefault((topic, why), []).append((sender, len(times)))
        texts = []
        for (topic, why), senders in found.items():
            count = sum(number for _, number in senders)
            names = ', '.join(sender or 'no node' for sender, _ in senders[:3])
            more = ', ...' if len(senders) > 3 else ''
            what = f'{count} message{"s"[: count > 1]} on {topic}'
            texts.append(f'{what}: from {names}{more}, {why}')
        return texts

    def _find_topics(self) -> dict[str, Topic]:
        """Return the topics of the files, sorted by name; note those of several types."""
        found: dict[str, Topic] = {}
        for file in self._files:
            for channel in file.summary.channels.values():
                schema = file.summary.schemas.get(channel.schema_id)
                if schema is None or channel.message_encoding != 'cdr':
                    continue
                topic = Topic(
                    channel.topic,
                    schema.name,
                    schema.data.decode(errors='replace'),
                    channel.metadata.get('offered_qos_profiles', ''),
                    channel.metadata.get('topic_type_hash', ''),
                    file.counts.get(channel.id, 0),
                )
                before = found.get(topic.name, topic)
                if (before.type, before.schema) != (topic.type, topic.schema):
                    self.note(f'{topic.name} is defined in several ways, and read by the last')
                if before is not topic:
                    topic.messages += before.messages
                found[topic.name] = topic
        return dict(sorted(found.items()))

    def _compare_facts(self) -> None:
        """Note where the copies of our recorder's facts differ."""
        facts = self.facts
        for file in self._files:
            if file.metadata.get(RECORD, facts) != facts:
                self.note(f'{file.path.name} has other facts than the last file')
        try:
            if text := self.metadata.get(SELF, {}).get(SELF_TEXT, ''):
                copy = check_information(parse_yaml(text)).custom_data
                # Other programs leave the facts out, which loses nothing.
                if copy and copy != facts:
                    self.note(f'the records {SELF} and {RECORD} differ: one of them is damaged')
        except FileError:
            self.note(f'the record {SELF} is damaged')


def open_bag(
    path: Path | str, on_read: ReadCallback = ignore_progress, namespace: str = ''
) -> Bag:
    """
    Open a rosbag2 directory or an MCAP file.

    A file that was cut short or not closed is opened with all that is whole in it; ``Bag.damage``
    then says what is wrong. One that is being recorded is opened with what is on the disk so far.

    :param on_read: is called with how much is read, and of how much, in every pass over the bag;
        the first of which finds the messages of a file without an index.
    :param namespace: of the graph to read, where the bag holds several; empty: the bag's own.
    :raises BagError: there is nothing, it is empty, was written by another program, or holds no
        humanopts topics and was not begun by our recorder.
    """
    path = Path(path)
    paths, information, damage = find_files(path)
    files, errors = [], []
    for file in paths:
        try:
            growing = is_being_written(file)  # asked before reading: it may be closed meanwhile
            files.append(open_file(file, on_read, growing=growing))
        except BagError as error:
            errors.append(error)
    if not files:
        raise errors[0]
    bag = Bag(path, files, information, [*damage, *map(str, errors)])
    bag.chosen = namespace
    if not bag.topics and RECORD not in bag.metadata:  # ours may have been killed at once
        reason = f' ({bag.damage})'.replace('\n', '; ') if bag.damage else ''
        raise BagError(f'{path} holds no messages{reason}')
    foreign = bag.topics and NAMESPACE not in bag.facts
    if foreign and not any(t.type.startswith(INTERFACES) for t in bag.topics.values()):
        raise BagError(f'{path} holds no humanopts topics: it is a recording of something else')
    first = next(bag.messages(), None) if foreign else None
    if first is not None and first.data.startswith(ZSTD_MAGIC):
        raise BagError(f'each message of {path} is compressed; {convert(path)}')
    bag.on_read = on_read
    return bag
