"""
SMDP value iteration: synchronous, over options (Sutton, Precup and Singh 1999, section 3.1).

In a sampled model many states are the successor of none: runs only passed through them. No value
depends on theirs, so sweeps leave them out, and they are valued at the end. All numbers are the
same as if they had been swept.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any, Literal

from humanopts_env.arrays import Flags, Floats
from humanopts_learner.planning.request import check_limits
from humanopts_learner.planning.smdp import (
    look_ahead,
    Model,
    MultiTimeModel,
    SparseMultiTimeModel,
)
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import _sparsetools

OnSweep = Callable[[int, float], bool | None]
COMPILED_FROM = (
    1_000_000  # pairs of state and option; sweeps over fewer end before Numba is loaded
)
COMPARED = 100_000  # states whose options are compared at once, after the sweeps
_FLOATS, _TABLE = 'float64[::1]', 'float64[:, ::1]'
_SIGNATURE = f'float64(uint32[:, ::1], {_TABLE}, {_TABLE}, float64, {_FLOATS}, {_FLOATS})'


@dataclass(frozen=True)
class Solution:
    """The result of value iteration."""

    values: Floats  # (S,), 0 where no option is available
    best: NDArray[np.int32]  # (S,) greedy option index, the lowest of equals; -1: none available
    sweeps: int
    residual: float  # largest change of the last sweep, reward units
    converged: bool  # residual is at most tol


class _IndexedBackup:
    """
    Sweeps over a model with one successor for each state and option, in place.

    Machine code goes state by state, and reads each number once. NumPy goes option by option, so
    that one at a time is in cache; both come to the same bits.

    :ivar n_swept: number of states that are swept, R.
    """

    def __init__(self, model: MultiTimeModel, compiled: Callable[..., float] | None) -> None:
        """
        Prepare the sweeps.

        :param compiled: ``_sweep_states`` as machine code; None: NumPy sweeps.
        """
        self.n_swept, self._compiled = model.n_states, compiled
        self._dead: Flags = ~np.asarray(model.available.T.any(axis=0))  # by rows in memory
        order: Literal['C', 'F'] = 'C' if compiled else 'F'
        discount = np.where(model.available, model.discount, 0.0)
        nothing, self._common = discount == 0.0, float(discount.max())
        alike = bool((nothing | (discount == self._common)).all())
        self._discount = np.empty((0, 0)) if alike else np.array(discount, order=order)
        del discount  # large
        kind: Any = np.uint32 if compiled else np.intp
        self._successor: NDArray[np.integer] = np.array(model.successor, kind, order=order)
        np.copyto(self._successor, model.n_states, where=nothing)  # the end of the task
        self._rewards = np.array(model.reward, order=order)
        np.copyto(self._rewards, -np.inf, where=~model.available)
        self._rewards[self._dead, 0] = 0.0  # nothing follows there, so their value stays 0
        self._discounted = np.empty(0 if compiled else self.n_swept + 1)  # work space
        self._choice = np.empty(0 if compiled else self.n_swept)

    def sweep(self, old: Floats, new: Floats) -> float:
        """
        Write the next values to ``new``, and return the largest change.

        :param old: (R + 1,), the last is the end of the task, 0; as ``new``.
        """
        if self._compiled:
            tables = self._successor, self._rewards, self._discount
            return self._compiled(*tables, self._common, old, new)
        alike, new = not self._discount.size, new[:-1]
        np.multiply(old, self._common if alike else 1.0, out=self._discounted)
        for option in range(self._successor.shape[1]):
            choice = self._choice if option else new
            np.take(self._discounted, self._successor[:, option], out=choice, mode='clip')
            if not alike:
                choice *= self._discount[:, option]
            choice += self._rewards[:, option]
            np.maximum(new, choice, out=new)
        change = np.subtract(new, old[:-1], out=self._choice)
        return float(np.abs(change, out=change).max())

    def best(self, values: Floats) -> NDArray[np.int32]:
        """
        Return the greedy option (S,) in the order of the model, the lowest of equals.

        :param values: (R,).
        """
        padded, best = np.append(values, 0.0), np.empty(len(values), dtype=np.int32)
        for begin in range(0, len(best), COMPARED):
            part = slice(begin, begin + COMPARED)
            choice = padded[self._successor[part]]
            choice *= self._discount[part] if self._discount.size else self._common
            choice += self._rewards[part]
            best[part] = choice.argmax(axis=1)
        best[self._dead] = -1
        return best

    def everywhere(self, values: Floats, before: Floats) -> Floats:
        """Return the values (S,) in the order of the model, by those (R,) of the last sweeps."""
        return values.copy()


class _SparseBackup:
    """
    The same for any number of successors, by layers of options and no loop over states.

    Layer k is the k-th available option of each state that has so many. States are in the order of
    their number of options, and then of the number of successors of the first: rows of equal
    length are multiplied more than twice as fast as in any order.
    """

    def __init__(self, model: SparseMultiTimeModel) -> None:
        self._model, self._dead = model, ~np.asarray(model.available.T.any(axis=0))
        swept = np.zeros(model.n_states, dtype=np.bool_)
        swept[model.rows.indices] = True
        swept[0] = True  # there is one at least
        states = np.flatnonzero(swept)
        available = model.available[states]
        available[self._dead[states], 0] = True  # nothing follows there, so their value stays 0
        n_options = available.sum(axis=1)
        first = available.argmax(axis=1) * model.n_states + states
        order = np.lexsort((np.diff(model.rows.indptr)[first], -n_options))
        self._order, self.n_swept = states[order], len(states)
        place = np.zeros(model.n_states, dtype=np.int32)
        place[self._order] = np.arange(len(states), dtype=np.int32)
        at, option = np.nonzero(available)
        layer = np.arange(len(at)) - np.repeat(np.cumsum(n_options) - n_options, n_options)
        state = states[at]
        ends = np.append(0, np.cumsum(np.bincount(layer)))
        pairs = np.empty(len(at), dtype=np.intp)
        pairs[ends[layer] + place[state]] = np.arange(len(at))
        state, option = state[pairs], option[pairs]
        self._layers = [slice(*part) for part in pairwise(ends.tolist())]
        rows = model.rows[option * model.n_states + state]
        successor, indptr = place[rows.indices], rows.indptr.astype(np.int32)
        # SciPy's own product, without what it looks at anew each time: that takes as long.
        shape, parts = (len(state), len(states)), (indptr, successor, rows.data)
        self._multiply = partial(_sparsetools.csr_matvec, *shape, *parts)
        self._choices = np.empty(len(state))  # work space
        self._rewards = np.where(self._dead[state], 0.0, model.reward[state, option])

    def sweep(self, old: Floats, new: Floats) -> float:
        old, new, choices = old[:-1], new[:-1], self._choices
        choices.fill(0.0)
        self._multiply(old, choices)  # adds to it
        if len(self._layers) == 1:  # as where a policy is evaluated
            np.add(choices, self._rewards, out=new)
        else:
            choices += self._rewards
            np.copyto(new, choices[self._layers[0]])
            for layer in self._layers[1:]:
                first = new[: layer.stop - layer.start]
                np.maximum(first, choices[layer], out=first)
        change = np.subtract(new, old, out=choices[: self.n_swept])
        return float(np.maximum.reduce(np.abs(change, out=change)))

    def everywhere(self, values: Floats, before: Floats) -> Floats:
        if self.n_swept == self._model.n_states:
            return self._of_all(values)
        found = look_ahead(self._model, self._of_all(before)).max(axis=1)
        return np.where(self._dead, 0.0, found)

    def _of_all(self, values: Floats) -> Floats:
        """Return the values (S,) in the order of the model, 0 where a state is not swept."""
        found = np.zeros(self._model.n_states)
        found[self._order] = values
        return found


def _sweep_states(
    successor: NDArray[np.uint32],
    reward: Floats,
    discount: Floats,
    common: float,
    old: Floats,
    new: Floats,
) -> float:
    """
    Sweep over states in order; ``compiled_sweep`` makes machine code of it.

    :param successor: (S, O), S: the end of the task. Unsigned numbers need no check of their sign.
    :param reward: (S, O), -inf: the option is not available.
    :param discount: (S, O); of size 0 where all options are discounted by ``common``.
    :param old: (S + 1,), the last is the end of the task, 0; as ``new``.
    """
    residual = 0.0
    for state in range(len(successor)):
        best = -np.inf
        for option in range(successor.shape[1]):
            value = old[successor[state, option]]
            value *= discount[state, option] if discount.size else common
            value += reward[state, option]
            if value > best:
                best = value
        new[state] = best
        residual = max(residual, abs(best - old[state]))
    return residual


@cache
def compiled_sweep() -> Callable[..., float] | None:
    """
    Return ``_sweep_states`` as machine code, or None where Numba cannot be imported.

    The first call on a machine compiles it, for some seconds, and keeps it on disk; the first call
    of a process loads it, in less than a second.
    """
    try:
        from numba import njit
    except ImportError:  # also where the two libraries' versions do not fit
        return None
    try:
        compiled: Callable[..., float] = njit(_SIGNATURE, cache=True)(_sweep_states)
    except RuntimeError:  # there is no folder to keep it in
        compiled = njit(_SIGNATURE)(_sweep_states)
    return compiled


def _indexed_backup(model: MultiTimeModel) -> _IndexedBackup:
    """Return the backup of a model: compiled where that is loaded, or pays for loading."""
    loaded = compiled_sweep.cache_info().currsize > 0
    pays = loaded or model.reward.size >= COMPILED_FROM
    return _IndexedBackup(model, compiled_sweep() if pays else None)


def solve_smdp(
    model: Model,
    tol: float = 1e-8,
    max_sweeps: int = 10_000,
    on_sweep: OnSweep | None = None,
) -> Solution:
    """
    Return the best value of every state, from values of 0.

    :param tol: largest change allowed in the last sweep, in reward units.
    :param max_sweeps: 1 or more.
    :param on_sweep: called with the number of sweeps and the residual after each, which is that of
        the states that are swept; returning True ends the work early, and what it raises passes
        through.
    :raises PlanError: tol is negative or no number, or max_sweeps is below 1.
    """
    if isinstance(model, SparseMultiTimeModel):
        values, sweeps, residual = sweep_values(model, tol, max_sweeps, on_sweep)
        best = greedy_options(look_ahead(model, values))
    else:
        backup = _indexed_backup(model)
        values, sweeps, residual = _sweep(backup, model.n_states, tol, max_sweeps, on_sweep)
        best = backup.best(values)
    return Solution(values, best, sweeps, residual, residual <= tol)


def sweep_values(
    model: SparseMultiTimeModel, tol: float, max_sweeps: int, on_sweep: OnSweep | None = None
) -> tuple[Floats, int, float]:
    """
    Return the best values (S,), the number of sweeps and the last residual; as ``solve_smdp``.

    :raises PlanError: as ``solve_smdp``.
    """
    return _sweep(_SparseBackup(model), model.n_states, tol, max_sweeps, on_sweep)


def greedy_options(option_values: Floats) -> NDArray[np.int32]:
    """Return (S,): the option of the greatest value (S, O), the lowest of equals; -1: of none."""
    best = option_values.argmax(axis=1)
    greatest = option_values[np.arange(len(best)), best]
    return np.where(greatest == -np.inf, -1, best).astype(np.int32)


def _sweep(
    backup: _IndexedBackup | _SparseBackup,
    n_states: int,
    tol: float,
    max_sweeps: int,
    on_sweep: OnSweep | None = None,
) -> tuple[Floats, int, float]:
    """Return the values of all states (S,), the number of sweeps and the last residual."""
    check_limits(tol, max_sweeps)
    partial = backup.n_swept < n_states
    values, before, earlier = np.zeros((3, backup.n_swept + 1))  # by the last sweep, and so on
    for sweeps in range(1, max_sweeps + 1):
        residual = backup.sweep(values, earlier)
        values, before, earlier = earlier, values, before
        stop = on_sweep is not None and on_sweep(sweeps, residual)
        if stop or residual <= tol or sweeps == max_sweeps:
            found = backup.everywhere(values[:-1], before[:-1])
            if partial:  # states that are no successors may have changed by more
                old = backup.everywhere(before[:-1], earlier[:-1]) if sweeps > 1 else 0.0
                residual = float(np.abs(found - old).max())
            if stop or residual <= tol:
                break
    return found, sweeps, residual


@dataclass(frozen=True)
class SweepRow:
    """The values after one sweep, for figures and tables."""

    sweep: int  # 0: before the first
    residual: float  # largest change of the sweep, reward units; NaN before the first
    error: float  # largest distance from the final values
    settled: int  # states whose value is as near to its final value as asked


def value_history(model: Model, tol: float = 1e-8, max_sweeps: int = 1000) -> Floats:
    """
    Return the values after each sweep, (sweeps + 1, S), from 0 to the final ones.

    :raises PlanError: as ``solve_smdp``.
    """
    check_limits(tol, max_sweeps)
    usable, residual = model.available.any(axis=1), np.inf
    history = [np.zeros(model.n_states)]
    while residual > tol and len(history) <= max_sweeps:
        ahead = look_ahead(model, history[-1]).max(axis=1)
        history.append(np.where(usable, ahead, 0.0))
        residual = float(np.abs(history[-1] - history[-2]).max())
    return np.array(history)


def sweep_table(model: Model, near: float = 1e-3, max_sweeps: int = 1000) -> list[SweepRow]:
    """
    Return one row for each sweep, from the values of 0 to the final ones.

    :param near: a value so close to its final one, in reward units, is settled.
    :raises PlanError: as ``solve_smdp``.
    """
    history = value_history(model, max_sweeps=max_sweeps)
    distance = np.abs(history - history[-1])
    change = np.abs(np.diff(history, axis=0)).max(axis=1)
    return [
        SweepRow(
            sweep=sweep,
            residual=float(change[sweep - 1]) if sweep else float('nan'),
            error=float(distance[sweep].max()),
            settled=int((distance[sweep] <= near).sum()),
        )
        for sweep in range(len(history))
    ]
