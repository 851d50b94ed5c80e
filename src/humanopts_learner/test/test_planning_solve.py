"""Value iteration against solutions found in other ways."""

from dataclasses import replace
from functools import cache

from humanopts_env.arrays import Flags, Floats
from humanopts_learner import solve_smdp
from humanopts_learner.planning import solve
from humanopts_learner.planning.models import (
    concatenate,
    look_ahead,
    MultiTimeModel,
    primitive_model,
)
from humanopts_learner.planning.request import PlanError
from humanopts_learner.planning.solve import compiled_sweep, value_history
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from random_rules import random_rules
from scipy.sparse import csr_array

SEEDS = st.integers(0, 2**32 - 1)


def random_model(
    seed: int,
    n_states: int,
    n_options: int,
    closed: float = 0.3,
    outcomes: int = 1,
    leads_to: int = 0,
) -> MultiTimeModel:
    """
    Return a random SMDP.

    :param closed: probability that a pair is not available.
    :param outcomes: successors of each pair, or fewer where some are equal.
    :param leads_to: only the states below this number are successors; 0: all.
    """
    rng, pairs = np.random.default_rng(seed), n_states * n_options
    share = rng.dirichlet(np.ones(outcomes), pairs) * 0.9 ** rng.integers(1, 6, (pairs, 1))
    share[rng.random(pairs) < 0.1] = 0.0
    successor = rng.integers(leads_to or n_states, size=(pairs, outcomes))
    ends = np.arange(0, share.size + 1, outcomes)
    rows = csr_array((share.ravel(), successor.ravel(), ends), shape=(pairs, n_states))
    rows.sum_duplicates()
    shape = n_states, n_options
    names = tuple(f'o{o}' for o in range(n_options))
    return MultiTimeModel(names, rng.normal(size=shape), rng.random(shape) >= closed, rows)


def policy_iteration(model: MultiTimeModel) -> tuple[Floats, Flags]:
    """
    Improve a policy by its exact values until nothing is better (Howard 1960).

    :return: values (S,), and which options (S, O) are the best.
    """
    usable, states = model.available.any(axis=1), np.arange(model.n_states)
    dense = model.rows.toarray().reshape(len(model.names), len(states), len(states))
    policy = model.available.argmax(axis=1)
    while True:
        step = np.where(usable[:, None], dense[policy, states], 0.0)
        reward = np.where(usable, model.reward[states, policy], 0.0)
        values = np.linalg.solve(np.eye(len(states)) - step, reward)
        ahead = np.where(model.available, model.reward + (dense @ values).T, -np.inf)
        better = usable & (ahead.max(axis=1) > values + 1e-10)
        if not better.any():
            return values, ahead >= values[:, None] - 1e-7
        policy[better] = ahead[better].argmax(axis=1)


@settings(max_examples=60)
@given(
    seed=SEEDS,
    n_states=st.integers(1, 40),
    n_options=st.integers(1, 5),
    outcomes=st.integers(1, 4),
)
def test_values_are_those_of_policy_iteration(
    seed: int, n_states: int, n_options: int, outcomes: int
) -> None:
    """And a best option is chosen wherever one is available."""
    model = random_model(seed, n_states, n_options, outcomes=outcomes)
    truth, best = policy_iteration(model)
    other = random_model(seed, n_states, 2, outcomes=3, closed=1.0)  # never available
    for each in (model, concatenate([model, other])):
        found = solve_smdp(each, 1e-12)
        assert found.converged
        assert found.values == pytest.approx(truth, abs=1e-9)
        usable = model.available.any(axis=1)
        assert ((found.best >= 0) == usable).all()
        assert best[usable, found.best[usable]].all()


def test_options_that_cannot_be_chosen_change_no_value() -> None:
    """Of equal choices the lowest index is best."""
    for outcomes in (1, 3):
        model = random_model(1, 30, 5, outcomes=outcomes)
        fewer = replace(model, available=model.available & (np.arange(5) < 2))
        found, expected = solve_smdp(model, n_choices=2), solve_smdp(fewer)
        assert found.values == pytest.approx(expected.values)
        assert (found.best == expected.best).all()
        twice = concatenate([model, replace(model, names=tuple('fghij'))])
        assert (solve_smdp(twice).best < 5).all()


def test_a_callback_sees_every_sweep_and_can_stop_the_work() -> None:
    model = random_model(3, 20, 3, closed=0.0)
    seen: list[tuple[int, float]] = []

    def stop_at_third(sweeps: int, residual: float) -> bool:
        seen.append((sweeps, residual))
        return sweeps == 3

    for solution in (solve_smdp(model, on_sweep=stop_at_third), solve_smdp(model, max_sweeps=3)):
        assert [sweeps for sweeps, _ in seen] == [1, 2, 3]
        assert (solution.sweeps, solution.residual) == seen[-1]
        assert not solution.converged
    with pytest.raises(PlanError, match='tol'):
        solve_smdp(model, -1.0)


@settings(max_examples=60)
@given(
    seed=SEEDS, n_states=st.integers(1, 60), n_options=st.integers(1, 5), one_step=st.booleans()
)
def test_compiled_sweeps_have_the_bits_of_those_of_numpy(
    seed: int, n_states: int, n_options: int, one_step: bool
) -> None:
    pytest.importorskip('numba')
    model = random_model(seed, n_states, n_options)
    if one_step:  # all discounted alike, but for the end of the task
        model.rows.data[model.rows.data > 0] = 0.95
    compiled_sweep()  # from now on it is used for models of any size
    compiled = solve_smdp(model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solve, 'compiled_sweep', cache(lambda: None))
        by_numpy = solve_smdp(model)
    assert (compiled.sweeps, compiled.residual) == (by_numpy.sweeps, by_numpy.residual)
    assert compiled.values.tobytes() == by_numpy.values.tobytes()
    assert compiled.best.tolist() == by_numpy.best.tolist()


def rows_of(*rows: list[float]) -> csr_array:
    """Return successors of the two states and one option of the model below."""
    return csr_array(np.array(rows))


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'reward': np.array([[np.nan], [0.0]])}, 'reward'),
        ({'available': np.ones((2, 2), dtype=np.bool_)}, 'available'),
        ({'rows': csr_array(([0.5], [2], [0, 1, 1]), shape=(2, 2))}, 'successor'),
        ({'rows': rows_of([0.5, 0.6], [0, 0])}, 'sum of a row'),
        ({'rows': rows_of([-0.1, 0.6], [0, 0])}, 'a row'),
        ({'rows': rows_of([0.5, 0.4])}, 'rows are'),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(change: dict[str, object], text: str) -> None:
    model = MultiTimeModel(
        ('one',), np.zeros((2, 1)), np.ones((2, 1), dtype=np.bool_), rows_of([0.5, 0.4], [0, 0.1])
    )
    with pytest.raises(PlanError, match=text):
        replace(model, **change)  # type: ignore[arg-type]


@settings(max_examples=60)
@given(
    seed=SEEDS,
    n_states=st.integers(2, 40),
    leads_to=st.integers(1, 40),
    tol=st.sampled_from([1e-9, 1e-3, 0.3]),
    max_sweeps=st.sampled_from([1, 2, 5, 1000]),
)
def test_states_that_are_no_successors_need_no_sweeps_for_the_same_bits(
    seed: int, n_states: int, leads_to: int, tol: float, max_sweeps: int
) -> None:
    model = random_model(seed, n_states, 3, outcomes=2, leads_to=min(leads_to, n_states))
    swept = value_history(model, tol, max_sweeps)
    found = solve_smdp(model, tol, max_sweeps)
    assert found.values.tobytes() == swept[-1].tobytes()
    best = look_ahead(model, swept[-1]).argmax(axis=1)
    assert found.best.tolist() == np.where(model.available.any(axis=1), best, -1).tolist()
    assert (found.sweeps, found.residual) == (len(swept) - 1, np.abs(swept[-1] - swept[-2]).max())
    assert found.converged == (found.residual <= tol)


@settings(max_examples=40)
@given(
    seed=SEEDS, n_states=st.integers(1, 6), n_actions=st.integers(1, 3), outcomes=st.integers(1, 3)
)
def test_the_model_of_primitive_actions_is_that_of_the_rules(
    seed: int, n_states: int, n_actions: int, outcomes: int
) -> None:
    rng = np.random.default_rng(seed)
    rules, over = random_rules(rng, n_states, n_actions, outcomes, 0.2)
    model = primitive_model(rules, over, 0.9, tuple(map(str, range(n_actions))))
    dense = np.zeros((n_actions, n_states, n_states))
    share = 0.9 * rules.probability * ~(rules.terminated | over[:, None, None])
    for s, a, b in np.ndindex(*rules.successor.shape):
        dense[a, s, rules.successor[s, a, b]] += share[s, a, b]
    assert model.rows.toarray().reshape(dense.shape) == pytest.approx(dense)
    assert model.reward == pytest.approx((rules.probability * rules.reward).sum(axis=2))
    assert (model.available == ~over[:, None]).all()
