"""
Multi-time models of a semi-Markov decision process (SMDP), in two forms that plan alike.

Axes: S states, O options (columns). A choice that takes k primitive steps counts its successor
with gamma**k. ``SmdpModel`` has one successor for each choice, ``RowModel`` a sparse row of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.errors import check_gamma, ModelError, NotDeterministicError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

Rows = Any  # csr_array of float64; SciPy has no types
# Writes the expected discounted value of every choice, (O, S), from values (S,)
Expectation = Callable[[NDArray[np.float64], NDArray[np.float64]], None]
ROUNDING = 1e-9  # how far above 1 the entries of one row may sum up


@dataclass(frozen=True)
class SmdpModel:
    """
    What choosing option o in state s leads to, with one successor.

    A choice takes k primitive steps; its reward is sum of gamma**i * r[i], i = 0..k-1. Entries of
    pairs that are not available are ignored, but must be valid numbers. Planning reads the
    arrays options-major, so transposed (O, S) arrays are used without a copy.

    :raises ModelError: shapes disagree, a number is not finite, or an entry is out of range.
    """

    names: tuple[str, ...]  # of the columns
    reward: NDArray[np.float64]  # (S, O)
    available: NDArray[np.bool_]  # (S, O)
    successor: NDArray[np.int32]  # (S, O)
    discount: NDArray[np.float64]  # (S, O), gamma**k; 0 where the task was over

    def __post_init__(self) -> None:
        """Check the arrays."""
        _check_shapes(self.names, self.reward, self.available)
        shape = self.reward.shape
        for name in ('successor', 'discount'):
            if getattr(self, name).shape != shape:
                raise ModelError(f'{name} is {getattr(self, name).shape}, and reward is {shape}')
        _check_range('successor', self.successor, 0, shape[0] - 1)
        _check_range('discount', self.discount, 0, 1)

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    @property
    def rows(self) -> Rows:
        """The successors as sparse rows, as in ``RowModel``."""
        data = np.where(self.available.T, self.discount.T, 0.0).ravel()
        ends = np.arange(len(data) + 1)
        rows = csr_array((data, self.successor.T.ravel(), ends), shape=(len(data), self.n_states))
        rows.eliminate_zeros()
        return rows

    def expectation(self) -> Expectation:
        """Return what a sweep takes of the successors; it allocates nothing."""
        successor = np.ascontiguousarray(self.successor.T, dtype=np.intp)
        discount = np.where(self.available.T, self.discount.T, 0.0)

        def expect(values: NDArray[np.float64], out: NDArray[np.float64]) -> None:
            np.take(values, successor, out=out, mode='clip')
            np.multiply(out, discount, out=out)

        return expect


@dataclass(frozen=True)
class RowModel:
    """
    What choosing option o in state s leads to, with any number of successors.

    :raises ModelError: shapes disagree, a number is not finite or out of range, a row sums to
        more than 1, or belongs to a pair that is not available.
    """

    names: tuple[str, ...]  # of the columns
    reward: NDArray[np.float64]  # (S, O), expected sum of gamma**i * r[i], i = 0..k-1
    available: NDArray[np.bool_]  # (S, O)
    rows: Rows  # (O*S, S), row o*S + s: expected gamma**k of each successor; none: task over

    def __post_init__(self) -> None:
        """Check the arrays."""
        _check_shapes(self.names, self.reward, self.available)
        count, columns = self.reward.shape
        if self.rows.shape != (columns * count, count):
            raise ModelError(f'rows are {self.rows.shape}, and reward is {self.reward.shape}')
        if self.rows.nnz:
            _check_range('a row', self.rows.data, 0, 1 + ROUNDING)
        sums = self.rows.sum(axis=1)
        _check_range('the sums of rows', sums, 0, 1 + ROUNDING)
        if sums[~self.available.T.ravel()].any():
            raise ModelError('a pair that is not available has successors')

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    def expectation(self) -> Expectation:
        """Return what a sweep takes of the successors; it allocates one array (O*S,)."""

        def expect(values: NDArray[np.float64], out: NDArray[np.float64]) -> None:
            np.copyto(out, (self.rows @ values).reshape(out.shape))

        return expect


Model = SmdpModel | RowModel


def concatenate(models: Sequence[Model]) -> Model:
    """Return one model with the columns of all, in order; sparse rows where one has them."""

    def columns(field: str) -> NDArray[Any]:
        return np.concatenate([getattr(model, field).T for model in models]).T

    names = tuple(name for model in models for name in model.names)
    reward, available = columns('reward'), columns('available')
    if any(isinstance(model, RowModel) for model in models):
        rows = vstack([model.rows for model in models], format='csr')
        return RowModel(names, reward, available, rows)
    return SmdpModel(names, reward, available, columns('successor'), columns('discount'))


def check_deterministic(transitions: Transitions) -> None:
    """
    Check that every action has one outcome.

    :raises NotDeterministicError: one has more.
    """
    if not transitions.deterministic:
        raise NotDeterministicError(
            'an action of this domain has more than one outcome; exact models need a domain '
            'whose actions have one'
        )


def primitive_model(
    transitions: Transitions, over: NDArray[np.bool_], gamma: float, names: Sequence[str]
) -> Model:
    """
    Return the model whose options are the primitive actions.

    :param over: (S,) states in which nothing is available, since the task is over there.
    :param names: of the actions, (A,).
    :raises PlanError: gamma is not in (0, 1].
    """
    check_gamma(gamma)
    if not transitions.deterministic:
        return _primitive_rows(transitions, over, gamma, names)
    reward = np.ascontiguousarray(transitions.reward[:, :, 0].T)
    ended = transitions.terminated[:, :, 0].T
    return SmdpModel(
        names=tuple(names),
        reward=reward.T,
        available=np.broadcast_to(~over, reward.shape).T,
        successor=np.ascontiguousarray(transitions.successor[:, :, 0].T).T,
        discount=np.where(ended, 0.0, gamma).T,
    )


def _primitive_rows(
    transitions: Transitions, over: NDArray[np.bool_], gamma: float, names: Sequence[str]
) -> RowModel:
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
    return RowModel(tuple(names), reward, np.broadcast_to(~over, reward.T.shape).T, rows)


def _check_shapes(
    names: Sequence[str], reward: NDArray[np.float64], available: NDArray[np.bool_]
) -> None:
    if available.shape != reward.shape:
        raise ModelError(f'available is {available.shape}, and reward is {reward.shape}')
    if reward.ndim != 2 or 0 in reward.shape or reward.shape[1] != len(names):
        raise ModelError(f'{len(names)} names do not fit arrays of shape {reward.shape}')
    largest = float(np.finfo(np.float64).max)
    _check_range('reward', reward, -largest, largest)


def _check_range(name: str, array: NDArray[Any], low: float, high: float) -> None:
    if not (array.min() >= low and array.max() <= high):  # false for NaN
        raise ModelError(f'{name} holds an entry that is not within {low}..{high}')
