"""Running columns to their ends in many games side by side."""

from typing import Any

from humanopts_learner.planning.sampled.columns import Columns
from humanopts_learner.planning.sampled.games import Flags, Ints, Watcher
from humanopts_learner.planning.sampled.policies import Choice, Policy
import numpy as np
from numpy.typing import NDArray


class Runs:
    """
    N games in each of which one column runs at a time.

    :ivar column: (N,) what runs; -1: to be decided.
    :ivar ran: (N,) its steps so far.
    """

    def __init__(
        self, watch: Watcher, columns: Columns, batch: Any, rng: np.random.Generator
    ) -> None:
        self._watch, self._columns, self._rng = watch, columns, rng
        self.batch, self.view = batch, watch(batch)
        self.column = np.full(len(self.view.codes), -1, dtype=np.intp)
        self.ran = np.zeros(len(self.column), dtype=np.intp)

    def decide(self, policy: Policy) -> tuple[Ints, Choice]:
        """
        Begin a column wherever none runs, or one is stopped.

        :return: those games (M,), and what was chosen in each.
        """
        stopped = policy.stops(self.view, self.column, self._rng)
        free = np.flatnonzero((self.column < 0) | stopped)
        choice = policy(self.view.take(free), self._rng)
        self.column[free], self.ran[free] = choice.column, 0
        return free, choice

    def step(self) -> tuple[NDArray[Any], Flags, Flags]:
        """Take one step; return rewards, which columns ended and which games are over, (N,)."""
        games, columns = self._watch.games, self._columns
        action = columns.actions(self.view, self.column)
        reward = games.batch_step(self.batch, action, self._rng)
        self.view = self._watch(self.batch)
        self.ran += 1
        over = games.batch_over(self.batch)
        ended = over | (self.ran >= columns.limits[self.column])
        ended |= columns.ends(self.view, self.column)
        return reward, ended, over

    def restart(self, chosen: Ints) -> None:
        """Begin chosen games (M,) again."""
        games = self._watch.games
        fresh = self._watch(games.batch_reset(len(chosen), self._rng))
        games.batch_put(self.batch, chosen, fresh.batch)
        self.view.rows[chosen], self.view.codes[chosen] = fresh.rows, fresh.codes
        self.column[chosen] = -1

    def keep(self, chosen: Ints) -> None:
        """Go on with chosen games (M,) only."""
        self.batch = self._watch.games.batch_take(self.batch, chosen)
        self.view = self._watch(self.batch)
        self.column, self.ran = self.column[chosen], self.ran[chosen]
