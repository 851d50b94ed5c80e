"""The messages, topics and files of a bag, whichever program wrote it, whole or damaged."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from humanopts_teach.bags import BagError
from humanopts_teach.bags.mcap_file import (
    ALWAYS,
    check_bytes,
    DAMAGE,
    ignore_progress,
    McapFile,
    read_attachment,
    ReadCallback,
)
from humanopts_teach.bags.rosbag2 import FILE, Information, Topic
from humanopts_teach.bags.schemas import Decoder, make_decoder
from humanopts_teach.bags.writer import RECORD
from mcap.records import Attachment, AttachmentIndex, ChunkIndex, Message

MAX_NOTES = 1000  # kinds of damage that are kept
_UNDECODABLE = (*DAMAGE, IndexError, TypeError, AttributeError)  # what bytes of another type raise
T = TypeVar('T')


class Recorded(NamedTuple):
    """One message of a bag."""

    topic: str
    type: str
    log_time: int  # when it was received, ns since the epoch
    publish_time: int  # when it was sent, ns since the epoch
    sequence: int  # as the program that wrote the file numbered it; see ``Recording.numbered``
    data: bytes  # CDR, as received
    recording: 'Recording'

    @property
    def message(self) -> Any:
        """The decoded message; None if its bytes are damaged, which is noted."""
        return self.convert(lambda message: message)

    def convert(self, convert: Callable[[Any], T]) -> T | None:
        """
        Decode the message, and make something of it.

        :param convert: may raise ValueError if a value is wrong, and AttributeError if the
            recorded type lacks a field.
        :return: None if either is impossible, which is noted as damage.
        """
        try:
            message = self.recording.decoder(self.topic)(self.data)
        except _UNDECODABLE as error:
            why = f'it does not decode: {error}'
        else:
            try:
                return convert(message)
            except (AttributeError, ValueError) as error:
                why = str(error)
        self.recording.note(f'a message on {self.topic} is left out: {why}')
        return None


class Recording:
    """
    A recording that was opened; it can be read any number of times.

    :ivar information: metadata.yaml; None if it is missing or damaged.
    :ivar on_read: called in every pass.
    :ivar metadata: the MCAP metadata records by name.
    :ivar growing: it was being recorded when it was opened; it holds what was written by then.
    :ivar numbered: our recorder wrote the bag, which numbers the messages of a topic from 1.
    :ivar topics: the topics by name, sorted.
    """

    def __init__(
        self, path: Path, files: list[McapFile], information: Information | None, damage: list[str]
    ) -> None:
        self.path = path
        self.information = information
        self.on_read: ReadCallback = ignore_progress
        self._files = files
        self.metadata = {name: each for file in files for name, each in file.metadata.items()}
        self.growing = any(file.growing for file in files)
        self.numbered = all(RECORD in file.metadata for file in files)
        self._damage = dict.fromkeys([*damage, *(text for file in files for text in file.damage)])
        self._decoders: dict[str, Decoder] = {}
        self.topics = self._find_topics()
        for file in files:
            if file.metadata.get(RECORD, self.facts) != self.facts:
                self.note(f'{file.path.name} has other facts than the last file')
        kept = information and information.custom_data
        if kept and self.numbered and kept != self.facts:  # other tools leave them out
            self.note(f'{FILE} and the record {RECORD} differ: one of them is damaged')

    @property
    def files(self) -> list[Path]:
        """The MCAP files."""
        return [file.path for file in self._files]

    @property
    def damage(self) -> str:
        """Damage found so far, a line each; empty: none."""
        return '\n'.join(self._damage)

    def note(self, damage: str) -> None:
        """Keep a description of damage, once."""
        self._damage[damage if len(self._damage) < MAX_NOTES else 'and more of the kind'] = None

    @property
    def facts(self) -> dict[str, str]:
        """The facts that our recorder was given to keep, by name."""
        return self.metadata.get(RECORD, {})

    @property
    def n_messages(self) -> int:
        """Number of messages that can be read."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def attachments(self) -> list[AttachmentIndex]:
        """Name, size and type of the attached files."""
        return [index for file in self._files for index in file.summary.attachment_indexes]

    def attached(self) -> Iterator[Attachment]:
        """Yield the attached files that are whole; the others are noted."""
        for file in self._files:
            for index in file.summary.attachment_indexes:
                try:
                    yield read_attachment(file.path, index)
                except BagError as error:
                    self.note(str(error))

    def compare_bytes(self) -> None:
        """Compare every file with its checksum; differences are noted."""
        for file in self._files:
            closed = not (file.growing or file.damage)  # else it has no checksum
            if closed and (fault := check_bytes(file.path, self.on_read)):
                self.note(f'{file.path.name}: {fault}')

    def messages(
        self, topics: Collection[str] | None = None, between: tuple[int, int] = ALWAYS
    ) -> Iterator[Recorded]:
        """
        Yield messages in order of log time.

        Chunks that overlap in time are held in memory together.

        :param topics: names; None: all.
        :param between: first and last log time, ns.
        """

        def select(messages: list[Message], wanted: dict[int, Topic]) -> Iterator[Recorded]:
            for each in messages:
                topic = wanted.get(each.channel_id)
                if topic is not None and between[0] <= each.log_time <= between[1]:
                    times = each.log_time, each.publish_time
                    yield Recorded(topic.name, topic.type, *times, each.sequence, each.data, self)

        held, chunks = list[Recorded](), list[tuple[ChunkIndex, McapFile, dict[int, Topic]]]()
        for file in self._files:
            wanted = {
                channel.id: self.topics[channel.topic]
                for channel in file.summary.channels.values()
                if channel.topic in self.topics and (topics is None or channel.topic in topics)
            }
            held += select(file.loose, wanted)
            chunks += ((chunk, file, wanted) for chunk in file.chunks(wanted, between))
        chunks.sort(key=lambda each: each[0].message_start_time)
        held.sort(key=attrgetter('log_time'))
        for number, (chunk, file, wanted) in enumerate(chunks, start=1):
            due = bisect_right(held, chunk.message_start_time, key=attrgetter('log_time'))
            yield from held[:due]
            del held[:due]
            self.on_read(number, len(chunks))
            try:
                held += select(file.read(chunk), wanted)
            except DAMAGE as error:
                where = f'{file.path.name}: the chunk at byte {chunk.chunk_start_offset}'
                self.note(f'{where} is damaged and left out: {error}')
            held.sort(key=attrgetter('log_time'))
        yield from held

    def decoder(self, topic: str) -> Decoder:
        """
        Return the decoder of a topic's messages.

        :raises BagError: the definition of its type is damaged.
        """
        if topic not in self._decoders:
            entry = self.topics[topic]
            self._decoders[topic] = make_decoder(entry.type, entry.schema)
        return self._decoders[topic]

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
                    file.counts[channel.id],
                )
                if before := found.get(topic.name):
                    if (before.type, before.schema) != (topic.type, topic.schema):
                        self.note(f'{topic.name} is defined in several ways, and read by the last')
                    topic.messages += before.messages
                found[topic.name] = topic
        return dict(sorted(found.items()))
