"""What ``humanopts bag export`` writes: tables, a dataset, or the files attached to a bag."""

from pathlib import Path, PurePosixPath

from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.minari_dataset import FOLDER, write_dataset
from humanopts_teach.export.tables import bag_tables, ExportError, write_csv, write_parquet


def export_bag(bag: Bag, form: str, out: Path) -> str:
    """
    Write the files; return the lines that name them.

    :param form: csv, parquet, minari or files.
    :raises BagError: the bag does not say which domain was played, or it is not installed.
    :raises ExportError: it cannot be exported as asked.
    :raises OSError: the folder cannot be written to.
    """
    if form == 'minari':
        found = write_dataset(bag, out)
        return (
            f'{found.episodes} episodes; with {FOLDER}={out} in the environment:\n'
            f'minari.load_dataset({found.dataset_id!r})'
        )
    if form == 'files':
        paths = write_attached(bag, out)
    else:
        write = {'csv': write_csv, 'parquet': write_parquet}[form]
        paths = write(bag_tables(bag), out)
    return '\n'.join(map(str, paths))


def write_attached(bag: Bag, out: Path) -> list[Path]:
    """
    Write every attached file that is whole into a folder, under its name.

    :raises ExportError: no file is attached, none is whole, or one has a name that leads out of
        the folder or exists there.
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
