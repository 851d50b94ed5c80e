"""
What sampled planning sees and chooses among, in many games at once.

Games with equal abstract features are in one abstract state. Abstract states are few enough that
each is visited often. The options of an action set, primitive actions among them, are run in all
games side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import BatchGames
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.options.lookup import Decisions, decisions
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import batch_games, OPTIONS_ONLY, PlanError, PRIMITIVE
import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
LARGEST_CODE = 2**53  # abstract states are numbered below this
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2**64 by the golden ratio, odd: for hashing


@dataclass
class Observation:
    """The features and abstract states of N games, for options and policies."""

    rows: NDArray[np.int32]  # (N, F) all features
    states: Codes  # (N,) codes of the abstract states
    startable: Flags | None = None  # (N, O) which options can start; None: not asked yet

    def take(self, chosen: Ints) -> 'Observation':
        """Return the observation of chosen games (M,)."""
        startable = None if self.startable is None else self.startable.take(chosen, axis=0)
        return Observation(self.rows.take(chosen, axis=0), self.states.take(chosen), startable)

    def part(self, begin: int, end: int) -> 'Observation':
        """Return the observation of the games from ``begin`` up to ``end``, in the same memory."""
        startable = None if self.startable is None else self.startable[begin:end]
        return Observation(self.rows[begin:end], self.states[begin:end], startable)

    def put(self, chosen: Ints, source: 'Observation') -> None:
        """Set chosen games (M,) to those of another observation."""
        self.rows[chosen], self.states[chosen] = source.rows, source.states
        if self.startable is not None and source.startable is not None:
            self.startable[chosen] = source.startable
        else:
            self.startable = None


class StateAbstraction:
    """Maps games to observations, for one action set."""

    def __init__(self, games: BatchGames, action_set: str) -> None:
        """
        Choose the abstract features that an action set needs.

        Plans with options and primitive actions use the features of both. With the fine features
        alone, states that differ in the progress of the game would be one abstract state, and
        primitive actions, which are valued step by step, would wander among them.

        :raises PlanError: the abstract features have too many values.
        """
        self.games, self._fine = games, action_set not in OPTIONS_ONLY
        coarse, own = games.abstraction(fine=False), games.abstraction(fine=self._fine)
        mixed = action_set not in (*OPTIONS_ONLY, PRIMITIVE)
        self._mixture = coarse.mixture if mixed else ()  # coarse features, before the fine ones
        sizes = (*(coarse.sizes[feature] for feature in self._mixture), *own.sizes)
        if np.prod(sizes, dtype=np.float64) > LARGEST_CODE:
            raise PlanError(f'abstract features of {sizes} values are too fine')
        self._sizes, self._radix = sizes, np.cumprod([1, *sizes[:-1]], dtype=np.int64)
        self.context = tuple(range(len(self._mixture))) if self._mixture else own.context
        """Indices of the abstract features that hardly decide which option is the best."""

    def observe(self, batch: Any) -> Observation:
        """Return the observation of a batch."""
        rows = self.games.batch_features(batch)
        features = self.games.abstract_features(batch, rows, fine=self._fine)
        if self._mixture:
            coarse = self.games.abstract_features(batch, rows, fine=False)
            features = np.concatenate([coarse[:, list(self._mixture)], features], axis=1)
        return Observation(rows, features @ self._radix)

    def without_context(self, states: Codes) -> Codes:
        """Return the codes (N,) of abstract states with all context features set to 0."""
        for feature in self.context:
            radix = self._radix[feature]
            states = states - states // radix % self._sizes[feature] * radix
        return states


class ActionSet:
    """
    Options, then all primitive actions as options of one step, by option index. Those from
    ``first_fallback`` on run only where no option can start.

    :ivar games: plays many games of the domain at once.
    :ivar abstraction: of the states that the options are chosen in.
    """

    def __init__(
        self, domain: Domain[Any], action_set: str, options: Sequence[LearnedOption]
    ) -> None:
        """
        Set up an action set.

        :param options: ignored in the set ``primitive``.
        :raises PlanError: the domain does not play many games at once.
        """
        self.options = () if action_set == PRIMITIVE else tuple(options)
        self.action_set, self.n_actions = action_set, len(domain.actions)
        self._decide = [decisions(option, domain) for option in self.options]
        self.games = batch_games(domain)
        self.abstraction = StateAbstraction(self.games, action_set)
        self.names = (
            *(option.name for option in self.options),
            *(PRIMITIVE_PREFIX + action.name for action in domain.actions),
        )
        only = action_set in OPTIONS_ONLY
        self.first_fallback = len(self.options) if only else len(self.names)
        self.limits = np.array([*(o.max_steps for o in self.options), *[1] * self.n_actions])

    def observe(self, batches: Sequence[Any]) -> list[Observation]:
        """Return the observation of each of some batches, which are looked at as one."""
        if len(batches) == 1:
            return [self.abstraction.observe(batches[0])]
        ends = np.cumsum([len(self.games.batch_over(batch)) for batch in batches]).tolist()
        parts = list(zip([0, *ends], ends))
        joined = self.games.batch_take(batches[0], np.zeros(ends[-1], dtype=np.intp))
        for batch, (begin, end) in zip(batches, parts):
            self.games.batch_put(joined, np.arange(begin, end), batch)
        seen = self.abstraction.observe(joined)
        self.startable(seen)
        return [seen.part(begin, end) for begin, end in parts]

    def observe_state(self, state: Any) -> Observation:
        """Return the observation of one game that is in a state of the domain."""
        return self.abstraction.observe(self.games.batch_of([state]))

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of the models: starting each option, then continuing where it cannot start."""
        names = self.names[: self.first_fallback]
        return (*names, *(f'going on: {option.name}' for option in self.options))

    def startable(self, seen: Observation) -> Flags:
        """Return (N, O): which options can start in each game, without the fallback ones."""
        if seen.startable is None:
            seen.startable = np.ones((len(seen.rows), self.first_fallback), dtype=np.bool_)
            for o, decide in enumerate(self._decide):
                seen.startable[:, o] = decide.can_start(seen.rows)
        return seen.startable

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

    def running(self, option: Ints) -> list[tuple[Decisions, Ints]]:
        """Return the decisions of each option that runs in some games, and which these are."""
        found = [(one, np.flatnonzero(option == o)) for o, one in enumerate(self._decide)]
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
        modelled = option < self.first_fallback
        found: Flags = modelled.copy()
        found[modelled] = self.startable(seen)[modelled, option[modelled]]
        return found
