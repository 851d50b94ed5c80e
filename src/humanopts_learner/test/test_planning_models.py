"""Exact option models against dense algebra."""

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


def option(action: NDArray[np.integer], termination: Flags, max_steps: int) -> TabularOption:
    """Return an option that can start everywhere."""
    return TabularOption('o', max_steps, action, np.ones_like(termination), termination)


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
@settings(max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_states=st.integers(1, 12),
    outcomes=st.sampled_from([1, 1, 2, 4]),
    max_steps=st.sampled_from([1, 2, 3, 7, 31, 32, 33, 3000]),
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
    ends = termination | over
    reward, successor, running = dense_model(rules, ends, gamma, action, max_steps)
    scale = 1 + np.abs(reward).max()
    kinds = [stochastic_model, deterministic_model] if outcomes == 1 else [stochastic_model]
    for kind in kinds:
        found = kind(rules, over, gamma, option(action, termination, max_steps), starts)
        assert found.reward / scale == pytest.approx(reward[starts] / scale, abs=1e-10)
        assert found.successor.toarray() == pytest.approx(successor[starts], abs=1e-10)
        if kind is deterministic_model:  # which loses nothing to the discount
            running = dense_model(rules, ends, 1.0, action, max_steps)[2]
        assert (found.cut_off == (running[starts] > 1e-14)).all()


def test_options_of_no_steps_are_refused() -> None:
    (rules, over), never = random_rules(np.random.default_rng(0), 3, 2, 1, 0.0), np.zeros(3, bool)
    with pytest.raises(PlanError, match='max_steps is 0'):
        model_option(rules, over, 0.9, option(np.zeros(3, np.intp), never, 0), ~never)
