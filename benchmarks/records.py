"""What the nodes of a benchmark report: one JSON object on each line of a file."""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any, Self


class RecordWriter:
    """Adds records to a file; a reader sees each at once."""

    def __init__(self, path: Path) -> None:
        self._file = path.open('a', encoding='utf-8')

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, **record: Any) -> None:
        """Add a record."""
        self._file.write(json.dumps(record) + '\n')
        self._file.flush()


def read_records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the records that are complete; none where there is no file yet."""
    if path.exists():
        for line in path.read_text('utf-8').splitlines(keepends=True):
            if line.endswith('\n'):
                yield json.loads(line)
