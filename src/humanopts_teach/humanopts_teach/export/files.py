"""Tables of a bag as files: CSV with the standard library, Parquet where pyarrow is installed."""

from collections.abc import Sequence
from contextlib import ExitStack
import csv
from itertools import islice
from pathlib import Path
from typing import Any

from humanopts_teach.export.tables import Table

BATCH = 50_000  # rows of a Parquet table that are held


class ExportError(ValueError):
    """A bag cannot be exported as asked; the text says why."""


def write_csv(tables: Sequence[Table], out: Path) -> list[Path]:
    """
    Write a file for each table, UTF-8, with a head; what is unknown is empty.

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
    """Write a table in parts, all of the types that the first has; text where it has nothing."""
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
