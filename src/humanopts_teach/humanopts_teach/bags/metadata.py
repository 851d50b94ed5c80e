"""The metadata.yaml of a rosbag2 directory, version 9 (Jazzy)."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from textwrap import indent
from typing import Any

import yaml

FILE = 'metadata.yaml'
ROOT = 'rosbag2_bagfile_information'
VERSION = 9
ROS_DISTRO = 'jazzy'
_NEVER = 2**63 - 1  # starting time of a bag with no messages, as rosbag2 writes it
_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
Qos = Mapping[str, Any]  # one offered QoS profile, keys as in rosbag2's metadata


@dataclass
class TopicEntry:
    """One topic of a bag."""

    name: str
    type: str
    qos: tuple[Qos, ...]
    type_hash: str  # RIHS01_...; empty: not known
    messages: int = 0

    @cached_property
    def channel_metadata(self) -> dict[str, str]:
        """What an MCAP channel of this topic carries."""
        return {
            'offered_qos_profiles': qos_text(self.qos),
            'topic_type_hash': self.type_hash,
        }


@dataclass
class Extent:
    """How much one bag file holds."""

    messages: int = 0
    first: int = _NEVER  # earliest log time, ns
    last: int = 0  # latest log time, ns

    def add(self, log_time: int) -> None:
        """Count one message."""
        self.messages += 1
        self.first = min(self.first, log_time)
        self.last = max(self.last, log_time)

    def include(self, other: 'Extent') -> None:
        """Count what another file holds."""
        self.messages += other.messages
        self.first = min(self.first, other.first)
        self.last = max(self.last, other.last)

    @property
    def duration(self) -> int:
        """Time from the first to the last message, ns."""
        return max(0, self.last - self.first)


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return QoS profiles as the YAML text that an MCAP channel carries."""
    return dump(deepcopy(list(map(dict, profiles)))) if profiles else ''


def dump(values: Any) -> str:
    """Return plain values as YAML."""
    return str(yaml.dump(values, Dumper=_DUMPER, sort_keys=False, default_flow_style=False))


def bag_information(
    files: Mapping[str, Extent], topics: Sequence[TopicEntry], custom: Mapping[str, str]
) -> dict[str, Any]:
    """
    Return what metadata.yaml says of a bag.

    :param files: by name within the directory, in order.
    :param custom: facts of our own.
    """
    whole = Extent()
    for extent in files.values():
        whole.include(extent)
    return deepcopy(  # equal parts are written out, not as references
        {
            'version': VERSION,
            'storage_identifier': 'mcap',
            **_times(whole),
            'message_count': whole.messages,
            'topics_with_message_count': [_topic_information(topic) for topic in topics],
            'compression_format': '',  # of whole files or messages; the chunks have their own
            'compression_mode': '',
            'relative_file_paths': list(files),
            'files': [
                {'path': name, **_times(extent), 'message_count': extent.messages}
                for name, extent in files.items()
            ],
            'custom_data': dict(custom),
            'ros_distro': ROS_DISTRO,
        }
    )


def _times(extent: Extent) -> dict[str, Any]:
    return {
        'duration': {'nanoseconds': extent.duration},
        'starting_time': {'nanoseconds_since_epoch': extent.first},
    }


def document(information: str) -> str:
    """Return the text of metadata.yaml, from the text of what it says of the bag."""
    return f'{ROOT}:\n{indent(information, "  ")}'


def _topic_information(topic: TopicEntry) -> dict[str, Any]:
    return {
        'topic_metadata': {
            'name': topic.name,
            'type': topic.type,
            'serialization_format': 'cdr',
            'offered_qos_profiles': [deepcopy(dict(profile)) for profile in topic.qos],
            'type_description_hash': topic.type_hash,
        },
        'message_count': topic.messages,
    }
