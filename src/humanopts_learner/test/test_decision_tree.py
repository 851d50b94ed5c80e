"""Decision trees: the answers of scikit-learn, features as trees see them, and bad arrays."""

from dataclasses import replace
import subprocess
import sys
from typing import Any

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.taxi import Taxi
from humanopts_learner.options.decision_tree import (
    encode_rows,
    EncodedFeature,
    feature_encoding,
    fit_tree,
    LEAF,
    TreeError,
)
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier
from sklearn.tree import DecisionTreeClassifier

TAXI = Taxi()


@settings(max_examples=40)
@given(st.integers(0, 2**31 - 1), st.integers(1, 60), st.integers(1, 6), st.booleans())
def test_own_evaluator_agrees_with_scikit_learn(
    seed: int, rows: int, columns: int, whole: bool
) -> None:
    rng = np.random.default_rng(seed)
    X, Z = rng.normal(scale=3, size=(2, 60, columns)).astype(np.float32)
    if whole:
        X, Z = np.rint(X), np.rint(Z)
    X, y = X[:rows], rng.choice([0, 2, 5], rows)
    judge = DecisionTreeClassifier(random_state=seed).fit(X, y)
    expected = np.zeros((len(Z), 6))
    expected[:, judge.classes_] = judge.predict_proba(Z)
    tree = fit_tree(X, y, range(6), seed)
    assert tree.probabilities(Z) == pytest.approx(expected)
    assert tree.most_probable(Z).tolist() == expected.argmax(axis=1).tolist()
    assert [tree.leaves(row[None])[0].tolist() for row in Z] == tree.leaves(Z).tolist()
    assert tree.probability_of(2, Z).tolist() == tree.probabilities(Z)[:, 2].tolist()
    assert tree == (again := fit_tree(X, y, range(6), seed))
    assert hash(tree) == hash(again)
    assert tree.counts[0].tolist() == np.bincount(y, minlength=6).tolist()


@settings(max_examples=20)
@given(st.integers(0, 2**31 - 1), st.integers(2, 60), st.integers(1, 7), st.floats(0.0, 4.0))
def test_a_forest_agrees_with_scikit_learn(
    seed: int, rows: int, min_leaf: int, min_gain: float
) -> None:
    """The probabilities of its trees are averaged, for many rows and for one."""
    rng = np.random.default_rng(seed)
    X, Z = rng.normal(scale=3, size=(2, 60, 3)).astype(np.float32)
    X, y = X[:rows], rng.choice([0, 2, 5], rows)
    theirs = RandomForestClassifier(
        7,
        max_features=None,
        random_state=seed,
        min_samples_leaf=min_leaf,
        ccp_alpha=min_gain / rows,
    ).fit(X, y)
    expected = np.zeros((len(Z), 6))
    expected[:, theirs.classes_] = theirs.predict_proba(Z)
    forest = fit_tree(X, y, range(6), seed, n_trees=7, min_leaf=min_leaf, min_gain=min_gain)
    assert len(forest.roots) == 7
    assert forest.probabilities(Z) == pytest.approx(expected)
    assert forest.probability_of(2, Z) == pytest.approx(expected[:, 2])
    assert forest.most_probable(Z).tolist() == forest.probabilities(Z).argmax(axis=1).tolist()
    assert [forest.leaves(row[None])[0].tolist() for row in Z] == forest.leaves(Z).tolist()
    assert forest.counts[list(forest.roots)].sum(axis=1).tolist() == [rows] * 7
    assert forest.depth == max(each.get_depth() for each in theirs.estimators_)


def test_fitting_refuses_no_rows_and_unknown_labels() -> None:
    with pytest.raises(ValueError, match='one row or more'):
        fit_tree(np.zeros((0, 1), dtype=np.float32), np.zeros(0, dtype=int), (0, 1), 0)
    with pytest.raises(ValueError, match='labelled with its classes'):
        fit_tree(np.zeros((1, 1), dtype=np.float32), np.array([7]), (0, 1), 0)


def array(*values: float) -> Any:
    """Return the type of array that a tree has for its nodes."""
    return np.array(values, dtype=np.int32)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'counts': np.ones((3, 2))}, 'fit counts'),
        ({'classes': (0, 2, 1)}, 'not ascending'),
        ({'counts': np.array([[1, 1, 1], [0, 0, 0], [1, 0, 1]])}, 'no examples'),
        ({'counts': np.array([[1, 1, 1], [2, -1, 0], [1, 0, 1]])}, 'no examples'),
        ({'left': array(1, 1, LEAF)}, 'child of exactly one'),
        ({'left': array(9, LEAF, LEAF)}, 'child of exactly one'),
        ({'left': array(LEAF, 2, LEAF), 'right': array(LEAF, 1, LEAF)}, 'before its parent'),
        ({'feature': array(0, 0, LEAF)}, 'a leaf of a tree has a test'),
        ({'threshold': np.array([np.nan, 0, 0])}, 'not finite'),
        ({'n_features': 0}, 'tests another one'),
        ({'roots': (1,)}, 'child of exactly one'),
        ({'roots': (0, 1)}, 'child of exactly one'),
        ({'roots': ()}, 'child of exactly one'),
        ({'feature': array(LEAF, LEAF, LEAF)}, 'tests another one'),
    ],
)
def test_arrays_that_are_not_a_tree_are_refused(change: dict[str, Any], message: str) -> None:
    tree = fit_tree(np.array([[0], [1]], dtype=np.float32), np.array([0, 2]), (0, 1, 2), 0)
    assert (tree.left.tolist(), tree.depth) == ([1, LEAF, LEAF], 1)
    with pytest.raises(TreeError, match=message):
        replace(tree, **change)
    with pytest.raises(TreeError, match='1 features'):
        tree.probabilities(np.zeros((1, 3), dtype=np.float32))


def test_ordinal_features_stay_numbers_and_nominal_ones_become_one_hot() -> None:
    encoding = feature_encoding(TAXI, ['blocked_moves', 'taxi_row'])
    names = [feature.name for feature in TAXI.features]
    blocked = names.index('blocked_moves')
    assert encoding[0] == EncodedFeature('taxi_row', names.index('taxi_row'))
    assert [c.value for c in encoding[1:]] == list(range(len(TAXI.features[blocked].values)))
    rows = TAXI.feature_table()
    encoded = encode_rows(encoding, rows)
    assert encoded[:, 0].tolist() == rows[:, names.index('taxi_row')].tolist()
    assert encoded[:, 1:].argmax(axis=1).tolist() == rows[:, blocked].tolist()
    assert set(encoded[:, 1:].sum(axis=1)) == {1.0}
    with pytest.raises(DomainError, match='ghost'):
        feature_encoding(TAXI, ['ghost_row'])


def test_an_option_can_be_used_without_loading_scikit_learn() -> None:
    code = (
        'import sys, humanopts_learner.options.files, humanopts_learner.options.starts;'
        'sys.exit("sklearn" in sys.modules)'
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0
