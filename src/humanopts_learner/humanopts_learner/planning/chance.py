"""
Exact multi-time models of options in domains with chance.

Sutton, Precup and Singh (1999), section 4, give the model of an option by linear equations: with M
the discounted probabilities of going on, E those of ending, and r the expected rewards of one
step, a run of at most n steps has

    reward     sum of M**k r, k = 0..n-1
    successor  sum of M**k E, k = 0..n-1, and M**n where it is cut off

Here ``max_steps`` counts as it does in execution. The reward is summed step by step. The successor
of runs without a limit is F = (I - M)**-1 E, one sparse factorisation for each option; where some
runs may be cut off, M**n (I - F) is added. States of which less than ``NEGLIGIBLE`` is still
running after n steps need no such correction.
"""

from dataclasses import dataclass

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.errors import check_gamma, ModelError
from humanopts_learner.planning.model import Rows
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import splu

NEGLIGIBLE = 1e-14  # discounted probability that is taken for 0
BLOCK = 256  # columns that are dense at once
Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OptionRows:
    """What running one option from each of n states leads to, in k steps."""

    states: NDArray[np.intp]  # (n,) ascending; all that were asked for, and those that runs visit
    reward: Floats  # (n,) expected sum of gamma**i * r[i], i = 0..k-1
    successor: Rows  # (n, S) expected gamma**k at each end; nothing where the task was over
    cut_off: Floats  # (n,) the part of it that was cut off after max_steps


@dataclass(frozen=True)
class _Step:
    """One step of an option from each of n states, as sparse rows."""

    states: NDArray[np.intp]  # (n,)
    reward: Floats  # (n,)
    on: Rows  # (n, n) discounted probability of going on: M
    end: Rows  # (n, S) discounted probability of ending with the task not over: E
    may_end: Mask  # (n,) the option may end with this step, the task over or not


class RowComposer:
    """Models the options of one domain, with chance or without."""

    def __init__(self, transitions: Transitions, over: Mask, gamma: float) -> None:
        """
        Prepare for one domain.

        :param over: (S,) states where the task is over.
        :raises GammaError: gamma is not in (0, 1].
        """
        check_gamma(gamma)
        self._rules, self._over, self._gamma = transitions, over, gamma

    def outcome(
        self,
        action: NDArray[np.integer],
        termination: Mask,
        max_steps: int,
        starts: Mask | None = None,
    ) -> OptionRows:
        """
        Run an option from many states, as execution does.

        It ends where the termination condition holds, which is looked at only after a step; where
        the task is over; or after ``max_steps``, at the state where it is.

        :param action: (S,) what it does; defined wherever it can come.
        :param termination: (S,).
        :param max_steps: 1 or more.
        :param starts: (S,) states from which the answer is needed; None: all.
        :raises ModelError: max_steps is below 1.
        """
        if max_steps < 1:
            raise ModelError(f'max_steps is {max_steps}, and must be 1 or more')
        step = self._step(action, termination | self._over, starts)
        reward, running = _count(step, max_steps)
        successor = _run_to_the_end(step)
        late = running > NEGLIGIBLE
        if late.any():
            successor = _cut_off(step, successor, late, max_steps)
        return OptionRows(step.states, reward, successor, np.where(late, running, 0.0))

    def _step(self, action: NDArray[np.integer], ends: Mask, starts: Mask | None) -> _Step:
        rules = self._rules
        states = np.arange(len(ends)) if starts is None else visited(rules, action, ends, starts)
        at = states, action[states]
        successor, share = rules.successor[at], rules.probability[at]  # (n, B)
        over = rules.terminated[at]
        last = ends[successor] | over
        row_of = np.zeros(len(ends), dtype=np.intp)
        row_of[states] = np.arange(len(states))

        def rows(kept: Mask, columns: NDArray[np.integer], width: int) -> Rows:
            data = np.where(kept, self._gamma * share, 0.0).ravel()
            pointers = np.arange(0, data.size + 1, share.shape[1])
            found = csr_array((data, columns.ravel(), pointers), shape=(len(states), width))
            found.sum_duplicates()
            found.eliminate_zeros()
            return found

        return _Step(
            states,
            (share * rules.reward[at]).sum(axis=1),
            rows(~last, row_of[successor], len(states)),
            rows(last & ~over, successor, len(ends)),
            (last & (share > 0)).any(axis=1),
        )


def visited(
    rules: Transitions, action: NDArray[np.integer], ends: Mask, starts: Mask
) -> NDArray[np.intp]:
    """Return the starts of an option and all states that runs from them can go on from."""
    found = starts.copy()
    fresh = np.flatnonzero(found)
    while fresh.size:
        at = fresh, action[fresh]
        onward = (rules.probability[at] > 0) & ~rules.terminated[at]
        reached = np.unique(rules.successor[at][onward])
        fresh = reached[~ends[reached] & ~found[reached]]
        found[fresh] = True
    return np.flatnonzero(found)


def _count(step: _Step, max_steps: int) -> tuple[Floats, Floats]:
    """Return the reward (n,) of at most ``max_steps`` steps and what is still running then."""
    first = np.stack([step.reward, np.zeros(len(step.states))], axis=1)
    total = np.stack([np.zeros(len(step.states)), np.ones(len(step.states))], axis=1)
    for _ in range(max_steps):
        total = first + step.on @ total
        if not (total[:, 1] > NEGLIGIBLE).any():
            break
    return total[:, 0], total[:, 1]


def _run_to_the_end(step: _Step) -> Rows:
    """Solve (I - M) F = E, (n, S), where runs can end; where they never do, F is 0."""
    can_end = step.may_end
    while True:
        more = can_end | ((step.on @ can_end.astype(np.float64)) > 0)
        if (more == can_end).all():
            break
        can_end = more
    rows = np.flatnonzero(can_end)
    if not step.end.nnz:
        return step.end
    solve = splu((eye_array(len(rows)) - step.on[rows][:, rows]).tocsc()).solve
    columns = np.unique(step.end.indices)
    blocks = []
    for begin in range(0, len(columns), BLOCK):
        block = columns[begin : begin + BLOCK]
        found = solve(step.end[rows][:, block].toarray())
        row, col = np.nonzero(found > NEGLIGIBLE)
        blocks.append((found[row, col], rows[row], block[col]))
    data, row, col = (np.concatenate(part) for part in zip(*blocks))
    return csr_array((data, (row, col)), shape=step.end.shape)


def _cut_off(step: _Step, successor: Rows, late: Mask, max_steps: int) -> Rows:
    """Return F + M**max_steps (I - F) in the late rows, and F in the others."""
    count = len(late)
    here = csr_array((np.ones(count), (np.arange(count), step.states)), shape=successor.shape)
    back, rest = step.on.T.tocsr(), (here - successor).T.tocsr()
    rows = np.flatnonzero(late)
    parts = []
    for begin in range(0, len(rows), BLOCK):
        block = rows[begin : begin + BLOCK]
        still = np.zeros((count, len(block)))  # columns of the transposed M**k
        still[block, np.arange(len(block))] = 1.0
        for _ in range(max_steps):
            still = back @ still
        change = rest @ still
        col, row = np.nonzero(np.abs(change) > NEGLIGIBLE)
        parts.append((change[col, row], block[row], col))
    data, row, col = (np.concatenate(part) for part in zip(*parts))
    corrected = (successor + csr_array((data, (row, col)), shape=successor.shape)).tocsr()
    corrected.data[corrected.data < NEGLIGIBLE] = 0.0  # differences that are rounding
    corrected.eliminate_zeros()
    return corrected
