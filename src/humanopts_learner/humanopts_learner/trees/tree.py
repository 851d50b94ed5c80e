"""A fitted decision tree as plain arrays: nothing but NumPy is needed to use one."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAF = -1  # left, right and column of a leaf
MANY = 100  # rows for each node, from which on it is quicker to go node by node


class TreeError(ValueError):
    """Data is not a decision tree; the text names what is wrong with it."""


@dataclass(frozen=True, eq=False)
class Tree:
    """
    A decision tree that keeps how often each class was seen.

    Axes: N nodes, the root first and every child after its parent; K classes. A row goes left
    where its column is at most the threshold.
    """

    left: NDArray[np.int32]  # (N,)
    right: NDArray[np.int32]  # (N,)
    column: NDArray[np.int32]  # (N,)
    threshold: NDArray[np.float64]  # (N,) 0 in leaves
    counts: NDArray[np.int64]  # (N, K) training examples of each class that came to the node
    classes: tuple[int, ...]  # (K,) labels, ascending
    n_columns: int  # columns of the rows that it takes

    def __post_init__(self) -> None:
        """Check the arrays against each other: evaluation may then trust them."""
        _check(self)

    def __eq__(self, other: object) -> bool:
        """Tell whether the other is the same tree."""
        return isinstance(other, Tree) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        """Return a hash that equal trees share."""
        return hash((self.column.tobytes(), self.counts.tobytes(), self.classes))

    def leaves(self, X: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return (N,): the node in which each row of X (N, C) ends."""
        if X.ndim != 2 or X.shape[1] != self.n_columns:
            raise TreeError(f'the tree takes rows of {self.n_columns} columns, not {X.shape}')
        values = X.astype(np.float32, copy=False)
        if len(X) > MANY * len(self.left):
            return self._part(np.ascontiguousarray(values.T))
        rows, node = np.arange(len(X)), np.zeros(len(X), dtype=np.intp)
        column, children = self._walk
        for _ in range(self.depth):
            goes_right = values[rows, column[node]] > self.threshold[node]
            node = children[goes_right.astype(np.intp), node]
        return node

    def _part(self, values: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return what ``leaves`` does, for columns (C, N): node by node, with all rows in it."""
        result = np.zeros(values.shape[1], dtype=np.intp)
        inside = {0: np.arange(len(result))}
        for node in range(len(self.left)):  # a child comes after its parent
            rows = inside.pop(node)
            if self.left[node] == LEAF:
                result[rows] = node
                continue
            right = values[self.column[node]][rows] > self.threshold[node]
            inside[int(self.left[node])] = rows[~right]
            inside[int(self.right[node])] = rows[right]
        return result

    def probabilities(self, X: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return (N, K): the share of each class in the leaf of each row of X (N, C)."""
        return self._shares[self.leaves(X)]

    def share_of(self, number: int, X: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return (N,): one column of ``probabilities``."""
        share: NDArray[np.float64] = self._shares[:, number].take(self.leaves(X))
        return share

    def likeliest(self, X: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return (N,): the number of the greatest of ``probabilities``, the first of equals."""
        best: NDArray[np.intp] = self._shares.argmax(axis=1).take(self.leaves(X))
        return best

    @cached_property
    def depth(self) -> int:
        """Number of tests on the longest way from the root to a leaf."""
        level = np.zeros(len(self.left), dtype=np.int64)
        for node in np.flatnonzero(self.left != LEAF):
            level[[self.left[node], self.right[node]]] = level[node] + 1
        return int(level.max())

    @cached_property
    def _walk(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Columns (N,) and children (2, N) in which every leaf is its own child."""
        leaf, itself = self.left == LEAF, np.arange(len(self.left))
        children = np.stack([np.where(leaf, itself, side) for side in (self.left, self.right)])
        return np.where(leaf, 0, self.column).astype(np.intp), children.astype(np.intp)

    @cached_property
    def _shares(self) -> NDArray[np.float64]:
        shares: NDArray[np.float64] = self.counts / self.counts.sum(axis=1, keepdims=True)
        return shares

    def to_dict(self) -> dict[str, Any]:
        """Return the tree as JSON data."""
        inner = [
            {'column': c, 'at_most': t, 'left': left, 'right': right}
            for c, t, left, right in zip(
                self.column.tolist(),
                self.threshold.tolist(),
                self.left.tolist(),
                self.right.tolist(),
            )
        ]
        nodes = [
            {'counts': counts} if test['column'] == LEAF else {**test, 'counts': counts}
            for test, counts in zip(inner, self.counts.tolist())
        ]
        return {'columns': self.n_columns, 'classes': list(self.classes), 'nodes': nodes}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> 'Tree':
        """
        Read what ``to_dict`` wrote.

        :raises TreeError: it is not a tree.
        """
        try:
            nodes = [_node(entry) for entry in data['nodes']]
            counts = [entry['counts'] for entry in data['nodes']]
            numbers = [data['columns'], *data['classes'], *(n for row in counts for n in row)]
            if any(type(number) is not int for number in numbers):
                raise TreeError('a tree counts in whole numbers, and these are not')
            column, threshold, left, right = zip(*nodes)
            return cls(
                np.array(left, dtype=np.int32),
                np.array(right, dtype=np.int32),
                np.array(column, dtype=np.int32),
                np.array(threshold, dtype=np.float64),
                np.array(counts, dtype=np.int64),
                tuple(data['classes']),
                data['columns'],
            )
        except TreeError:
            raise
        except KeyError as error:
            raise TreeError(f'the tree has no {error}') from None
        except (TypeError, ValueError, OverflowError) as error:
            raise TreeError(f'not a tree: {error}') from None


def _node(entry: Mapping[str, Any]) -> tuple[int, float, int, int]:
    if 'column' not in entry:
        return LEAF, 0.0, LEAF, LEAF
    whole = entry['column'], entry['left'], entry['right']
    if any(type(number) is not int or number < 0 for number in whole):
        raise TreeError(f'a node of a tree does not name its column and children: {entry}')
    if type(entry['at_most']) not in (int, float):
        raise TreeError(f'a node of a tree compares with something that is not a number: {entry}')
    return entry['column'], float(entry['at_most']), entry['left'], entry['right']


def _check(tree: Tree) -> None:
    size = len(tree.left)
    sizes = {len(part) for part in (tree.right, tree.column, tree.threshold, tree.counts)}
    if size == 0 or sizes != {size}:
        raise TreeError(f'a tree needs as many of everything as it has nodes ({size})')
    if tree.counts.shape != (size, len(tree.classes)) or not tree.classes:
        raise TreeError(f'a tree of {len(tree.classes)} classes has counts {tree.counts.shape}')
    if list(tree.classes) != sorted(set(tree.classes)):
        raise TreeError(f'the classes of a tree are not ascending: {tree.classes}')
    if (tree.counts < 0).any() or not tree.counts.any(axis=1).all():
        raise TreeError('a node of a tree counts no examples, or fewer than none')
    inner = np.flatnonzero(tree.left != LEAF)
    children = np.concatenate([tree.left[inner], tree.right[inner]])
    if not np.array_equal(np.sort(children), np.arange(1, size)):
        raise TreeError('every node of a tree but the root is the child of exactly one other')
    if (children <= np.concatenate([inner, inner])).any():
        raise TreeError('a node of a tree comes before its parent')
    leaves = tree.left == LEAF
    if (tree.right[leaves] != LEAF).any() or (tree.column[leaves] != LEAF).any():
        raise TreeError('a leaf of a tree has a test or a child')
    if not np.isfinite(tree.threshold).all():
        raise TreeError('a threshold of a tree is not finite')
    if (tree.column[inner] < 0).any() or (tree.column[inner] >= tree.n_columns).any():
        raise TreeError(f'a node of a tree tests a column that is not among {tree.n_columns}')
