"""Random transitions for the tests of planning."""

from humanopts_env.domains.base import Transitions
import numpy as np
from numpy.typing import NDArray


def random_rules(
    rng: np.random.Generator, n_states: int, n_actions: int, outcomes: int, ending: float
) -> tuple[Transitions, NDArray[np.bool_]]:
    """Return random transitions, some outcomes unused, and the states that are over."""
    shape = (n_states, n_actions, outcomes)
    probability = rng.random(shape) * (rng.random(shape) < 0.7)
    probability[:, :, 0] += 0.1
    probability /= probability.sum(axis=2, keepdims=True)
    over = rng.random(n_states) < ending
    successor = rng.integers(0, n_states, shape).astype(np.int32)
    terminated = over[successor] | (rng.random(shape) < ending / 2)
    return Transitions(successor, probability, rng.normal(size=shape), terminated), over
