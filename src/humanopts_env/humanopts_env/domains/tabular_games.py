"""Many games at once of an enumerable domain."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_env.domains.capabilities import Abstraction
from humanopts_env.domains.tabular import TabularSimulator
import numpy as np
from numpy.typing import NDArray


class TabularGames:
    """
    The ``BatchGames`` of an ``EnumerableDomain``; every state is an abstract state of its own.

    A batch is (1, N): the index of each game's state.
    """

    def __init__(self, domain: EnumerableDomain[Any]) -> None:
        """Take the tables of a domain."""
        self.domain: Domain[Any] = domain
        self._listed = domain

    @cached_property
    def _simulator(self) -> TabularSimulator:
        return TabularSimulator(self._listed.transitions(), self._listed.over())

    def batch_reset(self, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Begin games."""
        return rng.choice(self._listed.start_states().astype(np.int64), (1, count))

    def batch_of(self, states: Sequence[Any]) -> NDArray[np.int64]:
        """Return games that stand at given states."""
        return np.array([[self._listed.index(state) for state in states]], dtype=np.int64)

    def batch_states(self, batch: NDArray[np.int64]) -> list[Any]:
        """Return the state of each game."""
        return [self._listed.state_at(index) for index in batch[0].tolist()]

    def batch_take(self, batch: NDArray[np.int64], games: NDArray[np.intp]) -> NDArray[np.int64]:
        """Return copies of chosen games, by their indices (M,)."""
        return batch[:, games]

    def batch_put(
        self, batch: NDArray[np.int64], games: NDArray[np.intp], source: NDArray[np.int64]
    ) -> None:
        """Set chosen games, by their indices (M,), to the M games of another batch."""
        batch[:, games] = source

    def batch_step(
        self, batch: NDArray[np.int64], actions: NDArray[np.intp], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Take one step in every game that is not over, in place; return the rewards (N,)."""
        return self._step(batch, actions, rng.random(len(actions)))

    def batch_step_each(
        self,
        batch: NDArray[np.int64],
        actions: NDArray[np.intp],
        rngs: Sequence[np.random.Generator],
    ) -> NDArray[np.float64]:
        """Take one step in every game, each with chance of its own; return the rewards (N,)."""
        numbers = np.zeros(len(rngs))
        if not self._listed.transitions().deterministic:
            numbers[:] = [rng.random() for rng in rngs]
        return self._step(batch, actions, numbers)

    def _step(
        self, batch: NDArray[np.int64], actions: NDArray[np.intp], numbers: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        live = ~self.batch_over(batch)
        there, reward, _ = self._simulator.step(batch[0], actions, numbers)
        batch[0] = np.where(live, there, batch[0])
        return np.where(live, reward, 0.0)

    def batch_over(self, batch: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return (N,): whether each game is over."""
        found: NDArray[np.bool_] = self._listed.over()[batch[0]]
        return found

    def batch_features(self, batch: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return (N, F): all features."""
        found: NDArray[np.int32] = self._listed.feature_table()[batch[0]]
        return found

    def batch_outcome(self, batch: NDArray[np.int64]) -> Mapping[str, NDArray[Any]]:
        """Return the state of each game."""
        return {'state': batch[0]}

    def abstraction(self, *, fine: bool) -> Abstraction:
        """Return the one abstract feature: the state."""
        return Abstraction((self._listed.n_states,))

    def abstract_features(
        self, batch: NDArray[np.int64], rows: NDArray[np.int32], *, fine: bool
    ) -> NDArray[np.int32]:
        """Return the states, (N, 1)."""
        return batch.T.astype(np.int32)
