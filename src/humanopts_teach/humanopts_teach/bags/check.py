"""What of a bag is damaged or missing, and a whole bag with the rest."""

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
            'accounts': [_columns(stream) for stream in self.streams],
            'recording': self.recording,
            'whole': self.whole,
            'findings': list(self.findings),
            'strangers': list(self.strangers),
        }

    def to_text(self) -> str:
        """Return the check as text for a person."""
        rows = [_columns(stream) for stream in self.streams]
        numbers = table(list(rows[0]), [list(row.values()) for row in rows]) if rows else ''
        if self.recording:
            wrong = 'something is wrong' if self.findings else 'none missing'
            verdict = f'{self.path} is being recorded: {self.messages} messages so far, {wrong}'
        elif self.whole:
            verdict = f'{self.path} is whole: {self.messages} messages, none missing'
        else:
            verdict = f'{self.path} is damaged or incomplete: {self.messages} messages were read'
        lines = *self.findings, *(f'not counted: {text}' for text in self.strangers)
        told = [verdict, *(f'- {text}' for text in lines)]
        return '\n'.join([*map(one_line, told), '', numbers])


def _columns(stream: Stream) -> dict[str, str | int]:
    return {
        'topic': stream.topic,
        'publisher': stream.publisher,
        'sent': stream.last,  # up to the last message that was recorded
        'recorded': stream.received,
        'missing': stream.missing,
        'repeated': stream.duplicates,
        'late': stream.late,
    }


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
    if bag.recording or not bag.information:
        return
    told = bag.information
    try:
        total = int(told['message_count'])
        counted = {
            str(entry['topic_metadata']['name']): int(entry['message_count'])
            for entry in told['topics_with_message_count']
        }
        start = int(told['starting_time']['nanoseconds_since_epoch'])
        duration = int(told['duration']['nanoseconds'])
    except (KeyError, TypeError, ValueError):
        bag.note(f'{FILE} does not tell the counts and times of messages')
        return
    if total != extent.messages:
        bag.note(f'{FILE} tells of {total} messages, and {extent.messages} were read')
        return  # so that the rest differs too, as in a recording that was not closed
    for name in sorted(counted.keys() | counts.keys()):
        if counted.get(name, 0) not in (counts[name], indexed.get(name)):
            bag.note(f'{name}: {FILE} tells of {counted.get(name, 0)}, {counts[name]} were read')
    if (start, duration) != (extent.first, extent.duration):
        bag.note(f'{FILE} tells of another beginning or duration than its messages')


REPAIR = 'humanopts_repair'  # name of the MCAP metadata record that describes a repair

MOST_AT_ONCE = 10_000  # messages of one log time among which repetitions are found


def repair(bag: Bag, out: Path) -> int:
    """
    Write what can be read of a bag as a new one, and leave the old one alone.

    Messages keep their bytes, times and order, and the numbers that our recorder gave them. Copies
    of one message (same number, time and bytes) are written once.

    :param out: folder of the new bag; must not exist.
    :return: number of messages written.
    :raises BagError: the new bag would be inside the old one.
    :raises BagWriteError: ``out`` exists, or cannot be written.
    """
    if out.resolve().is_relative_to(bag.path.resolve()):
        raise BagError(f'{out} is inside {bag.path}, which a repair leaves alone; name another')
    with BagWriter(out, bag.metadata.get(RECORD)) as writer:
        for topic in bag.topics.values():
            writer.add_topic(
                topic.name, topic.type, profiles(topic.qos), topic.type_hash, topic.schema
            )
        repeated = _copy(bag, writer)
        for file in bag.attached():
            times = (file.create_time, file.log_time)
            writer.attach(file.name, file.data, file.media_type, times)
        for name, values in bag.metadata.items():
            if name not in (RECORD, SELF, REPAIR):
                writer.note(name, values)
        facts = {'from': bag.path.name, 'damage': bag.damage, 'repeated': str(repeated)}
        before = bag.metadata.get(REPAIR, {})
        writer.note(REPAIR, {**facts, **{f'earlier {k}': v for k, v in before.items()}})
        return writer.extent.messages


def _copy(bag: Bag, writer: BagWriter) -> int:
    """Copy the messages; return how many repetitions were left out."""
    repeated, time = 0, -1
    now: set[tuple[str, int, bytes]] = set()  # messages of this log time that were written
    for recorded in bag.messages():
        if recorded.log_time != time or len(now) == MOST_AT_ONCE:
            time = recorded.log_time
            now.clear()
        key = (recorded.topic, recorded.sequence, recorded.data)
        if bag.numbered and key in now:
            repeated += 1
        else:
            now.add(key)
            number = recorded.sequence if bag.numbered else None
            writer.write(recorded.topic, recorded.data, time, recorded.publish_time, number)
    return repeated
