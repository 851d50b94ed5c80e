"""The messages, topics and files of a bag from any program, possibly damaged."""

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

MAX_NOTES = 1000  # damage descriptions
_UNDECODABLE = (*DAMAGE, IndexError, TypeError, AttributeError)  # raised for undecodable bytes
T = TypeVar('T')


class Recorded(NamedTuple):
    """A recorded message."""

    topic: str
    type: str
    log_time: int  # time of reception, ns since the epoch
    publish_time: int  # time of sending, ns since the epoch
    sequence: int  # number assigned by the recording program; see ``Recording.numbered``
    data: bytes  # CDR, as received
    recording: 'Recording'

    @property
    def message(self) -> Any:
        """The decoded message; None if damaged; the damage is recorded."""
        return self.convert(lambda message: message)

    def convert(self, convert: Callable[[Any], T]) -> T | None:
        """
        Decode and convert the message.

        :param convert: conversion function; may raise ValueError for an invalid value and
            AttributeError if the recorded type lacks a field.
        :return: converted message; None if decoding or conversion fails; the failure is recorded
            as damage.
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
    An open recording, which can be read any number of times.

    :ivar information: contents of metadata.yaml; None if missing or damaged.
    :ivar on_read: progress callback for every pass.
    :ivar metadata: MCAP metadata records by name.
    :ivar growing: whether the bag was being recorded when opened; later messages are omitted.
    :ivar numbered: whether the humanopts recorder numbered each topic's messages from 1.
    :ivar topics: topics by name, sorted.
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
        if kept and self.numbered and kept != self.facts:  # other tools omit facts
            self.note(f'{FILE} and the record {RECORD} differ: one of them is damaged')

    @property
    def files(self) -> list[Path]:
        """The MCAP files."""
        return [file.path for file in self._files]

    @property
    def damage(self) -> str:
        """The damage found so far, one line each; empty: none."""
        return '\n'.join(self._damage)

    def note(self, damage: str) -> None:
        """Record a description of damage, once."""
        self._damage[damage if len(self._damage) < MAX_NOTES else 'and more of the kind'] = None

    @property
    def facts(self) -> dict[str, str]:
        """The facts stored by the humanopts recorder, by name."""
        return self.metadata.get(RECORD, {})

    @property
    def n_messages(self) -> int:
        """The number of readable messages."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def attachments(self) -> list[AttachmentIndex]:
        """The names, sizes and types of the attached files."""
        return [index for file in self._files for index in file.summary.attachment_indexes]

    def attached(self) -> Iterator[Attachment]:
        """Yield the intact attached files; record damage for the others."""
        for file in self._files:
            for index in file.summary.attachment_indexes:
                try:
                    yield read_attachment(file.path, index)
                except BagError as error:
                    self.note(str(error))

    def compare_bytes(self) -> None:
        """Verify the checksums of all files; record differences as damage."""
        for file in self._files:
            closed = not (file.growing or file.damage)  # other files have no checksum
            if closed and (fault := check_bytes(file.path, self.on_read)):
                self.note(f'{file.path.name}: {fault}')

    def messages(
        self, topics: Collection[str] | None = None, between: tuple[int, int] = ALWAYS
    ) -> Iterator[Recorded]:
        """
        Yield messages in order of log time.

        Chunks that overlap in time are in memory at the same time.

        :param topics: topic names; None: all.
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
        """Return the topics of the files, sorted by name; report conflicting types as damage."""
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
                        self.note(f'{topic.name} has several definitions; the last one is used')
                    topic.messages += before.messages
                found[topic.name] = topic
        return dict(sorted(found.items()))
