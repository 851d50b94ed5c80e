"""
Playing a plan in the rules of its domain, all episodes at once, and what the returns show.

So it shows what the options of a plan do not cover: where a person can teach more (paper,
section 8).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Domain, EnumerableDomain, S
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_env.seeding import generator
from humanopts_learner.planning.exact import ExactPlan, option_table
from humanopts_learner.planning.request import ignore_progress, PlanError, Progress
from humanopts_learner.planning.smdp import look_ahead, primitive_model
import numpy as np
from numpy.typing import NDArray

_STARTS = 2_000  # that coverage is found from, at most
_ROUNDING = 1e-6  # in units of discounted return


@dataclass(frozen=True)
class Returns:
    """Results of E episodes."""

    total: NDArray[np.float64]  # (E,) undiscounted
    discounted: NDArray[np.float64]  # (E,)
    steps: Ints  # (E,) primitive steps
    successes: Flags  # (E,) the task was done, not cut off
    decisions: Ints  # (E,) options begun
    fallbacks: Ints  # (E,) decisions for a primitive action because no option could start
    unknown: Ints  # (E,) decisions by preference because no option was sampled enough; exact: 0
    outcomes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """(E,) each: other results that the domain reports of its games; exact: none."""

    @classmethod
    def of_none(cls, over: Flags, outcomes: Mapping[str, NDArray[Any]] | None = None) -> 'Returns':
        """Return the results of E episodes before their first step; ``over`` (E,) are done."""
        steps, decisions, fallbacks, unknown = np.zeros((4, len(over)), dtype=np.intp)
        total, discounted = np.zeros((2, len(over)))
        return cls(total, discounted, steps, over, decisions, fallbacks, unknown, outcomes or {})


def episode_starts(
    domain: EnumerableDomain[Any], seed: int, episodes: int, progress: Progress = ignore_progress
) -> NDArray[np.int32]:
    """
    Draw the start states of episodes, (E,) state indices.

    Each draw has its own generator, so start i is the same however many are asked for.

    :param progress: called with the stage evaluation, which begins with this.
    """
    starts = np.empty(episodes, dtype=np.int32)
    for episode in range(episodes):
        progress('evaluation', 0.0, 0, math.nan)
        starts[episode] = domain.index(episode_start(domain, seed, episode))
    return starts


def episode_start(domain: Domain[S], seed: int, episode: int) -> S:
    """Draw the start state of one episode."""
    return domain.reset(generator(seed, 'episode_start', episode))


def play(
    plan: ExactPlan,
    starts: NDArray[np.integer],
    max_steps: int = 0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Returns:
    """
    Run each option of the policy to its end, as the runner does, until the episode ends.

    Chance has its own generator for each step, so episode i is the same however many are played.

    :param starts: (E,) state indices.
    :param seed: of the outcomes; not used where every action has one.
    :param max_steps: episodes are cut off after so many steps; 0: the domain's own limit.
    :param progress: called with the stage evaluation; what it raises passes through.
    :raises PlanError: neither limits the episodes, or a start is not a state.
    """
    limit = max_steps or plan.domain.max_steps
    if limit < 1:
        raise PlanError(f'{plan.domain.name} never cuts an episode off: give max_steps')
    if len(starts) and not 0 <= starts.min() <= starts.max() < plan.domain.n_states:
        raise PlanError(f'a start is not within 0..{plan.domain.n_states - 1}')
    episodes = Episodes(plan, starts)
    for step in range(limit):
        if not len(episodes.live):
            break
        progress('evaluation', step / limit, 0, math.nan)
        episodes.decide()
        episodes.step(generator(seed, 'play', step))
    return episodes.returns


class Episodes:
    """E episodes side by side; ``live`` are those that go on."""

    def __init__(self, plan: ExactPlan, starts: NDArray[np.integer]) -> None:
        count = len(starts)
        self._plan = plan
        over = plan.domain.over()
        self._simulator = TabularSimulator(plan.domain.transitions(), over)
        self._options = option_table(plan.domain, plan.action_set, plan.options)
        self._state = starts.astype(np.intp)
        self._option = np.full(count, -1, dtype=np.intp)  # -1: to be decided
        self._ran = np.zeros(count, dtype=np.intp)  # steps of the running option
        self._discount = np.ones(count)
        self.live = np.flatnonzero(~over[self._state])
        self.returns = Returns.of_none(over[self._state])

    def decide(self) -> Ints:
        """Begin an option wherever none is running; return the states of these decisions, (N,)."""
        free = self.live[self._option[self.live] < 0]
        option = self._plan.solution.best[self._state[free]]
        self._option[free], self._ran[free] = option, 0
        self.returns.decisions[free] += 1
        self.returns.fallbacks[free] += option >= self._plan.first_fallback
        return self._state[free]

    def step(self, rng: np.random.Generator) -> None:
        """Take one primitive step in every episode that goes on."""
        live, returns = self.live, self.returns
        state, option = self._state[live], self._option[live]
        action = self._options.action[option, state]
        drawn = self._simulator.draw(rng, len(self._state))
        arrived, reward, over = self._simulator.step(
            state, action, None if drawn is None else drawn[live]
        )
        returns.total[live] += reward
        returns.discounted[live] += self._discount[live] * reward
        returns.steps[live] += 1
        returns.successes[live] = over
        self._discount[live] *= self._plan.gamma
        self._state[live] = arrived
        self._ran[live] += 1
        cut_off = self._ran[live] >= self._options.limits[option]
        ended = self._options.ends[option, arrived] | cut_off
        self._option[live[ended]] = -1
        self.live = live[~over]


@dataclass(frozen=True)
class Coverage:
    """States in which the plan comes to a decision that its options do not serve well."""

    fallback: Ints  # (N,) no option can start there; those that most starts lead to come first
    single_step: Ints  # (M,) a primitive action first is worth more; the greatest gain comes first
    gain: Floats  # (M,) of each, in units of discounted return


def find_coverage(plan: ExactPlan, most: int = 20) -> Coverage:
    """
    Play one episode from each start of the task, and look at the states of its decisions.

    What a primitive action is worth, with the plan from the next state on, follows from the values
    of the plan.

    :param plan: with options only.
    :param most: states of each kind.
    :raises PlanError: primitive actions are among its choices, or the domain never cuts an
        episode off.
    """
    domain = plan.domain
    if plan.first_fallback != len(plan.options) or not domain.max_steps or not plan.options:
        raise PlanError('coverage is found of plans with options only, where episodes end')
    starts = domain.start_states()
    starts = starts[:: -(-len(starts) // _STARTS)]
    visits = np.zeros(domain.n_states, dtype=np.intp)
    episodes = Episodes(plan, starts)
    for step in range(domain.max_steps):
        visits += np.bincount(episodes.decide(), minlength=domain.n_states)
        episodes.step(generator(0, 'coverage', step))
    chosen, values = plan.solution.best, plan.solution.values
    decided = visits > 0
    fallback = np.flatnonzero(decided & (chosen >= plan.first_fallback))
    names = [action.name for action in domain.actions]
    steps = primitive_model(domain.transitions(), domain.over(), plan.gamma, names)
    gain = look_ahead(steps, values).max(axis=1) - values
    better = np.flatnonzero(decided & (chosen < plan.first_fallback) & (gain > _ROUNDING))
    fallback = fallback[np.argsort(-visits[fallback], kind='stable')][:most]
    better = better[np.argsort(-gain[better], kind='stable')][:most]
    return Coverage(fallback, better, gain[better])
