"""One MCAP file of a bag (profile ros2), which can be read without the others."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast, IO

from humanopts_teach.bags.metadata import Extent, TopicEntry
from humanopts_teach.bags.sink import Sink
from mcap.writer import CompressionType, Writer

CHUNK_BYTES = 256 * 1024
LIBRARY = 'humanopts'  # who wrote the file, in its header
RECORD = 'humanopts'  # name of the MCAP metadata record with our facts
SELF = 'rosbag2'  # name of that with what metadata.yaml says ...
SELF_TEXT = 'serialized_metadata'  # ... under this key


class BagFile:
    """
    One file that is being written.

    It has its name only when its head is on the disk, so that no reader finds it empty.
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
        """Write the chunk under way; errors as ``write``."""
        self._writer.flush()

    def finish(self, information: str) -> None:
        """
        Write index and statistics, and close the file; errors as ``write``.

        :param information: what metadata.yaml says of the bag, as YAML.
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
