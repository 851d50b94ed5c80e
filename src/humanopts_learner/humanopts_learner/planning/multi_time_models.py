"""
Multi-time models of a semi-Markov decision process (SMDP), in two forms that plan alike.

Axes: S states, O options; a primitive action is an option of one step. An option that takes k
primitive steps counts its successor with gamma**k (Sutton, Precup and Singh 1999, section 3.1).
``MultiTimeModel`` has one successor for each state and option, ``SparseMultiTimeModel`` a sparse
row of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

Rows = Any  # csr_array of float64; SciPy has no types
ROUNDING = 1e-9  # how far above 1 the entries of one row may sum up


class Expectation(Protocol):
    """Computes the expected discounted value of the successors of an option."""

    def prepare(self, values: NDArray[np.float64], /) -> object:
        """Take the values (S,) of the states."""

    def of_option(self, option: int, out: NDArray[np.float64], /) -> object:
        """Write (S,): the expected discounted value of the successors of one option."""


def expected_values(model: 'Model', values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (O, S): the expected discounted value of the successors of every option."""
    expected, result = model.expectation(), np.empty(model.reward.T.shape)
    expected.prepare(values)
    for option, out in enumerate(result):
        expected.of_option(option, out)
    return result


@dataclass(frozen=True)
class MultiTimeModel:
    """
    Rewards and successors of running option o from state s, with one successor each.

    An option takes k primitive steps; its reward is sum of gamma**i * r[i], i = 0..k-1. Entries
    of pairs that are not available are ignored, but must be valid numbers. Planning reads the
    arrays options-major, so transposed (O, S) arrays are used without a copy.

    :raises PlanError: shapes disagree, a number is not finite, or an entry is out of range.
    """

    names: tuple[str, ...]  # of the options, (O,)
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
                raise PlanError(f'{name} is {getattr(self, name).shape}, and reward is {shape}')
        _check_range('successor', self.successor, 0, shape[0] - 1)
        _check_range('discount', self.discount, 0, 1)

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    @property
    def rows(self) -> Rows:
        """The successors as sparse rows, as in ``SparseMultiTimeModel``."""
        data = np.where(self.available.T, self.discount.T, 0.0).ravel()
        ends = np.arange(len(data) + 1)
        rows = csr_array((data, self.successor.T.ravel(), ends), shape=(len(data), self.n_states))
        rows.eliminate_zeros()
        return rows

    def expectation(self) -> Expectation:
        """Return the expectation over the successors; computing it allocates nothing."""
        return _Successors(self)


class _Successors:
    """
    Expectation over single successors, by indexing.

    Where all options are discounted alike, as primitive actions are, the values are discounted
    before they are indexed, and the successor of the end of the task is one more state of value 0.
    """

    def __init__(self, model: MultiTimeModel) -> None:
        self._successor = np.ascontiguousarray(model.successor.T, dtype=np.intp)
        self._discount = np.where(model.available.T, model.discount.T, 0.0)
        self._common_discount = float(self._discount.max())
        nothing = self._discount == 0.0
        self._same_discount = bool((nothing | (self._discount == self._common_discount)).all())
        self._values = np.zeros(model.n_states + 1)
        if self._same_discount:
            self._successor[nothing] = model.n_states

    def prepare(self, values: NDArray[np.float64]) -> None:
        np.multiply(
            values, self._common_discount if self._same_discount else 1.0, out=self._values[:-1]
        )

    def of_option(self, option: int, out: NDArray[np.float64]) -> None:
        np.take(self._values, self._successor[option], out=out, mode='clip')
        if not self._same_discount:
            np.multiply(out, self._discount[option], out=out)


@dataclass(frozen=True)
class SparseMultiTimeModel:
    """
    Rewards and successors of running option o from state s, with any number of successors.

    :raises PlanError: shapes disagree, a number is not finite or out of range, a row sums to
        more than 1, or belongs to a pair that is not available.
    """

    names: tuple[str, ...]  # of the options, (O,)
    reward: NDArray[np.float64]  # (S, O), expected sum of gamma**i * r[i], i = 0..k-1
    available: NDArray[np.bool_]  # (S, O)
    rows: Rows  # (O*S, S), row o*S + s: expected gamma**k of each successor; none: task over

    def __post_init__(self) -> None:
        """Check the arrays."""
        _check_shapes(self.names, self.reward, self.available)
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
        rows = self.rows[: count * self.n_states]
        return SparseMultiTimeModel(
            self.names[:count], self.reward[:, :count], self.available[:, :count], rows
        )

    def of_policy(self, option: NDArray[np.integer]) -> 'SparseMultiTimeModel':
        """Return the model whose only option is, in each state, a given one, (S,)."""
        states = np.arange(self.n_states)
        return SparseMultiTimeModel(
            ('policy',),
            self.reward[states, option][:, None],
            self.available[states, option][:, None],
            self.rows[option * self.n_states + states],
        )

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])

    def expectation(self) -> Expectation:
        """Return the expectation over the successors; computing it allocates one array (O*S,)."""
        return _Products(self)


class _Products:
    """Expectation over sparse rows, by one sparse product."""

    def __init__(self, model: SparseMultiTimeModel) -> None:
        self._rows, self._shape = model.rows, model.reward.T.shape
        self._expected = np.zeros(self._shape)

    def prepare(self, values: NDArray[np.float64]) -> None:
        self._expected = (self._rows @ values).reshape(self._shape)

    def of_option(self, option: int, out: NDArray[np.float64]) -> None:
        np.copyto(out, self._expected[option])


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
    transitions: Transitions, over: NDArray[np.bool_], gamma: float, names: Sequence[str]
) -> Model:
    """
    Return the exact model whose options are the primitive actions.

    :param over: (S,) states where no action is available, because the task is over.
    :param names: of the actions, (A,).
    """
    if not transitions.deterministic:
        return _primitive_rows(transitions, over, gamma, names)
    reward = np.ascontiguousarray(transitions.reward[:, :, 0].T)
    ended = transitions.terminated[:, :, 0].T
    return MultiTimeModel(
        names=tuple(names),
        reward=reward.T,
        available=np.broadcast_to(~over, reward.shape).T,
        successor=np.ascontiguousarray(transitions.successor[:, :, 0].T).T,
        discount=np.where(ended, 0.0, gamma).T,
    )


def _primitive_rows(
    transitions: Transitions, over: NDArray[np.bool_], gamma: float, names: Sequence[str]
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


def _check_shapes(
    names: Sequence[str], reward: NDArray[np.float64], available: NDArray[np.bool_]
) -> None:
    if available.shape != reward.shape:
        raise PlanError(f'available is {available.shape}, and reward is {reward.shape}')
    if reward.ndim != 2 or 0 in reward.shape or reward.shape[1] != len(names):
        raise PlanError(f'{len(names)} names do not fit arrays of shape {reward.shape}')
    largest = float(np.finfo(np.float64).max)
    _check_range('reward', reward, -largest, largest)


def _check_range(name: str, array: NDArray[Any], low: float, high: float) -> None:
    if not (array.min() >= low and array.max() <= high):  # false for NaN
        raise PlanError(f'{name} holds an entry that is not within {low}..{high}')
