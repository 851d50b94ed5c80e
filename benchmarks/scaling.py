"""How planning time grows with the size of the world."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
import statistics
from typing import Any

import numpy as np

from benchmarks.solvers import Solved, Solver, solvers
from benchmarks.taxi_case import TaxiCase

SIDES = (5, 25, 50, 100)
OnSolved = Callable[[float, str], object]  # share that is done, what is next


@dataclass(frozen=True)
class ScalingRow:
    """One solver on one grid: medians over several runs."""

    side: int
    n_states: int
    solver: str
    obtained: str
    obtained_seconds: float  # to get that, once, before all runs
    table_seconds: float
    model_seconds: float
    sweep_seconds: float
    seconds: float  # the median of the sums
    sweeps: int
    error: float  # largest distance from the true value of a state, reward units

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        return asdict(self)


def scaling_rows(
    sides: Sequence[int] = SIDES, repeats: int = 5, progress: OnSolved | None = None
) -> list[ScalingRow]:
    """
    Solve Taxi grids by every solver, in turns, so that a busy machine slows all of them alike.

    The true values are those of the breadth-first search, which sums up no series of roundings.

    :param repeats: runs behind each median; one more is made first, and not counted.
    :raises DomainError: a side is not from 4 to 1000.
    """
    tell = progress or (lambda fraction, text: None)
    rows, total, done = [], sum(side * side for side in sides), 0
    for side in sides:
        case, chosen = TaxiCase(side), solvers()
        runs: dict[str, list[Solved]] = {solver.name: [] for solver in chosen}
        for turn in range(repeats + 1):
            for solver in chosen:
                share = turn / (repeats + 1) * side * side
                tell((done + share) / total, f'taxi {side} x {side}: {solver.name}')
                runs[solver.name].append(solver.solve(case))
        truth = runs['breadth-first search backwards'][0].values
        rows += [_row(case, solver, runs[solver.name][1:], truth) for solver in chosen]
        done += side * side
    return rows


def _row(case: TaxiCase, solver: Solver, runs: Sequence[Solved], truth: Any) -> ScalingRow:
    def median(field: str) -> float:
        return float(statistics.median(getattr(run, field) for run in runs))

    return ScalingRow(
        side=case.domain.rows,
        n_states=len(truth),
        solver=solver.name,
        obtained=solver.obtained,
        obtained_seconds=solver.cost(case),
        table_seconds=median('table_seconds'),
        model_seconds=median('model_seconds'),
        sweep_seconds=median('sweep_seconds'),
        seconds=median('seconds'),
        sweeps=runs[0].sweeps,
        error=float(np.abs(runs[0].values - truth).max()),
    )
