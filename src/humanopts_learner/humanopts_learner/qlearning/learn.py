"""
SMDP Q-learning and intra-option Q-learning, many learners side by side.

R. S. Sutton, D. Precup and S. Singh (1999), "Between MDPs and semi-MDPs". SMDP Q-learning (section
3.2; "macro Q-learning" for options that cannot be interrupted) learns of an option when it ends
after k steps, with r the discounted reward on the way:

    Q(s, o) += rate * (r + gamma**k * max Q(s', .) - Q(s, o))

Intra-option Q-learning (section 6) learns with every step, of all options that would have done
the same there, whichever runs, with U(s', o) = Q(s', o) where o goes on and max Q(s', .) where it
ends:

    Q(s, o) += rate * (r + gamma * U(s', o) - Q(s, o))

It takes no notice of the limits of options, which depend on more than the state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.seeding import generator
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.qlearning.choices import Choices
from humanopts_learner.qlearning.world import any_of, Flags, Floats, Ints, World
import numpy as np

# Told which share of the episodes is done, 0..1; raises ``PlanCanceled`` to stop
Progress = Callable[[float], object]
TOLD_EVERY = 200  # steps


class Method(Enum):
    """What is learned from."""

    SMDP = 'smdp'  # whole runs of options
    INTRA_OPTION = 'intra-option'  # single steps


@dataclass(frozen=True)
class Rates:
    """How one learner learns and explores."""

    learning_rate: float = 0.1
    explore: float = 0.1  # share of decisions that are drawn from all that is available

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises PlanError: one is out of range.
        """
        if not (0.0 < self.learning_rate <= 1.0 and 0.0 <= self.explore <= 1.0):
            raise PlanError(f'{self}: the rate must be above 0, and both at most 1')


@dataclass(frozen=True)
class Learning:
    """What N learners did in E episodes each."""

    steps: Ints  # (N, E) primitive steps
    returns: Floats  # (N, E) undiscounted
    values: Floats  # (N, S, O) in the end


def learn(
    domain: EnumerableDomain[Any],
    choices: Choices,
    rates: Sequence[Rates],
    episodes: int,
    seed: int,
    method: Method = Method.SMDP,
    gamma: float | None = None,
    max_steps: int = 0,
    progress: Progress | None = None,
) -> Learning:
    """
    Learn from values of 0, each option run to its end.

    Where an episode is cut off, SMDP learning takes the running option as ended there.

    :param rates: of the N learners; their chance is independent.
    :param gamma: discount per primitive step; None: the domain's own.
    :param max_steps: episodes are cut off after so many steps; 0: the domain's own limit.
    :raises PlanError: nothing limits the episodes, or there are no learners or no episodes.
    :raises PlanCanceled: from ``progress``.
    """
    limit = max_steps or domain.max_steps
    if limit < 1 or episodes < 1 or not rates:
        raise PlanError(
            f'cannot learn with {len(rates)} learners in {episodes} episodes of {limit} steps: '
            'each must be 1 or more'
        )
    rng = generator(seed, 'qlearning', method.value)
    discount = domain.gamma if gamma is None else gamma
    learners = _Learners(domain, choices, rates, episodes, method, discount, limit, rng)
    rounds = 0
    while learners.live.size:
        learners.decide()
        learners.step()
        rounds += 1
        if progress is not None and rounds % TOLD_EVERY == 0:
            progress(learners.done)
    if progress is not None:
        progress(1.0)
    return learners.result


class _Learners:
    """N learners, each in an episode of its own; ``live`` are those that go on."""

    def __init__(
        self,
        domain: EnumerableDomain[Any],
        choices: Choices,
        rates: Sequence[Rates],
        episodes: int,
        method: Method,
        gamma: float,
        limit: int,
        rng: np.random.Generator,
    ) -> None:
        self._world = World(domain.transitions(), domain.over())
        self._starts, self._choices = domain.start_states().astype(np.intp), choices
        self._gamma, self._limit, self._rng, self._method = gamma, limit, rng, method
        count = len(rates)
        self._rate = np.array([rate.learning_rate for rate in rates])
        self._explore = np.array([rate.explore for rate in rates])
        self.live = np.arange(count)
        self.result = Learning(
            np.zeros((count, episodes), dtype=np.intp),
            np.zeros((count, episodes)),
            np.zeros((count, domain.n_states, len(choices.names))),
        )
        self._episode = np.zeros(count, dtype=np.intp)
        self._state = rng.choice(self._starts, count)
        self._column = np.full(count, -1, dtype=np.intp)  # what runs; -1: to be decided
        self._begun = np.zeros(count, dtype=np.intp)  # state in which it began
        self._ran = np.zeros(count, dtype=np.intp)  # its steps so far
        self._gained = np.zeros(count)  # discounted reward since it began
        self._discount = np.ones(count)  # gamma**ran

    @property
    def done(self) -> float:
        """Share of the episodes that are over."""
        return float(self._episode.sum()) / self.result.steps.size

    def decide(self) -> None:
        """Begin a column wherever none runs: the best, any of equals, or now and then any."""
        free = self.live[self._column[self.live] < 0]
        state = self._state[free]
        can = self._choices.available[state]
        values = np.where(can, self.result.values[free, state], -np.inf)
        best = values == values.max(axis=1, keepdims=True)
        explore = self._rng.random(len(free)) < self._explore[free]
        self._column[free] = any_of(can & (best | explore[:, None]), self._rng)
        self._begun[free], self._ran[free] = state, 0
        self._gained[free], self._discount[free] = 0.0, 1.0

    def step(self) -> None:
        """Take one primitive step in every episode that goes on, and learn."""
        live, state, column = self.live, self._state[self.live], self._column[self.live]
        action = self._choices.action[column, state]
        there, reward, over = self._world.step(state, action, self._rng)
        out_of_time = self._count(reward)
        ended = over | out_of_time | self._choices.ends[column, there]
        ended |= self._ran[live] >= self._choices.limits[column]
        ahead = np.where(over, 0.0, self._best(live, there))
        if self._method is Method.SMDP:
            self._learn_of_runs(live[ended], ahead[ended])
        else:
            self._learn_of_steps(state, action, reward, there, over, ahead)
        self._state[live] = there
        self._column[live[ended]] = -1
        self._begin_again(live[over | out_of_time])

    def _count(self, reward: Floats) -> Flags:
        """Count a step and its reward; return which episodes (n,) are cut off with it."""
        live, result = self.live, self.result
        at = live, self._episode[live]
        result.steps[at] += 1
        result.returns[at] += reward
        self._gained[live] += self._discount[live] * reward
        self._discount[live] *= self._gamma
        self._ran[live] += 1
        cut: Flags = result.steps[at] >= self._limit
        return cut

    def _best(self, live: Ints, state: Ints) -> Floats:
        """Return (n,): the value of the best that can be chosen; 0 where nothing can."""
        can = self._choices.available[state]
        values = np.where(can, self.result.values[live, state], -np.inf).max(axis=1)
        return np.where(can.any(axis=1), values, 0.0)

    def _learn_of_runs(self, ended: Ints, ahead: Floats) -> None:
        at = ended, self._begun[ended], self._column[ended]
        goal = self._gained[ended] + self._discount[ended] * ahead
        self.result.values[at] += self._rate[ended] * (goal - self.result.values[at])

    def _learn_of_steps(
        self, state: Ints, action: Ints, reward: Floats, there: Ints, over: Flags, ahead: Floats
    ) -> None:
        game, column = np.nonzero(action[:, None] == self._choices.action[:, state].T)
        learner = self.live[game]
        values, ends = self.result.values, self._choices.ends[column, there[game]]
        onward = np.where(over[game], 0.0, values[learner, there[game], column])
        goal = reward[game] + self._gamma * np.where(ends, ahead[game], onward)
        at = learner, state[game], column
        values[at] += self._rate[learner] * (goal - values[at])

    def _begin_again(self, ended: Ints) -> None:
        self._episode[ended] += 1
        self._state[ended] = self._rng.choice(self._starts, len(ended))
        self.live = self.live[self._episode[self.live] < self.result.steps.shape[1]]
