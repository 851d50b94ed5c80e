"""Synchronous value iteration over options (Sutton, Precup and Singh 1999, section 4)."""

from collections.abc import Callable
from dataclasses import dataclass

from humanopts_learner.planning.errors import check_limits
from humanopts_learner.planning.model import Model
import numpy as np
from numpy.typing import NDArray

OnSweep = Callable[[int, float], bool | None]
OnValues = Callable[[NDArray[np.float64]], object]


@dataclass(frozen=True)
class Solution:
    """What value iteration came to."""

    values: NDArray[np.float64]  # (S,), 0 where nothing is available
    best: NDArray[np.int32]  # (S,) greedy column, the lowest among equals; -1: none available
    sweeps: int
    residual: float  # largest change of the last sweep, reward units
    converged: bool  # residual is at most tol


class _Backup:
    """One sweep over a model, in place: no loop over states, and one column in cache at a time."""

    def __init__(self, model: Model) -> None:
        self.dead = ~model.available.any(axis=1)
        self._expected = model.expectation()
        self._reward = np.where(model.available.T, model.reward.T, -np.inf)
        self._reward[0, self.dead] = 0.0  # nothing follows there, so their value stays 0
        self._choice = np.empty(model.n_states)

    def sweep(self, old: NDArray[np.float64], new: NDArray[np.float64]) -> float:
        """Write the next values to ``new`` and the changes to ``old``; return the largest."""
        self._expected.prepare(old)
        self._value(0, new)
        for column in range(1, len(self._reward)):
            np.maximum(new, self._value(column, self._choice), out=new)
        np.subtract(new, old, out=old)
        return max(float(old.max()), -float(old.min()))

    def best(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the greedy column of every state, the lowest among equals; -1: none."""
        self._expected.prepare(values)
        greatest = self._value(0, np.empty_like(values))
        best = np.zeros(len(values), dtype=np.int32)
        for column in range(1, len(self._reward)):
            best[self._value(column, self._choice) > greatest] = column
            np.maximum(greatest, self._choice, out=greatest)
        best[self.dead] = -1
        return best

    def _value(self, column: int, out: NDArray[np.float64]) -> NDArray[np.float64]:
        """Write the value of one choice in every state to ``out``, and return it."""
        self._expected.column(column, out)
        out += self._reward[column]
        return out


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
    :raises ModelError: tol is negative or no number, or max_sweeps is below 1.
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
