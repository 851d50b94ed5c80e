"""Where demonstrations start: the strategies of the learner, with what has been learned so far."""

from collections.abc import Sequence
from typing import Any, Protocol

from humanopts_learner.demonstrations import Demonstration
import numpy as np


class StartStates(Protocol):
    """A strategy of start states, with what has been learned so far."""

    def choose(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> Any:
        """Draw the state from which the person is asked to demonstrate next."""
        ...

    def knows(self, participant: str, option_name: str, uuid: str) -> bool:
        """Tell whether what it has learned counts this demonstration in."""
        ...

    def exhausted(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> bool:
        """Tell whether it has nothing left to ask, once the criteria hold."""
        ...
