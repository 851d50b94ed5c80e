"""Runs the sections of ``humanopts bench``, and gives their results as data."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.games import game_rows
from benchmarks.latencies import latency_rows, LatencySizes
from benchmarks.learning import learning_rows
from benchmarks.measured import Comparison, OnMeasured
from benchmarks.place import own_place
from benchmarks.readers import Load
from benchmarks.recording import LOADS, recording_rows, RecordingRow
from benchmarks.scaling import scaling_rows, ScalingRow, SIDES

VERSION = 1
QUICK_LATENCIES = LatencySizes(2, 20, 3)
QUICK_LOADS = (Load(2_000, 0, 1), Load(1_500, 3_000, 1))
YARDSTICK = 'primitive value iteration'  # of planning


@dataclass(frozen=True)
class Planned:
    """One way to plan on one grid, beside primitive value iteration on the same grid."""

    row: ScalingRow
    yardstick_seconds: float

    @property
    def ratio(self) -> float:
        """How many times the yardstick's time it takes."""
        return self.row.seconds / self.yardstick_seconds

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        own = {'yardstick': YARDSTICK, 'yardstick_seconds': self.yardstick_seconds}
        return {**self.row.to_dict(), **own, 'ratio': self.ratio}


Rows = Sequence[Planned] | Sequence[Comparison] | Sequence[RecordingRow]


def planning_rows(
    sides: Sequence[int], repeats: int, progress: OnMeasured | None = None
) -> list[Planned]:
    """Solve Taxi grids by every solver; see ``scaling_rows``."""
    rows = scaling_rows(sides, repeats, progress)
    seconds = {row.side: row.seconds for row in rows if row.solver == YARDSTICK}
    return [Planned(row, seconds[row.side]) for row in rows]


def run_section(name: str, *, quick: bool, progress: OnMeasured) -> Rows:
    """
    Measure one section.

    :param name: a key of ``SECTIONS``.
    :param quick: take small sizes, to see that it works; the times mean little.
    :raises LaunchError: a process of the graph died, or is not done in time.
    """
    return SECTIONS[name](quick, progress)


def results_to_dict(
    sections: dict[str, Rows], machine: dict[str, str | int], *, quick: bool
) -> dict[str, Any]:
    """Return everything as JSON data."""
    return {
        'format': 'humanopts-bench',
        'version': VERSION,
        'quick': quick,
        'machine': machine,
        **{name: [row.to_dict() for row in rows] for name, rows in sections.items()},
    }


def _planning(quick: bool, progress: OnMeasured) -> Rows:
    return planning_rows((5, 10), 1, progress) if quick else planning_rows(SIDES, 5, progress)


def _learning(quick: bool, progress: OnMeasured) -> Rows:
    return learning_rows((10,), 2, progress) if quick else learning_rows(progress=progress)


def _games(quick: bool, progress: OnMeasured) -> Rows:
    return game_rows(2, 50, 2, progress) if quick else game_rows(progress=progress)


def _graph(quick: bool, progress: OnMeasured) -> Rows:
    with own_place() as folder:
        return latency_rows(QUICK_LATENCIES if quick else LatencySizes(), folder, progress)


def _recording(quick: bool, progress: OnMeasured) -> Rows:
    with own_place() as folder:
        return recording_rows(QUICK_LOADS if quick else LOADS, folder, progress)


SECTIONS: dict[str, Callable[[bool, OnMeasured], Rows]] = {
    'planning': _planning,
    'learning': _learning,
    'games': _games,
    'graph': _graph,
    'recording': _recording,
}
