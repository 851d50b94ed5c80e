"""Look-up tables decide as the trees that they are made of."""

from dataclasses import replace

from humanopts_env.arrays import Rows
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import parameters_json
from humanopts_env.seeding import generator
from humanopts_learner.options import lookup
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding, fit_tree, Tree
from humanopts_learner.options.lookup import decisions
from humanopts_learner.options.option import LearnedOption, MEMBERSHIP
import numpy as np
import pytest

DOMAIN = PacMan()
# ordinal and nominal features
FEATURES = ('pacman_row', 'food_direction', 'food_distance', 'danger_distance', 'ate')


def _rows(seed: int, count: int) -> Rows:
    rng = generator(seed, 'rows')
    values = [rng.integers(len(f.values), size=count) for f in DOMAIN.features]
    return np.stack(values, axis=1).astype(np.int32)


def _option(seed: int, examples: int) -> LearnedOption:
    """Return an option whose trees fit random labels, so that they are as wild as trees get."""
    encoding = feature_encoding(DOMAIN, FEATURES)
    rng, actions = generator(seed, 'labels'), tuple(action.name for action in DOMAIN.actions)
    X = encode_rows(encoding, _rows(seed, examples))

    def tree(classes: tuple[int, ...]) -> Tree:
        return fit_tree(X, rng.integers(len(classes), size=examples), classes, seed)

    return LearnedOption(
        name='any',
        participant='nobody',
        domain=DOMAIN.name,
        domain_parameters=parameters_json(DOMAIN),
        actions=actions,
        features=FEATURES,
        encoding=encoding,
        policy=tree(tuple(range(len(actions)))),
        initiation=tree(MEMBERSHIP),
        termination=tree(MEMBERSHIP),
        n_demonstrations=1,
        n_not_here=0,
        max_steps=10,
        uuids=(),
    )


def _same(option: LearnedOption, rows: Rows) -> None:
    found = decisions(option, DOMAIN)
    for name in ('greedy_action', 'can_start', 'ends'):
        expected, given = getattr(option, name)(rows), getattr(found, name)(rows)
        assert given.dtype == expected.dtype
        np.testing.assert_array_equal(given, expected)


@pytest.mark.parametrize('examples', [1, 2, 30, 300])
def test_tables_decide_as_the_trees_do(examples: int) -> None:
    for seed in range(3):
        _same(_option(seed, examples), _rows(seed + 100, 2000))


def test_a_tree_with_too_many_combinations_is_walked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lookup, 'LARGEST', 3)
    option = _option(7, 40)
    found = decisions(option, DOMAIN)
    assert found.greedy_action == option.greedy_action
    _same(option, _rows(8, 500))


def test_a_policy_that_looks_at_other_features_has_its_own_table() -> None:
    one = _option(3, 60)
    other = feature_encoding(DOMAIN, ('pill_direction', 'pacman_col'))
    rng = generator(3, 'other')
    policy = fit_tree(encode_rows(other, _rows(4, 60)), rng.integers(4, size=60), range(4), 1)
    _same(replace(one, policy=policy, policy_encoding=other), _rows(9, 500))


def test_other_trees_have_other_tables() -> None:
    one, other = _option(1, 50), _option(2, 50)
    mixed = replace(one, policy=other.policy)
    for option in (one, other, mixed):
        _same(option, _rows(9, 500))
