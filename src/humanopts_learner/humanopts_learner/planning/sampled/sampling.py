"""
Sampling of option models: many games are played, and every end of a run is a sample.

A run of option o from s0 to sk, where o could also have started at s1, .., sk-1, shows as well
what running it from each of those leads to, since a Markov option does not look back (Precup 2000,
chapter 4). The same from where it could not have started shows what going on there leads to. Runs
that are cut off (by ``max_steps``, the length of an episode, or the end of the sampling) and runs
that the policy stops count as having ended where they were.
"""

from collections.abc import Callable

from humanopts_learner.planning.sampled.columns import Columns
from humanopts_learner.planning.sampled.counts import Counts, Samples
from humanopts_learner.planning.sampled.games import Ints, Watcher
from humanopts_learner.planning.sampled.policies import Policy
from humanopts_learner.planning.sampled.runs import Runs
import numpy as np

BLOCK = 1_000_000  # game steps that are kept before they are counted
Tell = Callable[[int], object]  # told the game steps so far


class Trace:
    """T steps of N games."""

    def __init__(self, length: int, count: int) -> None:
        shape = (length, count)
        self.code = np.empty((length, count), dtype=np.int64)
        self.column = np.empty(shape, dtype=np.int16)
        self.counts = np.empty(shape, dtype=np.bool_)  # it is modelled
        self.reward = np.empty(shape)
        self.ended = np.empty(shape, dtype=np.bool_)
        self.over = np.empty(shape, dtype=np.bool_)
        self.successor = np.empty(shape, dtype=np.int64)  # where the step led

    def samples(self, gamma: float) -> Samples:
        """Return every end of every run, by one pass backwards."""
        reward = self.reward
        successor = self.successor
        discount = np.where(self.over, 0.0, gamma)
        self.ended[-1] = True
        for t in range(len(reward) - 2, -1, -1):
            on = ~self.ended[t]
            reward[t] += np.where(on, gamma * reward[t + 1], 0.0)
            discount[t] = np.where(on, gamma * discount[t + 1], discount[t])
            successor[t] = np.where(on, successor[t + 1], successor[t])
        kept = self.counts
        return Samples(
            self.code[kept],
            self.column[kept].astype(np.intp),
            reward[kept],
            discount[kept],
            successor[kept],
        )


class Sampler:
    """N games that go on from round to round, and whose runs are counted."""

    def __init__(
        self,
        watch: Watcher,
        columns: Columns,
        counts: Counts,
        n_games: int,
        gamma: float,
        rng: np.random.Generator,
    ) -> None:
        """Begin games at the start of the task."""
        self._columns, self._counts, self._gamma = columns, counts, gamma
        self._limit = watch.games.domain.max_steps or np.iinfo(np.intp).max
        self._runs = Runs(watch, columns, watch.games.batch_reset(n_games, rng), rng)
        self._age = np.zeros(n_games, dtype=np.intp)

    def play(self, policy: Policy, steps: int, tell: Tell) -> int:
        """
        Go on by a policy, and count the runs.

        :param steps: game steps in all, rounded down to whole steps of all games.
        :return: game steps taken.
        """
        n_games = len(self._age)
        left, done = steps // n_games, 0
        while left:
            trace = Trace(min(left, max(BLOCK // n_games, 1)), n_games)
            self._runs.column[:] = -1
            for t in range(len(trace.reward)):
                self._step(policy, trace, t)
                done += n_games
                tell(done)
            self._counts.add(trace.samples(self._gamma))
            left -= len(trace.reward)
        return done

    def _step(self, policy: Policy, trace: Trace, t: int) -> None:
        runs = self._runs
        decided, _ = runs.decide(policy)
        if t:
            trace.ended[t - 1, decided] = True  # those that were stopped
        trace.code[t], trace.column[t] = runs.view.codes, self._modelled(runs)
        trace.counts[t] = runs.column < self._columns.first_fallback
        trace.reward[t], ended, over = runs.step()
        trace.successor[t], trace.over[t] = runs.view.codes, over
        self._age += 1
        last = over | (self._age >= self._limit)
        trace.ended[t] = ended | last
        runs.column[trace.ended[t]] = -1
        fresh = np.flatnonzero(last)
        if fresh.size:
            runs.restart(fresh)
            self._age[fresh] = 0

    def _modelled(self, runs: Runs) -> Ints:
        """Return the number of each game's column among those that are counted."""
        inside = self._columns.can_start(runs.view, runs.column)
        number: Ints = np.where(inside, runs.column, runs.column + self._columns.first_fallback)
        return number
