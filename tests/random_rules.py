"""Random transitions and worlds for the tests of planning."""

from dataclasses import dataclass
from functools import cached_property

from humanopts_env.domains.base import Action, Transitions
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


@dataclass(frozen=True)
class RandomWorld:
    """Random rules over a few states; what learning and planning ask of a domain."""

    seed: int
    n_states: int = 5
    outcomes: int = 1
    gamma: float = 0.7
    max_steps: int = 10_000
    actions: tuple[Action, ...] = tuple(Action(name, name, '') for name in 'abc')

    @cached_property
    def rules(self) -> Transitions:
        """Drawn once; the task is over in the last state, and action c leads a state nearer."""
        rng = np.random.default_rng(self.seed)
        rules, _ = random_rules(rng, self.n_states, 3, self.outcomes, 0.0)
        rules.successor[:-1, 2, 0] = np.arange(1, self.n_states)
        return Transitions(
            rules.successor, rules.probability, rules.reward, self.over()[rules.successor]
        )

    def transitions(self) -> Transitions:
        return self.rules

    def over(self) -> NDArray[np.bool_]:
        return np.arange(self.n_states) == self.n_states - 1

    def start_states(self) -> NDArray[np.int32]:
        return np.arange(self.n_states - 1, dtype=np.int32)
