"""``humanopts bag export``: a bag for other tools."""

from pathlib import Path
import sys

from humanopts_env.domains.base import StateError
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.commands.bag import progress_bar
from humanopts_teach.commands.ending import CommandError
from humanopts_teach.export.files import ExportError, write_attached, write_csv, write_parquet
from humanopts_teach.export.minari_dataset import FOLDER, write_dataset
from humanopts_teach.export.tables import bag_tables


def export(path: Path, form: str, out: Path) -> int:
    """
    Write the files, and print what was written.

    :param form: csv, parquet, minari or files.
    :raises BagError: there is no bag.
    """
    try:
        with progress_bar() as show:
            bag = open_bag(path, show)
            written = _write(bag, form, out)
    except (ExportError, StateError) as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        raise CommandError(f'cannot write in {out}: {error.strerror or error}') from error
    print(written)
    for line in bag.damage.splitlines():
        print(f'humanopts bag export: {line}', file=sys.stderr)
    return 0


def _write(bag: Bag, form: str, out: Path) -> str:
    """Write the files; return the lines that name them."""
    if form == 'minari':
        return _dataset(bag, out)
    if form == 'files':
        return '\n'.join(map(str, write_attached(bag, out)))
    write = {'csv': write_csv, 'parquet': write_parquet}[form]
    return '\n'.join(map(str, write(bag_tables(bag), out)))


def _dataset(bag: Bag, out: Path) -> str:
    found = write_dataset(bag, out)
    if found.left_out:
        print(
            f'humanopts bag export: {found.left_out} episodes are left out: of one state, or with '
            'steps missing',
            file=sys.stderr,
        )
    return (
        f'{found.episodes} episodes; with {FOLDER}={out} in the environment:\n'
        f'minari.load_dataset({found.dataset_id!r})'
    )
