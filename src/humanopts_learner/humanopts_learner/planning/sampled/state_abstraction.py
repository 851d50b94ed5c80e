"""
The state abstraction of sampled planning.

Games with equal abstract features are in one abstract state. Abstract states are few enough that
each is visited often.
"""

from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Ints
from humanopts_env.domains.capabilities import BatchGames
from humanopts_learner.planning.request import OPTIONS_ONLY, PlanError, PRIMITIVE
import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
LARGEST_CODE = 2**53  # abstract states are numbered below this


@dataclass(frozen=True)
class Observation:
    """The features and abstract states of N games, for options and policies."""

    rows: NDArray[np.int32]  # (N, F) all features
    states: Codes  # (N,) codes of the abstract states

    def take(self, chosen: Ints) -> 'Observation':
        """Return the observation of chosen games (M,)."""
        return Observation(self.rows[chosen], self.states[chosen])


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
