"""Sampled option models: runs counted into a multi-time model of the abstract states visited."""

from dataclasses import dataclass

from humanopts_env.arrays import Floats, Ints
from humanopts_learner.planning.abstraction import Codes
from humanopts_learner.planning.action_set import CodeTable
from humanopts_learner.planning.models import MultiTimeModel, SparseRows
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array


@dataclass(frozen=True)
class Samples:
    """M finished runs, or final parts of runs."""

    state: Codes  # (M,) abstract state where it began
    option: NDArray[np.integer]  # (M,) index of the model
    reward: Floats  # (M,) sum of gamma**i * r[i], i = 0..k-1
    discount: Floats  # (M,) gamma**k; 0 where the task was over
    successor: Codes  # (M,) abstract state where it ended


class StateIndex:
    """Numbers abstract states in the order of their first visit."""

    def __init__(self) -> None:
        self._table = CodeTable(np.empty(0, dtype=np.int64))
        self._number = np.empty(0, dtype=np.intp)

    def __len__(self) -> int:
        return len(self._number)

    @property
    def codes(self) -> Codes:
        """(S,) the abstract states by their numbers."""
        return self._table.codes[np.argsort(self._number)]

    def add(self, codes: Codes) -> Ints:
        """Return each code's state number (N,), and number the new ones."""
        place = self._table.find(codes)
        new = np.unique(codes[place == len(self)])
        if new.size:
            numbers = np.concatenate([self._number, len(self) + np.arange(len(new))])
            merged = np.concatenate([self._table.codes, new])
            order = np.argsort(merged, kind='stable')
            self._table, self._number = CodeTable(merged[order]), numbers[order]
            place = self._table.find(codes)
        found: Ints = self._number.take(place)
        return found


class SampleCounts:
    """Sums over the samples of S abstract states and O options."""

    def __init__(self, names: tuple[str, ...], choosable: int = 0) -> None:
        """
        Begin without samples.

        :param names: of the models, (O,).
        :param choosable: the number of them, from the first, that can be chosen; 0: all.
        """
        self.names, self.index = names, StateIndex()
        self._choosable = choosable or len(names)
        self._count = np.zeros((len(names), 0))
        self._reward = np.zeros((len(names), 0))
        self._rows: SparseRows = csr_array((0, 0))

    def add(self, samples: Samples) -> None:
        codes = np.concatenate([samples.state, samples.successor])
        state, successor = np.split(self.index.add(codes), 2)
        options, states = len(self.names), len(self.index)
        shape, old = (options, states), self._count.shape[1]
        if states > old:
            more = ((0, 0), (0, states - old))
            self._count, self._reward = np.pad(self._count, more), np.pad(self._reward, more)
            rows = self._rows.tocoo()
            row = rows.row.astype(np.int64) // max(old, 1) * states + rows.row % max(old, 1)
            parts = rows.data, (row, rows.col)
            self._rows = coo_array(parts, (options * states, states)).tocsr()
        pair = samples.option * states + state
        self._count += np.bincount(pair, minlength=options * states).reshape(shape)
        reward = np.bincount(pair, samples.reward, minlength=options * states)
        self._reward += reward.reshape(shape)
        added = coo_array((samples.discount, (pair, successor)), (options * states, states))
        self._rows = self._rows + added.tocsr()

    def model(self, min_samples: int) -> MultiTimeModel:
        """
        Return the mean of the samples.

        Pairs of state and option with fewer than ``min_samples`` are not available. States without
        an available pair that can be chosen have no value: samples that end there count as if they
        had ended like the other samples of their pair, and pairs with no other samples are not
        available.
        """
        enough = self._count >= max(min_samples, 1)
        pairs = np.flatnonzero(enough)  # the others are many, and are not looked at
        rows = self._rows[pairs]
        total = rows.sum(axis=1)
        left = np.ones(len(pairs), dtype=np.bool_)
        while True:
            known = np.asarray(enough[: self._choosable].any(axis=0))
            kept = rows @ known
            more = left & ((kept > 0) | (total == 0))
            if (more == left).all():
                break
            left = more
            enough.ravel()[pairs] = left
        scale = np.where(left & (kept > 0), total, 0.0)
        scale /= np.where(kept > 0, kept, 1.0) * self._count.ravel()[pairs]
        rows.data *= np.repeat(scale, np.diff(rows.indptr)) * known[rows.indices]
        rows.eliminate_zeros()
        lengths = np.zeros(enough.size + 1, dtype=rows.indptr.dtype)
        lengths[pairs + 1] = np.diff(rows.indptr)
        parts = rows.data, rows.indices, np.cumsum(lengths, dtype=lengths.dtype)
        reward = np.zeros(enough.shape)
        reward[enough] = self._reward[enough] / self._count[enough]
        joined = csr_array(parts, shape=self._rows.shape)
        return MultiTimeModel(self.names, reward.T, enough.T, joined)
