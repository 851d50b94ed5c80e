"""Bags with something taken out."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from humanopts_teach.bags.reader import open_bag
from mcap.reader import make_reader
from mcap.writer import Writer


def without(bag: Path, copy: Path, type_name: str, leave_out: Callable[[Any], bool]) -> Path:
    """Copy a bag's MCAP file record by record, without the messages of a type that match."""
    opened = open_bag(bag)
    (source,) = opened.files
    with source.open('rb') as old, copy.open('wb') as new:
        reader, writer = make_reader(old), Writer(new)
        writer.start(profile='ros2')
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind, channel.metadata
                )
            if schema.name == type_name and leave_out(opened.decode(channel.topic, message.data)):
                continue
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()
    return copy
