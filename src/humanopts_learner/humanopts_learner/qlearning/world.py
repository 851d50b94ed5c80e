"""What all learners by playing share: steps by exact transitions, and greedy choices."""

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.chance import draw_outcomes, outcome_limits
import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.intp]


class World:
    """Takes steps in many games at once."""

    def __init__(self, rules: Transitions, over: Flags) -> None:
        """
        Prepare the rules.

        :param over: (S,) where the domain's own task is over.
        """
        self.rules, self.over = rules, over
        self._limits = None if rules.deterministic else outcome_limits(rules)

    def step(
        self, state: Ints, action: Ints, rng: np.random.Generator
    ) -> tuple[Ints, Floats, Flags]:
        """Return where actions lead, the rewards, and where the task is over then, (N,)."""
        outcome: Ints | int = 0
        if self._limits is not None:
            outcome = draw_outcomes(self._limits, state, action, rng.random(len(state)))
        at = state, action, outcome
        there = self.rules.successor[at].astype(np.intp)
        return there, self.rules.reward[at], self.rules.terminated[at] | self.over[there]


def any_of(among: Flags, rng: np.random.Generator) -> Ints:
    """Return one of each row's True columns (N, A), each as likely."""
    chosen: Ints = np.where(among, rng.random(among.shape), -1.0).argmax(axis=1)
    return chosen
