"""Exact option models against runs taken step by step."""

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.errors import GammaError, ModelError, NotDeterministicError
from humanopts_learner.planning.option_models import Composer
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest


def table(
    successor: NDArray[np.integer], reward: NDArray[np.float64], terminated: NDArray[np.bool_]
) -> Transitions:
    """Return deterministic transitions from (S, A) arrays."""
    return Transitions(
        successor.astype(np.int32)[:, :, None],
        np.ones((*successor.shape, 1)),
        reward.astype(np.float64)[:, :, None],
        terminated.astype(np.bool_)[:, :, None],
    )


def chain(length: int, last: int | None = None) -> Transitions:
    """Return states 0..length-1, one action "next" that costs 1; the last leads to ``last``."""
    successor = np.minimum(np.arange(1, length + 1), length - 1)
    successor[-1] = length - 1 if last is None else last
    return table(successor[:, None], -np.ones((length, 1)), np.zeros((length, 1), dtype=np.bool_))


def run_by_steps(
    rules: Transitions,
    over: NDArray[np.bool_],
    gamma: float,
    action: NDArray[np.integer],
    termination: NDArray[np.bool_],
    max_steps: int,
    start: int,
) -> tuple[float, int, float, bool]:
    """Return reward, successor, discount and reached of one run, the slow and obvious way."""
    state, total, steps = start, 0.0, 0
    while True:
        at = (state, action[state], 0)
        total += gamma**steps * rules.reward[at]
        steps += 1
        state, terminated = int(rules.successor[at]), bool(rules.terminated[at])
        ended = terminated or over[state] or termination[state]
        if ended or steps == max_steps:
            return total, state, 0.0 if terminated else gamma**steps, bool(ended)


@settings(deadline=None, max_examples=200)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_states=st.integers(1, 30),
    n_actions=st.integers(1, 3),
    max_steps=st.integers(1, 70),
    gamma=st.sampled_from([0.5, 0.9, 0.99, 1.0]),
    ending=st.sampled_from([0.0, 0.05, 0.4]),
    some=st.booleans(),
)
def test_models_equal_runs_taken_step_by_step(
    seed: int,
    n_states: int,
    n_actions: int,
    max_steps: int,
    gamma: float,
    ending: float,
    some: bool,
) -> None:
    rng = np.random.default_rng(seed)
    shape = (n_states, n_actions)
    rules = table(
        rng.integers(0, n_states, shape), rng.normal(size=shape), rng.random(shape) < ending
    )
    over, termination, starts = (rng.random((3, n_states)) < [[ending], [ending], [0.5]])[:]
    action = rng.integers(0, n_actions, n_states)
    outcome = Composer(rules, over, gamma).outcome(
        action, termination, max_steps, starts if some else None
    )
    assert set(np.flatnonzero(starts) if some else range(n_states)) <= set(outcome.states)
    for row, state in enumerate(outcome.states):
        if some and not starts[state]:
            continue
        reward, successor, discount, reached = run_by_steps(
            rules, over, gamma, action, termination, max_steps, int(state)
        )
        assert outcome.successor[row] == successor
        assert outcome.reached[row] == reached
        assert outcome.reward[row] == pytest.approx(reward, abs=1e-10)
        assert outcome.discount[row] == pytest.approx(discount, abs=1e-12)


@pytest.mark.parametrize('length', [1, 2, 3, 4, 7, 8, 9, 100])
def test_discount_is_gamma_to_the_number_of_steps(length: int) -> None:
    termination = np.arange(length + 1) == length
    rules, never = chain(length + 1), np.zeros(length + 1, dtype=np.bool_)
    action = np.zeros(length + 1, dtype=np.intp)
    outcome = Composer(rules, never, 0.9).outcome(action, termination, 1000)
    assert outcome.successor[0] == length
    assert outcome.discount[0] == pytest.approx(0.9**length)
    assert outcome.reward[0] == pytest.approx(-(1 - 0.9**length) / (1 - 0.9))
    assert outcome.reached.all()


@pytest.mark.parametrize('max_steps', [1, 2, 3, 4, 5, 31, 32, 33, 63, 64, 65])
def test_a_run_is_cut_off_at_max_steps_where_it_is(max_steps: int) -> None:
    rules, never = chain(100), np.zeros(100, dtype=np.bool_)
    termination = np.arange(100) == 64
    action = np.zeros(100, dtype=np.intp)
    outcome = Composer(rules, never, 0.9).outcome(action, termination, max_steps)
    assert outcome.successor[0] == min(max_steps, 64)
    assert outcome.discount[0] == pytest.approx(0.9 ** min(max_steps, 64))
    assert outcome.reached[0] == (max_steps >= 64)


def test_a_circle_is_not_valued_as_if_it_reached_its_end() -> None:
    rules, never = chain(3, last=0), np.zeros(3, dtype=np.bool_)
    outcome = Composer(rules, never, 0.9).outcome(
        np.zeros(3, dtype=np.intp), np.zeros(3, dtype=np.bool_), max_steps=7
    )
    assert not outcome.reached.any()
    assert outcome.successor.tolist() == [1, 2, 0]  # 7 steps of 3
    assert outcome.discount == pytest.approx(0.9**7)


def test_termination_is_looked_at_only_after_a_step() -> None:
    rules, never = chain(3), np.zeros(3, dtype=np.bool_)
    termination = np.array([True, False, True])
    outcome = Composer(rules, never, 0.9).outcome(np.zeros(3, dtype=np.intp), termination, 9)
    assert outcome.successor[0] == 2
    assert outcome.discount[0] == pytest.approx(0.81)


def test_the_end_of_the_task_ends_the_option_and_nothing_follows() -> None:
    rules = chain(5)
    rules.terminated[2] = True
    never = np.zeros(5, dtype=np.bool_)
    outcome = Composer(rules, never, 0.9).outcome(np.zeros(5, dtype=np.intp), never, 9)
    assert outcome.successor[0] == 3
    assert outcome.reward[0] == pytest.approx(-1 - 0.9 - 0.81)
    assert outcome.discount[0] == 0.0
    assert outcome.reached[0]


def test_a_start_is_answered_although_the_run_leaves_the_starts() -> None:
    rules, never = chain(6), np.zeros(6, dtype=np.bool_)
    starts = np.arange(6) == 0
    termination = np.arange(6) == 4
    outcome = Composer(rules, never, 0.9).outcome(
        np.zeros(6, dtype=np.intp), termination, 9, starts
    )
    row = outcome.states.tolist().index(0)
    assert outcome.successor[row] == 4
    assert outcome.discount[row] == pytest.approx(0.9**4)


def test_impossible_requests_are_refused() -> None:
    rules, never = chain(3), np.zeros(3, dtype=np.bool_)
    with pytest.raises(GammaError, match=r'1\.5'):
        Composer(rules, never, 1.5)
    with pytest.raises(ModelError, match='max_steps is 0'):
        Composer(rules, never, 0.9).outcome(np.zeros(3, dtype=np.intp), never, 0)
    two = Transitions(
        np.zeros((3, 1, 2), dtype=np.int32),
        np.full((3, 1, 2), 0.5),
        np.zeros((3, 1, 2)),
        np.zeros((3, 1, 2), dtype=np.bool_),
    )
    with pytest.raises(NotDeterministicError, match='more than one outcome'):
        Composer(two, never, 0.9)
