"""Which MCAP files make up a bag."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.metadata import FILE, ROOT
import yaml

MOST_FILES = 100_000  # a larger number of a file is none
_MOST_NAMED = 3  # bags that are named in place of a folder that is none
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
# What damaged text makes the loader raise, ValueError apart.
_NO_YAML = (
    yaml.YAMLError,
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
)


@dataclass(frozen=True)
class Directory:
    """The files of a bag, and what metadata.yaml says of them."""

    files: list[Path]  # in order
    information: dict[str, Any]  # {}: it says nothing, or is not there
    damage: list[str]


def find_files(path: Path) -> Directory:
    """
    Find the files of a bag.

    :raises BagError: there is nothing, or no MCAP file of a bag.
    """
    if path.is_file():
        return Directory([path], {}, [])
    if not path.is_dir():
        raise BagError(f'there is no bag at {path}')
    found = sorted(path.glob('*.mcap'), key=_place)
    information, damage = _information(path / FILE)
    storage = information.get('storage_identifier', 'mcap')
    if storage != 'mcap' and not found:
        raise BagError(f'{path} is a bag in {storage} format; convert it to mcap first')
    listed = [path / Path(str(name)).name for name in information.get('relative_file_paths', [])]
    missing = [file for file in listed if file not in found]
    unlisted = [file for file in found if file not in listed] if listed else []
    damage += [f'{file.name} is in {FILE} but is not there' for file in missing]
    damage += [f'{file.name} is not in {FILE}, and is read too' for file in unlisted]
    damage += [f'{name} is not there, and later files are' for name in _gaps([*found, *listed])]
    files = [*dict.fromkeys(file for file in listed if file in found), *unlisted] or found
    if not files:
        raise BagError(f'{path} is not a bag: there is no MCAP file in it{_below(path)}')
    return Directory(files, information, damage)


def _below(path: Path) -> str:
    """Name the bags in a folder that is none, and in its folders; empty: there are none."""
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
    return (name, int(number)) if number.isdecimal() else (file.stem, -1)


def _gaps(files: list[Path]) -> list[str]:
    """Return the names of files that are left out in the numbers of the others."""
    found: dict[str, set[int]] = {}
    for name, number in map(_place, files):
        found.setdefault(name, set()).add(number)
    return [
        f'{name}_{number}.mcap'
        for name, numbers in found.items()
        if 0 in numbers
        for number in range(min(max(numbers), MOST_FILES))
        if number not in numbers
    ]


def _information(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Return what metadata.yaml says; {} and why where it cannot be used."""
    try:
        document = load(path.read_text('utf-8'))
    except OSError as error:
        return {}, [f'{path.name} cannot be read: {error.strerror}']
    except ValueError:
        return {}, [f'{path.name} is damaged']
    information = document.get(ROOT) if isinstance(document, dict) else None
    if not isinstance(information, dict):
        return {}, [f'{path.name} is not that of a bag']
    if not isinstance(information.get('relative_file_paths', []), list):
        return {}, [f'{path.name} is damaged']
    return information, []


def load(text: str) -> Any:
    """
    Read YAML.

    :raises ValueError: it is none.
    """
    try:
        return yaml.load(text, Loader=_LOADER)
    except _NO_YAML as error:
        raise ValueError(str(error)) from error
