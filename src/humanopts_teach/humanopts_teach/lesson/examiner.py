"""
Verdicts of a simulated examiner who knows the reference option.

A run is right if the reference option can start in its first state, and the run ends in the first
state, after at least one step, that is an intended end of the reference option. Without chance,
it also takes at most twice as many steps as the reference option. With chance, a long run need not
be wrong: instead, at most a quarter of its actions may be suboptimal, which on a grid without
chance would double its length; and optimal actions may also lead to an unintended end. A run
without steps is right where the reference option cannot start.
"""

from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import reached, ReferenceOption
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_learner.options.rollout import is_deterministic
import numpy as np

TIMES = 2  # maximum length of a right run, relative to the reference option
ERRORS = 0.25  # maximum share of suboptimal actions, with chance


class Examiner:
    """
    Watches one run of an option, step by step.

    :ivar past: whether the run continued past an end.
    """

    def __init__(self, domain: Domain, reference: ReferenceOption, start: Any) -> None:
        self._domain, self._reference, self._last = domain, reference, start
        self._names = [action.name for action in domain.actions]
        self._steps = self._errors = 0
        self._ended = self.past = False
        self._can_start = reference.can_start(start)
        known = isinstance(domain, ReplayedDomain) or is_deterministic(domain)
        self._limit = TIMES * self._shortest() if known and self._can_start else None

    def see(self, state: Any, action: str = '') -> None:
        """
        Register the next state.

        :param action: action that led to it; empty: unknown.
        """
        self.past |= self._ended
        chance, erred = self._limit is None, False
        if action and chance:
            best = self._reference.optimal_actions(self._last)
            erred = self._names.index(action) not in best
            self._errors += erred
        self._last, self._steps = state, self._steps + 1
        self._ended = reached(self._reference, state)
        if chance and not erred:  # chance may lead to an unintended end, or end the task
            over = self._domain.is_over(state)
            self._ended |= bool(action) if over else self._reference.ends(state)

    @property
    def failed(self) -> bool:
        """Whether the run is wrong, regardless of how it continues."""
        too_long = self._limit is not None and self._steps > self._limit
        return self._steps > 0 and (not self._can_start or self.past or too_long)

    @property
    def right(self) -> bool:
        """Whether the run is right if it ends now."""
        if not self._steps:
            return not self._can_start
        return self._ended and not self.failed and self._errors <= ERRORS * self._steps

    @property
    def can_continue(self) -> bool:
        """Whether the run can be corrected from the current state."""
        return self._can_start and not self.past and self._reference.can_start(self._last)

    def _shortest(self) -> int:
        """Return the number of steps that the reference option takes, without chance."""
        rng, state, steps = np.random.default_rng(0), self._last, 0  # the generator is unused
        while steps == 0 or not reached(self._reference, state):
            best = self._reference.optimal_actions(state)
            if not best:
                break
            state, steps = self._domain.step(state, best[0], rng).state, steps + 1
        return steps
