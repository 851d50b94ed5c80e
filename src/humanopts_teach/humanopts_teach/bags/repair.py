"""Writes a whole bag with all that can be read of a damaged one."""

from pathlib import Path
from typing import Any

from humanopts_teach.bags.directory import load
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.file import RECORD, SELF
from humanopts_teach.bags.reader import Bag, Topic
from humanopts_teach.bags.schemas import Definitions
from humanopts_teach.bags.writer import BagWriter

REPAIR = 'humanopts_repair'  # name of the MCAP metadata record that tells of a repair

MOST_AT_ONCE = 10_000  # messages of one log time that are looked through for repetitions


def repair(bag: Bag, out: Path) -> int:
    """
    Write what can be read of a bag as a new one, and leave the old one alone.

    Messages keep their bytes, times and order, and the numbers that our recorder gave them. One
    that it wrote once and that is there again (number, time and bytes are the same) is written
    once.

    :param out: folder of the new bag; must not exist.
    :return: number of messages written.
    :raises BagError: the new bag would be inside the old one.
    :raises BagWriteError: ``out`` exists, or cannot be written.
    """
    if out.resolve().is_relative_to(bag.path.resolve()):
        raise BagError(f'{out} is inside {bag.path}, which a repair leaves alone; name another')
    with BagWriter(out, bag.metadata.get(RECORD), _Recorded(bag)) as writer:
        for topic in bag.topics.values():
            writer.add_topic(topic.name, topic.type, _profiles(topic), topic.type_hash)
        repeated = _copy(bag, writer)
        for file in bag.attached():
            times = (file.create_time, file.log_time)
            writer.attach(file.name, file.data, file.media_type, times)
        for name, values in bag.metadata.items():
            if name not in (RECORD, SELF, REPAIR):
                writer.note(name, values)
        told = {'from': bag.path.name, 'damage': bag.damage, 'repeated': str(repeated)}
        before = bag.metadata.get(REPAIR, {})
        writer.note(REPAIR, {**told, **{f'earlier {k}': v for k, v in before.items()}})
        return writer.extent.messages


class _Recorded(Definitions):
    """The definitions that a bag brings with it."""

    def __init__(self, bag: Bag) -> None:
        super().__init__([])
        self._schemas = {topic.type: topic.schema for topic in bag.topics.values()}


def _copy(bag: Bag, writer: BagWriter) -> int:
    """Copy the messages; return how many were repetitions, which are left out."""
    repeated, time = 0, -1
    now: set[tuple[str, int, bytes]] = set()  # what was written of this log time
    for recorded in bag.messages(decoded=False):
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


def _profiles(topic: Topic) -> list[dict[str, Any]]:
    """Return the QoS profiles of a topic; none where they are damaged."""
    try:
        profiles = load(topic.qos) or []
    except ValueError:
        return []
    known = isinstance(profiles, list) and all(isinstance(p, dict) for p in profiles)
    return profiles if known else []
