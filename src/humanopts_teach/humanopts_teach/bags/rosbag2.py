"""A rosbag2 directory (version 9, Jazzy): metadata.yaml and MCAP files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, NoReturn

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
_NEVER = 2**63 - 1  # start time of a bag without messages, as in rosbag2
_TRANSIENT_LOCAL = ('transient_local', 1)  # name, or number in versions before 9


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """A YAML dumper that writes repeated values in full, without aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump(values: Any) -> str:
    """Serialise plain values as YAML."""
    return str(yaml.dump(values, Dumper=_Dumper, sort_keys=False, default_flow_style=False))


@dataclass(slots=True)
class Topic:
    """One topic of a bag."""

    name: str
    type: str  # such as humanopts_interfaces/msg/GameState
    schema: str  # complete ros2msg definition
    qos: str  # offered profiles, YAML; empty: unknown
    type_hash: str  # RIHS01_...; empty: unknown
    messages: int = 0

    @property
    def latched(self) -> bool:
        """Whether all publishers offered transient_local durability."""
        offered = [profile.get('durability') for profile in profiles(self.qos)]
        return bool(offered) and all(each in _TRANSIENT_LOCAL for each in offered)


@dataclass
class Extent:
    """The number and times of the messages in a bag or in one of its files."""

    messages: int = 0
    first: int = _NEVER  # earliest log time, ns
    last: int = 0  # latest log time, ns

    def add(self, log_time: int) -> None:
        """Add one message."""
        self.messages += 1
        self.first = min(self.first, log_time)
        self.last = max(self.last, log_time)

    @property
    def times(self) -> dict[str, dict[str, int]]:
        """The start and duration, as in metadata.yaml."""
        return {
            'duration': {'nanoseconds': max(0, self.last - self.first)},
            'starting_time': {'nanoseconds_since_epoch': self.first},
        }


def whole_extent(parts: Iterable[Extent]) -> Extent:
    """Return the combined extent of several files."""
    whole = Extent()
    for part in parts:
        whole.messages += part.messages
        whole.first = min(whole.first, part.first)
        whole.last = max(whole.last, part.last)
    return whole


def bag_information(
    files: Mapping[str, Extent], topics: Iterable[Topic], custom: Mapping[str, str]
) -> dict[str, Any]:
    """
    Return the values of metadata.yaml below ``ROOT``.

    :param files: extents by file name within the directory, in order.
    :param custom: facts stored by the recorder.
    """
    whole = whole_extent(files.values())
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **whole.times,
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
        'compression_format': '',  # for whole files or messages; chunk compression is separate
        'compression_mode': '',
        'relative_file_paths': list(files),
        'files': [
            {'path': name, **extent.times, 'message_count': extent.messages}
            for name, extent in files.items()
        ],
        'custom_data': dict(custom),
        'ros_distro': 'jazzy',
    }


@lru_cache
def profiles(text: str) -> list[dict[str, Any]]:
    """Parse QoS profiles from YAML; empty if damaged."""
    try:
        found = parse_yaml(text)
    except YamlError:
        return []
    known = isinstance(found, list) and all(isinstance(p, dict) for p in found)
    return found if known else []


class _Values(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _Name(_Values):
    name: str


class _TopicCount(_Values):
    topic_metadata: _Name
    message_count: int


class Information(_Values):
    """The values of metadata.yaml that readers use."""

    relative_file_paths: list[str]
    starting_time: dict[str, int]
    duration: dict[str, int]
    message_count: int
    topics_with_message_count: list[_TopicCount]
    custom_data: dict[str, Any] | None = None


def find_files(path: Path) -> tuple[list[Path], Information | None, list[str]]:
    """
    Find the files of a bag.

    :return: files in order; metadata (None: missing or damaged); descriptions of faults in both.
    :raises BagError: the path does not exist, or contains no MCAP file.
    """
    if path.is_file():
        return [path], None, []
    if not path.is_dir():
        raise BagError(f'there is no bag at {path}')
    found = sorted(path.glob('*.mcap'))
    if not found:
        _refuse(path)
    try:
        document = parse_yaml(read_text(path / FILE, MAX_YAML))
        information = Information.model_validate(
            document.get(ROOT) if isinstance(document, dict) else None
        )
    except YamlError as error:
        return found, None, [f'{FILE} is damaged: {error}']
    except FileError as error:
        return found, None, [str(error)]
    except ValidationError as error:
        return found, None, [f'{FILE} is damaged: {fault_in(error)}']
    files, faults = [], []
    for file in dict.fromkeys(path / Path(name).name for name in information.relative_file_paths):
        if file in found:
            files.append(file)
        elif file.suffix in COMPRESSED and file.exists():
            faults.append(f'{file.name} is left out: {decompress(file, file.suffix)}')
        else:
            faults.append(f'{file.name} is in {FILE} but does not exist')
    for file in found:
        if file not in files:
            files.append(file)
            faults.append(f'{file.name} is not in {FILE}, and is read too')
    return files, information, faults


class Compression(NamedTuple):
    """A file compression format."""

    command: str
    magic: bytes


COMPRESSED = {  # by file suffix
    '.zst': Compression('zstd', b'\x28\xb5\x2f\xfd'),
    '.zstd': Compression('zstd', b'\x28\xb5\x2f\xfd'),
    '.gz': Compression('gzip', b'\x1f\x8b'),
    '.bz2': Compression('bzip2', b'BZh'),
    '.xz': Compression('xz', b'\xfd7zXZ\0'),
    '.lz4': Compression('lz4', b'\x04\x22\x4d\x18'),
}


def _refuse(path: Path) -> NoReturn:
    """
    Raise an error that describes a folder without MCAP files and explains how to convert it.

    :raises BagError: always.
    """
    names = sorted(file.name for file in path.iterdir() if file.is_file())
    packed = [f', compressed, such as {name}' for name in names if Path(name).suffix in COMPRESSED]
    formats = {'.db3': 'in sqlite3 format', '.mcap': 'in MCAP format', '.bag': 'of ROS 1'}
    for suffix, what in formats.items():
        if any(suffix in Path(name).suffixes for name in names):
            raise BagError(f'{path} is a bag {what}{"".join(packed[:1])}; {convert(path)}')
    below = [*path.glob(f'*/{FILE}'), *path.glob(f'*/*/{FILE}')]
    below.sort(key=lambda file: file.parent.stat().st_mtime, reverse=True)
    newest = ', '.join(str(file.parent) for file in below[:3])
    hint = newest and f'; the newest bags below it: {newest}'
    raise BagError(f'{path} is not a bag: there is no MCAP file in it{hint}')


def convert(path: Path) -> str:
    """Explain how to convert a bag written by another program."""
    new = path.with_name(f'{path.resolve().name}-mcap')
    return (
        'pip install rosbags, and convert it: '
        f'rosbags-convert --src {quote(str(path))} --dst {quote(str(new))} --dst-storage mcap'
    )


def decompress(path: Path, suffix: str) -> str:
    """
    Explain how to decompress a file.

    :param suffix: key of its format in ``COMPRESSED``.
    """
    new = path.with_suffix('') if path.suffix in COMPRESSED else path.with_name(f'new-{path.name}')
    tool = COMPRESSED[suffix].command
    command = f'{tool} -d -c < {quote(str(path))} > {quote(str(new))}'
    return f'it is compressed; decompress it: {command}'
