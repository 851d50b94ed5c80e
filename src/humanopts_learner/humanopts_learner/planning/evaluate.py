"""Playing a plan in the rules of its domain, all episodes at once."""

from dataclasses import dataclass
import math
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, S
from humanopts_env.domains.chance import draw_outcomes, outcome_limits
from humanopts_env.seeding import generator
from humanopts_learner.planning.action_sets import Progress, say_nothing
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.planning.plan import Plan
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Returns:
    """What each of E episodes came to."""

    total: NDArray[np.float64]  # (E,) undiscounted
    discounted: NDArray[np.float64]  # (E,)
    steps: Ints  # (E,) primitive steps
    successes: Flags  # (E,) the task was done
    decisions: Ints  # (E,) options begun
    fallbacks: Ints  # (E,) of these, primitive actions because no option was available


def episode_starts(
    domain: EnumerableDomain[Any], seed: int, episodes: int, progress: Progress | None = None
) -> NDArray[np.int32]:
    """
    Draw the start states of episodes, (E,) state indices.

    Each draw has its own generator, so start i is the same however many are asked for.

    :param progress: told the stage evaluation, which begins with this.
    """
    tell = progress or say_nothing
    starts = np.empty(episodes, dtype=np.int32)
    for episode in range(episodes):
        tell('evaluation', 0.0, 0, math.nan)
        starts[episode] = domain.index(episode_start(domain, seed, episode))
    return starts


def episode_start(domain: Domain[S], seed: int, episode: int) -> S:
    """Draw the start state of one episode."""
    return domain.reset(generator(seed, 'episode_start', episode))


def play(
    plan: Plan,
    starts: NDArray[np.integer],
    max_steps: int = 0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Returns:
    """
    Run each option of the policy to its end, as the runner does, until the episode ends.

    Chance has its own generator for each step, so episode i is the same however many are played.

    :param starts: (E,) state indices.
    :param seed: of the outcomes; not used where every action has one.
    :param max_steps: episodes are cut off after so many steps; 0: the domain's own limit.
    :param progress: told the stage evaluation; what it raises passes through.
    :raises PlanError: neither limits the episodes, or a start is not a state.
    """
    limit = max_steps or plan.domain.max_steps
    if limit < 1:
        raise PlanError(f'{plan.domain.name} never cuts an episode off: give max_steps')
    if len(starts) and not 0 <= starts.min() <= starts.max() < plan.domain.n_states:
        raise PlanError(f'a start is not within 0..{plan.domain.n_states - 1}')
    game, tell = _Games(plan, starts), progress or say_nothing
    chance = not plan.domain.transitions().deterministic
    for step in range(limit):
        if not len(game.live):
            break
        tell('evaluation', step / limit, 0, math.nan)
        game.decide()
        game.step(generator(seed, 'play', step).random(len(starts)) if chance else None)
    return game.returns


class _Games:
    """E games side by side; ``live`` are those that go on."""

    def __init__(self, plan: Plan, starts: NDArray[np.integer]) -> None:
        count = len(starts)
        self._plan = plan
        self._rules = plan.domain.transitions()
        self._limits = None if self._rules.deterministic else outcome_limits(self._rules)
        self._over = plan.domain.over()
        self._tables = _Tables(plan)
        self._state = starts.astype(np.intp)
        self._column = np.full(count, -1, dtype=np.intp)  # -1: to be decided
        self._ran = np.zeros(count, dtype=np.intp)  # steps of the running option
        self._discount = np.ones(count)
        self.live = np.flatnonzero(~self._over[self._state])
        self.returns = Returns(
            total=np.zeros(count),
            discounted=np.zeros(count),
            steps=np.zeros(count, dtype=np.intp),
            successes=self._over[self._state],
            decisions=np.zeros(count, dtype=np.intp),
            fallbacks=np.zeros(count, dtype=np.intp),
        )

    def decide(self) -> None:
        """Begin an option wherever none is running."""
        free = self.live[self._column[self.live] < 0]
        column = self._plan.solution.best[self._state[free]]
        self._column[free], self._ran[free] = column, 0
        self.returns.decisions[free] += 1
        self.returns.fallbacks[free] += column >= self._plan.first_fallback

    def step(self, numbers: NDArray[np.float64] | None) -> None:
        """
        Take one primitive step in every game that goes on.

        :param numbers: (E,), uniform, that choose the outcomes; None: every action has one.
        """
        live, returns = self.live, self.returns
        state, column = self._state[live], self._column[live]
        action = self._tables.action(column, state)
        outcome: Ints | int = 0
        if self._limits is not None and numbers is not None:
            outcome = draw_outcomes(self._limits, state, action, numbers[live])
        at = state, action, outcome
        arrived, reward = self._rules.successor[at], self._rules.reward[at]
        over = self._rules.terminated[at] | self._over[arrived]
        returns.total[live] += reward
        returns.discounted[live] += self._discount[live] * reward
        returns.steps[live] += 1
        returns.successes[live] = over
        self._discount[live] *= self._plan.gamma
        self._state[live] = arrived
        self._ran[live] += 1
        ended = self._tables.ends(column, arrived) | (
            self._ran[live] >= self._tables.limit[column]
        )
        self._column[live[ended]] = -1
        self.live = live[~over]


class _Tables:
    """The columns of a plan as arrays; primitive actions are options of one step."""

    def __init__(self, plan: Plan) -> None:
        n_options = len(plan.options)
        primitives = len(plan.names) - n_options
        self._n_options = n_options
        shape = (n_options, plan.domain.n_states)
        tables = [option.tables for option in plan.options]
        self._action = np.array([t.action for t in tables], dtype=np.intp).reshape(shape)
        self._ends = np.array([t.termination for t in tables], dtype=np.bool_).reshape(shape)
        self.limit = np.array([o.max_steps for o in plan.options] + [1] * primitives)

    def action(self, column: Ints, state: Ints) -> Ints:
        """Return the primitive action of each game, (E,)."""
        action = column - self._n_options
        learned = column < self._n_options
        action[learned] = self._action[column[learned], state[learned]]
        return action

    def ends(self, column: Ints, state: Ints) -> Flags:
        """Tell where the termination condition holds, (E,)."""
        ends = column >= self._n_options
        learned = ~ends
        ends[learned] = self._ends[column[learned], state[learned]]
        return ends
