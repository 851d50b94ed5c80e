"""Which MCAP files make up a bag."""

from pathlib import Path
from typing import Any

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.metadata import FILE, ROOT
import yaml

_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def bag_files(path: Path) -> tuple[list[Path], list[str]]:
    """
    Return the files of a bag in order, and what is wrong with the list of them.

    :raises BagError: there is nothing, or no MCAP file of a bag.
    """
    if path.is_file():
        return [path], []
    if not path.is_dir():
        raise BagError(f'there is no bag at {path}')
    found = sorted(path.glob('*.mcap'))
    information, damage = _information(path / FILE)
    storage = information.get('storage_identifier', 'mcap')
    if storage != 'mcap':
        raise BagError(f'{path} is a bag in {storage} format; convert it to mcap first')
    listed = [path / Path(str(name)).name for name in information.get('relative_file_paths', [])]
    missing = [file for file in listed if file not in found]
    damage += [f'{file.name} is in {FILE} but is not there' for file in missing]
    files = [file for file in listed if file in found] or found
    if not files:
        raise BagError(f'{path} is not a bag: there is no MCAP file in it')
    return files, damage


def _information(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Return what metadata.yaml says; {} and why where it cannot be used."""
    try:
        document = yaml.load(path.read_text('utf-8'), Loader=_LOADER)
    except OSError as error:
        return {}, [f'{path.name} cannot be read: {error.strerror}']
    except (yaml.YAMLError, UnicodeDecodeError):
        return {}, [f'{path.name} is damaged']
    information = document.get(ROOT) if isinstance(document, dict) else None
    if not isinstance(information, dict):
        return {}, [f'{path.name} is not that of a bag']
    if not isinstance(information.get('relative_file_paths', []), list):
        return {}, [f'{path.name} is damaged']
    return information, []
