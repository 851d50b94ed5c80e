"""
Decision trees and forests, fitted by scikit-learn, and stored and evaluated as plain arrays.

A tree uses encoded features: an ordinal or continuous feature is a number, a nominal one is
one-hot. They are float32, as in scikit-learn, for both fitting and evaluation. scikit-learn is
imported when the first tree is fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any

from humanopts_env.arrays import Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, FeatureKind
from humanopts_env.domains.formulas import column_values, feature_columns
from humanopts_learner.demonstrations import Count, Text
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

Formula = Annotated[Text, Field(pattern=r'x\[')]
LEAF = -1  # value of left, right and feature in a leaf
FEW_PATHS = 50  # number of rows times trees up to which a loop is faster than arrays
FEW_NODES = 25  # number of nodes up to which testing all of them is faster than following paths


class TreeError(ValueError):
    """Data is not a valid decision tree; the message says why."""


@dataclass(frozen=True, slots=True)
class EncodedFeature:
    """One input of a tree: a feature, or whether a nominal feature has a value."""

    feature: Text
    index: Count | Formula  # feature index in the domain, or a formula over indices if derived
    value: Count | None = None  # None: the feature itself; otherwise 1 at this value, else 0


def feature_encoding(domain: ActableDomain, features: Sequence[str]) -> tuple[EncodedFeature, ...]:
    """
    Return the encoding of selected features: nominal ones one-hot, others unchanged.

    :raises DomainError: a name is not a feature of the domain.
    """
    encoding: list[EncodedFeature] = []
    for column in feature_columns(domain, features):
        feature, index = column.feature, column.source
        if feature.kind is FeatureKind.NOMINAL:
            values = range(len(feature.values))
            encoding += [EncodedFeature(feature.name, index, value) for value in values]
        else:
            encoding.append(EncodedFeature(feature.name, index))
    return tuple(encoding)


class Encoder:
    """Encodes rows of features as inputs of trees."""

    def __init__(self, encoding: Sequence[EncodedFeature], tested: Ints | None = None) -> None:
        """
        Prepare the arrays.

        :param tested: indices of the encoded features to compute; the others are undefined. None:
            all.
        """
        self._size, self._tested = len(encoding), slice(None) if tested is None else tested
        chosen = encoding if tested is None else [encoding[at] for at in tested]
        values, index = [each.value for each in chosen], [each.index for each in chosen]
        self._formulas = list(dict.fromkeys(each for each in index if isinstance(each, str)))
        # Values of formulas are appended to the rows, so that their indices count from the end.
        at = {formula: k - len(self._formulas) for k, formula in enumerate(self._formulas)}
        self._index = np.array(
            [at[each] if isinstance(each, str) else each for each in index], dtype=np.intp
        )
        self._one_hot = np.array([[value is not None] for value in values], dtype=np.bool_)
        self._has_one_hot = bool(self._one_hot.any())
        self._wanted = np.array([[value or 0] for value in values], dtype=np.float64)

    def __call__(self, rows: Rows) -> NDArray[np.float32]:
        """
        Return the encoded features.

        :param rows: (N, F), all features of the domain.
        :return: (N, C), column-major, which suits the traversal of large trees.
        """
        if self._formulas:
            rows = np.column_stack([rows, *(column_values(f, rows) for f in self._formulas)])
        picked = rows.T[self._index]
        if self._has_one_hot:
            picked = np.where(self._one_hot, picked == self._wanted, picked)
        encoded = np.empty((self._size, len(rows)), dtype=np.float32)
        encoded[self._tested] = picked
        return encoded.T


def encode_rows(encoding: Sequence[EncodedFeature], rows: Rows) -> NDArray[np.float32]:
    """Return the encoded features, as ``Encoder``."""
    return Encoder(encoding)(rows)


@dataclass(frozen=True, eq=False)
class Tree:
    """
    A decision tree with class counts, or a forest of R trees, one after another in its arrays.

    Axes: N nodes, the first root first and every child after its parent; K classes. A row goes
    left if its feature is at most the threshold. A forest predicts the mean of the shares in the
    leaves of its trees (bagging, Breiman 1996).
    """

    left: NDArray[np.int32]  # (N,)
    right: NDArray[np.int32]  # (N,)
    feature: NDArray[np.int32]  # (N,) index of the tested encoded feature
    threshold: Floats  # (N,) 0 in leaves
    counts: NDArray[np.int64]  # (N, K) training examples per class
    classes: tuple[int, ...]  # (K,) labels, ascending
    n_features: int  # number of encoded features, C
    roots: tuple[int, ...] = (0,)  # (R,) nodes, ascending

    def __post_init__(self) -> None:
        """
        Check that the arrays are consistent, so that evaluation may rely on them.

        :raises TreeError: they do not form a tree.
        """
        size, leaf = len(self.left), self.left == LEAF
        inner = np.flatnonzero(~leaf)
        children = np.concatenate([self.left[inner], self.right[inner]])
        if self.counts.shape != (size, len(self.classes)) or not self.counts.size:
            raise TreeError(f'{len(self.classes)} classes do not fit counts {self.counts.shape}')
        if list(self.classes) != sorted(set(self.classes)):
            raise TreeError(f'the classes of a tree are not ascending: {self.classes}')
        if (self.counts < 0).any() or not self.counts.any(axis=1).all():
            raise TreeError('a node of a tree has no examples')
        nodes = np.concatenate([self.roots, children])
        if self.roots[:1] != (0,) or not np.array_equal(np.sort(nodes), np.arange(size)):
            raise TreeError('every node of a tree but the root must be the child of exactly one')
        if (children <= np.concatenate([inner, inner])).any():
            raise TreeError('a node of a tree comes before its parent')
        if (self.right[leaf] != LEAF).any() or (self.feature[leaf] != LEAF).any():
            raise TreeError('a leaf of a tree has a test or a child')
        if not np.isfinite(self.threshold).all():
            raise TreeError('a threshold of a tree is not finite')
        if not ((self.feature[inner] >= 0) & (self.feature[inner] < self.n_features)).all():
            raise TreeError(f'a tree of {self.n_features} features tests another one')

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tree) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
        )

    def __hash__(self) -> int:
        return hash((self.feature.tobytes(), self.counts.tobytes(), self.classes))

    def leaves(self, X: NDArray[np.float32]) -> Ints:
        """Return (N, R): the leaf of each row of X (N, C) in each tree."""
        if X.ndim != 2 or X.shape[1] != self.n_features:
            raise TreeError(f'the tree takes rows of {self.n_features} features, not {X.shape}')
        values, n_trees = X.astype(np.float32, copy=False), len(self.roots)
        if len(X) == 1 or len(X) * n_trees <= FEW_PATHS:
            ways, found = self._ways, list[int]()
            for row in values.tolist():
                for place in self.roots:
                    while place in ways:
                        left, right, feature, threshold = ways[place]
                        place = right if row[feature] > threshold else left
                    found.append(place)
            return np.array(found, dtype=np.intp).reshape(-1, n_trees)
        if len(self.left) <= FEW_NODES and n_trees == 1:  # from leaves to root, all rows at once
            leaf: list[Any] = [*range(len(self.left))]
            for at, left, right, feature, threshold in self._tests:
                leaf[at] = np.where(values[:, feature] > threshold, leaf[right], leaf[left])
            return np.full((len(X), 1), np.reshape(leaf[0], (-1, 1)))
        node = np.tile(np.array(self.roots, dtype=np.intp), len(X))
        going = np.flatnonzero(self.left[node] != LEAF)
        while going.size:
            level = node[going]
            goes_right = values[going // n_trees, self.feature[level]] > self.threshold[level]
            node[going] = level = np.where(goes_right, self.right[level], self.left[level])
            going = going[self.left[level] != LEAF]
        return node.reshape(-1, n_trees)

    def probabilities(self, X: NDArray[np.float32]) -> Floats:
        """Return (N, K): the class shares in the leaves of each row of X (N, C)."""
        shares: Floats = self.shares[self.leaves(X)].mean(axis=1)
        return shares

    def probability_of(self, number: int, X: NDArray[np.float32]) -> Floats:
        """Return (N,): ``probabilities`` of one class, given by its position in ``classes``."""
        share: Floats = self.shares[:, number].take(self.leaves(X))
        return share[:, 0] if len(self.roots) == 1 else share.mean(axis=1)

    def most_probable(self, X: NDArray[np.float32]) -> Ints:
        """Return (N,): the position of the most likely class; the first on ties."""
        if len(self.roots) > 1:
            best: Ints = self.probabilities(X).argmax(axis=1)
            return best
        return self._best.take(self.leaves(X)[:, 0])

    @property
    def depth(self) -> int:
        """Number of tests on the longest path from a root to a leaf."""
        level = np.zeros(len(self.left), dtype=np.int64)
        for node in np.flatnonzero(self.left != LEAF):
            level[[self.left[node], self.right[node]]] = level[node] + 1
        return int(level.max())

    @cached_property
    def _tests(self) -> list[tuple[Any, ...]]:
        """Node, left, right, feature and threshold of each test, children before parents."""
        parts = (part.tolist() for part in (self.left, self.right, self.feature))
        tests = zip(range(len(self.left)), *parts, self.threshold)  # not rounded to float32
        return [test for test in tests if test[1] != LEAF][::-1]

    @cached_property
    def _ways(self) -> dict[int, tuple[int, int, int, float]]:
        """Left, right, feature and threshold of each test, by node."""
        return {
            at: (left, right, feature, float(t)) for at, left, right, feature, t in self._tests
        }

    @cached_property
    def tested(self) -> Ints:
        """Indices of the encoded features that the tree tests, ascending."""
        return np.unique(self.feature[self.left != LEAF]).astype(np.intp)

    @cached_property
    def _best(self) -> Ints:
        """(N,) position of the most likely class of each node."""
        best: Ints = self.shares.argmax(axis=1)
        return best

    @cached_property
    def shares(self) -> Floats:
        """(N, K) share of each class among the examples of a node."""
        shares: Floats = self.counts / self.counts.sum(axis=1, keepdims=True)
        return shares


def fit_tree(
    X: NDArray[np.float32],
    y: NDArray[np.integer],
    classes: Sequence[int],
    seed: int,
    *,
    n_trees: int = 1,
    min_leaf: int = 1,
    min_gain: float = 0.0,
) -> Tree:
    """
    Fit a tree that separates the examples as far as their features allow (CART, Gini impurity).

    :param X: (N, C) rows, N > 0.
    :param y: (N,) labels.
    :param classes: all possible labels, ascending; those not in y have count 0.
    :param seed: random seed for choosing between equally good splits.
    :param n_trees: number of trees; more than one: a forest, by bagging (Breiman 1996).
    :param min_leaf: minimum number of examples in a leaf.
    :param min_gain: minimum decrease of Gini impurity, in examples, per leaf of a subtree; other
        subtrees are pruned (minimal cost-complexity pruning; Breiman et al. 1984).
    :raises ValueError: there are no rows, or a label is not among the classes.
    """
    if len(X) == 0 or not np.isin(y, classes).all():
        raise ValueError('a tree is fitted to one row or more, labelled with its classes')
    from sklearn import config_context  # slow to import

    # Use the public classes: their internals are twice as fast, but differ between versions.
    usual: dict[str, Any] = {
        'random_state': seed,
        'min_samples_leaf': min_leaf,
        'ccp_alpha': min_gain / len(X),
    }
    with config_context(assume_finite=True, skip_parameter_validation=True):
        if n_trees == 1:
            from sklearn.tree import DecisionTreeClassifier

            classifier = DecisionTreeClassifier(**usual)
            # Rows and labels have the required types.
            trees = [classifier.fit(X, y, check_input=False).tree_]
        else:
            from sklearn.ensemble import RandomForestClassifier

            # People choose few features; random subsets of them would often lack the relevant one.
            classifier = RandomForestClassifier(n_trees, max_features=None, **usual).fit(X, y)
            trees = [each.tree_ for each in classifier.estimators_]
    ends = np.cumsum([tree.node_count for tree in trees])
    roots = ends - [tree.node_count for tree in trees]
    left, right = (
        np.concatenate(
            [
                np.where((to := getattr(t, side)) == LEAF, LEAF, to + r)
                for t, r in zip(trees, roots)
            ]
        )
        for side in ('children_left', 'children_right')
    )
    feature, threshold, shares = (
        np.concatenate(parts)
        for parts in zip(
            *(
                (t.feature, t.threshold, t.value[:, 0] * t.weighted_n_node_samples[:, None])
                for t in trees
            )
        )
    )
    leaf = left == LEAF
    counts = np.zeros((len(left), len(classes)), dtype=np.int64)
    counts[:, np.searchsorted(classes, classifier.classes_)] = np.rint(shares)
    return Tree(
        left.astype(np.int32),
        right.astype(np.int32),
        np.where(leaf, LEAF, feature).astype(np.int32),
        np.where(leaf, 0.0, threshold),
        counts,
        tuple(classes),
        X.shape[1],
        tuple(roots.tolist()),
    )
