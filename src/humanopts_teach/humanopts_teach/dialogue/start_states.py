"""Where demonstrations start: drawn by a strategy, keyed by person, option and number."""

from collections.abc import Sequence
from typing import Any, Protocol

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_teach.dialogue.history import OptionHistory
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

    def knows(self, demonstration: Demonstration) -> bool:
        """Tell whether what it has learned counts this one in; out, where it is withdrawn."""
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


class StartDraws:
    """
    The draws of one lesson.

    They depend on seed, participant, option, the number of the demonstration and, where the
    strategy looks at it, what was learned; so a demonstration that is tried again, or after a
    restart, starts in the same state.
    """

    def __init__(self, domain: Domain[Any], starts: StartStates, seed: int) -> None:
        self._domain = domain
        self._starts = starts
        self._seed = seed

    def draw(self, participant: str, option: OptionHistory) -> str:
        """Return the start state of the next demonstration, in the domain's notation."""
        rng = self._generator('start_state', participant, option)
        state = self._starts.choose(participant, option.name, option.demonstrations, rng)
        return self._domain.encode(state)

    def check(self, text: str) -> str:
        """
        Return the state that somebody asked for, in the domain's notation.

        :raises DomainError: it is not a state, or the task is over there.
        """
        state = self._domain.decode(text)
        if self._domain.is_over(state):
            raise DomainError(f'the task is over in {text}: nothing can be shown from there')
        return self._domain.encode(state)

    def episode_seed(self, participant: str, option: OptionHistory) -> int:
        """Return the seed of the chance in the next demonstration's episode."""
        return int(self._generator('episode', participant, option).integers(2**63))

    def know(self, option: OptionHistory, demonstration: Demonstration) -> bool:
        """Tell whether the next draw counts this one in; out, where it is withdrawn."""
        return not option.n_trajectories or self._starts.knows(demonstration)

    def exhausted(self, participant: str, option: OptionHistory) -> bool:
        """Tell whether the strategy has nothing left to ask, once the criteria hold."""
        rng = self._generator('exhausted', participant, option)
        return self._starts.exhausted(participant, option.name, option.demonstrations, rng)

    def _generator(
        self, purpose: str, participant: str, option: OptionHistory
    ) -> np.random.Generator:
        return generator(self._seed, purpose, participant, option.name, option.number)
