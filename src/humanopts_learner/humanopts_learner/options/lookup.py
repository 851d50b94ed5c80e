"""
The decisions of an option as look-up tables, for plans that ask for them in millions of states.

A tree tests few features, and a test splits the values of one feature in two. So the values of a
feature fall into a few buckets that the tree does not tell apart, and every leaf is a box of
buckets. The answer in a state is then one look-up for each feature that is tested, and one in the
table of all combinations, in place of a walk from the root.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
from typing import Any

from humanopts_env.arrays import Flags, Rows
from humanopts_learner.options.decision_tree import EncodedFeature, LEAF, Tree
from humanopts_learner.options.option import HALF, LearnedOption, MEMBER
import numpy as np
from numpy.typing import NDArray

LARGEST = 2**20  # combinations of buckets; a tree with more of them is walked


@dataclass(frozen=True)
class Decisions:
    """What ``LearnedOption`` decides in N states, by the rows (N, F) of all features."""

    action: Callable[[Rows], NDArray[np.integer]]
    can_start: Callable[[Rows], Flags]
    ends: Callable[[Rows], Flags]


@dataclass(frozen=True)
class _Table:
    """
    The values of a tree's leaves, by row; other processes can have it.

    :ivar places: index of a feature, and what each of its values (V,) adds to the place in
        ``values``.
    """

    places: Sequence[tuple[int, NDArray[np.intp]]]
    values: NDArray[Any]

    def __call__(self, rows: Rows) -> NDArray[Any]:
        at = np.zeros(len(rows), dtype=np.intp)
        for feature, place in self.places:
            at += place.take(rows[:, feature].astype(np.intp))
        found: NDArray[Any] = self.values.take(at)
        return found


@lru_cache(maxsize=32)
def decisions(option: LearnedOption, counts: tuple[int, ...]) -> Decisions:
    """
    Return the decisions of an option; the next plan with the same option has them at once.

    :param counts: number of values of each of the F features of its domain; 0: it is continuous.
    """
    best = option.policy.shares.argmax(axis=1).astype(np.min_scalar_type(len(option.actions)))
    starts, ends = (
        tree.shares[:, MEMBER] >= HALF for tree in (option.initiation, option.termination)
    )
    return Decisions(
        tree_table(option.policy, option.policy_encoding, counts, best) or option.action,
        tree_table(option.initiation, option.encoding, counts, starts) or option.can_start,
        tree_table(option.termination, option.encoding, counts, ends) or option.ends,
    )


def tree_table(
    tree: Tree, encoding: Sequence[EncodedFeature], counts: Sequence[int], values: NDArray[Any]
) -> Callable[[Rows], NDArray[Any]] | None:
    """
    Return a function of rows (N, F) that gives the value of each row's leaf, (N,).

    :param counts: number of values of each of the F features; 0: it is continuous.
    :param values: one for each node of the tree.
    :return: None: there are more than ``LARGEST`` combinations, or it tests a continuous feature.
    """
    if not all(counts[encoding[column].index] for column in tree.tested):
        return None
    tests = {}  # by node: its feature, and which of the feature's values (V,) go left
    for node in np.flatnonzero(tree.left != LEAF).tolist():
        encoded = encoding[int(tree.feature[node])]
        value = np.arange(counts[encoded.index])
        seen = value if encoded.value is None else value == encoded.value
        tests[node] = encoded.index, seen.astype(np.float32) <= tree.threshold[node]
    features = sorted({encoding[column].index for column in tree.tested})
    buckets, firsts = {}, {}
    for feature in features:
        known = np.array([left for tested, left in tests.values() if tested == feature])
        _, first, bucket = np.unique(known, axis=1, return_index=True, return_inverse=True)
        buckets[feature], firsts[feature] = bucket.ravel().astype(np.intp), first
    shape = tuple(len(firsts[feature]) for feature in features)
    if math.prod(shape) > LARGEST:
        return None
    table = np.empty(shape, dtype=values.dtype)
    boxes = {0: tuple(np.ones(size, dtype=np.bool_) for size in shape)}
    for node in range(len(tree.left)):  # a child comes after its parent
        box = boxes.pop(node)
        if tree.left[node] == LEAF:
            table[np.ix_(*box)] = values[node]
            continue
        feature, goes_left = tests[node]
        axis, left = features.index(feature), goes_left[firsts[feature]]
        for child, side in ((tree.left[node], left), (tree.right[node], ~left)):
            boxes[int(child)] = (*box[:axis], box[axis] & side, *box[axis + 1 :])
    strides = np.cumprod([1, *shape[:0:-1]])[::-1]
    places = [(feature, buckets[feature] * stride) for feature, stride in zip(features, strides)]
    return _Table(tuple(places), table.ravel())
