"""
SMDP value iteration: synchronous, over options (Sutton, Precup and Singh 1999, section 3.1).

In a sampled model, many states are never successors: runs only pass through them. No other value
depends on these states, so sweeps skip them, and their values are computed at the end. The results
are the same as with full sweeps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_learner.planning.models import look_ahead, MultiTimeModel
from humanopts_learner.planning.request import check_limits
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

OnSweep = Callable[[int, float], bool | None]
Sweep = Callable[[Floats, Floats], float]
COMPILED_FROM = 1_000_000  # state-option pairs; with fewer, sweeps finish before Numba has loaded
_FLOATS, _TABLE = 'float64[::1]', 'float64[:, ::1]'
_SIGNATURE = f'float64(uint32[:, ::1], {_TABLE}, {_TABLE}, float64, {_FLOATS}, {_FLOATS})'


@dataclass(frozen=True)
class Solution:
    """The result of value iteration."""

    values: Floats  # (S,), 0 if no option is available
    best: NDArray[np.int32]  # (S,) greedy option index, lowest on ties; -1: none available
    sweeps: int
    residual: float  # largest change of the last sweep, reward units
    converged: bool  # residual is at most tol


def _sweep_of(model: MultiTimeModel, n_choices: int) -> tuple[Ints, Sweep]:
    """
    Prepare the sweeps over a model.

    :return: the states (R,) to sweep, and the sweep function, which takes their old values
        (R + 1,), writes the new values and returns the largest change. The last value, 0, is that
        of the end of the task.
    """
    available, reward = model.available[:, :n_choices], model.reward[:, :n_choices]
    worth_it = compiled_sweep.cache_info().currsize or reward.size >= COMPILED_FROM
    if model.single and worth_it and (compiled := compiled_sweep()):
        tables = _single_successors(model, available, reward)
        return np.arange(len(reward)), lambda old, new: compiled(*tables, old, new)
    swept = np.zeros(len(reward), dtype=np.bool_)
    swept[model.rows.indices[: model.rows.indptr[reward.size]]] = True
    # Layer k has the k-th available option of each state that has one. Multiplying consecutive
    # rows of equal length is three times as fast.
    count, length = available.sum(axis=1), np.diff(model.rows.indptr)
    first = length[available.argmax(axis=1) * len(reward) + np.arange(len(reward))]
    order = np.lexsort((first, -count))
    states = order[(swept & (count > 0))[order]]
    at, option = np.nonzero(available[states])
    layer = np.arange(len(at)) - np.searchsorted(at, at)
    pairs = np.lexsort((at, layer))
    at, option, ends = at[pairs], option[pairs], np.cumsum(np.bincount(layer))
    chosen, column = (
        model.rows[option * len(reward) + states[at]],
        np.full(len(reward), len(states)),
    )
    column[states] = np.arange(len(states))
    parts = chosen.data, column[chosen.indices], chosen.indptr
    rows, rewards = csr_array(parts, (len(at), len(states) + 1)), reward[states[at], option]

    def sweep(old: Floats, new: Floats) -> float:
        choices = rows @ old
        choices += rewards
        new[:-1] = choices[: len(states)]
        for begin, end in pairwise(ends.tolist()):
            np.maximum(new[: end - begin], choices[begin:end], out=new[: end - begin])
        return float(np.abs(new - old).max())

    return states, sweep


def _single_successors(model: MultiTimeModel, available: Flags, reward: Floats) -> tuple[Any, ...]:
    """Return the tables of ``_sweep_states``, if each pair has at most one successor."""
    shape, rows = reward.T.shape, model.rows
    end = rows.indptr[reward.size]
    successor, discount = rows.indices[:end], rows.data[:end]
    if end < reward.size:  # some pairs have no successor
        has = np.diff(rows.indptr[: reward.size + 1]) == 1
        successor, discount = np.zeros(len(has), dtype=np.int32), np.zeros(len(has))
        successor[has], discount[has] = rows.indices[:end], rows.data[:end]
    nothing, common = discount == 0.0, float(discount.max())
    nothing |= ~available.T.ravel()
    successor = np.where(nothing, np.int32(len(reward)), successor)
    rewards = np.array(reward, order='C')
    np.copyto(rewards, -np.inf, where=~available)
    rewards[~available.any(axis=1), 0] = 0.0  # no option available, so the value stays 0
    if (nothing | (discount == common)).all():
        discount = np.empty((0, 0))
    else:
        discount = np.ascontiguousarray(discount.reshape(shape).T)
    successor = np.ascontiguousarray(successor.astype(np.uint32).reshape(shape).T)
    return successor, rewards, discount, common


def _sweep_states(
    successor: NDArray[np.uint32],
    reward: Floats,
    discount: Floats,
    common: float,
    old: Floats,
    new: Floats,
) -> float:
    """
    Sweep over states in order; ``compiled_sweep`` compiles it to machine code.

    :param successor: (S, O), S: the end of the task. Unsigned indices need no sign check.
    :param reward: (S, O), -inf: the option is unavailable.
    :param discount: (S, O); size 0: all options are discounted by ``common``.
    :param old: (S + 1,) old values; the last one, 0, is that of the end of the task.
    :param new: (S + 1,) array that receives the new values.
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
    Return ``_sweep_states`` as machine code, or None if Numba cannot be imported.

    The first call on a machine compiles it within seconds and caches it on disk. After that, the
    first call in a process loads it in less than a second.
    """
    try:
        from numba import njit
    except ImportError:  # also if library versions are incompatible
        return None
    try:
        compiled: Callable[..., float] = njit(_SIGNATURE, cache=True)(_sweep_states)
    except RuntimeError:  # no writable cache folder
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
    Return the optimal value of every state, starting from values of 0.

    :param tol: maximum change in the last sweep, in reward units.
    :param max_sweeps: maximum number of sweeps, 1 or more.
    :param on_sweep: called after each sweep with the number of sweeps and the residual over the
        swept states; returning True stops early, and its exceptions propagate.
    :param n_choices: number of leading options that can be chosen; 0: all.
    :raises PlanError: tol is negative or NaN, or max_sweeps is below 1.
    """
    check_limits(tol, max_sweeps)
    n_choices = n_choices or len(model.names)
    states, sweep = _sweep_of(model, n_choices)
    live = np.asarray(model.available[:, :n_choices].any(axis=1))

    def ahead(values: Floats) -> Floats:
        return look_ahead(model, values)[:, :n_choices]

    def everywhere(values: Floats, before: Floats) -> Floats:
        """Return the values (S,) of all states, from those of the last two sweeps."""
        known = np.zeros(len(live))
        known[states] = values[:-1]
        if len(states) < len(live):
            known[states] = before[:-1]
            known = np.where(live, ahead(known).max(axis=1), 0.0)
        return known

    values, before, earlier = np.zeros((3, len(states) + 1))  # values of the last three sweeps
    for sweeps in range(1, max_sweeps + 1):
        residual = sweep(values, earlier)
        values, before, earlier = earlier, values, before
        stop = on_sweep is not None and on_sweep(sweeps, residual)
        if stop or residual <= tol or sweeps == max_sweeps:
            found = everywhere(values, before)
            if len(states) < len(live):  # skipped states may have changed by more
                old = everywhere(before, earlier) if sweeps > 1 else 0.0
                residual = float(np.abs(found - old).max())
            if stop or residual <= tol:
                break
    best, greatest = np.full(len(live), -1, dtype=np.int32), np.full(len(live), -np.inf)
    for option, worth in enumerate(ahead(found).T):  # because argmax would copy the table
        best[worth > greatest] = option
        np.maximum(greatest, worth, out=greatest)
    return Solution(found, best, sweeps, residual, residual <= tol)


def value_history(model: MultiTimeModel, tol: float = 1e-8, max_sweeps: int = 1000) -> Floats:
    """
    Return the values after each sweep, (sweeps + 1, S), from the initial 0 to the final ones.

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
