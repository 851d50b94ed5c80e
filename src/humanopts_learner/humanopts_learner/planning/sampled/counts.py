"""Samples of runs, counted into a multi-time model over the planning states that were visited."""

from copy import copy
from dataclasses import dataclass

from humanopts_learner.planning.multi_time_models import Rows, SparseMultiTimeModel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Samples:
    """M finished runs, or ends of runs."""

    code: NDArray[np.int64]  # (M,) planning state where it began
    column: NDArray[np.integer]  # (M,)
    reward: NDArray[np.float64]  # (M,) sum of gamma**i * r[i], i = 0..k-1
    discount: NDArray[np.float64]  # (M,) gamma**k; 0 where the task was over
    successor: NDArray[np.int64]  # (M,) planning state where it ended


class StateIndex:
    """Numbers the planning states that were seen, in the order of coming."""

    def __init__(self, codes: NDArray[np.int64] | None = None) -> None:
        """
        Begin with some planning states.

        :param codes: (S,) ascending; None: none.
        """
        self._sorted = np.empty(0, dtype=np.int64) if codes is None else codes
        self._number = np.arange(len(self._sorted))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._sorted)

    def snapshot(self) -> 'StateIndex':
        """Return a copy that does not grow with this one."""
        return copy(self)  # the arrays are never changed in place

    def find(self, codes: NDArray[np.int64]) -> tuple[Ints, NDArray[np.bool_]]:
        """Return the number of each (N,), 0 where it has none, and whether it has one (N,)."""
        if not len(self._sorted):
            return np.zeros(len(codes), dtype=np.intp), np.zeros(len(codes), dtype=np.bool_)
        at = np.minimum(np.searchsorted(self._sorted, codes), len(self._sorted) - 1)
        seen = self._sorted[at] == codes
        return np.where(seen, self._number[at], 0), seen

    @property
    def codes(self) -> NDArray[np.int64]:
        """(S,) the planning states by their numbers."""
        return self._sorted[np.argsort(self._number)]

    def add(self, codes: NDArray[np.int64]) -> Ints:
        """Return the number of each (N,), numbering those that are new."""
        unique, inverse = np.unique(codes, return_inverse=True)
        new = unique[~self.find(unique)[1]]
        numbers = np.concatenate([self._number, len(self) + np.arange(len(new))])
        merged = np.concatenate([self._sorted, new])
        order = np.argsort(merged, kind='stable')
        self._sorted, self._number = merged[order], numbers[order]
        return self.find(unique)[0][inverse]


class Counts:
    """Sums over samples of S planning states and O columns."""

    def __init__(self, names: tuple[str, ...], choosable: int = 0) -> None:
        """
        Begin without samples.

        :param names: of the columns that are modelled, (O,).
        :param choosable: how many of them, from the first on, can be chosen; 0: all.
        """
        self.names, self.index = names, StateIndex()
        self._choosable = choosable or len(names)
        self._count = np.zeros((len(names), 0))
        self._reward = np.zeros((len(names), 0))
        self._rows: Rows = csr_array((0, 0))

    def add(self, samples: Samples) -> None:
        """Count samples."""
        codes = np.concatenate([samples.code, samples.successor])
        state, successor = np.split(self.index.add(codes), 2)
        columns, states = len(self.names), len(self.index)
        shape = (columns, states)
        self._grow(states)
        pair = samples.column * states + state
        self._count += np.bincount(pair, minlength=columns * states).reshape(shape)
        reward = np.bincount(pair, samples.reward, minlength=columns * states)
        self._reward += reward.reshape(shape)
        at = (pair, successor)
        more = coo_array((samples.discount, at), (columns * states, states))
        self._rows = self._rows + more.tocsr()

    def _grow(self, states: int) -> None:
        """Make room for more states."""
        columns, old = self._count.shape
        if states == old:
            return
        more = ((0, 0), (0, states - old))
        self._count, self._reward = np.pad(self._count, more), np.pad(self._reward, more)
        rows = self._rows.tocoo()
        row = rows.row.astype(np.int64) // max(old, 1) * states + rows.row % max(old, 1)
        at = (row, rows.col)
        self._rows = coo_array((rows.data, at), (columns * states, states)).tocsr()

    @property
    def samples(self) -> NDArray[np.float64]:
        """(S, O) how many samples there are of each pair."""
        return self._count.T

    def model(self, min_samples: int, penalty: float) -> SparseMultiTimeModel:
        """
        Return the mean of the samples.

        Pairs of state and column with fewer than ``min_samples`` are not available. Nothing is
        known of states without an available pair that can be chosen: samples that end there count
        as if they had ended as the other samples of their pair did, and pairs with no others are
        not available.

        :param penalty: reward units that a pair with one sample is worth less; with n samples it
            is this by the square root of n.
        """
        enough, rows = self._known(self._count >= max(min_samples, 1))
        count = np.where(enough, self._count, 1.0)
        reward = np.where(enough, self._reward / count - penalty / np.sqrt(count), 0.0)
        return SparseMultiTimeModel(self.names, reward.T, enough.T, rows)

    def _known(self, enough: Flags) -> tuple[Flags, Rows]:
        """Return the pairs (O, S) that lead to states with such pairs, and where they lead."""
        total = self._rows.sum(axis=1)
        while True:
            known = np.asarray(enough[: self._choosable].any(axis=0))
            kept = self._rows @ known
            more = enough & ((kept > 0) | (total == 0)).reshape(enough.shape)
            if (more == enough).all():
                break
            enough = more
        scale = np.where(enough.ravel() & (kept > 0), total, 0.0)
        scale /= np.where(kept > 0, kept, 1.0) * np.maximum(self._count.ravel(), 1.0)
        rows = self._rows.copy()
        rows.data *= np.repeat(scale, np.diff(rows.indptr)) * known[rows.indices]
        rows.eliminate_zeros()
        return enough, rows
