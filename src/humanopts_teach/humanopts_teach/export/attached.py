"""The files that are attached to a bag, as files again."""

from pathlib import Path, PurePosixPath

from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.files import ExportError


def write_attached(bag: Bag, out: Path) -> list[Path]:
    """
    Write every attached file that is whole under its name there.

    :raises ExportError: none is attached or none is whole, or one has a name that is outside of
        the folder, or is there already.
    :raises OSError: the folder cannot be written to.
    """
    if not bag.attachments:
        raise ExportError(f'{bag.path} has no attached files')
    paths = []
    for file in bag.attached():
        name = PurePosixPath(file.name)
        if name.is_absolute() or '..' in name.parts or not name.parts:
            raise ExportError(f'{bag.path} has an attached file of the name {file.name!r}')
        path = out / name
        if path.exists():
            raise ExportError(f'{path} exists already; name another folder')
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)
        paths.append(path)
    if not paths:
        raise ExportError(f'all files attached to {bag.path} are damaged')
    return paths
