"""The tables of a domain whose states can all be listed, each built once."""

from abc import ABC, abstractmethod
from collections.abc import Hashable
from functools import cached_property
from typing import Generic, TypeVar

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

S = TypeVar('S', bound=Hashable)


class SharedTables(ABC, Generic[S]):
    """
    What an ``EnumerableDomain`` reads from its tables.

    Each table is built when it is first asked for, then shared and read-only.
    """

    @abstractmethod
    def index(self, state: S) -> int:
        """Return the state's index, 0..n_states-1."""

    @abstractmethod
    def state_at(self, index: int) -> S:
        """Return the state of an index."""

    @abstractmethod
    def _build_transitions(self) -> Transitions:
        """Return the exact transitions, with read-only arrays."""

    @abstractmethod
    def _build_feature_table(self) -> NDArray[np.int32]:
        """Return (S, F)."""

    @abstractmethod
    def _build_start_states(self) -> NDArray[np.int32]:
        """Return the indices of all start states."""

    @abstractmethod
    def _build_over(self) -> NDArray[np.bool_]:
        """Return (S,): where the task is over."""

    def reset(self, rng: np.random.Generator) -> S:
        """Draw a start state of the task."""
        return self.state_at(int(rng.choice(self.start_states())))

    def feature_values(self, state: S) -> NDArray[np.int32]:
        """Return the value of every feature, (F,), indices into ``Feature.values``."""
        values: NDArray[np.int32] = self.feature_table()[self.index(state)]
        return values

    def transitions(self) -> Transitions:
        """Return the exact transitions; built once, then shared and read-only."""
        return self._transitions

    def feature_table(self) -> NDArray[np.int32]:
        """Return (S, F): ``feature_values`` of every state; shared and read-only."""
        return self._feature_table

    def start_states(self) -> NDArray[np.int32]:
        """Return the indices that ``reset`` draws from, uniformly."""
        return self._start_states

    def over(self) -> NDArray[np.bool_]:
        """Return (S,): ``is_over`` of every state; shared and read-only."""
        return self._over

    @cached_property
    def _transitions(self) -> Transitions:
        return self._build_transitions()

    @cached_property
    def _feature_table(self) -> NDArray[np.int32]:
        return read_only(self._build_feature_table())

    @cached_property
    def _start_states(self) -> NDArray[np.int32]:
        return read_only(self._build_start_states())

    @cached_property
    def _over(self) -> NDArray[np.bool_]:
        return read_only(self._build_over())
