"""
Multi-time models of a semi-Markov decision process (SMDP), in two forms that plan alike.

Axes: S states, O options; a primitive action is an option of one step. An option that takes k
primitive steps counts its successor with gamma**k (Sutton, Precup and Singh 1999, section 3.1).
``MultiTimeModel`` has one successor for each state and option, ``SparseMultiTimeModel`` a sparse
row of them.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from humanopts_env.arrays import Flags, Floats
from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

Rows = Any  # csr_array of float64; SciPy has no types
ROUNDING = 1e-9  # how far above 1 the entries of one row may sum up


def look_ahead(model: 'Model', values: Floats) -> Floats:
    """Return (S, O): the value of each option by the values (S,) of its ends, or -inf."""
    ahead: Floats = (model.rows @ values).reshape(model.reward.T.shape).T
    ahead += model.reward
    np.copyto(ahead, -np.inf, where=~model.available)
    return ahead


@dataclass(frozen=True)
class _Rewards:
    """The rewards of running option o from state s, in both forms of a model."""

    names: tuple[str, ...]  # of the options, (O,)
    reward: Floats  # (S, O), expected sum of gamma**i * r[i], i = 0..k-1
    available: Flags  # (S, O)

    def __post_init__(self) -> None:
        reward = self.reward
        if self.available.shape != reward.shape:
            raise PlanError(f'available is {self.available.shape}, and reward is {reward.shape}')
        if reward.ndim != 2 or 0 in reward.shape or reward.shape[1] != len(self.names):
            raise PlanError(f'{len(self.names)} names do not fit arrays of shape {reward.shape}')
        largest = float(np.finfo(np.float64).max)
        _check_range('reward', reward, -largest, largest)

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])


@dataclass(frozen=True)
class MultiTimeModel(_Rewards):
    """
    Rewards and successors of running option o from state s, with one successor each.

    Entries of pairs that are not available are ignored, but must be valid numbers. Arrays may be
    shared and read-only, and of any strides.

    :raises PlanError: shapes disagree, a number is not finite, or an entry is out of range.
    """

    successor: NDArray[np.int32]  # (S, O)
    discount: Floats  # (S, O), gamma**k of an option that takes k steps; 0 where the task was over

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.reward.shape
        for name in ('successor', 'discount'):
            if getattr(self, name).shape != shape:
                raise PlanError(f'{name} is {getattr(self, name).shape}, and reward is {shape}')
        _check_range('successor', self.successor, 0, shape[0] - 1)
        _check_range('discount', self.discount, 0, 1)

    @cached_property
    def rows(self) -> Rows:
        """The successors as sparse rows, as in ``SparseMultiTimeModel``."""
        data = np.where(self.available.T, self.discount.T, 0.0).ravel()
        ends = np.arange(len(data) + 1)
        rows = csr_array((data, self.successor.T.ravel(), ends), shape=(len(data), self.n_states))
        rows.eliminate_zeros()
        return rows


@dataclass(frozen=True)
class SparseMultiTimeModel(_Rewards):
    """
    Rewards and successors of running option o from state s, with any number of successors.

    :raises PlanError: shapes disagree, a number is not finite or out of range, a row sums to
        more than 1, or belongs to a pair that is not available.
    """

    rows: Rows  # (O*S, S), row o*S + s: expected gamma**k of each successor; none: task over

    def __post_init__(self) -> None:
        super().__post_init__()
        count, options = self.reward.shape
        if self.rows.shape != (options * count, count):
            raise PlanError(f'rows are {self.rows.shape}, and reward is {self.reward.shape}')
        if self.rows.nnz:
            _check_range('a row', self.rows.data, 0, 1 + ROUNDING)
        sums = self.rows.sum(axis=1)
        _check_range('the sums of rows', sums, 0, 1 + ROUNDING)
        if sums[~self.available.T.ravel()].any():
            raise PlanError('a pair that is not available has successors')

    def first(self, count: int) -> 'SparseMultiTimeModel':
        """Return the model of the first options only."""
        n_rows = count * self.n_states
        end = self.rows.indptr[n_rows]
        parts = (self.rows.data[:end], self.rows.indices[:end], self.rows.indptr[: n_rows + 1])
        return self._with(
            names=self.names[:count],
            reward=self.reward[:, :count],
            available=self.available[:, :count],
            rows=csr_array(parts, shape=(n_rows, self.n_states)),
        )

    def of_policy(self, option: NDArray[np.integer]) -> 'SparseMultiTimeModel':
        """Return the model whose only option is, in each state, a given one, (S,)."""
        states = np.arange(self.n_states)
        return self._with(
            names=('policy',),
            reward=self.reward[states, option][:, None],
            available=self.available[states, option][:, None],
            rows=self.rows[option * self.n_states + states],
        )

    def _with(self, **parts: Any) -> 'SparseMultiTimeModel':
        """Return a model with some rows of this one, which were checked."""
        model = copy(self)
        vars(model).update(parts)
        return model


Model = MultiTimeModel | SparseMultiTimeModel


def concatenate(models: Sequence[Model]) -> Model:
    """Return one model with the options of all, in order; sparse where one of them is."""

    def joined(field: str) -> NDArray[Any]:
        return np.concatenate([getattr(model, field).T for model in models]).T

    names = tuple(name for model in models for name in model.names)
    reward, available = joined('reward'), joined('available')
    if any(isinstance(model, SparseMultiTimeModel) for model in models):
        rows = vstack([model.rows for model in models], format='csr')
        return SparseMultiTimeModel(names, reward, available, rows)
    return MultiTimeModel(names, reward, available, joined('successor'), joined('discount'))


def primitive_model(
    transitions: Transitions, over: Flags, gamma: float, names: Sequence[str]
) -> Model:
    """
    Return the exact model whose options are the primitive actions.

    :param over: (S,) states where no action is available, because the task is over.
    :param names: of the actions, (A,).
    """
    if not transitions.deterministic:
        return _primitive_rows(transitions, over, gamma, names)
    reward = transitions.reward[:, :, 0]
    return MultiTimeModel(
        names=tuple(names),
        reward=reward,
        available=np.broadcast_to(~over, reward.T.shape).T,
        successor=transitions.successor[:, :, 0],
        discount=np.where(transitions.terminated[:, :, 0], 0.0, gamma),
    )


def _primitive_rows(
    transitions: Transitions, over: Flags, gamma: float, names: Sequence[str]
) -> SparseMultiTimeModel:
    count, actions, outcomes = transitions.successor.shape
    share = np.where(transitions.terminated | over[:, None, None], 0.0, transitions.probability)
    rows = csr_array(
        (
            gamma * share.swapaxes(0, 1).ravel(),
            transitions.successor.swapaxes(0, 1).ravel(),
            np.arange(0, actions * count * outcomes + 1, outcomes),
        ),
        shape=(actions * count, count),
    )
    rows.sum_duplicates()
    rows.eliminate_zeros()
    reward = (transitions.probability * transitions.reward).sum(axis=2)
    return SparseMultiTimeModel(
        tuple(names), reward, np.broadcast_to(~over, reward.T.shape).T, rows
    )


def _check_range(name: str, array: NDArray[Any], low: float, high: float) -> None:
    if not (array.min() >= low and array.max() <= high):  # false for NaN
        raise PlanError(f'{name} holds an entry that is not within {low}..{high}')
