"""
The observations and options of sampled planning, in many parallel games.

Games with equal columns are in one abstract state; abstract states must be few enough to be
visited often. The options of an action set, including primitive actions, run in all games in
parallel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.capabilities import HasPrimitiveColumns
from humanopts_env.domains.described import can_simulate
from humanopts_env.games import Games, games_at
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.execution import draw_among, Loops, Policy
from humanopts_learner.option import Option, StochasticOption
from humanopts_learner.options.learned_option import decisions, loops_of, SeenStates
from humanopts_learner.planning.abstraction import Abstraction, Codes
from humanopts_learner.planning.request import OPTIONS_ONLY, PRIMITIVE
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Observation:
    """The abstract states of N games, and the decisions of O options, without the fallback."""

    states: Codes  # (N,) codes of the abstract states
    startable: Flags  # (N, O) whether each option can start
    wanted: NDArray[np.int16]  # (N, O) primitive action of each option
    ending: Flags  # (N, O) whether each option would end
    fallback: Ints  # (N,) index of the primitive action if no option can start; else -1
    n_options: int  # number of options before the primitive actions

    def take(self, games: Ints) -> 'Observation':
        return Observation(
            self.states.take(games),
            self.startable.take(games, axis=0),
            self.wanted.take(games, axis=0),
            self.ending.take(games, axis=0),
            self.fallback.take(games),
            self.n_options,
        )

    def at_random(self, rng: np.random.Generator) -> Ints:
        """Return (N,): a uniformly random option that can start, or the fallback."""
        option = draw_among(self.startable, rng)
        np.copyto(option, self.fallback, where=self.fallback >= 0)
        return option

    def action(self, option: Ints) -> Ints:
        action = option - self.n_options
        running = np.flatnonzero(action < 0)
        action[running] = self.wanted[running, option[running]]
        return action

    def ends(self, option: Ints) -> Flags:
        """Return (N,): whether each game's option ends; primitive actions always do."""
        ends = np.ones(len(option), dtype=np.bool_)
        running = np.flatnonzero(option < self.n_options)
        ends[running] = self.ending[running, option[running]]
        return ends

    def can_start(self, option: Ints) -> Flags:
        """Return (N,): whether each game's option can start; False for a fallback."""
        found: Flags = option < self.startable.shape[1]
        found[found] = self.startable[found, option[found]]
        return found


@dataclass(frozen=True)
class AnyOption(Policy[Observation | SeenStates]):
    """The policy that runs uniformly random options to their ends."""

    rng: np.random.Generator

    def choose(self, seen: Observation | SeenStates, games: Ints) -> Ints:
        return seen.at_random(self.rng)


class ActionSet:
    """
    The options, followed by all primitive actions as one-step options.

    Actions with an index of ``first_fallback`` or more run only if no option can start.
    """

    def __init__(
        self,
        domain: ActableDomain,
        action_set: str,
        options: Sequence[Option],
        columns: Sequence[str] = (),
    ) -> None:
        """
        Set up an action set.

        :param options: ignored in the set ``primitive``.
        :param columns: feature columns of abstract states, as in ``Abstraction``; empty: defaults.
        :raises PlanError: a column is invalid.
        """
        self.options = () if action_set == PRIMITIVE else tuple(options)
        self.action_set, self.n_actions = action_set, len(domain.actions)
        self.domain = domain
        if action_set == PRIMITIVE and isinstance(domain, HasPrimitiveColumns):
            columns = columns or domain.primitive_columns
        self.columns, self._abstraction = tuple(columns), Abstraction(domain, columns)
        self.names = (
            *(option.name for option in self.options),
            *(PRIMITIVE_PREFIX + action.name for action in domain.actions),
        )
        only = action_set in OPTIONS_ONLY
        self.first_fallback = len(self.options) if only else len(self.names)
        self.limits = np.array([*(o.max_steps for o in self.options), *[1] * self.n_actions])

    def observe_state(self, state: Any) -> Observation:
        """Return the observation of one game in a state of the domain."""
        if can_simulate(self.domain):
            return self.see(games_at(self.domain, [state]))
        return self.see_rows(self.domain.feature_values(state)[None])

    def see(self, games: Games) -> Observation:
        """Observe games."""
        return self.see_rows(games.features(), games)

    def see_rows(self, rows: Rows, games: Games | None = None) -> Observation:
        """Observe games by their features (N, F); ``games`` is None if nothing else is known."""
        shape, n_options = (len(rows), self.first_fallback), len(self.options)
        startable, ending = np.ones(shape, dtype=np.bool_), np.ones(shape, dtype=np.bool_)
        wanted = np.empty(shape, dtype=np.int16)
        wanted[:, n_options:] = np.arange(shape[1] - n_options)
        stuck = np.full(len(rows), n_options == shape[1])
        for o, option in enumerate(self.options):
            can_start, action, ends = decisions(option, rows, self.domain)
            startable[:, o], wanted[:, o], ending[:, o] = can_start, action, ends
            stuck &= ~can_start
        symbols = [*startable.T[:n_options], *ending.T[:n_options], *wanted.T[:n_options]]
        states = self._abstraction.codes(games, rows, symbols)
        fallback = np.full(len(rows), -1, dtype=np.intp)
        at = np.flatnonzero(stuck)
        if at.size:
            fallback[at] = n_options + self._fallback(rows[at], wanted[at])
        return Observation(states, startable, wanted, ending, fallback, n_options)

    def loops(self, count: int, rng: np.random.Generator | None) -> Loops | None:
        """Return a detector of runs that repeat themselves; see ``loops_of``."""
        return loops_of(self.domain, self.options, count, rng, self.n_actions)

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of models: starting each option, then continuing it where it cannot start."""
        names = self.names[: self.first_fallback]
        return (*names, *(f'going on: {option.name}' for option in self.options))

    def _fallback(self, rows: Rows, wanted: NDArray[np.int16]) -> Ints:
        """
        Return (N,): the action of the option with the highest initiation probability.

        Options without probabilities have probability 0, since none of the options can start.
        """
        chances = [
            option.initiation_probability(rows)
            if isinstance(option, StochasticOption)
            else np.zeros(len(rows))
            for option in self.options
        ]
        nearest = np.stack(chances, axis=1).argmax(axis=1)
        action: Ints = wanted[np.arange(len(rows)), nearest].astype(np.intp)
        return action
