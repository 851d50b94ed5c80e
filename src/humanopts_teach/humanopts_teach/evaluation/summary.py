"""summary.json: what a demo came to, in numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
import tempfile
from typing import Any

from humanopts_teach.evaluation.games import GamesEvaluation
from humanopts_teach.evaluation.options_block import OptionBlock
from humanopts_teach.evaluation.planning import PlanningRow
from humanopts_teach.evaluation.settings import Settings


class SummaryError(OSError):
    """The summary could not be written; the text says why."""


@dataclass(frozen=True)
class Execution:
    """Episodes played by running options."""

    episodes: int
    successes: int  # that ended with the task done
    fallbacks: int  # primitive actions taken because no option was available
    mean_return: float | None  # undiscounted


@dataclass(frozen=True)
class BagFacts:
    """What the recording holds."""

    path: str
    messages: int
    topics: int


@dataclass(frozen=True)
class Summary:
    """Everything of summary.json."""

    domain: str
    settings: Settings
    options: tuple[OptionBlock, ...]  # as seen live
    planning: tuple[PlanningRow, ...]
    execution: Execution
    bag: BagFacts
    offline: tuple[OptionBlock, ...]  # learned again from the bag
    offline_planning: tuple[PlanningRow, ...] = ()  # planned again with these
    games: GamesEvaluation | None = None  # None: plans are exact

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as JSON data, without NaN."""
        settings = self.settings.to_dict()
        return {
            'domain': self.domain,
            'seed': settings.pop('seed'),
            'options': _blocks(self.options),
            'teaching': settings,
            'planning': [row.to_dict() for row in self.planning],
            'execution': asdict(self.execution),
            'bag': asdict(self.bag),
            'offline': {
                'options': _blocks(self.offline),
                'planning': [row.to_dict() for row in self.offline_planning],
            },
            'games': None if self.games is None else self.games.to_dict(),
        }


def _blocks(blocks: Sequence[OptionBlock]) -> list[dict[str, Any]]:
    return [block.to_dict() for block in blocks]


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """
    Write JSON data; a reader sees the old file or all of the new one.

    :raises SummaryError: the folder is missing, full or not writable.
    :raises ValueError: a number is NaN or infinite.
    """
    text = json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    """
    Write a text file; a reader sees the old file or all of the new one.

    :raises SummaryError: the folder is missing, full or not writable.
    """
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(
            'w', encoding='utf-8', dir=path.parent, prefix=f'.{path.name}.', delete=False
        ) as file:
            temporary = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise SummaryError(f'cannot write {path}: {error.strerror or error}') from error
