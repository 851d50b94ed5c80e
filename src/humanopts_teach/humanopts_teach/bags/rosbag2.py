"""A rosbag2 directory (version 9, Jazzy): its metadata.yaml and its MCAP files."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from shlex import quote
from textwrap import indent
from typing import Any

from humanopts_ros.text_files import FileError, MAX_YAML, parse_yaml, read_text, YamlError
from humanopts_teach.bags import BagError
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
MOST_FILES = 100_000  # larger numbers in a file's name are not taken for its place
_MOST_GAPS = 100  # missing files that are named
_MOST_DIGITS = 9  # of a file's number
_MOST_NAMED = 3  # bags below a folder that are named in an error message


def find_files(path: Path) -> tuple[list[Path], dict[str, Any], list[str]]:
    """
    Find the files of a bag.

    :return: the files in order; the contents of metadata.yaml, {} where it is missing or damaged;
        what is wrong with either, in words.
    :raises BagError: the path does not exist, or there is no MCAP file.
    """
    if path.is_file():
        return [path], {}, []
    if not path.is_dir():
        raise BagError(f'there is no bag at {path}')
    found = sorted(path.glob('*.mcap'), key=_place)
    information, damage = _information(path / FILE)
    if not found:
        _check_storage(path, information)
    listed = [path / Path(str(name)).name for name in information.get('relative_file_paths', [])]
    packed = [file for file in listed if file.suffix in PACKED and file.exists()]
    damage += [f'{file.name} is left out: {unpack(file, file.suffix)}' for file in packed]
    missing = [file for file in listed if file not in [*found, *packed]]
    unlisted = [file for file in found if file not in listed] if listed else []
    damage += [f'{file.name} is in {FILE} but is not there' for file in missing]
    damage += [f'{file.name} is not in {FILE}, and is read too' for file in unlisted]
    damage += [f'{name} is not there, and later files are' for name in _gaps([*found, *listed])]
    files = [*dict.fromkeys(file for file in listed if file in found), *unlisted] or found
    if not files:
        raise BagError(f'{path} is not a bag: there is no MCAP file in it{_below(path)}')
    return files, information, damage


def _check_storage(path: Path, information: Mapping[str, Any]) -> None:
    """
    Refuse a bag whose messages are not in MCAP files, or in compressed ones.

    :raises BagError: the text says what it is, and how to convert it.
    """
    files = sorted(file for file in path.iterdir() if file.is_file())
    packed = [file.name for file in files if file.suffix in PACKED]
    storage = str(information.get('storage_identifier', 'mcap'))
    if any('.db3' in file.suffixes for file in files):
        storage = 'sqlite3'
    compressed = f', with compressed files such as {packed[0]}' if packed else ''
    if storage != 'mcap':
        raise BagError(f'{path} is a bag in {storage} format{compressed}; {convert(path)}')
    if packed:
        raise BagError(f'the files of {path} are compressed, such as {packed[0]}; {convert(path)}')
    if any(file.suffix == '.bag' for file in files):
        raise BagError(f'{path} holds a bag of ROS 1; {convert(path)}')


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


def _below(path: Path) -> str:
    """Name the bags up to two levels below a folder, newest first; empty: there are none."""
    there = [*path.glob(f'*/{FILE}'), *path.glob(f'*/*/{FILE}')]
    newest = sorted(
        (file.parent for file in there), key=lambda bag: bag.stat().st_mtime, reverse=True
    )
    if not newest:
        return ''
    more = f' and {len(newest) - _MOST_NAMED} more' if len(newest) > _MOST_NAMED else ''
    return f'; bags below it: {", ".join(map(str, newest[:_MOST_NAMED]))}{more}'


def _place(file: Path) -> tuple[str, int]:
    """Return the name of a file without its number, and the number: NAME_2.mcap is the third."""
    name, _, number = file.stem.rpartition('_')
    counted = number.isdecimal() and len(number) <= _MOST_DIGITS
    return (name, int(number)) if counted else (file.stem, -1)


def _gaps(files: Sequence[Path]) -> list[str]:
    """Return the names of files whose numbers are missing among the others, up to a limit."""
    found: dict[str, set[int]] = {}
    for name, number in map(_place, files):
        found.setdefault(name, set()).add(number)
    missing = (
        f'{name}_{number}.mcap'
        for name, numbers in found.items()
        if 0 in numbers
        for number in range(min(max(numbers), MOST_FILES))
        if number not in numbers
    )
    return list(islice(missing, _MOST_GAPS))


def _information(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Return the contents of metadata.yaml, and what is wrong with it; {} if it is unusable."""
    try:
        values = parse_yaml(read_text(path, MAX_YAML))
    except YamlError as error:
        return {}, [f'{path.name} is damaged: {error}']
    except FileError as error:
        return {}, [str(error)]
    information = values.get(ROOT) if isinstance(values, dict) else None
    if not isinstance(information, dict):
        return {}, [f'{path.name} is not that of a bag']
    if not isinstance(information.get('relative_file_paths', []), list):
        return {}, [f'{path.name} is damaged']
    return information, []
