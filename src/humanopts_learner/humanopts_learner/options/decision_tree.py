"""
Decision trees: fitted by scikit-learn, kept and evaluated as plain arrays.

A tree looks at encoded features: an ordinal or continuous feature is a number, a nominal one is
one-hot. They are float32, as scikit-learn sees them, when it is fitted and when it is evaluated.
scikit-learn is imported when the first tree is fitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
import sys
from types import ModuleType
from typing import Any

from humanopts_env.arrays import Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, feature_columns, FeatureKind
import numpy as np
from numpy.typing import NDArray

LEAF = -1  # left, right and feature of a leaf
MANY_ROWS = 100  # for each node: from there on it is quicker to go node by node


class TreeError(ValueError):
    """Data is not a decision tree; the text names what is wrong with it."""


@dataclass(frozen=True, slots=True)
class EncodedFeature:
    """One number that a tree sees: a feature, or whether a nominal one has a value."""

    feature: str
    index: int  # of the feature among all features of the domain
    value: int | None = None  # None: the feature itself; else 1 where it has this value, 0 else

    def to_dict(self) -> dict[str, Any]:
        return {'feature': self.feature, 'index': self.index, 'value': self.value}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> 'EncodedFeature':
        """
        Read what ``to_dict`` wrote.

        :raises TreeError: it is not an encoded feature.
        """
        try:
            name, index, value = data['feature'], data['index'], data['value']
        except (KeyError, TypeError) as error:
            raise TreeError(f'an encoded feature has no {error}') from None
        numbers = [index] if value is None else [index, value]
        if not isinstance(name, str) or any(type(n) is not int or n < 0 for n in numbers):
            raise TreeError(f'an encoded feature is not a feature, an index and a value: {data}')
        return cls(name, index, value)


def feature_encoding(domain: ActableDomain, features: Sequence[str]) -> tuple[EncodedFeature, ...]:
    """
    Return how selected features are encoded: nominal ones one-hot, the others as they are.

    :raises DomainError: a name is not a feature of the domain.
    """
    encoding: list[EncodedFeature] = []
    for index in feature_columns(domain, features):
        feature = domain.features[index]
        if feature.kind is FeatureKind.NOMINAL:
            values = range(len(feature.values))
            encoding += [EncodedFeature(feature.name, index, value) for value in values]
        else:
            encoding.append(EncodedFeature(feature.name, index))
    return tuple(encoding)


def encode_rows(encoding: Sequence[EncodedFeature], rows: Rows) -> NDArray[np.float32]:
    """
    Return what the trees see.

    :param rows: (N, F), all features of the domain.
    :return: (N, C), one encoded feature after the other in memory, as large trees are walked.
    """
    return Encoder(encoding)(rows)


class Encoder:
    """Encodes rows, again and again, with the encoding as arrays."""

    def __init__(self, encoding: Sequence[EncodedFeature]) -> None:
        values = [encoded.value for encoded in encoding]
        self._index = np.array([encoded.index for encoded in encoding], dtype=np.intp)
        self._one_hot = np.array([value is not None for value in values], dtype=np.bool_)
        self._wanted = np.array([value or 0 for value in values], dtype=np.float64)

    def __call__(self, rows: Rows, tested: Ints | slice = slice(None)) -> NDArray[np.float32]:
        """
        Return what ``encode_rows`` does.

        :param tested: the encoded features that matter; the others may have any values.
        """
        picked, one_hot = rows.T[self._index[tested]], self._one_hot[tested]
        if one_hot.any():
            equal = picked == self._wanted[tested][:, None]
            picked = np.where(one_hot[:, None], equal, picked)
        encoded = np.empty((len(self._index), len(rows)), dtype=np.float32)
        encoded[tested] = picked
        return encoded.T


@dataclass(frozen=True, eq=False)
class Tree:
    """
    A decision tree that keeps how often each class was seen.

    Axes: N nodes, the root first and every child after its parent; K classes. A row goes left
    where its feature is at most the threshold.
    """

    left: NDArray[np.int32]  # (N,)
    right: NDArray[np.int32]  # (N,)
    feature: NDArray[np.int32]  # (N,) index of the encoded feature that is tested
    threshold: Floats  # (N,) 0 in leaves
    counts: NDArray[np.int64]  # (N, K) training examples of each class in the node
    classes: tuple[int, ...]  # (K,) labels, ascending
    n_features: int  # encoded features of the rows that it takes, C

    def __post_init__(self) -> None:
        """Check the arrays against each other: evaluation may then trust them."""
        _check(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tree) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.feature.tobytes(), self.counts.tobytes(), self.classes))

    def leaves(self, X: NDArray[np.float32]) -> Ints:
        """Return (N,): the node in which each row of X (N, C) ends."""
        if X.ndim != 2 or X.shape[1] != self.n_features:
            raise TreeError(f'the tree takes rows of {self.n_features} features, not {X.shape}')
        values = X.astype(np.float32, copy=False)
        if len(X) > MANY_ROWS * len(self.left):
            return self._leaves_node_by_node(np.ascontiguousarray(values.T))
        rows, node = np.arange(len(X)), np.zeros(len(X), dtype=np.intp)
        feature, children = self._self_looping
        for _ in range(self.depth):
            goes_right = values[rows, feature[node]] > self.threshold[node]
            node = children[goes_right.astype(np.intp), node]
        return node

    def _leaves_node_by_node(self, values: NDArray[np.float32]) -> Ints:
        """Return the leaf of each row of X.T (C, N), taking all rows of a node at once."""
        result = np.zeros(values.shape[1], dtype=np.intp)
        inside = {0: np.arange(len(result))}
        for node in range(len(self.left)):  # a child comes after its parent
            rows = inside.pop(node)
            if self.left[node] == LEAF:
                result[rows] = node
                continue
            right = values[self.feature[node]][rows] > self.threshold[node]
            inside[int(self.left[node])] = rows[~right]
            inside[int(self.right[node])] = rows[right]
        return result

    def probabilities(self, X: NDArray[np.float32]) -> Floats:
        """Return (N, K): the share of each class in the leaf of each row of X (N, C)."""
        return self.shares[self.leaves(X)]

    def probability_of(self, number: int, X: NDArray[np.float32]) -> Floats:
        """Return (N,): ``probabilities`` of one class, given by its place among the classes."""
        share: Floats = self.shares[:, number].take(self.leaves(X))
        return share

    def likeliest(self, X: NDArray[np.float32]) -> Ints:
        """Return (N,): the place of the likeliest class, the first of equals."""
        best: Ints = self.shares.argmax(axis=1).take(self.leaves(X))
        return best

    @cached_property
    def tested(self) -> Ints:
        """Indices of the encoded features that it tests, ascending."""
        return np.unique(self.feature[self.left != LEAF]).astype(np.intp)

    @cached_property
    def depth(self) -> int:
        """Number of tests on the longest way from the root to a leaf."""
        level = np.zeros(len(self.left), dtype=np.int64)
        for node in np.flatnonzero(self.left != LEAF):
            level[[self.left[node], self.right[node]]] = level[node] + 1
        return int(level.max())

    @cached_property
    def _self_looping(self) -> tuple[Ints, Ints]:
        """
        Features (N,) and children (2, N) where every leaf is its own child.

        Leaves look at the first feature that is tested anywhere: others need not be encoded.
        """
        leaf, itself = self.left == LEAF, np.arange(len(self.left))
        any_tested = self.tested[0] if len(self.tested) else 0
        children = np.stack([np.where(leaf, itself, side) for side in (self.left, self.right)])
        return np.where(leaf, any_tested, self.feature).astype(np.intp), children.astype(np.intp)

    @cached_property
    def shares(self) -> Floats:
        """(N, K) share of each class among the examples in a node."""
        shares: Floats = self.counts / self.counts.sum(axis=1, keepdims=True)
        return shares

    def to_dict(self) -> dict[str, Any]:
        parts = (self.feature, self.threshold, self.left, self.right, self.counts)
        nodes = []
        for feature, threshold, left, right, counts in zip(*(part.tolist() for part in parts)):
            test = {'column': feature, 'at_most': threshold, 'left': left, 'right': right}
            nodes.append({'counts': counts} if left == LEAF else {**test, 'counts': counts})
        return {'columns': self.n_features, 'classes': list(self.classes), 'nodes': nodes}

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
            feature, threshold, left, right = zip(*nodes)
            return cls(
                np.array(left, dtype=np.int32),
                np.array(right, dtype=np.int32),
                np.array(feature, dtype=np.int32),
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


def fit_tree(
    X: NDArray[np.float32], y: NDArray[np.integer], classes: Sequence[int], seed: int
) -> Tree:
    """
    Fit a tree that separates the examples as far as their features can (CART, Gini impurity).

    :param X: (N, C) rows, N > 0.
    :param y: (N,) labels.
    :param classes: every label that there could be, ascending; those not in y have count 0.
    :param seed: decides between equally good splits.
    :raises ValueError: there is no row, or a label is not among the classes.
    """
    if len(X) == 0 or not np.isin(y, classes).all():
        raise ValueError('a tree is fitted to one row or more, labelled with its classes')
    import_scikit_learn()
    from sklearn import config_context
    from sklearn.tree import DecisionTreeClassifier

    # The public class: its parts would take half the time, and differ between versions.
    classifier = DecisionTreeClassifier(random_state=seed)
    with config_context(assume_finite=True, skip_parameter_validation=True):
        fitted = classifier.fit(X, y, check_input=False).tree_  # both are of the right type
    leaf = fitted.children_left == LEAF
    counts = np.zeros((fitted.node_count, len(classes)), dtype=np.int64)
    shares = fitted.value[:, 0, :] * fitted.weighted_n_node_samples[:, None]
    counts[:, np.searchsorted(classes, classifier.classes_)] = np.rint(shares)
    return Tree(
        fitted.children_left.astype(np.int32),
        fitted.children_right.astype(np.int32),
        np.where(leaf, LEAF, fitted.feature).astype(np.int32),
        np.where(leaf, 0.0, fitted.threshold),
        counts,
        tuple(classes),
        X.shape[1],
    )


class _Postponed(ModuleType):
    """Stands for a module while others import functions of it; it is imported when one is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):  # it has no file, which loggers of other threads look for
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is not self:
            return getattr(import_module(self.__name__), name)

        def call(*args: Any, **options: Any) -> Any:
            return getattr(import_module(self.__name__), name)(*args, **options)

        return call


@cache
def import_scikit_learn() -> None:
    """
    Import scikit-learn, but not pandas, nor the statistics of SciPy.

    scikit-learn imports pandas where it is installed, and has no use for it with arrays: 30 MB, or
    60 where pyarrow is installed too. Of ``scipy.stats`` it needs three functions, and none for
    trees. Both take half of the time until the first tree of a process is fitted.
    """
    instead: dict[str, Any] = {
        'pandas': None,  # as if it were not installed
        'scipy.stats': _Postponed('scipy.stats'),
    }
    instead = {name: module for name, module in instead.items() if name not in sys.modules}
    sys.modules.update(instead)
    try:
        import sklearn.tree  # noqa: F401
    finally:
        for name in instead:
            del sys.modules[name]


def _node(entry: Mapping[str, Any]) -> tuple[int, float, int, int]:
    """Return the feature, threshold, left and right child of a node in JSON data."""
    if 'column' not in entry:
        return LEAF, 0.0, LEAF, LEAF
    whole = entry['column'], entry['left'], entry['right']
    if any(type(number) is not int or number < 0 for number in whole):
        raise TreeError(f'a node of a tree does not name its feature and children: {entry}')
    if type(entry['at_most']) not in (int, float):
        raise TreeError(f'a node of a tree compares with something that is not a number: {entry}')
    return entry['column'], float(entry['at_most']), entry['left'], entry['right']


def _check(tree: Tree) -> None:
    size = len(tree.left)
    sizes = {len(part) for part in (tree.right, tree.feature, tree.threshold, tree.counts)}
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
    if (tree.right[leaves] != LEAF).any() or (tree.feature[leaves] != LEAF).any():
        raise TreeError('a leaf of a tree has a test or a child')
    if not np.isfinite(tree.threshold).all():
        raise TreeError('a threshold of a tree is not finite')
    if (tree.feature[inner] < 0).any() or (tree.feature[inner] >= tree.n_features).any():
        raise TreeError(f'a node of a tree tests a feature that is not among {tree.n_features}')
