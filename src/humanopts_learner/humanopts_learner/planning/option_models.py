"""
Exact multi-time models of options in deterministic domains (Precup 2000, chapter 3).

Sutton, Precup and Singh (1999, section 4) define the model of an option by its reward and by its
discounted successor. Where every action has one outcome both follow from running the option, and
running it n steps from all states at once needs about log2(n) compositions of the successor table
with itself.
"""

from dataclasses import dataclass

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.errors import check_gamma, ModelError
from humanopts_learner.planning.model import check_deterministic
import numpy as np
from numpy.typing import NDArray

IntTable = NDArray[np.intp]
FloatTable = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class OptionModel:
    """What running one option from each of n states leads to, in k steps."""

    states: IntTable  # (n,) ascending; all that were asked for, and perhaps others
    reward: FloatTable  # (n,) sum of gamma**i * r[i], i = 0..k-1
    successor: IntTable  # (n,) state where it ended
    discount: FloatTable  # (n,) gamma**k; 0 where the task was over
    reached: Mask  # (n,) False: still going after max_steps, and cut off there


@dataclass
class _Walk:
    """Some number of moves from each of n rows, absorbed where the next step is the last."""

    row: IntTable  # (n,) where it leads
    reward: FloatTable  # (n,) discounted to the start
    discount: FloatTable  # (n,) gamma to the number of moves


@dataclass(frozen=True)
class _Policy:
    """One step of an option from each of n states."""

    states: IntTable  # (n,) in ascending order
    successor: IntTable  # (n,) states
    reward: FloatTable  # (n,)
    terminated: Mask  # (n,)
    last: Mask  # (n,) the step ends the option


class Composer:
    """Models the options of one deterministic domain."""

    def __init__(self, transitions: Transitions, over: Mask, gamma: float) -> None:
        """
        Prepare for one domain.

        :param over: (S,) states where the task is over.
        :raises PlanError: gamma is not in (0, 1], or the transitions are not deterministic.
        """
        check_gamma(gamma)
        check_deterministic(transitions)
        self._n_actions = transitions.successor.shape[1]
        self._gamma = gamma
        self._over = over
        self._successor = transitions.successor.ravel()
        self._reward = transitions.reward.ravel()
        self._terminated = transitions.terminated.ravel()
        self._floats = np.empty(len(over))  # work space
        self._ints = np.empty(len(over), dtype=np.intp)

    def outcome(
        self,
        action: NDArray[np.integer],
        termination: Mask,
        max_steps: int,
        starts: Mask | None = None,
    ) -> OptionModel:
        """
        Run an option from many states, as execution does.

        It ends where the termination condition holds, which is looked at only after a step; where
        the task is over; or after ``max_steps``, at the state where it is.

        A step that ends the option leads from a row of the table that is made absorbing, so n
        moves are a product of binary powers of one table; the step itself is taken at the end.

        :param action: (S,) what it does; defined wherever it can come.
        :param termination: (S,).
        :param max_steps: 1 or more.
        :param starts: (S,) states from which the answer is needed; None: all.
        :raises ModelError: max_steps is below 1.
        """
        if max_steps < 1:
            raise ModelError(f'max_steps is {max_steps}, and must be 1 or more')
        policy = self._policy(action, termination | self._over, starts)
        walk = self._walk(policy, max_steps - 1, starts)
        return self._last_step(policy, walk)

    def _policy(self, action: NDArray[np.integer], ends: Mask, starts: Mask | None) -> _Policy:
        """Tabulate one step from the starts if no run leaves them, or else from all states."""
        states = np.arange(len(ends)) if starts is None else np.flatnonzero(starts)
        pair = states * self._n_actions
        pair += action[states]
        successor = self._successor[pair].astype(np.intp)
        terminated = self._terminated[pair]
        last = ends[successor]
        last |= terminated
        if starts is not None and not (last | starts[successor]).all():
            return self._policy(action, ends, None)
        return _Policy(states, successor, self._reward[pair], terminated, last)

    def _walk(self, policy: _Policy, steps: int, starts: Mask | None) -> _Walk:
        """Move ``steps`` times from every row, but stay before a step that would be the last."""
        last = policy.last
        here = np.arange(len(last))
        if steps == 0:
            return _Walk(here, np.zeros(len(last)), np.ones(len(last)))
        row_of = np.zeros(len(self._over), dtype=np.intp)
        row_of[policy.states] = here
        one = _Walk(
            np.where(last, here, row_of[policy.successor]),
            np.where(last, 0.0, policy.reward),
            np.where(last, 1.0, self._gamma),
        )
        wanted = None if starts is None else starts[policy.states]
        highest = 1 << (steps.bit_length() - 1)
        walk = self._power(one, highest, last, wanted)
        if highest < steps and not _all_stay(walk, last, wanted):
            self._append(walk, self._power(one, steps - highest, last, wanted))
        return walk

    def _power(self, one: _Walk, steps: int, last: Mask, wanted: Mask | None) -> _Walk:
        """Return ``steps`` moves (1 or more), or fewer where more would change nothing."""
        walk = _Walk(one.row.copy(), one.reward.copy(), one.discount.copy())
        for bit in bin(steps)[3:]:  # the highest bit is ``one`` itself
            if _all_stay(walk, last, wanted):
                break
            self._append(walk, walk)
            if bit == '1':
                self._append(walk, one)
        return walk

    def _append(self, walk: _Walk, then: _Walk) -> None:
        """Go on from where ``walk`` leads by ``then``, which may be ``walk`` itself."""
        at = walk.row
        floats, ints = self._floats[: len(at)], self._ints[: len(at)]
        np.take(then.reward, at, out=floats, mode='clip')
        floats *= walk.discount
        walk.reward += floats
        np.take(then.discount, at, out=floats, mode='clip')
        walk.discount *= floats
        np.take(then.row, at, out=ints, mode='clip')
        at[:] = ints

    def _last_step(self, policy: _Policy, walk: _Walk) -> OptionModel:
        """Take the step that ends the option, or the last that ``max_steps`` allows."""
        end = walk.row
        walk.reward += walk.discount * policy.reward[end]
        walk.discount *= self._gamma
        walk.discount[policy.terminated[end]] = 0.0
        return OptionModel(
            policy.states, walk.reward, policy.successor[end], walk.discount, policy.last[end]
        )


def _all_stay(walk: _Walk, last: Mask, wanted: Mask | None) -> bool:
    stays = last[walk.row]
    return bool(stays.all() if wanted is None else (stays | ~wanted).all())
