"""SMDP value iteration: synchronous, over options (Sutton, Precup and Singh 1999, section 3.1)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from humanopts_env.arrays import Floats
from humanopts_learner.planning.request import check_limits
from humanopts_learner.planning.smdp import Model
import numpy as np
from numpy.typing import NDArray

OnSweep = Callable[[int, float], bool | None]
OnValues = Callable[[Floats], object]


@dataclass(frozen=True)
class Solution:
    """The result of value iteration."""

    values: Floats  # (S,), 0 where no option is available
    best: NDArray[np.int32]  # (S,) greedy option index, the lowest of equals; -1: none available
    sweeps: int
    residual: float  # largest change of the last sweep, reward units
    converged: bool  # residual is at most tol


class _Backup:
    """One sweep over a model, in place: no loop over states, and one option in cache at a time."""

    def __init__(self, model: Model) -> None:
        self._dead = ~model.available.any(axis=1)
        self._expected = model.expectation()
        self._reward = np.where(model.available.T, model.reward.T, -np.inf)
        self._reward[0, self._dead] = 0.0  # nothing follows there, so their value stays 0

    def sweep(self, old: Floats, new: Floats) -> float:
        """Write the next values to ``new`` and the changes to ``old``; return the largest."""
        new.fill(-np.inf)
        for choice in self._option_values(old):
            np.maximum(new, choice, out=new)
        np.subtract(new, old, out=old)
        return max(float(old.max()), -float(old.min()))

    def best(self, values: Floats) -> NDArray[np.int32]:
        """Return the greedy option of every state, the lowest of equals; -1: none."""
        greatest = np.full(len(values), -np.inf)
        best = np.zeros(len(values), dtype=np.int32)
        for option, choice in enumerate(self._option_values(values)):
            best[choice > greatest] = option
            np.maximum(greatest, choice, out=greatest)
        best[self._dead] = -1
        return best

    def _option_values(self, values: Floats) -> Iterator[Floats]:
        """Yield the value of each option in every state (S,), valid until the next."""
        for expected, reward in zip(self._expected(values), self._reward):
            expected += reward
            yield expected


def solve_smdp(
    model: Model,
    tol: float = 1e-8,
    max_sweeps: int = 10_000,
    on_sweep: OnSweep | None = None,
    on_values: OnValues | None = None,
) -> Solution:
    """
    Return the best value of every state, from values of 0.

    :param tol: largest change allowed in the last sweep, in reward units.
    :param max_sweeps: 1 or more.
    :param on_sweep: called with the number of sweeps and the residual after each; returning True
        ends the work early, and what it raises passes through.
    :param on_values: called with the values (S,) after each sweep; they must be copied to be kept.
    :raises PlanError: tol is negative or no number, or max_sweeps is below 1.
    """
    check_limits(tol, max_sweeps)
    backup = _Backup(model)
    old, new = np.zeros(model.n_states), np.empty(model.n_states)
    for sweeps in range(1, max_sweeps + 1):
        residual = backup.sweep(old, new)
        old, new = new, old
        if on_values is not None:
            on_values(old)
        stop = on_sweep is not None and on_sweep(sweeps, residual)
        if stop or residual <= tol:
            break
    return Solution(old, backup.best(old), sweeps, residual, residual <= tol)


@dataclass(frozen=True)
class SweepRow:
    """The values after one sweep, for figures and tables."""

    sweep: int  # 0: before the first
    residual: float  # largest change of the sweep, reward units; NaN before the first
    error: float  # largest distance from the final values
    valued: int  # states whose value is no longer 0
    settled: int  # states whose value is as near to its final value as asked


def value_history(model: Model, tol: float = 1e-8, max_sweeps: int = 1000) -> Floats:
    """
    Return the values after each sweep, (sweeps + 1, S), from 0 to the final ones.

    :raises PlanError: as ``solve_smdp``.
    """
    history = [np.zeros(model.n_states)]
    solve_smdp(model, tol, max_sweeps, on_values=lambda values: history.append(values.copy()))
    return np.array(history)


def sweep_table(
    model: Model, tol: float = 1e-8, near: float = 1e-3, max_sweeps: int = 1000
) -> list[SweepRow]:
    """
    Return one row for each sweep, from the values of 0 to the final ones.

    :param near: a value so close to its final one, in reward units, is settled.
    :raises PlanError: as ``solve_smdp``.
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
