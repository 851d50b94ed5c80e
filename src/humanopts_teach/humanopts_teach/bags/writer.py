"""Writes a rosbag2 directory: MCAP files (profile ros2) and metadata.yaml."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
from types import TracebackType
from typing import Any, cast, IO

from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.rosbag2 import (
    bag_information,
    document,
    dump,
    Extent,
    FILE,
    Qos,
    TopicEntry,
)
from humanopts_teach.bags.schemas import Definitions
from mcap.writer import CompressionType, Writer


class Sink:
    """
    Writes whole MCAP records to a new file, unbuffered.

    A record that does not fit on the disk is removed, so that the file stays readable; after that
    nothing more is written.
    """

    def __init__(self, path: Path) -> None:
        """
        Create the file.

        :raises OSError: it exists, or cannot be created.
        """
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._end = 0
        self._failure = ''

    def write(self, data: bytes) -> None:
        """
        Append whole records.

        :raises BagWriteError: the disk is full, or the file cannot be written any more.
        """
        if self._failure:
            raise BagWriteError(self._failure)
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError as error:
            self._failure = f'cannot write to {self._path}: {error.strerror}; what was written'
            self._failure += ' before is kept. Free space and start another recording'
            with suppress(OSError):
                os.ftruncate(self._file, self._end)
            raise BagWriteError(self._failure) from error
        self._end += len(data)

    def rename(self, path: Path) -> None:
        """
        Give the file another name.

        :raises OSError: it cannot have it.
        """
        os.replace(self._path, path)
        self._path = path

    def discard(self) -> None:
        """Close the file and remove it."""
        self.close()
        with suppress(OSError):
            self._path.unlink()

    def tell(self) -> int:
        """Return the size of the file."""
        return self._end

    def flush(self) -> None:
        """Do nothing: the operating system has everything that was written."""

    def close(self) -> None:
        """Close the file; it can be called again."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


CHUNK_BYTES = 256 * 1024
LIBRARY = 'humanopts'  # the program that wrote the file, in its header
RECORD = 'humanopts'  # name of the MCAP metadata record with the recorder's facts
SELF = 'rosbag2'  # name of the record with a copy of metadata.yaml ...
SELF_TEXT = 'serialized_metadata'  # ... under this key


class BagFile:
    """
    One file that is being written.

    The file gets its name only when its head is on the disk, so that no reader finds it empty.
    """

    def __init__(self, path: Path, facts: Mapping[str, str]) -> None:
        """
        Begin the file.

        :param facts: kept in the metadata record ``humanopts``.
        :raises OSError: it cannot be created.
        :raises BagWriteError: the disk is full.
        """
        self.name = path.name
        self.extent = Extent()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._finished = False
        self._sink = Sink(path.with_name(f'{path.name}.new'))
        self._writer: Any = Writer(
            cast(IO[Any], self._sink),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        try:
            self._writer.start(profile='ros2', library=LIBRARY)
            self.note(RECORD, facts)
            self._sink.rename(path)
        except OSError:
            self._sink.discard()
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file."""
        return self._sink.tell()

    def announce(self, topic: TopicEntry, schema: str) -> None:
        """Add a topic; errors as ``write``."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, 'ros2msg', schema.encode()
            )
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, 'cdr', self._schemas[topic.type], topic.channel_metadata
        )

    def knows(self, topic: str) -> bool:
        """Tell whether a topic was announced."""
        return topic in self._channels

    def write(
        self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int
    ) -> None:
        """
        Add one message on a topic that was announced.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._writer.add_message(
            self._channels[topic], log_time, data, publish_time, sequence=sequence % 2**32
        )
        self.extent.add(log_time)

    def attach(self, name: str, data: bytes, media_type: str, times: tuple[int, int]) -> None:
        """Keep a file of another kind; errors as ``write``."""
        self._writer.flush()
        made, recorded = times
        self._writer.add_attachment(made, recorded, name, media_type, data)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Keep facts in a metadata record; errors as ``write``."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Write the present chunk; errors as ``write``."""
        self._writer.flush()

    def finish(self, information: str) -> None:
        """
        Write index and statistics, and close the file; errors as ``write``.

        :param information: the contents of metadata.yaml.
        """
        if self._finished:
            return
        self._finished = True
        try:
            self._writer.flush()
            self.note(SELF, {SELF_TEXT: information})
            self._writer.finish()
            self._writer = None  # its index takes memory
        finally:
            self._sink.close()

    def discard(self) -> None:
        """Remove the file."""
        self._sink.discard()


@dataclass(frozen=True)
class Limits:
    """When the next file of a bag begins; 0: never."""

    bytes: int = 0  # size of a file, without the present chunk and the index
    seconds: float = 0.0  # after the first message in the file

    def reached(self, file: BagFile, log_time: int) -> bool:
        """Tell whether a message of this time (ns) belongs into the next file."""
        if file.extent.messages == 0:
            return False
        age = log_time - file.extent.first
        return 0 < self.bytes <= file.bytes_written or 0 < self.seconds * 1e9 <= age


NO_LIMITS = Limits()


class BagWriter:
    """
    One recording.

    ``flush`` hands every message so far to the operating system as whole chunks: a process that
    is killed loses only what came after. After a ``BagWriteError`` nothing more is written.
    """

    def __init__(
        self,
        path: Path,
        facts: Mapping[str, str] | None = None,
        definitions: Definitions | None = None,
        limits: Limits = NO_LIMITS,
    ) -> None:
        """
        Begin a bag.

        :param path: its directory; must not exist.
        :param facts: settings and versions, kept in the MCAP metadata record ``humanopts``.
        :param definitions: where message definitions are found; None: AMENT_PREFIX_PATH.
        :param limits: when the next file is begun.
        :raises BagWriteError: the directory exists, or cannot be made.
        """
        self.path = Path(path)
        self._facts = dict(facts or {})
        self._definitions = definitions or Definitions()
        self._limits = limits
        self._topics: dict[str, TopicEntry] = {}
        self._described = -1  # topics in metadata.yaml
        self._closed = False
        self._make_directory()
        self._file = self._begin_file(0)
        self._files = [self._file]
        self.flush()

    @property
    def bytes_written(self) -> int:
        """Size of the MCAP files."""
        return sum(file.bytes_written for file in self._files)

    @property
    def n_files(self) -> int:
        """Number of MCAP files."""
        return len(self._files)

    @property
    def extent(self) -> Extent:
        """How much the files hold."""
        whole = Extent()
        for file in self._files:
            whole.include(file.extent)
        return whole

    @property
    def topics(self) -> list[TopicEntry]:
        """Every topic that was added, with its message count."""
        return list(self._topics.values())

    def add_topic(
        self, name: str, type_name: str, qos: Sequence[Qos] = (), type_hash: str = ''
    ) -> str:
        """
        Add a topic; one that was added already stays as it is.

        :param type_name: such as humanopts_interfaces/msg/GameState.
        :param qos: the profiles that its publishers offer.
        :param type_hash: RIHS01_..., where it is known; kept for messages only.
        :return: the schema of its messages.
        :raises SchemaError: the type's definition is not installed here.
        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        schema = self._definitions.schema(type_name)
        if name in self._topics:
            return schema
        if '/msg/' not in type_name:
            type_hash = ''  # rosbags 0.11 opens no bag with that of a service event or feedback
        self._topics[name] = TopicEntry(name, type_name, tuple(qos), type_hash)
        self._file.announce(self._topics[name], schema)
        return schema

    def write(
        self,
        topic: str,
        data: bytes,
        log_time: int,
        publish_time: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """
        Add one message.

        :param data: the CDR bytes as received.
        :param log_time: when it was received, ns since the epoch.
        :param publish_time: when it was sent; None: not known, so ``log_time``.
        :param sequence: its number; None: the next one of its topic.
        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        if self._limits.reached(self._file, log_time):
            self._split()
        entry, file = self._topics[topic], self._file
        if not file.knows(topic):
            file.announce(entry, self._definitions.schema(entry.type))
        sent = log_time if publish_time is None else publish_time
        number = entry.messages + 1 if sequence is None else sequence
        file.write(topic, data, log_time, sent, number)
        entry.messages += 1

    def attach(
        self,
        name: str,
        data: bytes,
        media_type: str = 'application/json',
        times: tuple[int, int] | None = None,
    ) -> None:
        """
        Keep a file in the bag.

        :param times: when the file was made and recorded, ns; None: that of the last message.
        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        last = self.extent.last
        self._file.attach(name, data, media_type, times or (last, last))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """
        Keep facts in an MCAP metadata record.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._file.note(name, values)

    def flush(self) -> None:
        """
        Write the present chunk, and metadata.yaml where it lacks a topic.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._file.flush()
        if self._described != len(self._topics):
            self._describe(self._information())

    def close(self) -> None:
        """
        Write index, statistics and metadata.yaml; it can be called again.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        if not self._closed:
            self._closed = True
            information = self._information()
            self._file.finish(information)
            self._describe(information)

    def __enter__(self) -> 'BagWriter':
        """Return the writer; leaving the context closes it."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self.close()

    def _split(self) -> None:
        """Begin the next file and finish this one."""
        file, self._file = self._file, self._begin_file(len(self._files))
        self._files.append(self._file)
        information = self._information()
        try:
            file.finish(information)
        except BagWriteError:
            self._files.pop().discard()
            self._file = file
            raise
        self._describe(information)  # on failure the new file stays: the old takes nothing more

    def _make_directory(self) -> None:
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise BagWriteError(
                f'{self.path} exists already; name a folder that does not, or remove it'
            ) from None
        except OSError as error:
            raise BagWriteError(f'cannot make {self.path}: {error.strerror}') from error

    def _begin_file(self, number: int) -> BagFile:
        name = f'{self.path.resolve().name}_{number}.mcap'
        try:
            return BagFile(self.path / name, self._facts)
        except BagWriteError:
            raise
        except OSError as error:
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error

    def _information(self) -> str:
        """Return the contents of metadata.yaml."""
        extents = {file.name: file.extent for file in self._files}
        return dump(bag_information(extents, self.topics, self._facts))

    def _describe(self, information: str) -> None:
        """Replace metadata.yaml atomically."""
        new = self.path / f'{FILE}.new'
        try:
            new.write_text(document(information), 'utf-8')
            os.replace(new, self.path / FILE)
        except OSError as error:
            with suppress(OSError):
                new.unlink()
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error
        self._described = len(self._topics)
