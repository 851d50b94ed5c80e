"""
Reference options: what an expert means by an option, exactly.

They are the yardstick of accuracy and the knowledge of the simulated teacher. Learning never sees
them.
"""

from dataclasses import dataclass
from typing import Any, Protocol

from humanopts_env.domains.base import EnumerableDomain
import numpy as np
from numpy.typing import NDArray


class ReferenceOption(Protocol):
    """An option whose initiation set, policy and termination condition are known exactly."""

    @property
    def name(self) -> str:
        """What a person calls it, lower case."""
        ...

    @property
    def features(self) -> tuple[str, ...]:
        """What a person would say that it depends on, in the domain's order."""
        ...

    @property
    def definition(self) -> str:
        """Where it can start, what it does and where it ends, in words."""
        ...

    def can_start(self, state: Any) -> bool:
        """Tell whether the state is in the initiation set."""
        ...

    def ends(self, state: Any) -> bool:
        """Tell whether the termination condition holds."""
        ...

    def optimal_actions(self, state: Any) -> tuple[int, ...]:
        """Return every action on a shortest path to the end; empty outside the initiation set."""
        ...


@dataclass(frozen=True, eq=False)
class TabularReferenceOption:
    """A reference option of an enumerable domain, as arrays over its S states and A actions."""

    domain: EnumerableDomain[Any]
    name: str
    features: tuple[str, ...]
    initiation: NDArray[np.bool_]  # (S,)
    termination: NDArray[np.bool_]  # (S,)
    optimal: NDArray[np.bool_]  # (S, A), False outside the initiation set
    distance: NDArray[np.int32]  # (S,) steps to the end; -1 outside the initiation set
    judged: NDArray[np.bool_]  # (S,) states over which learned I and beta are compared with these
    definition: str = ''  # in words

    def can_start(self, state: Any) -> bool:
        """Tell whether the state is in the initiation set."""
        return bool(self.initiation[self.domain.index(state)])

    def ends(self, state: Any) -> bool:
        """Tell whether the termination condition holds."""
        return bool(self.termination[self.domain.index(state)])

    def optimal_actions(self, state: Any) -> tuple[int, ...]:
        """Return every action on a shortest path to the end; empty outside the initiation set."""
        return tuple(np.flatnonzero(self.optimal[self.domain.index(state)]).tolist())
