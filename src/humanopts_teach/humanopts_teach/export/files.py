"""Tables of a bag as files: CSV with the standard library, Parquet where pyarrow is installed."""

from collections.abc import Sequence
import csv
from pathlib import Path

from humanopts_teach.export.tables import Table


class ExportError(ValueError):
    """A bag cannot be exported as asked; the text says why."""


def write_csv(tables: Sequence[Table], out: Path) -> list[Path]:
    """
    Write a file for each table, UTF-8, with a head; what is unknown is empty.

    :raises OSError: the folder cannot be written to.
    """
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.csv')
        with paths[-1].open('w', encoding='utf-8', newline='') as file:
            writer = csv.writer(file)
            writer.writerow(table.columns)
            writer.writerows(zip(*table.columns.values()))
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
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.parquet')
        columns = {name: list(column) for name, column in table.columns.items()}
        parquet.write_table(pyarrow.table(columns), paths[-1])
    return paths
