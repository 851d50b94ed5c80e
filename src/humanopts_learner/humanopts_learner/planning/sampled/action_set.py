"""The options of an action set, run in many games at once; primitive actions among them."""

from collections.abc import Sequence
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Domain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import OPTIONS_ONLY, PRIMITIVE
from humanopts_learner.planning.sampled.state_abstraction import Observation
import numpy as np

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2**64 by the golden ratio, odd: for hashing


class ActionSet:
    """
    Options, then all primitive actions as options of one step, by option index. Those from
    ``first_fallback`` on run only where no option can start.
    """

    def __init__(
        self, domain: Domain[Any], action_set: str, options: Sequence[LearnedOption]
    ) -> None:
        """Set up an action set; ``options`` are ignored in the set ``primitive``."""
        self.options = () if action_set == PRIMITIVE else tuple(options)
        self.action_set, self.n_actions = action_set, len(domain.actions)
        self.names = (
            *(option.name for option in self.options),
            *(PRIMITIVE_PREFIX + action.name for action in domain.actions),
        )
        only = action_set in OPTIONS_ONLY
        self.first_fallback = len(self.options) if only else len(self.names)
        self.limits = np.array([*(o.max_steps for o in self.options), *[1] * self.n_actions])

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of the models: starting each option, then continuing where it cannot start."""
        names = self.names[: self.first_fallback]
        return (*names, *(f'going on: {option.name}' for option in self.options))

    def startable(self, rows: Rows) -> Flags:
        """Return (N, O): which options can start in each game, without the fallback ones."""
        can = np.ones((len(rows), self.first_fallback), dtype=np.bool_)
        for o, option in enumerate(self.options):
            can[:, o] = option.can_start(rows)
        return can

    def fallback(self, rows: Rows) -> Ints:
        """
        Return (N,): the index of the primitive action where no option can start.

        A hash of all features chooses among all actions evenly: always the same action for equal
        features, and most often another one when a feature changes.
        """
        weights = 2 * np.arange(rows.shape[1], dtype=np.uint64) + GOLDEN
        mixed = (rows.astype(np.uint64) + np.uint64(1)) * weights
        mixed ^= mixed >> np.uint64(29)
        number = (mixed * weights).sum(axis=1, dtype=np.uint64) >> np.uint64(33)
        chosen: Ints = len(self.options) + (number % np.uint64(self.n_actions)).astype(np.intp)
        return chosen

    def running(self, option: Ints) -> list[tuple[LearnedOption, Ints]]:
        """Return each option that runs in some games, and the indices of these games."""
        found = [(one, np.flatnonzero(option == o)) for o, one in enumerate(self.options)]
        return [(one, games) for one, games in found if games.size]

    def actions(self, seen: Observation, option: Ints) -> Ints:
        """Return (N,): the primitive action of each game's option."""
        action = option - len(self.options)
        for one, games in self.running(option):
            action[games] = one.greedy_action(seen.rows[games])
        return action

    def ends(self, seen: Observation, option: Ints) -> Flags:
        """Return (N,): whether each game's option ends there; primitive actions always do."""
        ends = np.ones(len(option), dtype=np.bool_)
        for one, games in self.running(option):
            ends[games] = one.ends(seen.rows[games])
        return ends

    def can_start(self, seen: Observation, option: Ints) -> Flags:
        """Return (N,): whether each game's option could start there."""
        can = option < self.first_fallback
        for one, games in self.running(option):
            can[games] = one.can_start(seen.rows[games])
        return can
