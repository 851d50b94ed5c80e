"""Writes a rosbag2 directory: one MCAP file (profile ros2) and metadata.yaml."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
import os
from pathlib import Path
from types import TracebackType
from typing import Any, cast, IO

from humanopts_teach.bags.errors import BagWriteError
from humanopts_teach.bags.metadata import (
    bag_information,
    dump,
    Extent,
    FILE,
    Qos,
    qos_text,
    ROOT,
    TopicEntry,
)
from humanopts_teach.bags.schemas import Definitions
from humanopts_teach.bags.sink import Sink
from mcap.writer import CompressionType, Writer

CHUNK_BYTES = 256 * 1024
LIBRARY = 'humanopts'  # who wrote the file, in its header
RECORD = 'humanopts'  # name of the MCAP metadata record with our facts
SELF = 'rosbag2'  # name of that with what metadata.yaml says ...
SELF_TEXT = 'serialized_metadata'  # ... under this key


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
    ) -> None:
        """
        Begin a bag.

        :param path: its directory; must not exist.
        :param facts: what reproduction needs, kept in the MCAP metadata record ``humanopts``.
        :param definitions: where message definitions are found; None: AMENT_PREFIX_PATH.
        :raises BagWriteError: the directory exists, or cannot be made.
        """
        self.path = Path(path)
        self.extent = Extent()
        self._facts = dict(facts or {})
        self._definitions = definitions or Definitions()
        self._topics: dict[str, TopicEntry] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._described = -1  # topics in metadata.yaml
        self._closed = False
        self._sink = self._create()
        self._writer: Any = Writer(
            cast(IO[Any], self._sink),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._writer.start(profile='ros2', library=LIBRARY)
        self._writer.add_metadata(RECORD, self._facts)
        self.flush()

    @property
    def bytes_written(self) -> int:
        """Size of the MCAP file."""
        return self._sink.tell()

    @property
    def topics(self) -> list[TopicEntry]:
        """Every topic that was added, with its message count."""
        return list(self._topics.values())

    def add_topic(
        self, name: str, type_name: str, qos: Sequence[Qos] = (), type_hash: str = ''
    ) -> str:
        """
        Announce a topic; a name that is known already changes nothing.

        :param type_name: such as humanopts_interfaces/msg/GameState.
        :param qos: the profiles that its publishers offer.
        :param type_hash: RIHS01_..., where it is known; kept for messages only.
        :return: the schema of its messages.
        :raises SchemaError: the type's definition is not installed here.
        """
        schema = self._definitions.schema(type_name)
        if name in self._topics:
            return schema
        if '/msg/' not in type_name:
            type_hash = ''  # rosbags 0.11 opens no bag with that of a service event or feedback
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, 'ros2msg', schema.encode()
            )
        self._channels[name] = self._writer.register_channel(
            name,
            'cdr',
            self._schemas[type_name],
            {'offered_qos_profiles': qos_text(qos), 'topic_type_hash': type_hash},
        )
        self._topics[name] = TopicEntry(name, type_name, tuple(qos), type_hash)
        return schema

    def write(
        self, topic: str, data: bytes, log_time: int, publish_time: int | None = None
    ) -> None:
        """
        Add one message.

        :param data: the CDR bytes as received.
        :param log_time: when it was received, ns since the epoch.
        :param publish_time: when it was sent; None: not known, so ``log_time``.
        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        entry = self._topics[topic]
        sent = log_time if publish_time is None else publish_time
        self._writer.add_message(
            self._channels[topic], log_time, data, sent, sequence=(entry.messages + 1) % 2**32
        )
        entry.messages += 1
        self.extent.add(log_time)

    def attach(
        self,
        name: str,
        data: bytes,
        media_type: str = 'application/json',
        times: tuple[int, int] | None = None,
    ) -> None:
        """
        Keep a file in the bag.

        :param times: when it was made and when recorded, ns; None: those of the last message.
        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._writer.flush()
        made, recorded = times or (self.extent.last, self.extent.last)
        self._writer.add_attachment(made, recorded, name, media_type, data)

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """
        Keep facts in an MCAP metadata record.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """
        Write the chunk under way, and metadata.yaml where it lacks a topic.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        self._writer.flush()
        if self._described != len(self._topics):
            self._describe()

    def close(self) -> None:
        """
        Write index, statistics and metadata.yaml; it can be called again.

        :raises BagWriteError: the disk is full or the file cannot be written.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.flush()
            self.note(SELF, {SELF_TEXT: dump(self._information())})
            self._writer.finish()
            self._describe()
        finally:
            self._sink.close()

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

    def _create(self) -> Sink:
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise BagWriteError(
                f'{self.path} exists already; name a folder that does not, or remove it'
            ) from None
        except OSError as error:
            raise BagWriteError(f'cannot make {self.path}: {error.strerror}') from error
        try:
            return Sink(self.path / self._file_name)
        except OSError as error:
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error

    @property
    def _file_name(self) -> str:
        return f'{self.path.resolve().name}_0.mcap'

    def _information(self) -> dict[str, Any]:
        return bag_information(self._file_name, self.topics, self.extent, self._facts)

    def _describe(self) -> None:
        """Replace metadata.yaml in one go."""
        new = self.path / f'{FILE}.new'
        try:
            new.write_text(dump({ROOT: self._information()}), 'utf-8')
            os.replace(new, self.path / FILE)
        except OSError as error:
            with suppress(OSError):
                new.unlink()
            raise BagWriteError(f'cannot write in {self.path}: {error.strerror}') from error
        self._described = len(self._topics)
