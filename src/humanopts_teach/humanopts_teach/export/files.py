"""
What is in a bag as files: tables as CSV or Parquet, and the files that are attached to it.

Tables are written while the bag is read, so that a long one takes no memory.
"""

from collections.abc import Sequence
from contextlib import ExitStack
import csv
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.tables import Table

BATCH = 50_000  # rows of a Parquet table that are held in memory


class ExportError(ValueError):
    """A bag cannot be exported as asked; the text says why."""


def write_csv(tables: Sequence[Table], out: Path) -> list[Path]:
    """
    Write a UTF-8 file for each table, with a head; unknown values are empty.

    :raises OSError: the folder cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.csv')
        with paths[-1].open('w', encoding='utf-8', newline='') as file:
            writer = csv.writer(file)
            writer.writerow(table.head)
            writer.writerows(table.rows)
    return paths


def write_parquet(tables: Sequence[Table], out: Path) -> list[Path]:
    """
    Write a file for each table.

    :raises ExportError: pyarrow is not installed.
    :raises OSError: the folder cannot be written to.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ExportError(
            'Parquet needs pyarrow, which is not installed: pip install pyarrow'
        ) from error
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.parquet')
        _write_batches(table, paths[-1], pyarrow, parquet)
    return paths


def _write_batches(table: Table, path: Path, pyarrow: Any, parquet: Any) -> None:
    """
    Write a table in parts.

    All parts have the column types of the first; a column that is empty there is text.
    """
    rows, schema = iter(table.rows), None
    with ExitStack() as stack:
        while (part := list(islice(rows, BATCH))) or schema is None:
            columns = dict(zip(table.head, zip(*part))) or dict.fromkeys(table.head, ())
            batch = pyarrow.table({name: list(c) for name, c in columns.items()}, schema)
            if schema is None:
                types = {f.name: f.type for f in batch.schema}
                empty = dict.fromkeys(
                    (name for name, kind in types.items() if kind == pyarrow.null()),
                    pyarrow.string(),
                )
                batch = batch.cast(pyarrow.schema({**types, **empty}))
                schema = batch.schema
                writer = stack.enter_context(parquet.ParquetWriter(path, schema))
            writer.write_table(batch)


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
