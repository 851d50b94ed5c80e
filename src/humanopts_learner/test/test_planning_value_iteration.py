"""Value iteration against solutions found in other ways."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
import sys
import tracemalloc

from humanopts_learner.planning import value_iteration
from humanopts_learner.planning.request import PlanCanceled, PlanError
from humanopts_learner.planning.smdp import (
    concatenate,
    look_ahead,
    MultiTimeModel,
    primitive_model,
    SparseMultiTimeModel,
)
from humanopts_learner.planning.value_iteration import (
    _sweep_states,
    compiled_sweep,
    Solution,
    solve_smdp,
    value_history,
)
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest
from random_rules import random_rules
from scipy.sparse import csr_array, eye
from scipy.sparse.linalg import spsolve

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


def random_model(seed: int, n_states: int, n_options: int, closed: float = 0.3) -> MultiTimeModel:
    """Return a random SMDP; each pair is out of use with probability ``closed``."""
    rng = np.random.default_rng(seed)
    shape = (n_states, n_options)
    steps = rng.integers(1, 6, shape)
    return MultiTimeModel(
        names=tuple(f'o{o}' for o in range(n_options)),
        reward=rng.normal(size=shape),
        available=rng.random(shape) >= closed,
        successor=rng.integers(0, n_states, shape).astype(np.int32),
        discount=np.where(rng.random(shape) < 0.1, 0.0, 0.9**steps),
    )


def test_a_model_whose_parts_have_different_shapes_is_refused() -> None:
    model = random_model(1, 5, 2)
    with pytest.raises(PlanError, match='discount is'):
        replace(model, discount=model.discount[:, :1])


def policy_values(model: MultiTimeModel, policy: NDArray[np.integer]) -> NDArray[np.float64]:
    """Solve the linear equations of one policy; -1 and its state's value is 0."""
    states = np.arange(model.n_states)
    going = policy >= 0
    follow = csr_array(
        (
            np.where(going, model.discount[states, policy], 0.0),
            (states, model.successor[states, policy]),
        ),
        shape=(model.n_states, model.n_states),
    )
    reward = np.where(going, model.reward[states, policy], 0.0)
    one = csr_array(eye(model.n_states))
    values: NDArray[np.float64] = spsolve((one - follow).tocsc(), reward)
    return values


def sparse(model: MultiTimeModel) -> SparseMultiTimeModel:
    """Return the same model with a sparse row for each state and option."""
    return SparseMultiTimeModel(model.names, model.reward, model.available, model.rows)


def policy_iteration(model: MultiTimeModel) -> NDArray[np.float64]:
    """Improve a policy by its exact values until nothing better is found (Howard 1960)."""
    usable = model.available.any(axis=1)
    policy = np.where(usable, model.available.argmax(axis=1), -1)
    while True:
        values = policy_values(model, policy)
        ahead = model.reward + model.discount * values[model.successor]
        ahead = np.where(model.available, ahead, -np.inf)
        better = usable & (ahead.max(axis=1) > values + 1e-10)
        if not better.any():
            return values
        policy[better] = ahead[better].argmax(axis=1)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), n_states=st.integers(1, 60), n_options=st.integers(1, 5))
def test_every_form_of_a_model_has_the_values_of_policy_iteration(
    seed: int, n_states: int, n_options: int
) -> None:
    """And its greedy policy is worth them; it has a choice wherever something is available."""
    model = random_model(seed, n_states, n_options)
    truth, by_index = policy_iteration(model), solve_smdp(model, 1e-12)
    assert policy_values(model, by_index.best) == pytest.approx(truth, abs=1e-9)
    assert ((by_index.best < 0) == ~model.available.any(axis=1)).all()
    both = concatenate([model, sparse(model)])
    assert isinstance(both, SparseMultiTimeModel)
    for form in (model, sparse(model), both):
        found = solve_smdp(form, 1e-12)
        assert found.converged
        assert found.values == pytest.approx(truth, abs=1e-9)
        assert (found.best == by_index.best).all()
        assert found.sweeps == by_index.sweeps


def test_the_walk_down_a_corridor_has_its_known_optimum() -> None:
    length, gamma = 30, 0.9
    here = np.arange(length)
    move = np.stack([np.maximum(here - 1, 0), np.minimum(here + 1, length - 1)], axis=1)
    goal = (here[:, None] == length - 2) & np.array([False, True])
    model = MultiTimeModel(
        ('left', 'right'),
        np.where(goal, 1.0, 0.0),
        np.broadcast_to(here[:, None] < length - 1, (length, 2)),
        move.astype(np.int32),
        np.where(goal, 0.0, gamma),
    )
    solution = solve_smdp(model)
    assert solution.values[:-1] == pytest.approx(gamma ** (length - 2.0 - here[:-1]))
    assert (solution.best[:-1] == 1).all()
    assert solution.sweeps == length  # one for each step back from the goal, one to see the end


def test_of_equal_choices_the_lowest_index_is_best() -> None:
    model = random_model(1, 10, 2, closed=0.0)
    twice = concatenate([model, replace(model, names=('again0', 'again1'))])
    assert (solve_smdp(twice).best < 2).all()


def test_spent_sweeps_are_reported_as_not_converged() -> None:
    model = random_model(2, 20, 3, closed=0.0)
    whole, part = solve_smdp(model, 1e-10), solve_smdp(model, 1e-10, max_sweeps=2)
    assert whole.converged
    assert whole.residual <= 1e-10
    assert (part.sweeps, part.converged) == (2, False)
    assert part.residual > 1e-10


def test_a_callback_sees_every_sweep_and_can_stop_the_work() -> None:
    model = random_model(3, 20, 3, closed=0.0)
    seen: list[tuple[int, float]] = []

    def stop_at_third(sweeps: int, residual: float) -> bool:
        seen.append((sweeps, residual))
        return sweeps == 3

    solution = solve_smdp(model, on_sweep=stop_at_third)
    assert [sweeps for sweeps, _ in seen] == [1, 2, 3]
    assert (solution.sweeps, solution.residual) == seen[-1]
    assert not solution.converged

    def cancel(sweeps: int, residual: float) -> None:
        raise PlanCanceled

    with pytest.raises(PlanCanceled):
        solve_smdp(model, on_sweep=cancel)


def solved_with(compiled: object, model: MultiTimeModel) -> tuple[Solution, list[float]]:
    """Return a solution and its residuals, by compiled sweeps or, with None, by those of NumPy."""
    residuals: list[float] = []
    with pytest.MonkeyPatch.context() as patch:
        loaded = cache(lambda: compiled)
        loaded()
        patch.setattr(value_iteration, 'compiled_sweep', loaded)
        solution = solve_smdp(model, on_sweep=lambda _, residual: residuals.append(residual))
    return solution, residuals


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_states=st.integers(1, 60),
    n_options=st.integers(1, 5),
    one_step=st.booleans(),
)
def test_compiled_sweeps_have_the_bits_of_those_of_numpy(
    seed: int, n_states: int, n_options: int, one_step: bool
) -> None:
    pytest.importorskip('numba')
    model = random_model(seed, n_states, n_options)
    if one_step:  # all discounted alike, but for the end of the task
        model = replace(model, discount=np.where(model.discount > 0, 0.95, 0.0))
    model = replace(model, reward=np.asfortranarray(model.reward))
    (by_numpy, before), (compiled, after) = (
        solved_with(sweep, model) for sweep in (None, compiled_sweep())
    )
    assert before == after
    assert compiled.values.tobytes() == by_numpy.values.tobytes()
    assert compiled.best.tolist() == by_numpy.best.tolist()
    assert compiled.values == pytest.approx(policy_iteration(model), abs=1e-6)


def test_what_is_compiled_has_the_bits_of_numpy_as_plain_python_too() -> None:
    model = random_model(2, 12, 3)
    alike = replace(model, discount=np.where(model.discount > 0, 0.95, 0.0))
    for each in (model, alike):
        plain, before = solved_with(_sweep_states, each)
        by_numpy, after = solved_with(None, each)
        assert (plain.values.tobytes(), before) == (by_numpy.values.tobytes(), after)


def test_only_large_models_are_worth_loading_a_compiled_sweep() -> None:
    class LoadedError(Exception):
        pass

    @cache
    def load() -> None:
        raise LoadedError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(value_iteration, 'compiled_sweep', load)
        patch.setattr(value_iteration, 'COMPILED_FROM', 60)
        assert solve_smdp(random_model(1, 19, 3)).converged
        with pytest.raises(LoadedError):
            solve_smdp(random_model(1, 20, 3))


def test_without_numba_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'numba', None)  # so that its import fails
    assert compiled_sweep.__wrapped__() is None


def test_sweeps_allocate_nothing() -> None:
    model = random_model(6, 20_000, 3)
    grown: list[int] = []

    def measure(sweeps: int, residual: float) -> None:
        now, peak = tracemalloc.get_traced_memory()
        grown.append(peak - now)
        tracemalloc.reset_peak()

    tracemalloc.start()
    try:
        solve_smdp(model, max_sweeps=10, on_sweep=measure)
    finally:
        tracemalloc.stop()
    assert max(grown[1:]) < 20_000  # one array of the states would be 160,000


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        (lambda m: {'reward': np.where(m.reward > 0, np.nan, m.reward)}, 'reward'),
        (lambda m: {'reward': m.reward + np.inf}, 'reward'),
        (lambda m: {'successor': m.successor + 5}, 'successor'),
        (lambda m: {'successor': m.successor - 5}, 'successor'),
        (lambda m: {'discount': m.discount + 1.0}, 'discount'),
        (lambda m: {'discount': -m.discount - 0.1}, 'discount'),
        (lambda m: {'available': m.available[:, :1]}, 'available'),
        (lambda m: {'names': ('one',)}, 'names'),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(
    change: Callable[[MultiTimeModel], dict[str, object]], text: str
) -> None:
    model = random_model(4, 5, 2)
    with pytest.raises(PlanError, match=text):
        replace(model, **change(model))  # type: ignore[arg-type]


@pytest.mark.parametrize(('tol', 'max_sweeps'), [(-1.0, 10), (float('nan'), 10), (1e-8, 0)])
def test_limits_that_make_no_sense_are_refused(tol: float, max_sweeps: int) -> None:
    with pytest.raises(PlanError, match='tol'):
        solve_smdp(random_model(5, 3, 2), tol, max_sweeps)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_states=st.integers(1, 40),
    n_successors=st.integers(1, 40),
    tol=st.sampled_from([1e-9, 1e-3, 0.3]),
    max_sweeps=st.sampled_from([1, 2, 5, 1000]),
)
def test_states_that_are_no_successors_need_no_sweeps_for_the_same_bits(
    seed: int, n_states: int, n_successors: int, tol: float, max_sweeps: int
) -> None:
    dense = random_model(seed, n_states, 3)
    model = sparse(replace(dense, successor=dense.successor % n_successors))
    swept = value_history(model, tol, max_sweeps)
    found = solve_smdp(model, tol, max_sweeps)
    assert found.values.tobytes() == swept[-1].tobytes()
    best = look_ahead(model, swept[-1]).argmax(axis=1)
    assert found.best.tolist() == np.where(model.available.any(axis=1), best, -1).tolist()
    assert (found.sweeps, found.residual) == (len(swept) - 1, np.abs(swept[-1] - swept[-2]).max())
    assert found.converged == (found.residual <= tol)


@settings(max_examples=40)
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
    value = dense_policy_iteration(dense, reward, over)
    assert solution.values == pytest.approx(value, abs=1e-9)
    assert ((solution.best < 0) == over).all()


def dense_policy_iteration(dense: Floats, reward: Floats, over: Flags) -> Floats:
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
    with pytest.raises(PlanError, match=text):
        SparseMultiTimeModel(('one',), np.zeros((2, 1)), available, csr_array(rows))
