"""
Multi-time models of a semi-Markov decision process (SMDP).

Axes: S states, O options; a primitive action is an option of one step. An option that takes k
primitive steps counts its successor with gamma**k (Sutton, Precup and Singh 1999, section 3.1).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from humanopts_env.arrays import Flags, Floats
from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

SparseRows = Any  # csr_array of float64; SciPy has no types
ROUNDING = 1e-9  # how far above 1 the entries of one row may sum up


@dataclass(frozen=True)
class MultiTimeModel:
    """
    The rewards and successors of running option o from state s.

    Entries of pairs that are not available are ignored, but must be valid numbers. Arrays may be
    shared and read-only, and of any strides.

    :raises PlanError: shapes disagree, a number is not finite or out of range, or a row sums to
        more than 1.
    """

    names: tuple[str, ...]  # of the options, (O,)
    reward: Floats  # (S, O), expected sum of gamma**i * r[i], i = 0..k-1
    available: Flags  # (S, O)
    rows: SparseRows  # (O*S, S), row o*S + s: expected gamma**k of each successor; 0: task over

    def __post_init__(self) -> None:
        reward, shape = self.reward, self.reward.shape
        if reward.ndim != 2 or 0 in shape or shape[1] != len(self.names):
            raise PlanError(f'{len(self.names)} names do not fit arrays of shape {shape}')
        if self.available.shape != shape:
            raise PlanError(f'available is {self.available.shape}, and reward is {shape}')
        if self.rows.shape != (reward.size, shape[0]):
            raise PlanError(f'rows are {self.rows.shape}, and reward is {shape}')
        largest = float(np.finfo(np.float64).max)
        ranges = [('reward', reward, -largest, largest)]
        if self.rows.nnz:
            ranges.append(('a successor', self.rows.indices, 0, shape[0] - 1))
            ranges.append(('a row', self.rows.data, 0, 1 + ROUNDING))
        for name, array, low, high in ranges:
            _check_range(name, array, low, high)
        if not self.single:
            _check_range('the sums of rows', self.rows.sum(axis=1), 0, 1 + ROUNDING)

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    @cached_property
    def single(self) -> bool:
        """Whether no pair of state and option has more than one successor."""
        return bool((np.diff(self.rows.indptr) <= 1).all())


def look_ahead(model: MultiTimeModel, values: Floats) -> Floats:
    """Return (S, O): the value of each option by the values (S,) of its ends, or -inf."""
    ahead: Floats = (model.rows @ values).reshape(model.reward.T.shape).T
    ahead += model.reward
    np.copyto(ahead, -np.inf, where=~model.available)
    return ahead


def concatenate(models: Sequence[MultiTimeModel]) -> MultiTimeModel:
    """Return one model with the options of all, in order."""
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
    Return the exact model whose options are the primitive actions.

    :param over: (S,) states where no action is available, because the task is over.
    :param names: of the actions, (A,).
    """
    count, actions, outcomes = transitions.successor.shape
    ended = (transitions.terminated | over[:, None, None]).swapaxes(0, 1).ravel()
    successor = transitions.successor.swapaxes(0, 1).ravel()
    share: Any = gamma
    reward = transitions.reward[:, :, 0]
    if not transitions.deterministic:
        share = gamma * transitions.probability.swapaxes(0, 1).ravel()
        reward = (transitions.probability * transitions.reward).sum(axis=2)
        successor = successor.copy()  # which is sorted below
    ends = np.arange(0, successor.size + 1, outcomes, dtype=np.int32)
    parts = np.where(ended, 0.0, share), successor, ends
    rows = csr_array(parts, shape=(actions * count, count))
    if not transitions.deterministic:
        rows.sum_duplicates()
        rows.eliminate_zeros()
    available = np.broadcast_to(~over, reward.T.shape).T
    return MultiTimeModel(tuple(names), reward, available, rows)


def _check_range(name: str, array: NDArray[Any], low: float, high: float) -> None:
    if not (array.min() >= low and array.max() <= high):  # false for NaN
        raise PlanError(f'{name} holds an entry that is not within {low}..{high}')
