"""Reachability and shortest ways in chains small enough to check by hand."""

import math
from typing import Any, cast

from humanopts_env.domains.base import EnumerableDomain, Transitions
from humanopts_env.domains.tabular import distance_to, reachable
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest


def table(*successors: tuple[int, ...]) -> Transitions:
    """Return deterministic transitions from the successors of each state."""
    successor = np.array(successors, dtype=np.int32)[:, :, None]
    shape = successor.shape
    return Transitions(successor, np.ones(shape), np.zeros(shape), np.zeros(shape, np.bool_))


class Chain:
    """States 0 to 4; 3 is over, and 4 comes after it."""

    n_states = 5

    def __init__(self, transitions: Transitions) -> None:
        """Keep the transitions."""
        self._transitions = transitions

    def transitions(self) -> Transitions:
        """Return what was given."""
        return self._transitions

    def start_states(self) -> np.ndarray[Any, Any]:
        """Start in 1."""
        return np.array([1], dtype=np.int32)

    def over(self) -> np.ndarray[Any, Any]:
        """End in 3."""
        return np.array([False, False, False, True, False])


def visited(transitions: Transitions) -> list[int]:
    """Return the reachable states of the chain."""
    domain = cast(EnumerableDomain, Chain(transitions))
    return np.flatnonzero(reachable(domain)).tolist()


def test_nothing_is_reached_through_the_end() -> None:
    """From 1 to 2 and 3; 4 lies behind the end, and nothing leads to 0."""
    assert visited(table((1,), (2,), (3,), (4,), (0,))) == [1, 2, 3]


def test_what_never_happens_is_not_reached() -> None:
    """The second outcome has probability 0."""
    successor = np.array([[[1, 1]], [[2, 0]], [[2, 2]], [[3, 3]], [[4, 4]]], dtype=np.int32)
    probability = np.tile([1.0, 0.0], (5, 1, 1))
    shape = successor.shape
    transitions = Transitions(
        successor, probability, np.zeros(shape), np.zeros(shape, dtype=np.bool_)
    )
    assert visited(transitions) == [1, 2]


# actions: right, stay, jump (from 0 to 3 only); 4 is a sink
LINE = table((1, 0, 3), (2, 1, 1), (3, 2, 2), (4, 3, 3), (4, 4, 4))
LAST = np.zeros((5, 3), dtype=np.bool_)
LAST[3, 0] = True  # right, from 3 to 4


@settings(max_examples=100)
@given(seed=st.integers(0, 2**32 - 1), n_states=st.integers(1, 30), n_actions=st.integers(1, 4))
def test_distances_are_those_of_relaxing_every_step_until_nothing_changes(
    seed: int, n_states: int, n_actions: int
) -> None:
    rng = np.random.default_rng(seed)
    pairs = n_states, n_actions
    transitions = table(*map(tuple, rng.integers(0, n_states, pairs).tolist()))
    goal, allowed = rng.random(pairs) < 0.1, rng.random(n_states) < 0.8
    length = [math.inf] * n_states
    steps = [
        (state, action, 0 if goal[state, action] else int(transitions.successor[state, action, 0]))
        for state, action in np.ndindex(pairs)
        if allowed[state]
    ]

    def by(state: int, action: int, then: int) -> float:
        return 1 if goal[state, action] else 1 + length[then]

    for _ in range(n_states):
        for state, action, then in steps:
            length[state] = min(length[state], by(state, action, then))
    distance, optimal = distance_to(transitions, goal, allowed)
    assert distance.tolist() == [-1 if math.isinf(steps) else steps for steps in length]
    best = {
        (state, action)
        for state, action, then in steps
        if by(state, action, then) == length[state] < math.inf
    }
    assert set(zip(*(axis.tolist() for axis in np.nonzero(optimal)))) == best


def test_chance_is_refused() -> None:
    """A shortest way is not defined there."""
    shape = (1, 1, 2)
    chance = Transitions(
        np.zeros(shape, np.int32), np.full(shape, 0.5), np.zeros(shape), np.zeros(shape, np.bool_)
    )
    with pytest.raises(ValueError, match='one outcome'):
        distance_to(chance, np.ones((1, 1), np.bool_), np.ones(1, np.bool_))
