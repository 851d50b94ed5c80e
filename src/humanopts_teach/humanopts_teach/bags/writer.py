"""Writing rosbag2 directories: MCAP files (profile ros2) and metadata.yaml."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
import fcntl
from itertools import count, takewhile
import os
from pathlib import Path
from typing import Any, cast, IO

from humanopts_learner.append_only_log import append_whole
from humanopts_teach.bags import BagWriteError
from humanopts_teach.bags.rosbag2 import (
    bag_information,
    dump,
    Extent,
    FILE,
    ROOT,
    Topic,
    whole_extent,
)
from humanopts_teach.bags.schemas import find_schema
from mcap.writer import CompressionType, Writer

CHUNK_BYTES = 256 * 1024
LIBRARY = 'humanopts'  # name of the writing program, in the file header
RECORD = 'humanopts'  # MCAP metadata record with the recorder's facts
NAMESPACE = 'namespace'  # fact with the namespace of the recorded graph
GAME = 'humanopts_game'  # metadata record with the publisher ids of the game ...
GAME_IDS = 'publisher_ids'  # ... as a JSON list under this key
SELF = 'rosbag2'  # metadata record with a copy of metadata.yaml ...
SELF_TEXT = 'serialized_metadata'  # ... under this key


class _File:
    """
    An MCAP file being written, unbuffered.

    An incomplete record, as on a full disk, is removed so that the file stays readable; nothing
    is written after that. The file gets its final name when its header is on disk, so that readers
    never see it empty. It is locked until it is closed, a write fails, or the process ends;
    ``is_being_written`` tests this lock.
    """

    def __init__(self, path: Path, facts: Mapping[str, str]) -> None:
        """
        Create the file.

        :param facts: facts for the metadata record ``humanopts``.
        :raises OSError: the file exists or cannot be created, or the disk is full.
        """
        self.name = path.name
        self.size = 0  # bytes
        self.extent = Extent()
        self.channels: dict[str, int] = {}  # channel ids by topic
        self.schemas: dict[str, int] = {}  # schema ids by type
        self._failure = ''
        self._finished = False
        self._path = path.with_name(f'{path.name}.new')
        self._handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._lock(fcntl.LOCK_EX)
        self.writer: Any = Writer(
            cast(IO[bytes], self),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        try:
            self.writer.start(profile='ros2', library=LIBRARY)
            self.writer.add_metadata(RECORD, dict(facts))
            os.replace(self._path, path)
            self._path = path
        except OSError:
            self.discard()
            raise

    def write(self, data: bytes) -> None:
        """
        Append complete records; called by the ``mcap`` package.

        :raises BagWriteError: the disk is full, or the file can no longer be written.
        """
        if self._failure:
            raise BagWriteError(self._failure)
        try:
            append_whole(self._handle, data)
        except OSError as error:
            self._failure = f'cannot write to {self._path}: {error.strerror}; what was written'
            self._failure += ' before is kept. Free space and start another recording'
            self._lock(fcntl.LOCK_UN)
            raise BagWriteError(self._failure) from error
        self.size += len(data)

    def tell(self) -> int:
        """Return the size of the file; called by the ``mcap`` package."""
        return self.size

    def flush(self) -> None:
        """No-op: writes are unbuffered."""

    def finish(self, information: Any) -> None:
        """
        Write the index and statistics and close the file; later calls do nothing.

        :param information: contents of metadata.yaml.
        :raises BagWriteError: the disk is full, or the file cannot be written.
        """
        if self._finished:
            return
        self._finished = True
        try:
            self.writer.flush()
            self.writer.add_metadata(SELF, {SELF_TEXT: dump(information)})
            self.writer.finish()
            self.writer = None  # free the memory of its index
        finally:
            os.close(self._handle)

    def discard(self) -> None:
        """Close and remove the file."""
        os.close(self._handle)
        with suppress(OSError):
            self._path.unlink()

    def _lock(self, how: int) -> None:
        with suppress(OSError):  # some network file systems do not support locks
            fcntl.flock(self._handle, how | fcntl.LOCK_NB)


def is_being_written(path: Path) -> bool:
    """Return whether a recorder on this machine is writing the file."""
    try:
        with path.open('rb') as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass  # it cannot be opened or locked, so no writer is known
    return False


def _names(bag: Path) -> Iterator[Path]:
    yield bag
    for number in count(2):
        yield bag.with_name(f'{bag.name}-{number}')


def parts(bag: Path) -> list[Path]:
    """
    Return the existing bags of a recording, in order: ``bag``, ``bag-2``, ``bag-3``.

    A restarted recorder creates the next bag and leaves the previous ones unchanged.
    """
    return list(takewhile(Path.exists, _names(bag)))


def next_part(bag: Path) -> Path:
    """Return the path of the next bag of a recording."""
    return next(path for path in _names(bag) if not path.exists())


@dataclass(frozen=True)
class Limits:
    """Limits at which a new file is started; 0: no limit."""

    bytes: int = 0  # size of a file, excluding the current chunk and the index
    seconds: float = 0.0  # duration since the first message in the file


NO_LIMITS = Limits()


class BagWriter(AbstractContextManager['BagWriter']):
    """
    A writer of a bag.

    ``flush`` passes all messages so far to the operating system as complete chunks. If the process
    is then killed, only later messages are lost.

    Every method that writes raises ``BagWriteError`` if the disk is full or a file cannot be
    written; nothing is written after that.
    """

    def __init__(
        self, path: Path, facts: Mapping[str, str] | None = None, limits: Limits = NO_LIMITS
    ) -> None:
        """
        Create a bag.

        :param path: directory of the bag; must not exist.
        :param facts: settings and versions for the MCAP metadata record ``humanopts``.
        :param limits: limits for each file.
        :raises BagWriteError: the directory exists or cannot be created.
        """
        self.path = Path(path)
        self.topics: dict[str, Topic] = {}  # all topics with message counts
        self._facts = dict(facts or {})
        self._limits = limits
        self._described = -1  # number of topics in metadata.yaml
        self._closed = False
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise BagWriteError(
                f'{self.path} already exists; name a folder that does not, or remove it'
            ) from None
        except OSError as error:
            raise BagWriteError(f'cannot create {self.path}: {error.strerror}') from error
        self._files: list[_File] = []
        self._begin_file()
        self.flush()

    @property
    def bytes_written(self) -> int:
        """The total size of the MCAP files in bytes."""
        return sum(file.size for file in self._files)

    @property
    def n_files(self) -> int:
        """The number of MCAP files."""
        return len(self._files)

    @property
    def extent(self) -> Extent:
        """The number and times of the messages."""
        return whole_extent(file.extent for file in self._files)

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Sequence[Mapping[str, Any]] = (),
        type_hash: str = '',
        schema: str | None = None,
    ) -> str:
        """
        Add a topic, unless it already exists.

        :param type_name: type such as humanopts_interfaces/msg/GameState.
        :param qos: profiles offered by its publishers, with keys as in rosbag2's metadata.
        :param type_hash: RIHS01_..., if known; stored for messages only.
        :param schema: definition of the type (ros2msg); None: the installed one.
        :return: schema.
        :raises SchemaError: the type is not installed.
        """
        if name not in self.topics:
            if '/msg/' not in type_name:
                type_hash = ''  # rosbags 0.11 rejects bags with type hashes of events or feedback
            profiles = dump([dict(profile) for profile in qos]) if qos else ''
            schema = find_schema(type_name) if schema is None else schema
            self.topics[name] = Topic(name, type_name, schema, profiles, type_hash)
            self._channel(self.topics[name])
        return self.topics[name].schema

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

        :param data: CDR bytes as received.
        :param log_time: time of reception, ns since the epoch.
        :param publish_time: time of sending, ns since the epoch; None: unknown, use ``log_time``.
        :param sequence: sequence number; None: the next number of the topic.
        """
        file, limits = self._files[-1], self._limits
        age = log_time - file.extent.first
        large = 0 < limits.bytes <= file.size or 0 < limits.seconds * 1e9 <= age
        if file.extent.messages and large:
            self._split()
        entry, file = self.topics[topic], self._files[-1]
        sent = log_time if publish_time is None else publish_time
        number = entry.messages + 1 if sequence is None else sequence
        file.writer.add_message(
            self._channel(entry), log_time, data, sent, sequence=number % 2**32
        )
        file.extent.add(log_time)
        entry.messages += 1

    def attach(
        self,
        name: str,
        data: bytes,
        media_type: str = 'application/json',
        times: tuple[int, int] | None = None,
    ) -> None:
        """
        Attach a file to the bag.

        :param times: times of creation and recording, ns; None: time of the last message.
        """
        made, recorded = times or (self.extent.last, self.extent.last)
        writer = self._files[-1].writer
        writer.flush()
        writer.add_attachment(made, recorded, name, media_type, data)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Store facts in an MCAP metadata record."""
        self._files[-1].writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Write the current chunk, and metadata.yaml if it lacks a topic."""
        self._files[-1].writer.flush()
        if self._described != len(self.topics):
            self._describe(self._information())

    def close(self) -> None:
        """Write the index, statistics and metadata.yaml; later calls do nothing."""
        if not self._closed:
            self._closed = True
            information = self._information()
            self._files[-1].finish(information)
            self._describe(information)

    def __exit__(self, *error: object) -> None:
        self.close()

    def _channel(self, topic: Topic) -> int:
        """Return the channel id of a topic in the current file; register it if necessary."""
        file = self._files[-1]
        if topic.name not in file.channels:
            if topic.type not in file.schemas:
                file.schemas[topic.type] = file.writer.register_schema(
                    topic.type, 'ros2msg', topic.schema.encode()
                )
            metadata = {'offered_qos_profiles': topic.qos, 'topic_type_hash': topic.type_hash}
            file.channels[topic.name] = file.writer.register_channel(
                topic.name, 'cdr', file.schemas[topic.type], metadata
            )
        return file.channels[topic.name]

    def _split(self) -> None:
        """Create the next file and finish the current one."""
        self._begin_file()
        information = self._information()
        try:
            self._files[-2].finish(information)
        except BagWriteError:
            self._files.pop().discard()
            raise
        self._describe(information)  # on failure, keep the new file: the old one is finished

    def _begin_file(self) -> None:
        path = self.path / f'{self.path.resolve().name}_{len(self._files)}.mcap'
        try:
            self._files.append(_File(path, self._facts))
        except BagWriteError:
            raise
        except OSError as error:
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error

    def _information(self) -> Any:
        """Return the contents of metadata.yaml."""
        extents = {file.name: file.extent for file in self._files}
        return bag_information(extents, self.topics.values(), self._facts)

    def _describe(self, information: Any) -> None:
        """Replace metadata.yaml atomically."""
        new = self.path / f'{FILE}.new'
        try:
            new.write_text(dump({ROOT: information}), 'utf-8')
            os.replace(new, self.path / FILE)
        except OSError as error:
            with suppress(OSError):
                new.unlink()
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error
        self._described = len(self.topics)
