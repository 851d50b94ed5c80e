"""Check a bag for damage and loss, and write the readable messages to a new bag."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanopts_ros.limits import one_line
from humanopts_ros.recording import own_name
from humanopts_teach.bags import BagError
from humanopts_teach.bags.reader import Bag
from humanopts_teach.bags.recording import Recorded
from humanopts_teach.bags.rosbag2 import Extent, FILE, profiles
from humanopts_teach.bags.sequence_numbers import (
    is_stamped,
    LossCounter,
    read_stamp,
    Stamp,
    Stream,
)
from humanopts_teach.bags.writer import BagWriter, NAMESPACE, RECORD, SELF
from humanopts_teach.text_table import table

RECORDER = '(recorder)'  # shown as the publisher if only the recorder numbered the messages
UNNUMBERED = '(none)'  # shown if messages have no numbers, so losses cannot be counted


class MessageCounter:
    """Counts the messages of a bag by topic, time and publishers' sequence numbers."""

    def __init__(self, bag: Bag) -> None:
        self.counts: Counter[str] = Counter()  # by topic
        self.extent = Extent()
        self.losses = LossCounter()
        self.stamped = {t.name for t in bag.topics.values() if is_stamped(t.schema)}
        self._latched = {t.name for t in bag.topics.values() if t.latched}
        namespace = bag.facts.get(NAMESPACE)  # None: recorded by another program
        self._own = {t for t in bag.topics if namespace is None or own_name(t, namespace)}
        self._bag = bag

    def add(self, recorded: Recorded) -> bool:
        """Count a message; return whether it is decodable and from a permitted publisher."""
        topic, stamp = recorded.topic, None
        self.counts[topic] += 1
        self.extent.add(recorded.log_time)
        if topic in self.stamped:
            stamp = read_stamp(recorded.data)
            if stamp is None:
                self._bag.note(f'a message on {topic} does not decode')
                return False
            if self._bag.is_foreign(recorded):  # its sequence numbers may be forged
                return False
        elif self._bag.numbered:
            stamp = Stamp(RECORDER, recorded.sequence)
        if stamp:
            latched = topic in self._latched and topic in self.stamped
            self.losses.add(topic, stamp, latched=latched, own=topic in self._own)
        return True


@dataclass(frozen=True)
class Check:
    """The result of a check."""

    path: str
    messages: int  # number of readable messages
    recording: bool  # whether the bag is being recorded; it was read up to its state on disk
    damage: Sequence[str]  # descriptions of damage to the files
    streams: Sequence[Stream]
    omitted: Sequence[str] = ()  # descriptions of messages from unpermitted publishers

    @property
    def findings(self) -> list[str]:
        """Descriptions of all defects; empty: the bag is complete, at least so far."""
        found = list(self.damage)
        for name, text in (
            ('missing', 'messages were sent and are missing'),
            ('repeated', 'messages are there more than once'),
            ('late', 'messages come after one that was sent later'),
        ):
            counts = [getattr(stream, name) for stream in self.streams]
            if total := sum(counts):
                found.append(f'{total} {text} (in {sum(map(bool, counts))} streams)')
        return found

    @property
    def whole(self) -> bool:
        """Whether the bag has no defects."""
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return {
            **vars(self),
            'streams': [stream.to_dict() for stream in self.streams],
            'whole': self.whole,
            'findings': self.findings,
        }

    def to_text(self) -> str:
        """Return the result as human-readable text."""
        verdict = 'damaged or incomplete' if self.findings else 'whole: nothing is missing'
        if self.recording:
            verdict = f'being recorded, and so far {verdict}'
        head = f'{self.path} is {verdict} ({self.messages} messages)'
        lines = *self.findings, *(f'left out: {text}' for text in self.omitted)
        numbers = table([stream.to_dict() for stream in self.streams])
        return '\n'.join([one_line(head), *(f'- {one_line(e)}' for e in lines), '', numbers])


def check_bag(bag: Bag) -> Check:
    """
    Read a bag once and verify checksums, sequence numbers and metadata.yaml.

    In a bag that is being recorded, metadata.yaml is older than the messages and is not compared.
    Messages without publishers' sequence numbers are counted by the recorder's numbers. The check
    keeps a few chunks, the index and one attached file in memory.
    """
    bag.compare_bytes()
    counter = MessageCounter(bag)
    for recorded in bag.messages():
        counter.add(recorded)
    for _ in bag.attached():
        pass  # the iteration notes damage
    counts, extent = counter.counts, counter.extent
    for topic in bag.topics.values():
        if topic.messages != counts[topic.name]:
            bag.note(f'{topic.name}: {counts[topic.name]} of {topic.messages} messages were read')
    metadata = None if bag.growing else bag.information
    if metadata is not None and metadata.message_count != extent.messages:
        bag.note(f'{FILE} lists {metadata.message_count} messages; {extent.messages} were read')
    elif metadata is not None:  # if the totals differ, so do the other values
        listed = {
            t.topic_metadata.name: t.message_count for t in metadata.topics_with_message_count
        }
        for name in sorted(listed.keys() | counts.keys()):
            if listed.get(name, 0) != counts[name]:
                times = f'{listed.get(name, 0)} messages; {counts[name]} were read'
                bag.note(f'{name}: {FILE} lists {times}')
        if {
            'duration': metadata.duration,
            'starting_time': metadata.starting_time,
        } != extent.times:
            bag.note(f'{FILE} states another start or duration than that of the messages')
    streams = list(counter.losses)
    streams += (
        Stream(topic, UNNUMBERED, sent=count, recorded=count)
        for topic, count in counts.items()
        if topic not in {stream.topic for stream in streams}
    )
    streams.sort(key=lambda stream: (stream.topic, stream.publisher))
    damage = bag.damage.splitlines()
    return Check(str(bag.path), extent.messages, bag.growing, damage, streams, bag.strangers)


REPAIR = 'humanopts_repair'  # MCAP metadata record that describes a repair


def repair(bag: Bag, out: Path) -> int:
    """
    Write the readable contents of a bag to a new bag, without modifying the old one.

    Messages keep their bytes, times and order, and the recorder's numbers.

    :param out: folder of the new bag; must not exist.
    :return: number of messages written.
    :raises BagError: the new bag would be inside the old one.
    :raises BagWriteError: ``out`` exists or cannot be written.
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
