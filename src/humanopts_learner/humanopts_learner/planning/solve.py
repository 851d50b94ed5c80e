"""
SMDP value iteration: synchronous, over options (Sutton, Precup and Singh 1999, section 3.1).

In a sampled model many states are the successor of none: runs only passed through them. No value
depends on theirs, so sweeps leave them out, and they are valued at the end. All numbers are the
same as if they had been swept.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from humanopts_env.arrays import Flags, Floats
from humanopts_learner.planning.models import look_ahead, MultiTimeModel
from humanopts_learner.planning.request import check_limits
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

OnSweep = Callable[[int, float], bool | None]
COMPILED_FROM = 1_000_000  # state-option pairs; sweeps over fewer end before Numba is loaded
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


class _Backup:
    """
    Sweeps over the options of all states, in place.

    :ivar states: (R,) those that are swept, in the order of values below.
    """

    def __init__(self, model: MultiTimeModel, n_choices: int) -> None:
        self._model, self._n_choices = model, n_choices
        available, reward = model.available[:, :n_choices], model.reward[:, :n_choices]
        self._dead = ~np.asarray(available.T.any(axis=0))  # by rows in memory
        self._common = 1.0  # discount of all successors that have no other
        self._compiled: Callable[..., float] | None = None
        prepare = self._prepare_single if model.single else self._prepare_sparse
        prepare(available, reward)

    def _prepare_single(self, available: Flags, reward: Floats) -> None:
        """
        Prepare sweeps over arrays (O, R).

        Machine code goes state by state, and reads each number once. NumPy goes option by option;
        both give the same bits.
        """
        shape, rows = reward.T.shape, self._model.rows
        end = rows.indptr[reward.size]
        self.states = np.arange(shape[1])
        successor, discount = rows.indices[:end], rows.data[:end]
        if end < reward.size:  # some pairs have none
            has = np.diff(rows.indptr[: reward.size + 1]) == 1
            successor, discount = np.zeros(len(has), dtype=np.int32), np.zeros(len(has))
            successor[has], discount[has] = rows.indices[:end], rows.data[:end]
        nothing, common = discount == 0.0, float(discount.max())
        nothing |= ~available.T.ravel()
        successor = np.where(nothing, np.int32(shape[1]), successor)  # the end of the task
        successor, discount = successor.reshape(shape), discount.reshape(shape)
        if (nothing.reshape(shape) | (discount == common)).all():
            self._common, discount = common, np.empty((0, 0))
        rewards = np.array(reward.T, order='C')
        np.copyto(rewards, -np.inf, where=~available.T)
        rewards[0, self._dead] = 0.0  # nothing follows there, so their value stays 0
        if compiled_sweep.cache_info().currsize or reward.size >= COMPILED_FROM:
            self._compiled = compiled_sweep()
        if self._compiled:
            parts = successor.astype(np.uint32), rewards, discount
            self._tables = [np.ascontiguousarray(part.T) for part in parts]
        else:
            self._tables = [successor.astype(np.intp), rewards, discount]
            self._discounted, self._choices = np.empty(shape[1] + 1), np.empty(shape[1])

    def _prepare_sparse(self, available: Flags, reward: Floats) -> None:
        """
        Prepare sweeps by layers: layer k has the k-th available option of each state that has one.

        States are in the order of their number of options, and then of the number of successors
        of the first: rows of equal length are multiplied more than twice as fast as in any order.
        """
        count, rows = len(available), self._model.rows
        swept = np.zeros(count, dtype=np.bool_)
        swept[rows.indices[: rows.indptr[available.size]]] = True
        swept[0] = True  # there is one at least
        states = np.flatnonzero(swept)
        available = available[states]
        available[self._dead[states], 0] = True  # nothing follows there, so their value stays 0
        n_options = available.sum(axis=1)
        first = available.argmax(axis=1) * count + states
        order = np.lexsort((np.diff(rows.indptr)[first], -n_options))
        self.states, n_options = states[order], n_options[order]
        at, option = np.nonzero(available[order])
        layer = np.arange(len(at)) - np.repeat(np.cumsum(n_options) - n_options, n_options)
        pairs = np.lexsort((at, layer))
        state, option = self.states[at[pairs]], option[pairs]
        ends = np.append(0, np.cumsum(np.bincount(layer)))
        self._layers = [slice(*part) for part in pairwise(ends.tolist())]
        chosen, place = rows[option * count + state], np.zeros(count, dtype=np.int32)
        place[self.states] = np.arange(len(states), dtype=np.int32)
        chosen.data[np.repeat(self._dead[state], np.diff(chosen.indptr))] = 0.0
        parts = chosen.data, place[chosen.indices], chosen.indptr
        self._rows = csr_array(parts, shape=(len(state), len(states)))
        self._rewards = np.where(self._dead[state], 0.0, reward[state, option])

    def sweep(self, old: Floats, new: Floats) -> float:
        """
        Write the next values to ``new``, and return the largest change.

        :param old: (R + 1,), the last is the end of the task, 0; as ``new``.
        """
        if self._compiled:
            return self._compiled(*self._tables, self._common, old, new)
        if self._model.single:
            np.multiply(old, self._common, out=self._discounted)
            old, new, change = old[:-1], new[:-1], self._choices
            for option, (successor, reward) in enumerate(zip(*self._tables[:2])):
                choice = self._choices if option else new  # one at a time stays in cache
                np.take(self._discounted, successor, out=choice, mode='clip')
                if self._tables[2].size:
                    choice *= self._tables[2][option]
                choice += reward
                np.maximum(new, choice, out=new)
        else:
            old, new = old[:-1], new[:-1]
            choices = self._rows @ old
            choices += self._rewards
            np.copyto(new, choices[self._layers[0]])
            for layer in self._layers[1:]:
                first = new[: layer.stop - layer.start]
                np.maximum(first, choices[layer], out=first)
            change = choices[: len(new)]
        np.subtract(new, old, out=change)
        return float(np.abs(change, out=change).max())

    def everywhere(self, values: Floats, before: Floats) -> Floats:
        """Return the values (S,) of all states, by those (R,) of the last two sweeps."""
        found = np.zeros(self._model.n_states)
        found[self.states] = values
        if len(values) == len(found):
            return found
        found[self.states] = before
        ahead = look_ahead(self._model, found)[:, : self._n_choices].max(axis=1)
        return np.where(self._dead, 0.0, ahead)


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


def solve_smdp(
    model: MultiTimeModel,
    tol: float = 1e-8,
    max_sweeps: int = 10_000,
    on_sweep: OnSweep | None = None,
    n_choices: int = 0,
) -> Solution:
    """
    Return the best value of every state, from values of 0.

    :param tol: largest change allowed in the last sweep, in reward units.
    :param max_sweeps: 1 or more.
    :param on_sweep: called with the number of sweeps and the residual after each, which is that of
        the states that are swept; returning True ends the work early, and what it raises passes
        through.
    :param n_choices: number of options, from the first, that can be chosen; 0: all.
    :raises PlanError: tol is negative or no number, or max_sweeps is below 1.
    """
    check_limits(tol, max_sweeps)
    n_choices = n_choices or len(model.names)
    backup = _Backup(model, n_choices)
    values, before, earlier = np.zeros((3, len(backup.states) + 1))  # of the last three sweeps
    for sweeps in range(1, max_sweeps + 1):
        residual = backup.sweep(values, earlier)
        values, before, earlier = earlier, values, before
        stop = on_sweep is not None and on_sweep(sweeps, residual)
        if stop or residual <= tol or sweeps == max_sweeps:
            found = backup.everywhere(values[:-1], before[:-1])
            if len(backup.states) < model.n_states:  # the others may have changed by more
                old = backup.everywhere(before[:-1], earlier[:-1]) if sweeps > 1 else 0.0
                residual = float(np.abs(found - old).max())
            if stop or residual <= tol:
                break
    best, greatest = np.full(model.n_states, -1, dtype=np.int32), np.full(model.n_states, -np.inf)
    for option, worth in enumerate(look_ahead(model, found).T[:n_choices]):
        best[worth > greatest] = option
        np.maximum(greatest, worth, out=greatest)
    return Solution(found, best, sweeps, residual, residual <= tol)


@dataclass(frozen=True)
class SweepRow:
    """The values after one sweep, for figures and tables."""

    sweep: int  # 0: before the first
    residual: float  # largest change of the sweep, reward units; NaN before the first
    error: float  # largest distance from the final values
    settled: int  # states whose value is as near to its final value as asked


def value_history(model: MultiTimeModel, tol: float = 1e-8, max_sweeps: int = 1000) -> Floats:
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


def sweep_table(
    model: MultiTimeModel, near: float = 1e-3, max_sweeps: int = 1000
) -> list[SweepRow]:
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
