"""Cells: what an experiment is computed from, each kept in a file of its own once it is done."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
import hashlib
from importlib.metadata import version
from importlib.util import find_spec
import json
from pathlib import Path
from typing import Any

from humanopts_teach.evaluation.summary import write_text

PACKAGES = ('humanopts_env', 'humanopts_learner', 'humanopts_teach', 'experiments')
LIBRARIES = ('numpy', 'scipy', 'scikit-learn')  # that results may depend on to the last digit
Compute = Callable[[Mapping[str, Any]], Any]  # parameters -> result, both JSON data


def digest(folders: Iterable[Path]) -> str:
    """Return a short text that changes with the Python code in folders, nodes left out."""
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob('*.py')):
            if 'ros' not in path.relative_to(folder).parts:
                found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return found.hexdigest()[:12]


@cache
def code_version() -> str:
    """Return the digest of the code that results depend on."""
    specs = [find_spec(package) for package in PACKAGES]
    return digest(Path(place) for s in specs if s for place in s.submodule_search_locations or ())


@dataclass(frozen=True)
class Cell:
    """One computation: the same experiment, code and parameters give the same result."""

    experiment: str  # such as fig2
    parameters: Mapping[str, Any]  # JSON data
    compute: Compute  # a function of a module, so that it can be sent to another process
    cost: float = 1.0  # expected, compared with other cells; for the estimate of the time left

    @property
    def identity(self) -> dict[str, Any]:
        """What the result depends on, as JSON data."""
        known = {
            'experiment': self.experiment,
            'code': code_version(),
            'parameters': dict(self.parameters),
            'libraries': {name: version(name) for name in LIBRARIES},
        }
        plain: dict[str, Any] = json.loads(json.dumps(known))
        return plain

    @property
    def key(self) -> str:
        """A short name that no other cell has."""
        text = json.dumps(self.identity, sort_keys=True)
        return f'{self.experiment}-{hashlib.sha256(text.encode()).hexdigest()[:20]}'

    def __str__(self) -> str:
        """Return the cell in words."""
        said = ', '.join(f'{name} {value}' for name, value in self.parameters.items())
        return f'{self.experiment} ({said})'


class CellStore:
    """The finished cells in one folder; a file that cannot be read counts as not there."""

    def __init__(self, folder: Path) -> None:
        """
        Use a folder, creating it where needed.

        :raises OSError: it cannot be made.
        """
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def load(self, cell: Cell) -> Any:
        """Return a finished cell's result; None: it is not finished."""
        try:
            kept = json.loads(self._path(cell).read_text('utf-8'))
        except (OSError, ValueError):
            return None
        if not isinstance(kept, dict) or kept.get('cell') != cell.identity:
            return None
        return kept.get('result')

    def save(self, cell: Cell, result: Any, seconds: float) -> None:
        """
        Keep a result; a reader sees none or all of it.

        :param seconds: that it took.
        :raises SummaryError: the file cannot be written.
        """
        kept = {'cell': cell.identity, 'seconds': round(seconds, 3), 'result': result}
        write_text(self._path(cell), json.dumps(kept, indent=1, allow_nan=False) + '\n')

    def _path(self, cell: Cell) -> Path:
        return self._folder / f'{cell.key}.json'
