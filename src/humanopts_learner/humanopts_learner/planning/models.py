"""
Multi-time models of a semi-Markov decision process (SMDP).

Axes: S states, O options; a primitive action is a one-step option. If an option takes k primitive
steps, its successor has weight gamma**k (Sutton, Precup and Singh 1999, section 3.1).

An exact model of an option (Precup 2000, chapter 3; Sutton, Precup and Singh 1999, section 3.1)
follows from running the option. ``max_steps`` applies as in execution.

If every action has a single outcome, running an option for n steps from all states takes about
log2(n) compositions of the successor table with itself.

With chance, the model solves linear equations. With M the discounted probabilities of continuing,
E those of ending, and r the expected rewards of one step, a run of at most n steps has

    reward     sum of M**k r, k = 0..n-1
    successor  sum of M**k E, k = 0..n-1, and M**n where it is cut off

The reward is summed step by step. The successor of runs without a limit is F = (I - M)**-1 E, one
sparse factorisation per option; if some runs may be cut off, M**n (I - F) is added. States from
which less than ``NEGLIGIBLE`` is still running after n steps need no such correction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Transitions
from humanopts_learner.options.learned_option import TabularOption
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye, vstack

SparseRows = Any  # csr_array of float64; SciPy has no types
ROUNDING = 1e-9  # tolerance of row sums above 1
NEGLIGIBLE = 1e-14  # discounted probability treated as 0
BLOCK = 256  # number of columns converted to dense arrays at a time


@dataclass(frozen=True)
class MultiTimeModel:
    """
    The rewards and successors of running option o from state s.

    Entries of unavailable pairs are ignored, but must be valid numbers. Arrays may be shared,
    read-only, and have any strides.

    :raises PlanError: shapes disagree, a number is not finite or out of range, or a row sums to
        more than 1.
    """

    names: tuple[str, ...]  # (O,) names of the options
    reward: Floats  # (S, O), expected sum of gamma**i * r[i], i = 0..k-1
    available: Flags  # (S, O)
    rows: SparseRows  # (O*S, S), row o*S + s: expected gamma**k of each successor; 0: task over

    def __post_init__(self) -> None:
        reward, rows, shape = self.reward, self.rows, self.reward.shape
        if reward.ndim != 2 or 0 in shape or shape[1] != len(self.names):
            raise PlanError(f'{len(self.names)} names do not fit arrays of shape {shape}')
        if self.available.shape != shape or rows.shape != (reward.size, shape[0]):
            raise PlanError(
                f'available is {self.available.shape}, rows are {rows.shape}, and reward {shape}'
            )
        largest = float(np.finfo(np.float64).max)
        sums = np.empty(0) if self.single else rows.sum(axis=1)
        for name, array, low, high in (
            ('reward', reward, -largest, largest),
            ('a successor', rows.indices, 0, shape[0] - 1),
            ('a row', rows.data, 0, 1 + ROUNDING),
            ('the sum of a row', sums, 0, 1 + ROUNDING),
        ):
            if array.size and not (array.min() >= low and array.max() <= high):  # also for NaN
                raise PlanError(f'{name} has an entry that is not within {low}..{high}')

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    @cached_property
    def single(self) -> bool:
        """Whether each pair of state and option has at most one successor."""
        return bool((np.diff(self.rows.indptr) <= 1).all())


def look_ahead(model: MultiTimeModel, values: Floats) -> Floats:
    """Return (S, O): the value of each option, given state values (S,); -inf: unavailable."""
    ahead: Floats = (model.rows @ values).reshape(model.reward.T.shape).T
    ahead += model.reward
    np.copyto(ahead, -np.inf, where=~model.available)
    return ahead


def concatenate(models: Sequence[MultiTimeModel]) -> MultiTimeModel:
    """Combine models into one with all options, in order."""
    return MultiTimeModel(
        names=tuple(name for model in models for name in model.names),
        reward=np.concatenate([model.reward.T for model in models]).T,
        available=np.concatenate([model.available.T for model in models]).T,
        rows=vstack([model.rows for model in models], format='csr'),
    )


def primitive_model(
    transitions: Transitions, over: Flags, gamma: float, names: Sequence[str]
) -> MultiTimeModel:
    """
    Return the exact model with the primitive actions as options.

    :param over: (S,) whether the task is over, so that no action is available.
    :param names: names of the actions, (A,).
    """
    count, actions, outcomes = transitions.successor.shape
    ended = (transitions.terminated | over[:, None, None]).swapaxes(0, 1).ravel()
    successor = transitions.successor.swapaxes(0, 1).ravel()
    share: Any = gamma
    reward = transitions.reward[:, :, 0]
    if not transitions.deterministic:
        share = gamma * transitions.probability.swapaxes(0, 1).ravel()
        reward = (transitions.probability * transitions.reward).sum(axis=2)
        successor = successor.copy()  # because it is sorted below
    ends = np.arange(0, successor.size + 1, outcomes, dtype=np.int32)
    parts = np.where(ended, 0.0, share), successor, ends
    rows = csr_array(parts, shape=(actions * count, count))
    if not transitions.deterministic:
        rows.sum_duplicates()
        rows.eliminate_zeros()
    available = np.broadcast_to(~over, reward.T.shape).T
    return MultiTimeModel(tuple(names), reward, available, rows)


@dataclass(frozen=True)
class OptionModel:
    """The outcome of running one option from each of n states; k: length of a run."""

    reward: Floats  # (n,) expected sum of gamma**i * r[i], i = 0..k-1
    successor: SparseRows  # (n, S) expected gamma**k per final state; 0 if the task was over
    cut_off: Flags  # (n,) whether some runs continue after max_steps


def model_option(
    rules: Transitions, over: Flags, gamma: float, option: TabularOption, starts: Flags
) -> OptionModel:
    """
    Run an option from many states, by the rules of execution.

    It ends when the termination condition holds, which is checked only after a step; when the task
    is over; or after ``max_steps``.

    :param over: (S,) whether the task is over.
    :param option: option to run; its action must be defined in all states that it can reach.
    :param starts: (S,) whether each state is one of the n start states.
    :raises PlanError: max_steps is below 1.
    """
    if option.max_steps < 1:
        raise PlanError(f'max_steps is {option.max_steps}, but must be 1 or more')
    kind = deterministic_model if rules.deterministic else stochastic_model
    return kind(rules, over, gamma, option, starts)


def deterministic_model(
    rules: Transitions, over: Flags, gamma: float, option: TabularOption, starts: Flags
) -> OptionModel:
    """
    Return the model of an option if every action has a single outcome; as ``model_option``.

    Table rows from which the next step ends the option are made absorbing, so n moves are a
    product of binary powers of one table; the last step is added at the end.
    """
    ends = option.termination | over
    for states in (np.flatnonzero(starts), np.arange(len(ends))):  # all if runs leave the starts
        pair = states * rules.successor.shape[1]
        pair += option.action[states]
        successor = rules.successor.ravel()[pair].astype(np.intp)
        reward, terminated = rules.reward.ravel()[pair], rules.terminated.ravel()[pair]
        last = ends[successor]
        last |= terminated
        if (last | starts[successor]).all():
            break
    row_of = np.zeros(len(ends), dtype=np.intp)
    row_of[states] = here = np.arange(len(states))
    one = _Walk(
        np.where(last, here, row_of[successor]),
        np.where(last, 0.0, reward),
        np.where(last, 1.0, gamma),
    )
    steps, needed = option.max_steps - 1, starts[states]
    walk = _Walk(here, np.zeros(len(last)), np.ones(len(last)))
    if steps:
        highest = 1 << (steps.bit_length() - 1)
        walk = _power(one, highest, last, needed)
        if highest < steps and not _all_stay(walk, last, needed):
            walk.append(_power(one, steps - highest, last, needed))
    if not needed.all():
        walk = _Walk(walk.row[needed], walk.reward[needed], walk.discount[needed])
    walk.reward += walk.discount * reward[walk.row]
    walk.discount *= gamma
    walk.discount[terminated[walk.row]] = 0.0
    count = len(walk.row)
    parts = walk.discount, successor[walk.row], np.arange(count + 1, dtype=np.int32)
    return OptionModel(walk.reward, csr_array(parts, shape=(count, len(ends))), ~last[walk.row])


@dataclass
class _Walk:
    """A number of moves from each of n rows, absorbed if the next step is the last."""

    row: Ints  # (n,) final row
    reward: Floats  # (n,) discounted to the start
    discount: Floats  # (n,) gamma**(number of moves)

    def append(self, then: '_Walk') -> None:
        """Append ``then``, which may be this walk itself."""
        gained = then.reward.take(self.row)
        gained *= self.discount
        self.reward += gained
        self.discount *= then.discount.take(self.row)
        self.row = then.row.take(self.row)


def _power(one: _Walk, steps: int, last: Flags, needed: Flags) -> _Walk:
    """Return ``steps`` moves (1 or more), or fewer if more would change nothing."""
    walk = _Walk(one.row, one.reward.copy(), one.discount.copy())
    for bit in bin(steps)[3:]:  # the highest bit is ``one`` itself
        if _all_stay(walk, last, needed):
            break
        walk.append(walk)
        if bit == '1':
            walk.append(one)
    return walk


def _all_stay(walk: _Walk, last: Flags, needed: Flags) -> bool:
    return bool((last[walk.row] | ~needed).all())


def stochastic_model(
    rules: Transitions, over: Flags, gamma: float, option: TabularOption, starts: Flags
) -> OptionModel:
    """Return the model of an option, with or without chance; as ``model_option``."""
    ends = option.termination | over
    states = visited(rules, option.action, ends, starts)
    at = states, option.action[states]
    successor, probability = rules.successor[at], rules.probability[at]  # (n, B)
    terminated = rules.terminated[at]
    last = ends[successor] | terminated
    row_of = np.zeros(len(ends), dtype=np.intp)
    row_of[states] = np.arange(len(states))

    def rows(kept: Flags, columns: NDArray[np.integer], width: int) -> SparseRows:
        data = np.where(kept, gamma * probability, 0.0).ravel()
        pointers = np.arange(0, data.size + 1, probability.shape[1])
        found = csr_array((data, columns.ravel(), pointers), shape=(len(states), width))
        found.sum_duplicates()
        found.eliminate_zeros()
        return found

    on = rows(~last, row_of[successor], len(states))  # M
    end = rows(last & ~terminated, successor, len(ends))  # E
    may_end = np.asarray((last & (probability > 0)).any(axis=1))
    reward = (probability * rules.reward[at]).sum(axis=1)
    expected, running = _rewards(on, reward, option.max_steps)
    ending = _unlimited_successors(on, end, may_end)
    late = running > NEGLIGIBLE
    if late.any():
        here = csr_array((np.ones(len(states)), (row_of[states], states)), shape=ending.shape)
        ending = _limited_successors(on, here, ending, late, option.max_steps)
    asked = np.flatnonzero(starts[states])
    return OptionModel(expected[asked], ending[asked], late[asked])


def visited(
    rules: Transitions, action: NDArray[np.integer], ends: Flags, starts: Flags
) -> NDArray[np.intp]:
    """Return the starts of an option and all states from which runs can continue."""
    found = starts.copy()
    fresh = np.flatnonzero(found)
    while fresh.size:
        at = fresh, action[fresh]
        onward = (rules.probability[at] > 0) & ~rules.terminated[at]
        reached = np.unique(rules.successor[at][onward])
        fresh = reached[~ends[reached] & ~found[reached]]
        found[fresh] = True
    return np.flatnonzero(found)


def _rewards(on: SparseRows, reward: Floats, max_steps: int) -> tuple[Floats, Floats]:
    """Return the reward of ``max_steps`` steps and the discounted share still running, (n,)."""
    first = np.stack([reward, np.zeros(len(reward))], axis=1)
    total = np.stack([np.zeros(len(reward)), np.ones(len(reward))], axis=1)
    for _ in range(max_steps):
        total = first + on @ total
        if not (total[:, 1] > NEGLIGIBLE).any():
            break
    return total[:, 0], total[:, 1]


def _unlimited_successors(on: SparseRows, end: SparseRows, can_end: Flags) -> SparseRows:
    """
    Solve (I - M) F = E, (n, S), for rows with runs that can end; in other rows, F is 0.

    :param can_end: (n,) whether the option may end with the next step, task over or not.
    """
    from scipy.sparse.linalg import splu  # slow to import

    while True:
        more = can_end | ((on @ can_end.astype(np.float64)) > 0)
        if (more == can_end).all():
            break
        can_end = more
    rows = np.flatnonzero(can_end)
    if not end.nnz:
        return end
    solve = splu((csr_array(eye(len(rows))) - on[rows][:, rows]).tocsc()).solve
    columns = np.unique(end.indices)
    blocks = []
    for begin in range(0, len(columns), BLOCK):
        block = columns[begin : begin + BLOCK]
        found = solve(end[rows][:, block].toarray())
        row, col = np.nonzero(found > NEGLIGIBLE)
        blocks.append((found[row, col], rows[row], block[col]))
    data, row, col = (np.concatenate(part) for part in zip(*blocks))
    return csr_array((data, (row, col)), shape=end.shape)


def _limited_successors(
    on: SparseRows, here: SparseRows, successor: SparseRows, late: Flags, max_steps: int
) -> SparseRows:
    """Return F + M**max_steps (I - F) in the late rows, and F in the others; ``here`` is I."""
    count = len(late)
    back, rest = on.T.tocsr(), (here - successor).T.tocsr()
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
    corrected.data[corrected.data < NEGLIGIBLE] = 0.0  # rounding errors
    corrected.eliminate_zeros()
    return corrected
