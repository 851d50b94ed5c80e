"""What each sweep of value iteration brings, for figures and tables."""

from dataclasses import dataclass

from humanopts_learner.planning.model import Model
from humanopts_learner.planning.value_iteration import solve_smdp
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SweepRow:
    """The values after one sweep."""

    sweep: int  # 0: before the first
    residual: float  # largest change of the sweep, reward units; NaN before the first
    error: float  # largest distance from the values in the end
    valued: int  # states whose value is no longer 0
    settled: int  # states whose value is as near to its end as asked


def value_history(model: Model, tol: float = 1e-8, max_sweeps: int = 1000) -> NDArray[np.float64]:
    """
    Return the values after each sweep, (sweeps + 1, S), from 0; the last are those in the end.

    :raises ModelError: as ``solve_smdp``.
    """
    history = [np.zeros(model.n_states)]
    solve_smdp(model, tol, max_sweeps, on_values=lambda values: history.append(values.copy()))
    return np.array(history)


def sweep_table(
    model: Model, tol: float = 1e-8, near: float = 1e-3, max_sweeps: int = 1000
) -> list[SweepRow]:
    """
    Return one row for each sweep, from the values of 0 to those in the end.

    :param near: a value so close to its end, in reward units, is settled.
    :raises ModelError: as ``solve_smdp``.
    """
    history = value_history(model, tol, max_sweeps)
    distance = np.abs(history - history[-1])
    change = np.abs(np.diff(history, axis=0)).max(axis=1)
    return [
        SweepRow(
            sweep=sweep,
            residual=float(change[sweep - 1]) if sweep else float('nan'),
            error=float(distance[sweep].max()),
            valued=int((history[sweep] != 0).sum()),
            settled=int((distance[sweep] <= near).sum()),
        )
        for sweep in range(len(history))
    ]
