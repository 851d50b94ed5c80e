"""Many games at once of an enumerable domain."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.capabilities import Abstraction, BatchGames
from humanopts_env.domains.tabular import TabularSimulator
import numpy as np
from numpy.typing import NDArray

Batch = NDArray[np.int64]  # (1, N) the index of each game's state


class TabularGames(BatchGames):
    """Games of an ``EnumerableDomain``; every state is an abstract state of its own."""

    def __init__(self, domain: EnumerableDomain[Any]) -> None:
        self.domain = domain
        self._listed = domain

    @cached_property
    def _simulator(self) -> TabularSimulator:
        return TabularSimulator(self._listed.transitions(), self._listed.over())

    def batch_reset(self, count: int, rng: np.random.Generator) -> Batch:
        return rng.choice(self._listed.start_states().astype(np.int64), (1, count))

    def batch_of(self, states: Sequence[Any]) -> Batch:
        return np.array([[self._listed.index(state) for state in states]], dtype=np.int64)

    def batch_states(self, batch: Batch) -> list[Any]:
        return [self._listed.state_at(index) for index in batch[0].tolist()]

    def batch_take(self, batch: Batch, games: Ints) -> Batch:
        return batch[:, games]

    def batch_put(self, batch: Batch, games: Ints, source: Batch) -> None:
        batch[:, games] = source

    def batch_step(self, batch: Batch, actions: Ints, rng: np.random.Generator) -> Floats:
        return self._step(batch, actions, rng.random(len(actions)))

    def batch_step_each(
        self, batch: Batch, actions: Ints, rngs: Sequence[np.random.Generator]
    ) -> Floats:
        numbers = np.zeros(len(rngs))
        if not self._listed.transitions().deterministic:
            numbers[:] = [rng.random() for rng in rngs]
        return self._step(batch, actions, numbers)

    def _step(self, batch: Batch, actions: Ints, numbers: Floats) -> Floats:
        live = ~self.batch_over(batch)
        there, reward, _ = self._simulator.step(batch[0], actions, numbers)
        batch[0] = np.where(live, there, batch[0])
        return np.where(live, reward, 0.0)

    def batch_over(self, batch: Batch) -> Flags:
        found: Flags = self._listed.over()[batch[0]]
        return found

    def batch_features(self, batch: Batch) -> Rows:
        found: Rows = self._listed.feature_table()[batch[0]]
        return found

    def batch_outcome(self, batch: Batch) -> Mapping[str, NDArray[Any]]:
        """Return the state of each game."""
        return {'state': batch[0]}

    def abstraction(self, *, fine: bool) -> Abstraction:
        """Return the one abstract feature: the state."""
        return Abstraction((self._listed.n_states,))

    def abstract_features(self, batch: Batch, rows: Rows, *, fine: bool) -> NDArray[np.int32]:
        """Return the states, (N, 1)."""
        return batch.T.astype(np.int32)
