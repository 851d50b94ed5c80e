"""A rosbag2 directory (version 9, Jazzy): its metadata.yaml and its MCAP files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from shlex import quote
from textwrap import indent
from typing import Any, NoReturn

from humanopts_ros.text_files import (
    fault_in,
    FileError,
    MAX_YAML,
    parse_yaml,
    read_text,
    YamlError,
)
from humanopts_teach.bags import BagError
from pydantic import BaseModel, ConfigDict, ValidationError
import yaml

FILE = 'metadata.yaml'
ROOT = 'rosbag2_bagfile_information'
VERSION = 9
ROS_DISTRO = 'jazzy'
_NEVER = 2**63 - 1  # starting time of a bag without messages, as rosbag2 writes it


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """Writes equal parts out, not as references."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump(values: Any) -> str:
    """Return plain values as YAML."""
    return str(yaml.dump(values, Dumper=_Dumper, sort_keys=False, default_flow_style=False))


_TRANSIENT_LOCAL = ('transient_local', 1)  # by name, and by number as before rosbag2's version 9


@dataclass(slots=True)
class Topic:
    """One topic of a bag."""

    name: str
    type: str  # such as humanopts_interfaces/msg/GameState
    schema: str  # its ros2msg definition, complete
    qos: str  # offered profiles, YAML; empty: not known
    type_hash: str  # RIHS01_...; empty: not known
    messages: int = 0

    @property
    def latched(self) -> bool:
        """Whether every publisher offered the last value to late subscribers (transient local)."""
        offered = [profile.get('durability') for profile in profiles(self.qos)]
        return bool(offered) and all(each in _TRANSIENT_LOCAL for each in offered)


@dataclass
class Extent:
    """How much a bag, or one of its files, holds."""

    messages: int = 0
    first: int = _NEVER  # earliest log time, ns
    last: int = 0  # latest log time, ns

    def add(self, log_time: int) -> None:
        """Count one message."""
        self.messages += 1
        self.first = min(self.first, log_time)
        self.last = max(self.last, log_time)

    @property
    def duration(self) -> int:
        """Time from the first to the last message, ns."""
        return max(0, self.last - self.first)


def whole_extent(parts: Iterable[Extent]) -> Extent:
    """Return how much several files hold together."""
    whole = Extent()
    for part in parts:
        whole.messages += part.messages
        whole.first = min(whole.first, part.first)
        whole.last = max(whole.last, part.last)
    return whole


def bag_information(
    files: Mapping[str, Extent], topics: Iterable[Topic], custom: Mapping[str, str]
) -> str:
    """
    Return the contents of metadata.yaml for a bag, without its first line.

    :param files: by name within the directory, in order.
    :param custom: facts that the recorder was given.
    """
    whole = whole_extent(files.values())
    return dump(
        {
            'version': VERSION,
            'storage_identifier': 'mcap',
            **_times(whole),
            'message_count': whole.messages,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic.name,
                        'type': topic.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': profiles(topic.qos),
                        'type_description_hash': topic.type_hash,
                    },
                    'message_count': topic.messages,
                }
                for topic in topics
            ],
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


def document(information: str) -> str:
    """Return the text of metadata.yaml from that of ``bag_information``."""
    return f'{ROOT}:\n{indent(information, "  ")}'


def _times(extent: Extent) -> dict[str, Any]:
    return {
        'duration': {'nanoseconds': extent.duration},
        'starting_time': {'nanoseconds_since_epoch': extent.first},
    }


@lru_cache
def profiles(text: str) -> list[dict[str, Any]]:
    """Return QoS profiles from YAML; none where it is damaged."""
    try:
        found = parse_yaml(text)
    except YamlError:
        return []
    known = isinstance(found, list) and all(isinstance(p, dict) for p in found)
    return found if known else []


PACKED = {  # what decompresses a file, by its suffix
    '.zstd': 'zstd -d',
    '.zst': 'zstd -d',
    '.gz': 'gzip -d',
    '.bz2': 'bzip2 -d',
    '.xz': 'xz -d',
    '.lz4': 'lz4 -d',
}
_MAX_NAMED = 3  # bags below a folder that are named in an error message


class _Values(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _StartingTime(_Values):
    nanoseconds_since_epoch: int


class _Duration(_Values):
    nanoseconds: int


class _TopicMetadata(_Values):
    name: str


class _TopicCount(_Values):
    topic_metadata: _TopicMetadata
    message_count: int


class Information(_Values):
    """What metadata.yaml says of a bag."""

    relative_file_paths: list[str]
    starting_time: _StartingTime
    duration: _Duration
    message_count: int
    topics_with_message_count: list[_TopicCount]
    custom_data: dict[str, Any] | None = None


def find_files(path: Path) -> tuple[list[Path], Information | None, list[str]]:
    """
    Find the files of a bag.

    :return: the files in order; what metadata.yaml says, None where it is missing or damaged; what
        is wrong with either, in words.
    :raises BagError: the path does not exist, or there is no MCAP file.
    """
    if path.is_file():
        return [path], None, []
    if not path.is_dir():
        raise BagError(f'there is no bag at {path}')
    found = sorted(path.glob('*.mcap'))
    if not found:
        _refuse(path)
    try:
        information = _read_information(path / FILE)
    except FileError as error:
        return found, None, [str(error)]
    listed = [path / Path(name).name for name in information.relative_file_paths]
    packed = [file for file in listed if file.suffix in PACKED and file.exists()]
    unlisted = [file for file in found if file not in listed]
    files = [*dict.fromkeys(file for file in listed if file in found), *unlisted]
    return (
        files,
        information,
        [
            *(f'{file.name} is left out: {unpack(file, file.suffix)}' for file in packed),
            *(
                f'{file.name} is in {FILE} but is not there'
                for file in listed
                if file not in [*found, *packed]
            ),
            *(f'{file.name} is not in {FILE}, and is read too' for file in unlisted),
        ],
    )


def _read_information(path: Path) -> Information:
    """
    Read metadata.yaml.

    :raises FileError: it is missing or damaged.
    """
    text = read_text(path, MAX_YAML)
    try:
        document = parse_yaml(text)
        return check_information(document.get(ROOT) if isinstance(document, dict) else None)
    except FileError as error:
        raise FileError(f'{path.name} is damaged: {error}') from error


def check_information(values: Any) -> Information:
    """
    Return what metadata.yaml says, from its values below ``ROOT``.

    :raises FileError: a value is missing or of another type.
    """
    try:
        return Information.model_validate(values)
    except ValidationError as error:
        raise FileError(fault_in(error)) from None


def _refuse(path: Path) -> NoReturn:
    """
    Say what a folder without MCAP files is, and how to make a bag of it.

    :raises BagError: always.
    """
    files = sorted(file for file in path.iterdir() if file.is_file())
    packed = [file.name for file in files if file.suffix in PACKED]
    if any('.db3' in file.suffixes for file in files):
        compressed = f', with compressed files such as {packed[0]}' if packed else ''
        raise BagError(f'{path} is a bag in sqlite3 format{compressed}; {convert(path)}')
    if packed:
        raise BagError(f'the files of {path} are compressed, such as {packed[0]}; {convert(path)}')
    if any(file.suffix == '.bag' for file in files):
        raise BagError(f'{path} holds a bag of ROS 1; {convert(path)}')
    below = [*path.glob(f'*/{FILE}'), *path.glob(f'*/*/{FILE}')]
    below.sort(key=lambda file: file.parent.stat().st_mtime, reverse=True)
    more = f' and {len(below) - _MAX_NAMED} more' if len(below) > _MAX_NAMED else ''
    named = ', '.join(str(file.parent) for file in below[:_MAX_NAMED]) + more
    hint = f'; bags below it: {named}' if below else ''
    raise BagError(f'{path} is not a bag: there is no MCAP file in it{hint}')


def convert(path: Path) -> str:
    """Say how to make a bag that can be read of one that another program wrote."""
    new = path.with_name(f'{path.resolve().name}-mcap')
    return (
        'pip install rosbags, and convert it: '
        f'rosbags-convert --src {quote(str(path))} --dst {quote(str(new))} --dst-storage mcap'
    )


def unpack(path: Path, suffix: str) -> str:
    """
    Say how to decompress a file.

    :param suffix: of ``PACKED``, of the files that are compressed as this one.
    """
    new = path.with_suffix('') if path.suffix in PACKED else path.with_name(f'new-{path.name}')
    command = f'{PACKED[suffix]} -c < {quote(str(path))} > {quote(str(new))}'
    return f'it is compressed; decompress it: {command}'
