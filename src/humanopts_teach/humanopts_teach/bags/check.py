"""Find what is damaged or missing in a bag, and write a new bag of the rest."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanopts_ros.limits import one_line
from humanopts_teach.bags import BagError
from humanopts_teach.bags.reader import Bag
from humanopts_teach.bags.rosbag2 import Extent, FILE, profiles
from humanopts_teach.bags.sequence_numbers import MessageCounter, Stamp, Stream
from humanopts_teach.bags.writer import BagWriter, RECORD, SELF
from humanopts_teach.text_table import table

RECORDER = '(recorder)'  # shown as publisher where only the recorder numbers messages
UNNUMBERED = '(nobody)'  # shown where messages have no numbers, so loss cannot be counted


@dataclass(frozen=True)
class Check:
    """What is wrong with a bag."""

    path: str
    messages: int  # that can be read
    recording: bool  # it is being recorded, and was read as far as it was on the disk
    damage: tuple[str, ...]  # of the files, in words
    streams: tuple[Stream, ...]
    strangers: tuple[str, ...] = ()  # messages of nodes that may not publish there, in words

    @property
    def findings(self) -> tuple[str, ...]:
        """Everything that is wrong, in words; empty: the bag is whole, or whole so far."""
        found = list(self.damage)
        for name, text in (
            ('missing', 'messages were sent and are missing'),
            ('duplicates', 'messages are there more than once'),
            ('late', 'messages are after one that was sent later'),
        ):
            counts = [getattr(stream, name) for stream in self.streams]
            if total := sum(counts):
                found.append(f'{total} {text} (in {sum(map(bool, counts))} streams)')
        return tuple(found)

    @property
    def whole(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        """Return the check as JSON data."""
        return {
            'path': self.path,
            'messages': self.messages,
            'damage': list(self.damage),
            'streams': [stream.to_dict() for stream in self.streams],
            'recording': self.recording,
            'whole': self.whole,
            'findings': list(self.findings),
            'strangers': list(self.strangers),
        }

    def to_text(self) -> str:
        """Return the check as text for a person."""
        if self.recording:
            wrong = 'something is wrong' if self.findings else 'none missing'
            verdict = f'{self.path} is being recorded: {self.messages} messages so far, {wrong}'
        elif self.whole:
            verdict = f'{self.path} is whole: {self.messages} messages, none missing'
        else:
            verdict = f'{self.path} is damaged or incomplete: {self.messages} messages were read'
        lines = *self.findings, *(f'not counted: {text}' for text in self.strangers)
        numbers = table([stream.to_dict() for stream in self.streams])
        return '\n'.join([one_line(verdict), *(f'- {one_line(e)}' for e in lines), '', numbers])


def check_bag(bag: Bag) -> Check:
    """
    Read a bag once and compare it with its checksums, numbers and metadata.yaml.

    While it is being recorded, counts and times in metadata.yaml are older, and not compared.

    Messages without a publisher's number are counted by those of our recorder. It needs memory for
    a few chunks, the index and one attached file.
    """
    bag.compare_bytes()
    counter = MessageCounter(bag)
    for recorded in bag.messages():
        counter.add(recorded)
        if bag.numbered and recorded.topic not in counter.stamped:
            counter.losses.add(recorded.topic, Stamp(RECORDER, recorded.sequence))
    for _ in bag.attached():
        pass  # what is damaged is noted
    _compare(bag, counter.counts, counter.extent)
    streams = list(counter.losses)
    for topic in set(counter.counts) - {stream.topic for stream in streams}:
        count = counter.counts[topic]
        streams.append(Stream(topic, UNNUMBERED, last=count, received=count))
    return Check(
        str(bag.path),
        counter.extent.messages,
        bag.recording,
        tuple(bag.damage.splitlines()),
        tuple(sorted(streams, key=lambda stream: (stream.topic, stream.publisher))),
        tuple(bag.strangers),
    )


def _compare(bag: Bag, counts: Counter[str], extent: Extent) -> None:
    """Note where metadata.yaml or an index disagrees with the messages that were read."""
    indexed = {topic.name: topic.messages for topic in bag.topics.values()}
    for name, count in indexed.items():
        if count != counts[name]:
            bag.note(f'{name}: {counts[name]} of {count} messages were read')
    said = bag.information
    if bag.recording or said is None:
        return
    if said.message_count != extent.messages:
        bag.note(f'{FILE} lists {said.message_count} messages; {extent.messages} were read')
        return  # so that the rest differs too, as in a recording that was not closed
    listed = {
        each.topic_metadata.name: each.message_count for each in said.topics_with_message_count
    }
    for name in sorted(listed.keys() | counts.keys()):
        if listed.get(name, 0) not in (counts[name], indexed.get(name)):
            bag.note(
                f'{name}: {FILE} lists {listed.get(name, 0)} messages; {counts[name]} were read'
            )
    times = said.starting_time.nanoseconds_since_epoch, said.duration.nanoseconds
    if times != (extent.first, extent.duration):
        bag.note(f'{FILE} states another start or duration than that of the messages')


REPAIR = 'humanopts_repair'  # name of the MCAP metadata record that describes a repair


def repair(bag: Bag, out: Path) -> int:
    """
    Write what can be read of a bag as a new one, and leave the old one alone.

    Messages keep their bytes, times and order, and the numbers that our recorder gave them.

    :param out: folder of the new bag; must not exist.
    :return: number of messages written.
    :raises BagError: the new bag would be inside the old one.
    :raises BagWriteError: ``out`` exists, or cannot be written.
    """
    if out.resolve().is_relative_to(bag.path.resolve()):
        raise BagError(f'{out} is inside {bag.path}, which a repair leaves alone; name another')
    with BagWriter(out, bag.facts) as writer:
        for topic in bag.topics.values():
            qos = profiles(topic.qos)
            writer.add_topic(topic.name, topic.type, qos, topic.type_hash, topic.schema)
        for recorded in bag.messages():
            number = recorded.sequence if bag.numbered else None
            times = recorded.log_time, recorded.publish_time
            writer.write(recorded.topic, recorded.data, *times, number)
        for file in bag.attached():
            times = file.create_time, file.log_time
            writer.attach(file.name, file.data, file.media_type, times)
        for name, values in bag.metadata.items():
            if name not in (RECORD, SELF, REPAIR):
                writer.note(name, values)
        writer.note(REPAIR, {'from': bag.path.name, 'damage': bag.damage})
        return writer.extent.messages
