"""Opens rosbag2 directories and MCAP files, whole or damaged."""

from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.mcap_file import (
    Attached,
    DAMAGE,
    data_fits,
    FileIndex,
    McapStream,
    read_attachment,
    read_block,
    read_index,
)
from humanopts_teach.bags.rosbag2 import FILE, find_files, load
from humanopts_teach.bags.schemas import decode, Decoder, make_decoder
from humanopts_teach.bags.writer import LIBRARY, RECORD, SELF, SELF_TEXT
from mcap.records import Attachment, Message, Schema

INTERFACES = 'humanopts_interfaces/'
ALWAYS = (0, 2**64)  # first and last log time
MOST_WAITING = 64 << 20  # bytes of messages that are held to be put in order of time
_MESSAGE_MEMORY = 500  # bytes that a message takes in memory apart from its data
MOST_NOTES = 1000  # kinds of damage that are kept
ProgressCallback = Callable[[int, int], object]  # takes how many bytes are read, and of how many


def ignore_progress(done: int, total: int) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a bag."""

    name: str
    type: str  # such as humanopts_interfaces/msg/GameState
    schema: str  # its ros2msg definition, complete
    messages: int
    qos: str  # offered profiles, YAML; empty: not known
    type_hash: str  # RIHS01_...; empty: not known


class Recorded(NamedTuple):
    """One message of a bag."""

    topic: str
    type: str
    log_time: int  # when it was received, ns since the epoch
    publish_time: int  # when it was sent, ns since the epoch
    sequence: int  # as the program that wrote the file numbered it; see ``Bag.numbered``
    data: bytes  # CDR, as received
    message: Any  # decoded; None: it was not asked for, or it does not decode


class Bag:
    """A bag that was opened; it can be read any number of times."""

    def __init__(
        self, path: Path, files: list[FileIndex], information: dict[str, Any], damage: list[str]
    ) -> None:
        self.path = path
        self.information = information  # of metadata.yaml; {}: there is none
        self.on_read: ProgressCallback = ignore_progress  # called in every pass
        self._files = files
        self._damage = dict.fromkeys([*damage, *(text for file in files for text in file.damage)])
        self._decoders: dict[str, Decoder] = {}
        self.topics = _topics(files)
        self._compare_topics()
        self._compare_facts()

    @property
    def damage(self) -> str:
        """What is wrong with the bag, as far as it was read, a line each; empty: nothing."""
        return '\n'.join(self._damage)

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The MCAP metadata records by name; ``humanopts`` has the facts of the recorder."""
        return {name: record for file in self._files for name, record in file.metadata.items()}

    @property
    def files(self) -> list[Path]:
        """The MCAP files."""
        return [file.path for file in self._files]

    @property
    def numbered(self) -> bool:
        """Whether our recorder wrote the bag, which numbers the messages of a topic from 1."""
        return all(file.library == LIBRARY or RECORD in file.metadata for file in self._files)

    @property
    def n_messages(self) -> int:
        """Number of messages that can be read."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def attachments(self) -> dict[str, Attached]:
        """The attached files by name, of which ``attached`` has the contents."""
        return {name: at for file in self._files for name, at in file.attachments.items()}

    def attached(self) -> Iterator[Attachment]:
        """Yield the attached files that are whole; ``damage`` then says which are not."""
        for file in self._files:
            for name in file.attachments:
                try:
                    yield read_attachment(file, name)
                except BagError as error:
                    self.note(str(error))

    def compare_bytes(self) -> None:
        """Compare every file with the checksum over it; ``damage`` says where they differ."""
        tell = _by_file(self.files, self.on_read)
        for number, file in enumerate(self.files):
            if not data_fits(file, partial(tell, number)):
                self.note(f'{file.name}: its bytes do not fit the checksum over all of them')

    def of_type(self, type_name: str) -> list[str]:
        """Return the names of the topics of a type, sorted."""
        return sorted(topic.name for topic in self.topics.values() if topic.type == type_name)

    def messages(
        self,
        topics: Collection[str] | None = None,
        *,
        decoded: bool = True,
        between: tuple[int, int] = ALWAYS,
    ) -> Iterator[Recorded]:
        """
        Yield messages in order of log time.

        :param topics: names; None: all.
        :param decoded: fill in ``Recorded.message``.
        :param between: first and last log time, ns.
        """
        found = _in_order(
            self._files,
            [self._wanted(file, topics) for file in self._files],
            between,
            _by_file(self.files, self.on_read),
            self.note,
        )
        for number, message in found:
            channel = self._files[number].channels[message.channel_id]
            topic = self.topics[channel.topic]
            yield Recorded(
                topic.name,
                topic.type,
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
                self.decode(topic.name, message.data) if decoded else None,
            )

    def decode(self, topic: str, data: bytes) -> Any:
        """Decode a message of a topic; None: its bytes are damaged, which ``damage`` then says."""
        try:
            if topic not in self._decoders:
                entry = self.topics[topic]
                self._decoders[topic] = make_decoder(entry.type, entry.schema)
            return decode(self._decoders[topic], data)
        except BagError as error:
            self.note(f'a message on {topic} is left out: {error}')
            return None

    @contextmanager
    def skipping_missing_fields(self, topic: str) -> Iterator[None]:
        """Leave a message out, and note it, where its type lacks a field that is read."""
        try:
            yield
        except AttributeError as error:
            self.note(f'a message on {topic} is left out: {error}')

    def note(self, damage: str) -> None:
        """Keep a description of damage, once."""
        self._damage[damage if len(self._damage) < MOST_NOTES else 'and more of the kind'] = None

    def _compare_topics(self) -> None:
        """Note where messages on one topic are of several types."""
        for file in self._files:
            for channel in file.channels.values():
                topic, schema = self.topics.get(channel.topic), file.schemas.get(channel.schema_id)
                if topic and schema and (topic.type, topic.schema) != _definition(schema):
                    self.note(f'{topic.name} is defined in several ways, and read by the last')

    def _compare_facts(self) -> None:
        """Note where the copies of our recorder's facts differ."""
        if not self.numbered:
            return
        facts = self.metadata.get(RECORD, {})
        for file in self._files:
            if file.metadata.get(RECORD, facts) != facts:
                self.note(f'{file.path.name} has other facts than the last file')
        copies = {FILE: self.information} if self.information else {}
        try:
            own = load(self.metadata.get(SELF, {}).get(SELF_TEXT, ''))
            copies.update({f'the record {SELF}': own} if isinstance(own, dict) else {})
        except ValueError:
            self.note(f'the record {SELF} is damaged')
        for place, copy in copies.items():
            if (copy.get('custom_data') or {}) != facts:
                self.note(f'{place} and the record {RECORD} differ: one of them is damaged')

    def _wanted(self, file: FileIndex, topics: Collection[str] | None) -> frozenset[int]:
        return frozenset(
            channel.id
            for channel in file.channels.values()
            if channel.topic in self.topics and (topics is None or channel.topic in topics)
        )


def open_bag(path: Path | str, on_read: ProgressCallback = ignore_progress) -> Bag:
    """
    Open a rosbag2 directory or an MCAP file.

    A file that was cut short or not closed is opened with all that is whole in it; ``Bag.damage``
    then says what is wrong.

    :param on_read: is called with the bytes read so far in every pass over the bag, the first of
        which finds the messages of a file without an index.
    :raises BagError: there is nothing, it is empty, was written by another program, or holds no
        humanopts topics and was not begun by our recorder.
    """
    path = Path(path)
    found = find_files(path)
    files, damage = _indexes(found.files, on_read)
    bag = Bag(path, files, found.information, [*found.damage, *damage])
    bag.on_read = on_read
    if not bag.topics and RECORD not in bag.metadata:  # ours may have been killed at once
        reason = f' ({bag.damage})' if bag.damage else ''
        raise BagError(f'{path} holds no messages{reason}')
    if bag.topics and not any(t.type.startswith(INTERFACES) for t in bag.topics.values()):
        raise BagError(f'{path} holds no humanopts topics: it is a recording of something else')
    return bag


def _indexes(
    files: Sequence[Path], on_read: ProgressCallback
) -> tuple[list[FileIndex], list[str]]:
    """
    Find the messages of the files that can be read; also return why others cannot.

    :raises BagError: none can.
    """
    tell = _by_file(files, on_read)
    found, errors = [], []
    for number, file in enumerate(files):
        try:
            found.append(read_index(file, partial(tell, number)))
        except BagError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return found, list(map(str, errors))


def _topics(files: list[FileIndex]) -> dict[str, Topic]:
    """Return the topics of the files, sorted by name."""
    found: dict[str, Topic] = {}
    for file in files:
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding != 'cdr':
                continue
            before = found[channel.topic].messages if channel.topic in found else 0
            found[channel.topic] = Topic(
                channel.topic,
                *_definition(schema),
                before + file.counts.get(channel.id, 0),
                channel.metadata.get('offered_qos_profiles', ''),
                channel.metadata.get('topic_type_hash', ''),
            )
    return dict(sorted(found.items()))


def _definition(schema: Schema) -> tuple[str, str]:
    """Return the name of a type and its ros2msg text."""
    return schema.name, schema.data.decode(errors='replace')


def _by_file(files: Sequence[Path], on_read: ProgressCallback) -> Callable[[int, int], object]:
    """Return what takes the number of a file and the offset up to which it is read."""
    sizes = [file.stat().st_size if file.exists() else 0 for file in files]
    total = sum(sizes)
    before = [sum(sizes[:number]) for number in range(len(sizes))]
    return lambda number, offset: on_read(before[number] + offset, total)


def _in_order(
    files: Sequence[FileIndex],
    wanted: Sequence[frozenset[int]],
    between: tuple[int, int],
    on_block: Callable[[int, int], object],
    note: Callable[[str], object],
) -> Iterator[tuple[int, Message]]:
    """
    Yield messages of several files by log time, each with the number of its file.

    Where blocks overlap in time, the messages of several are held, up to ``MOST_WAITING`` bytes.

    :param wanted: ids of the channels that are read, of each file.
    :param between: first and last log time that are read, ns.
    :param on_block: takes the number of the file and the offset of each block that is read.
    :param note: takes in words what is damaged.
    """
    first, last = between
    blocks = sorted(
        ((block.start, number, block.offset), block)
        for number, file in enumerate(files)
        for block in file.blocks
        if block.start <= last
        and block.end >= first
        and not block.channels.isdisjoint(wanted[number])
    )
    waiting: list[tuple[int, int, int, int, Message]] = []  # time, file, block, place in it
    with ExitStack() as stack:
        streams = [stack.enter_context(McapStream(file.path)) for file in files]
        for here, ((_, number, offset), block) in enumerate(blocks):
            on_block(number, offset)
            try:
                records = read_block(streams[number], block)
            except DAMAGE as error:
                name = files[number].path.name
                note(f'{name}: the chunk at byte {offset} is damaged and left out: {error}')
                continue
            waiting += [
                (record.log_time, number, offset, place, record)
                for place, record in enumerate(records)
                if isinstance(record, Message)
                and record.channel_id in wanted[number]
                and first <= record.log_time <= last
            ]
            waiting.sort()
            due = len(waiting)
            if here + 1 < len(blocks):
                due = bisect_left(waiting, blocks[here + 1][0])
            if (
                sum(len(entry[-1].data) + _MESSAGE_MEMORY for entry in waiting[due:])
                > MOST_WAITING
            ):
                note('its messages are so far out of order that they come as they are')
                due = len(waiting)
            yield from ((entry[1], entry[-1]) for entry in waiting[:due])
            del waiting[:due]
        yield from ((entry[1], entry[-1]) for entry in waiting)
