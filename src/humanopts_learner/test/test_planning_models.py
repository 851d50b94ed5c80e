"""Exact option models against runs taken step by step, dense algebra and answers by hand."""

from humanopts_env.domains.base import Transitions
from humanopts_learner.options.learned_option import TabularOption
from humanopts_learner.planning.models import (
    deterministic_model,
    model_option,
    stochastic_model,
)
from humanopts_learner.planning.request import PlanError
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest
from random_rules import random_rules

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


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


def option(action: NDArray[np.integer], termination: Flags, max_steps: int) -> TabularOption:
    """Return an option that can start everywhere."""
    return TabularOption('o', max_steps, action, np.ones_like(termination), termination)


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


@settings(max_examples=100)
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
    starts |= not some
    found = deterministic_model(rules, over, gamma, option(action, termination, max_steps), starts)
    dense = found.successor.toarray()
    assert len(dense) == starts.sum()
    for row, state in enumerate(np.flatnonzero(starts)):
        reward, successor, discount, reached = run_by_steps(
            rules, over, gamma, action, termination, max_steps, int(state)
        )
        assert dense[row] == pytest.approx(discount * np.eye(n_states)[successor], abs=1e-12)
        assert found.cut_off[row] != reached
        assert found.reward[row] == pytest.approx(reward, abs=1e-10)


@pytest.mark.parametrize('max_steps', [1, 2, 3, 4, 5, 31, 32, 33, 63, 64, 65])
def test_a_run_is_cut_off_at_max_steps_where_it_is(max_steps: int) -> None:
    rules, never = chain(100), np.zeros(100, dtype=np.bool_)
    termination = np.arange(100) == 64
    action = np.zeros(100, dtype=np.intp)
    walk = option(action, termination, max_steps)
    found = deterministic_model(rules, never, 0.9, walk, ~never)
    steps = min(max_steps, 64)
    assert found.successor[[0], [steps]] == pytest.approx(0.9**steps)
    assert found.cut_off[0] == (max_steps < 64)


def test_a_circle_is_not_valued_as_if_it_reached_its_end() -> None:
    rules, never = chain(3, last=0), np.zeros(3, dtype=np.bool_)
    walk = option(np.zeros(3, dtype=np.intp), never, max_steps=7)
    found = deterministic_model(rules, never, 0.9, walk, ~never)
    assert found.cut_off.all()
    assert found.successor.indices.tolist() == [1, 2, 0]  # 7 steps of 3
    assert found.successor.data == pytest.approx(0.9**7)


def dense_model(
    rules: Transitions, ends: Flags, gamma: float, action: NDArray[np.intp], max_steps: int
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


@pytest.mark.heavy
@settings(max_examples=80)
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
    starts |= not some
    found = stochastic_model(rules, over, gamma, option(action, termination, max_steps), starts)
    reward, successor, running = dense_model(rules, termination | over, gamma, action, max_steps)
    scale = 1 + np.abs(reward).max()
    assert found.reward / scale == pytest.approx(reward[starts] / scale, abs=1e-10)
    assert found.successor.toarray() == pytest.approx(successor[starts], abs=1e-10)
    assert (found.cut_off == (running[starts] > 1e-14)).all()
    assert (found.successor.data > 0).all()


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
    throw = option(np.zeros(2, np.intp), heads, max_steps)
    found = stochastic_model(coin(), never, 1.0, throw, ~never)
    assert found.reward[0] == pytest.approx(-2 * (1 - 0.5**max_steps))
    assert found.successor.toarray()[0] == pytest.approx([cut_off, 1 - cut_off])
    assert found.cut_off[0] == (cut_off > 0)


def test_options_of_no_steps_are_refused() -> None:
    never = np.zeros(3, dtype=np.bool_)
    with pytest.raises(PlanError, match='max_steps is 0'):
        model_option(chain(3), never, 0.9, option(np.zeros(3, np.intp), never, 0), ~never)
