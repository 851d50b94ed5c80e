"""What can be run in many games at once: options, and primitive actions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from humanopts_env.domains.capabilities import BatchGames
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import OPTIONS_ONLY, PRIMITIVE
from humanopts_learner.planning.sampled.games import Flags, Ints, View
import numpy as np

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2**64 by the golden ratio, odd: for hashing


class BatchOption(Protocol):
    """An option that is judged for many games at once."""

    @property
    def name(self) -> str:
        """Name of the option."""
        ...

    @property
    def max_steps(self) -> int:
        """Primitive steps after which a run is cut off."""
        ...

    def can_start(self, view: View) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        ...

    def action(self, view: View) -> Ints:
        """Return (N,): what it does."""
        ...

    def ends(self, view: View) -> Flags:
        """Return (N,): whether it ends there; not asked before its first step."""
        ...


@dataclass(frozen=True)
class LearnedBatchOption:
    """A learned option, in greedy mode."""

    option: LearnedOption

    @property
    def name(self) -> str:
        """Name of the option."""
        return self.option.name

    @property
    def max_steps(self) -> int:
        """Primitive steps after which a run is cut off."""
        return self.option.max_steps

    def can_start(self, view: View) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        return self.option.can_start(view.rows)

    def action(self, view: View) -> Ints:
        """Return (N,): the likeliest action."""
        return self.option.greedy_action(view.rows)

    def ends(self, view: View) -> Flags:
        """Return (N,): whether it ends there."""
        return self.option.ends(view.rows)


class Columns:
    """
    What an action set can run: options, then all primitive actions.

    Columns from ``first_fallback`` on are run only where no option can start.
    """

    def __init__(self, games: BatchGames, action_set: str, options: Sequence[BatchOption]) -> None:
        """Set up an action set; ``options`` are not looked at in the set ``primitive``."""
        self.options = () if action_set == PRIMITIVE else tuple(options)
        actions = games.domain.actions
        self.n_actions = len(actions)
        self.names = (
            *(option.name for option in self.options),
            *(PRIMITIVE_PREFIX + action.name for action in actions),
        )
        only = action_set in OPTIONS_ONLY
        self.first_fallback = len(self.options) if only else len(self.names)
        self.limits = np.array([*(o.max_steps for o in self.options), *[1] * self.n_actions])

    @property
    def modelled(self) -> tuple[str, ...]:
        """What is counted: starting each column that can start, then going on from elsewhere."""
        names = self.names[: self.first_fallback]
        return (*names, *(f'going on: {option.name}' for option in self.options))

    def startable(self, view: View) -> Flags:
        """Return (N, O): which columns can start in each game, fallback columns apart."""
        can = np.ones((len(view.codes), self.first_fallback), dtype=np.bool_)
        for column, option in enumerate(self.options):
            can[:, column] = option.can_start(view)
        return can

    def fallback(self, view: View) -> Ints:
        """
        Return (N,): the column of the primitive action where no option can start.

        A hash of all features chooses among all actions evenly: the same for equal features, and
        another one when something moves.
        """
        weights = 2 * np.arange(view.rows.shape[1], dtype=np.uint64) + GOLDEN
        mixed = (view.rows.astype(np.uint64) + np.uint64(1)) * weights
        mixed ^= mixed >> np.uint64(29)
        number = (mixed * weights).sum(axis=1, dtype=np.uint64) >> np.uint64(33)
        chosen: Ints = len(self.options) + (number % np.uint64(self.n_actions)).astype(np.intp)
        return chosen

    def running(self, column: Ints) -> list[tuple[BatchOption, Ints]]:
        """Return each option that runs in some games, and their indices."""
        found = [(o, np.flatnonzero(column == c)) for c, o in enumerate(self.options)]
        return [(option, games) for option, games in found if games.size]

    def actions(self, view: View, column: Ints) -> Ints:
        """Return (N,): what each game's column does."""
        action = column - len(self.options)
        for option, games in self.running(column):
            action[games] = option.action(view.take(games))
        return action

    def ends(self, view: View, column: Ints) -> Flags:
        """Return (N,): whether each game's column ends there; primitive actions always do."""
        ends = np.ones(len(column), dtype=np.bool_)
        for option, games in self.running(column):
            ends[games] = option.ends(view.take(games))
        return ends

    def can_start(self, view: View, column: Ints) -> Flags:
        """Return (N,): whether each game's column could start there."""
        can = column < self.first_fallback
        for option, games in self.running(column):
            can[games] = option.can_start(view.take(games))
        return can
