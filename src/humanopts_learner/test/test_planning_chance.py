"""Exact option models of domains with chance, against dense algebra and simulated runs."""

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.chance import RowComposer
from humanopts_learner.planning.errors import GammaError, ModelError
from humanopts_learner.planning.model import concatenate, primitive_model, RowModel, SmdpModel
from humanopts_learner.planning.option_models import Composer
from humanopts_learner.planning.value_iteration import solve_smdp
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest
from scipy.sparse import csr_array

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def random_rules(
    rng: np.random.Generator, n_states: int, n_actions: int, outcomes: int, ending: float
) -> tuple[Transitions, Mask]:
    """Return random transitions, some outcomes unused, and the states that are over."""
    shape = (n_states, n_actions, outcomes)
    probability = rng.random(shape) * (rng.random(shape) < 0.7)
    probability[:, :, 0] += 0.1
    probability /= probability.sum(axis=2, keepdims=True)
    over = rng.random(n_states) < ending
    successor = rng.integers(0, n_states, shape).astype(np.int32)
    terminated = over[successor] | (rng.random(shape) < ending / 2)
    return Transitions(successor, probability, rng.normal(size=shape), terminated), over


def dense_model(
    rules: Transitions, ends: Mask, gamma: float, action: NDArray[np.intp], max_steps: int
) -> tuple[Floats, Floats, Floats]:
    """Run at most max_steps steps by dense matrices: reward (S,), successor (S, S), cut off."""
    n = len(ends)
    on, end, reward = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    for s in range(n):
        for b in range(rules.successor.shape[2]):
            at = s, action[s], b
            reward[s] += rules.probability[at] * rules.reward[at]
            if rules.terminated[at]:
                continue
            into = end if ends[rules.successor[at]] else on
            into[s, rules.successor[at]] += gamma * rules.probability[at]
    total, successor, running = np.zeros(n), np.zeros((n, n)), np.eye(n)
    for _ in range(max_steps):
        total += running @ reward
        successor += running @ end
        running = running @ on
    return total, successor + running, running.sum(axis=1)


@settings(deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_states=st.integers(1, 12),
    outcomes=st.integers(1, 4),
    max_steps=st.sampled_from([1, 2, 3, 7, 40, 3000]),
    gamma=st.sampled_from([0.5, 0.9, 0.99, 1.0]),
    ending=st.sampled_from([0.0, 0.1, 0.4]),
    some=st.booleans(),
)
def test_models_equal_those_of_dense_algebra(
    seed: int,
    n_states: int,
    outcomes: int,
    max_steps: int,
    gamma: float,
    ending: float,
    some: bool,
) -> None:
    rng = np.random.default_rng(seed)
    rules, over = random_rules(rng, n_states, 2, outcomes, ending)
    termination, starts = rng.random((2, n_states)) < [[ending], [0.5]]
    action = rng.integers(0, 2, n_states)
    found = RowComposer(rules, over, gamma).outcome(
        action, termination, max_steps, starts if some else None
    )
    reward, successor, running = dense_model(rules, termination | over, gamma, action, max_steps)
    assert set(np.flatnonzero(starts) if some else range(n_states)) <= set(found.states)
    scale = 1 + np.abs(reward).max()
    assert found.reward / scale == pytest.approx(reward[found.states] / scale, abs=1e-10)
    assert found.successor.toarray() == pytest.approx(successor[found.states], abs=1e-10)
    assert found.cut_off == pytest.approx(running[found.states], abs=1e-10)
    assert (found.successor.data > 0).all()


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), n_states=st.integers(1, 20), max_steps=st.integers(1, 30))
def test_without_chance_both_composers_agree(seed: int, n_states: int, max_steps: int) -> None:
    rng = np.random.default_rng(seed)
    rules, over = random_rules(rng, n_states, 3, 1, 0.1)
    action, termination = rng.integers(0, 3, n_states), rng.random(n_states) < 0.2
    by_index = Composer(rules, over, 0.9).outcome(action, termination, max_steps)
    by_rows = RowComposer(rules, over, 0.9).outcome(action, termination, max_steps)
    assert by_rows.reward == pytest.approx(by_index.reward, abs=1e-10)
    expected = np.zeros((n_states, n_states))
    expected[np.arange(n_states), by_index.successor] = by_index.discount
    assert by_rows.successor.toarray() == pytest.approx(expected, abs=1e-10)
    assert ((by_rows.cut_off > 0) == ~by_index.reached).all()


def coin() -> Transitions:
    """Return states 0 and 1: a coin is thrown in 0 for a reward of -1; heads leads to 1."""
    return Transitions(
        np.array([[[1, 0]], [[1, 1]]], dtype=np.int32),
        np.full((2, 1, 2), 0.5),
        np.full((2, 1, 2), -1.0),
        np.zeros((2, 1, 2), dtype=np.bool_),
    )


@pytest.mark.parametrize(('max_steps', 'cut_off'), [(1, 0.5), (2, 0.25), (5, 1 / 32), (100, 0.0)])
def test_throwing_until_heads_is_cut_off_at_max_steps(max_steps: int, cut_off: float) -> None:
    never, heads = np.zeros(2, dtype=np.bool_), np.array([False, True])
    found = RowComposer(coin(), never, 1.0).outcome(np.zeros(2, np.intp), heads, max_steps)
    assert found.reward[0] == pytest.approx(-2 * (1 - 0.5**max_steps))
    assert found.successor.toarray()[0] == pytest.approx([cut_off, 1 - cut_off])
    assert found.cut_off[0] == pytest.approx(cut_off)


def test_what_never_ends_is_cut_off_and_not_valued_as_if_it_ended() -> None:
    never = np.zeros(2, dtype=np.bool_)
    found = RowComposer(coin(), never, 1.0).outcome(np.zeros(2, np.intp), never, 3)
    assert found.reward.tolist() == [-3.0, -3.0]
    assert found.successor.toarray() == pytest.approx(np.array([[1 / 8, 7 / 8], [0, 1]]))
    assert found.cut_off == pytest.approx(1.0)


def test_impossible_requests_are_refused() -> None:
    never = np.zeros(2, dtype=np.bool_)
    with pytest.raises(GammaError, match=r'1\.5'):
        RowComposer(coin(), never, 1.5)
    with pytest.raises(ModelError, match='max_steps is 0'):
        RowComposer(coin(), never, 0.9).outcome(np.zeros(2, dtype=np.intp), never, 0)


# Planning over sparse rows.


def as_rows(model: SmdpModel) -> RowModel:
    """Return the same model with a row for each choice."""
    return RowModel(model.names, model.reward, model.available, model.rows)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), n_states=st.integers(1, 40), n_options=st.integers(1, 4))
def test_both_forms_of_one_model_have_one_solution(
    seed: int, n_states: int, n_options: int
) -> None:
    rng = np.random.default_rng(seed)
    shape = (n_states, n_options)
    model = SmdpModel(
        tuple(map(str, range(n_options))),
        rng.normal(size=shape),
        rng.random(shape) < 0.7,
        rng.integers(0, n_states, shape).astype(np.int32),
        0.9 ** rng.integers(1, 5, shape) * (rng.random(shape) < 0.9),
    )
    by_index, by_rows = solve_smdp(model, 1e-12), solve_smdp(as_rows(model), 1e-12)
    assert by_rows.values == pytest.approx(by_index.values, abs=1e-12)
    assert (by_rows.best == by_index.best).all()
    assert by_rows.sweeps == by_index.sweeps
    both = concatenate([model, as_rows(model)])
    assert isinstance(both, RowModel)
    assert solve_smdp(both, 1e-12).values == pytest.approx(by_index.values, abs=1e-12)
    assert (solve_smdp(both, 1e-12).best == by_index.best).all()


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), n_states=st.integers(1, 6), n_actions=st.integers(1, 3))
def test_primitive_values_solve_the_dense_optimality_equations(
    seed: int, n_states: int, n_actions: int
) -> None:
    rng = np.random.default_rng(seed)
    rules, over = random_rules(rng, n_states, n_actions, 3, 0.2)
    names = tuple(map(str, range(n_actions)))
    model = primitive_model(rules, over, 0.9, names)
    solution = solve_smdp(model, 1e-12)
    dense = np.zeros((n_states, n_actions, n_states))
    share = 0.9 * rules.probability * ~rules.terminated
    for s, a, b in np.ndindex(*rules.successor.shape):
        dense[s, a, rules.successor[s, a, b]] += share[s, a, b]
    reward = (rules.probability * rules.reward).sum(axis=2)
    value = policy_iteration(dense, reward, over)
    assert solution.values == pytest.approx(value, abs=1e-9)
    assert ((solution.best < 0) == over).all()


def policy_iteration(dense: Floats, reward: Floats, over: Mask) -> Floats:
    """Solve the optimality equations by dense solves; values 0 where the task is over."""
    n, states = len(reward), np.arange(len(reward))
    policy = np.zeros(n, dtype=np.intp)
    while True:
        step = np.where(over[:, None], 0.0, dense[states, policy])
        value = np.linalg.solve(np.eye(n) - step, np.where(over, 0.0, reward[states, policy]))
        ahead = reward + dense @ value
        better = ahead.argmax(axis=1)
        gain = ahead.max(axis=1) - ahead[states, policy] > 1e-12
        if not (gain & ~over).any():
            found: Floats = value
            return found
        policy = np.where(gain, better, policy)


@pytest.mark.parametrize(
    ('rows', 'text'),
    [
        (np.array([[0.5, 0.6], [0, 0]]), 'sums of rows'),
        (np.array([[-0.1, 0.6], [0, 0]]), 'a row'),
        (np.array([[np.nan, 0.6], [0, 0]]), 'a row'),
        (np.array([[0.5, 0.4], [0, 0.1]]), 'not available'),
        (np.array([[0.5, 0.4]]), 'rows are'),
    ],
)
def test_rows_that_are_no_probabilities_are_refused(rows: Floats, text: str) -> None:
    available = np.array([[True], [False]])
    with pytest.raises(ModelError, match=text):
        RowModel(('one',), np.zeros((2, 1)), available, csr_array(rows))
