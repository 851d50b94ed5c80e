"""Playing a policy in the real game, many games at once."""

import math
from typing import Any

from humanopts_env.seeding import generator
from humanopts_learner.planning.action_sets import ignore_progress, Progress
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.sampled.columns import Columns
from humanopts_learner.planning.sampled.games import Flags, Ints, Watcher
from humanopts_learner.planning.sampled.policies import Policy
from humanopts_learner.planning.sampled.runs import Runs
import numpy as np


def play_games(
    watch: Watcher,
    columns: Columns,
    policy: Policy,
    gamma: float,
    seed: int,
    episodes: int,
    progress: Progress | None = None,
) -> Returns:
    """
    Play games from the start of the task, each option run to its end.

    :param episodes: how many, E, all side by side; games do not affect each other, but which
        chance each meets depends on how many there are.
    :param progress: called with the stage evaluation; what it raises passes through.
    :raises PlanError: the domain never cuts an episode off, or ``episodes`` is below 1.
    """
    limit = watch.games.domain.max_steps
    if limit < 1 or episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes of at most {limit} steps')
    rng = generator(seed, 'play_games')
    batch = watch.games.batch_reset(episodes, rng)
    result = _Result(watch, columns, batch, gamma)
    runs, at = Runs(watch, columns, batch, rng), np.arange(episodes)
    over, report = watch.games.batch_over(batch), progress or ignore_progress
    for step in range(limit):
        report('evaluation', step / limit, 0, math.nan)
        if not over.all():
            result.step(runs, policy, at, over)
            over = watch.games.batch_over(runs.batch)
        if over.mean() >= 0.3:
            result.finish(runs, at, over)
            at, over = at[~over], over[~over]
            runs.keep(np.flatnonzero(~watch.games.batch_over(runs.batch)))
        if not len(at):
            break
    result.finish(runs, at, np.ones(len(at), dtype=np.bool_))
    return result.returns


class _Result:
    """Adds up what happens in E games."""

    def __init__(self, watch: Watcher, columns: Columns, batch: Any, gamma: float) -> None:
        self._watch, self._columns, self._gamma = watch, columns, gamma
        self._outcomes = {
            name: values.copy() for name, values in watch.games.batch_outcome(batch).items()
        }
        self.returns = Returns.of_none(watch.games.batch_over(batch), self._outcomes)

    def step(self, runs: Runs, policy: Policy, at: Ints, over: Flags) -> None:
        """
        Take one step in games that go on.

        :param at: (M,) which of the E games are still looked at.
        :param over: (M,) which of those are over; they are not counted any more.
        """
        returns, live = self.returns, at[~over]
        free, choice = runs.decide(policy)
        going = ~over[free]
        returns.decisions[at[free[going]]] += 1
        fallback = choice.column >= self._columns.first_fallback
        returns.fallbacks[at[free[going]]] += fallback[going]
        returns.unknown[at[free[going]]] += choice.unknown[going]
        reward, ended, now_over = runs.step()
        runs.column[ended] = -1
        returns.total[live] += reward[~over]
        returns.discounted[live] += self._gamma ** returns.steps[live] * reward[~over]
        returns.steps[live] += 1
        returns.successes[at] = now_over

    def finish(self, runs: Runs, at: Ints, which: Flags) -> None:
        """Note how games (M,) stand that are not looked at any more."""
        for name, values in self._watch.games.batch_outcome(runs.batch).items():
            self._outcomes[name][at[which]] = values[which]
