"""
Sampling option models: N games that go on from round to round, their runs counted as samples.

Every suffix of a run is counted. A run of option o from s0 to sk, where o could also have started
at s1, .., sk-1, is a sample of running it from each of those states too, since a Markov option
does not depend on earlier states (Precup 2000, chapter 4). From a state where o could not have
started, it is a sample of continuing o there. Runs that are cut off (by ``max_steps``, the length
of an episode, or the end of the sampling) and runs that the policy stops count as having ended
where they were.
"""

from collections.abc import Callable

from humanopts_env.games import new_games
from humanopts_learner.execution import Execution, NONE, Policy
from humanopts_learner.planning.action_set import ActionSet, Observation
from humanopts_learner.planning.sampled_models import SampleCounts, Samples
import numpy as np

BLOCK = 1_000_000  # game steps that are kept before they are counted


class Recording:
    """T steps of N games."""

    def __init__(self, length: int, count: int) -> None:
        shape = (length, count)
        self.state = np.empty(shape, dtype=np.int64)  # abstract
        self.option = np.empty(shape, dtype=np.int16)
        self.modelled = np.empty(shape, dtype=np.bool_)
        self.reward = np.empty(shape)
        self.ended = np.empty(shape, dtype=np.bool_)
        self.over = np.empty(shape, dtype=np.bool_)
        self.successor = np.empty(shape, dtype=np.int64)  # abstract state after the step

    def samples(self, gamma: float) -> Samples:
        """Return every suffix of every run, by one pass backwards."""
        reward = self.reward
        successor = self.successor
        discount = np.where(self.over, 0.0, gamma)
        self.ended[-1] = True
        for t in range(len(reward) - 2, -1, -1):
            on = ~self.ended[t]
            reward[t] += np.where(on, gamma * reward[t + 1], 0.0)
            discount[t] = np.where(on, gamma * discount[t + 1], discount[t])
            successor[t] = np.where(on, successor[t + 1], successor[t])
        kept = self.modelled
        return Samples(
            self.state[kept],
            self.option[kept].astype(np.intp),
            reward[kept],
            discount[kept],
            successor[kept],
        )


class Sampler:
    """N games that continue from round to round; their runs are counted as samples."""

    def __init__(
        self,
        actions: ActionSet,
        counts: SampleCounts,
        n_games: int,
        gamma: float,
        rng: np.random.Generator,
    ) -> None:
        """Begin games at the start of the task."""
        self._actions, self._counts, self._gamma, self._rng = actions, counts, gamma, rng
        self._limit = actions.domain.max_steps or np.iinfo(np.intp).max
        self._games = new_games(actions.domain, n_games, rng)
        self._seen = actions.see(self._games)
        self._age = np.zeros(n_games, dtype=np.intp)

    def play(
        self, policy: Policy[Observation], steps: int, on_steps: Callable[[int], object]
    ) -> int:
        """
        Continue by a policy, and count the runs.

        :param steps: game steps in all, rounded down to whole steps of all games.
        :param on_steps: called with the game steps so far.
        :return: game steps taken.
        """
        n_games = len(self._age)
        left, done = steps // n_games, 0
        while left:
            recording = Recording(min(left, max(BLOCK // n_games, 1)), n_games)
            execution = Execution(self._actions, policy, n_games)
            for t in range(len(recording.reward)):
                self._step(execution, recording, t)
                done += n_games
                on_steps(done)
            self._counts.add(recording.samples(self._gamma))
            left -= len(recording.reward)
        return done

    def _step(self, execution: Execution[Observation], recording: Recording, t: int) -> None:
        """Take one step in every game; those that are over or cut off then begin again."""
        fallback, seen = self._actions.first_fallback, self._seen
        actions = execution.act(seen)
        inside = seen.can_start(execution.option)
        recording.state[t] = seen.states
        recording.option[t] = np.where(inside, execution.option, execution.option + fallback)
        recording.modelled[t] = execution.option < fallback
        steps = self._games.step(actions, self._rng)
        self._age += 1
        cut_off = self._age >= self._limit
        last = steps.over | cut_off
        left = self._actions.see(self._games) if (cut_off & ~steps.over).any() else None
        if last.any():
            self._games.reset(np.flatnonzero(last), self._rng)
            self._age[last] = 0
        self._seen = self._actions.see(self._games)
        recording.reward[t], recording.over[t] = steps.reward, steps.over
        # The successor of a game that is over does not count.
        recording.successor[t] = (left or self._seen).states
        execution.observe(self._seen, steps, cut_off)
        recording.ended[t] = execution.option == NONE
