"""Fitting decision trees with scikit-learn, which is imported when the first one is fitted."""

from collections.abc import Sequence

from humanopts_learner.trees.tree import LEAF, Tree
import numpy as np
from numpy.typing import NDArray


def fit_tree(
    X: NDArray[np.float32], y: NDArray[np.integer], classes: Sequence[int], seed: int
) -> Tree:
    """
    Fit a tree that separates the examples as far as their columns can.

    :param X: (N, C) rows, N > 0.
    :param y: (N,) labels.
    :param classes: every label that there could be, ascending; those not in y have count 0.
    :param seed: decides between equally good splits.
    :raises ValueError: there is no row, or a label is not among the classes.
    """
    if len(X) == 0 or not np.isin(y, classes).all():
        raise ValueError('a tree is fitted to one row or more, labelled with its classes')
    from sklearn import config_context
    from sklearn.tree import DecisionTreeClassifier

    classifier = DecisionTreeClassifier(random_state=seed)
    with config_context(assume_finite=True, skip_parameter_validation=True):
        fitted = classifier.fit(X, y).tree_
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
