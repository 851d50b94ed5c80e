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
from humanopts_learner.options.lookup import decisions
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import batch_games, OPTIONS_ONLY, PlanError, PRIMITIVE
import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
LARGEST_CODE = 2**53  # abstract states are numbered below this
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2**64 by the golden ratio, odd: for hashing


class CodeTable:
    """
    Finds abstract states in a list by a hash, many times as fast as by bisection.

    :ivar codes: (K,) of the states, ascending.
    """

    def __init__(self, codes: Codes) -> None:
        self.codes, self._bits = codes, len(codes).bit_length() + 2
        self._padded = np.append(codes, np.iinfo(np.int64).max)  # of no state
        self._place = np.full(1 << self._bits, len(codes))  # of one of the codes with each hash
        self._place[self._hash(codes)] = np.arange(len(codes))

    def find(self, codes: Codes) -> Ints:
        """Return the places (N,) of codes (N,) in the list; K: it is not there."""
        place: Ints = self._place.take(self._hash(codes))
        others = (self._padded.take(place) != codes).nonzero()[0]
        if others.size:
            wanted = codes.take(others)
            at = self.codes.searchsorted(wanted)
            place[others] = np.where(self._padded.take(at) == wanted, at, len(self.codes))
        return place

    def _hash(self, codes: Codes) -> Ints:
        """Return the highest bits of products with the golden ratio (Fibonacci hashing)."""
        mixed = codes.view(np.uint64) * GOLDEN
        mixed >>= np.uint64(64 - self._bits)
        return mixed.view(np.int64)


@dataclass
class Observation:
    """The abstract states of N games, and what O options, fallback aside, decide."""

    states: Codes  # (N,) codes of the abstract states
    startable: Flags  # (N, O) which options can start
    wanted: NDArray[np.int16]  # (N, O) the primitive action of each
    ending: Flags  # (N, O) whether each, if it runs, ends
    fallback: Ints  # (N,) index of the primitive action where no option can start; -1 elsewhere

    def take(self, chosen: Ints) -> 'Observation':
        """Return the observation of chosen games (M,)."""
        return Observation(*(array.take(chosen, axis=0) for array in vars(self).values()))

    def part(self, begin: int, end: int) -> 'Observation':
        """Return the observation of the games from ``begin`` up to ``end``, in the same memory."""
        return Observation(*(array[begin:end] for array in vars(self).values()))

    def put(self, chosen: Ints, source: 'Observation') -> None:
        """Set chosen games (M,) to those of another observation."""
        for mine, its in zip(vars(self).values(), vars(source).values()):
            mine[chosen] = its


class StateAbstraction:
    """Maps games to abstract states, for one action set."""

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
        self._sizes, self._radix = sizes, np.cumprod([1, *sizes[:-1]], dtype=np.float64)
        self.context = tuple(range(len(self._mixture))) if self._mixture else own.context
        """Indices of the abstract features that hardly decide which option is the best."""

    def observe(self, batch: Any) -> tuple[Rows, Codes]:
        """Return all features (N, F) and the codes of the abstract states (N,) of a batch."""
        rows = self.games.batch_features(batch)
        features = self.games.abstract_features(batch, rows, fine=self._fine)
        if self._mixture:
            coarse = self.games.abstract_features(batch, rows, fine=False)
            features = np.concatenate([coarse.T[list(self._mixture)], features.T]).T
        # Products of floats are exact below LARGEST_CODE, and faster than those of integers.
        return rows, (features.astype(np.float64) @ self._radix).astype(np.int64)

    def without_context(self, states: Codes) -> Codes:
        """Return the codes (N,) of abstract states with all context features set to 0."""
        for feature in self.context:
            radix = int(self._radix[feature])
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
        counts = tuple(len(feature.values) for feature in domain.features)
        self._decide = [decisions(option, counts) for option in self.options]
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
            return [self._observe(batches[0])]
        ends = np.cumsum([len(self.games.batch_over(batch)) for batch in batches]).tolist()
        parts = list(zip([0, *ends], ends))
        joined = self.games.batch_take(batches[0], np.zeros(ends[-1], dtype=np.intp))
        for batch, (begin, end) in zip(batches, parts):
            self.games.batch_put(joined, np.arange(begin, end), batch)
        seen = self._observe(joined)
        return [seen.part(begin, end) for begin, end in parts]

    def observe_state(self, state: Any) -> Observation:
        """Return the observation of one game that is in a state of the domain."""
        return self._observe(self.games.batch_of([state]))

    def _observe(self, batch: Any) -> Observation:
        rows, states = self.abstraction.observe(batch)
        shape, n_options = (len(rows), self.first_fallback), len(self.options)
        startable, ending = np.ones(shape, dtype=np.bool_), np.ones(shape, dtype=np.bool_)
        wanted = np.empty(shape, dtype=np.int16)
        wanted[:, n_options:] = np.arange(shape[1] - n_options)
        stuck = np.full(len(rows), n_options == shape[1])
        for o, decide in enumerate(self._decide):
            startable[:, o] = can_start = decide.can_start(rows)
            stuck &= ~can_start
            wanted[:, o] = decide.greedy_action(rows)
            ending[:, o] = decide.ends(rows)
        fallback = np.full(len(rows), -1, dtype=np.intp)
        if stuck.any():
            fallback[stuck] = self._fallback(rows[stuck])
        return Observation(states, startable, wanted, ending, fallback)

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of the models: starting each option, then continuing where it cannot start."""
        names = self.names[: self.first_fallback]
        return (*names, *(f'going on: {option.name}' for option in self.options))

    def _fallback(self, rows: Rows) -> Ints:
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

    def actions(self, seen: Observation, option: Ints) -> Ints:
        """Return (N,): the primitive action of each game's option."""
        action = option - len(self.options)
        running = np.flatnonzero(action < 0)
        action[running] = seen.wanted[running, option[running]]
        return action

    def ends(self, seen: Observation, option: Ints) -> Flags:
        """Return (N,): whether each game's option ends there; primitive actions always do."""
        ends = np.ones(len(option), dtype=np.bool_)
        running = np.flatnonzero(option < len(self.options))
        ends[running] = seen.ending[running, option[running]]
        return ends

    def can_start(self, seen: Observation, option: Ints) -> Flags:
        """Return (N,): whether each game's option could start there."""
        modelled = option < self.first_fallback
        found: Flags = modelled.copy()
        found[modelled] = seen.startable[modelled, option[modelled]]
        return found
