"""Decision trees as data: scikit-learn's answers, also by tables; damaged ones are refused."""

from collections.abc import Callable
import copy
from dataclasses import replace
import json
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
    MANY_ROWS,
    Tree,
    TreeError,
)
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from sklearn.tree import DecisionTreeClassifier

TAXI = Taxi()


def small_tree() -> Tree:
    """Return a tree of two tests: x0 <= 0.5 is class 0, else x1 <= 1.5 tells 1 from 2."""
    X = np.array([[0, 0], [0, 2], [1, 1], [1, 2], [1, 2]], dtype=np.float32)
    return fit_tree(X, np.array([0, 0, 1, 2, 2]), (0, 1, 2, 3), 0)


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
    assert tree.counts[0].tolist() == np.bincount(y, minlength=6).tolist()


def test_equal_seeds_give_equal_trees() -> None:
    assert small_tree() == small_tree()
    assert hash(small_tree()) == hash(small_tree())


def test_fitting_refuses_no_rows_and_unknown_labels() -> None:
    with pytest.raises(ValueError, match='one row or more'):
        fit_tree(np.zeros((0, 1), dtype=np.float32), np.zeros(0, dtype=int), (0, 1), 0)
    with pytest.raises(ValueError, match='labelled with its classes'):
        fit_tree(np.zeros((1, 1), dtype=np.float32), np.array([7]), (0, 1), 0)


@settings(max_examples=30)
@given(st.integers(0, 2**31 - 1))
def test_many_rows_end_in_the_leaves_that_each_alone_ends_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X = rng.integers(0, 4, (20, 3)).astype(np.float32)
    tree = fit_tree(X, rng.integers(0, 3, 20), (0, 1, 2), 0)
    rows = rng.integers(0, 4, (MANY_ROWS * len(tree.left) + 1, 3)).astype(np.float32)
    together, halves = tree.leaves(rows), np.array_split(rows, 8)
    assert together.tolist() == np.concatenate([tree.leaves(half) for half in halves]).tolist()
    shares = tree.probabilities(rows)
    assert tree.likeliest(rows).tolist() == shares.argmax(axis=1).tolist()
    assert tree.probability_of(1, rows).tolist() == shares[:, 1].tolist()


def test_rows_of_another_width_are_refused() -> None:
    with pytest.raises(TreeError, match='2 features'):
        small_tree().probabilities(np.zeros((1, 3), dtype=np.float32))


def test_a_tree_comes_back_from_json() -> None:
    tree = small_tree()
    assert Tree.from_dict(json.loads(json.dumps(tree.to_dict()))) == tree


Damage = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ('damage', 'message'),
    [
        (lambda d: d.pop('nodes'), "no 'nodes'"),
        (lambda d: d.update(nodes=[]), 'not a tree'),
        (lambda d: d.update(nodes=3), 'not a tree'),
        (lambda d: d.update(columns=1), 'not among 1'),
        (lambda d: d.update(columns='2'), 'whole numbers'),
        (lambda d: d.update(classes=[0, 1, 2]), 'of 3 classes'),
        (lambda d: d.update(classes=[0, 2, 1, 3]), 'not ascending'),
        (lambda d: d['nodes'].pop(), 'child of exactly one'),
        (lambda d: d['nodes'][0].update(left=0), 'child of exactly one'),
        (lambda d: d['nodes'][0].update(left=99), 'child of exactly one'),
        (lambda d: d['nodes'][0].update(left=2), 'child of exactly one'),
        (lambda d: d['nodes'][0].update(left=-1), 'name its feature'),
        (lambda d: d['nodes'][0].update(column=7), 'not among 2'),
        (lambda d: d['nodes'][0].update(at_most=float('nan')), 'not finite'),
        (lambda d: d['nodes'][0].update(at_most='0.5'), 'not a number'),
        (lambda d: d['nodes'][0].pop('right'), "no 'right'"),
        (lambda d: d['nodes'][1].update(counts=[0, 0, 0, 0]), 'no examples'),
        (lambda d: d['nodes'][1].update(counts=[5, -1, 0, 0]), 'fewer than none'),
        (lambda d: d['nodes'][1].update(counts=[1.5, 0, 0, 0]), 'whole numbers'),
        (lambda d: d['nodes'][1].update(counts=[1]), 'not a tree'),
        (lambda d: d['nodes'][1].update(counts=[10**30, 0, 0, 0]), 'not a tree'),
    ],
)
def test_a_damaged_tree_is_refused(damage: Damage, message: str) -> None:
    data = copy.deepcopy(small_tree().to_dict())
    damage(data)
    with pytest.raises(TreeError, match=message):
        Tree.from_dict(data)


def test_arrays_of_different_lengths_and_leaves_with_tests_are_refused() -> None:
    tree = small_tree()
    with pytest.raises(TreeError, match='as many of everything'):
        replace(tree, threshold=tree.threshold[1:])
    with pytest.raises(TreeError, match='a leaf of a tree has a test'):
        replace(tree, feature=np.zeros_like(tree.feature))


def test_nodes_in_a_circle_are_refused() -> None:
    leaf = {'counts': [1, 0]}
    test = {'column': 0, 'at_most': 0.5, 'counts': [1, 0]}
    nodes = [leaf, {**test, 'left': 2, 'right': 3}, {**test, 'left': 1, 'right': 4}, leaf, leaf]
    with pytest.raises(TreeError, match='before its parent'):
        Tree.from_dict({'columns': 1, 'classes': [0, 1], 'nodes': nodes})


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


def test_a_feature_of_another_domain_cannot_be_encoded() -> None:
    with pytest.raises(DomainError, match='ghost'):
        feature_encoding(TAXI, ['ghost_row'])


@pytest.mark.parametrize('data', [{}, {'feature': 1, 'index': 0, 'value': None}, []])
def test_a_damaged_column_is_refused(data: Any) -> None:
    with pytest.raises(TreeError, match='encoded feature'):
        EncodedFeature.from_dict(data)


@pytest.mark.parametrize('index', [-1, 1.0, True])
def test_a_column_index_is_a_whole_number(index: Any) -> None:
    with pytest.raises(TreeError, match='encoded feature'):
        EncodedFeature.from_dict({'feature': 'taxi_row', 'index': index, 'value': None})


def test_an_option_can_be_used_without_loading_scikit_learn() -> None:
    code = (
        'import sys, humanopts_learner.options.files, humanopts_learner.options.starts;'
        'sys.exit("sklearn" in sys.modules)'
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


def test_a_tree_is_fitted_without_pandas_and_statistics_which_can_be_used_afterwards() -> None:
    code = (
        'import sys, numpy; from humanopts_learner.options.decision_tree import fit_tree;'
        'fit_tree(numpy.eye(2, dtype=numpy.float32), numpy.array([0, 1]), (0, 1), 0);'
        'assert not {"pandas", "pyarrow", "scipy.stats"} & sys.modules.keys();'
        'import pandas; from sklearn.tree import DecisionTreeClassifier;'
        'frame = pandas.DataFrame({"a": [0, 1]});'
        'assert DecisionTreeClassifier().fit(frame, [0, 1]).feature_names_in_ == ["a"];'
        'from sklearn.metrics import label_ranking_average_precision_score as score;'
        'assert score([[0, 1, 1]], [[.3, .2, .1]]) == (1 / 2 + 2 / 3) / 2;'
        'import scipy.stats; assert scipy.stats.gmean([1, 4]) == 2'
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


def test_modules_can_be_looked_through_while_scikit_learn_is_imported() -> None:
    """As the logger of rclpy does in another thread."""
    code = (
        'import inspect, sys; from humanopts_learner.options.decision_tree import *\n'
        'looked = []\n'
        'def look(event, words):\n'
        '    if event == "import" and words[0] == "sklearn.tree._classes":\n'
        '        assert "scipy.stats" in sys.modules\n'
        '        looked.append(inspect.getmodule(sys._getframe(), "nowhere"))\n'
        'sys.addaudithook(look); import_scikit_learn(); assert looked'
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0
