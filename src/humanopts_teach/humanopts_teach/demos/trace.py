"""The episode that is being played, collected step by step from the stream of game states."""

from dataclasses import dataclass
from enum import Enum


class Source(Enum):
    """Who chose an action."""

    NONE = 'none'  # the first state of an episode
    PERSON = 'person'
    MACHINE = 'machine'


@dataclass(frozen=True, slots=True)
class GameStep:
    """One state of the game with the transition that led to it, as in GameState."""

    episode: int  # 0: no episode was begun yet
    step: int
    state: str  # in the domain's notation
    features: tuple[int, ...]
    action: str  # that led here; empty at step 0
    source: Source
    reward: float
    terminated: bool
    truncated: bool


class Trace:
    """The steps of the newest episode, without gaps."""

    def __init__(self) -> None:
        self.steps: list[GameStep] = []
        self.broken = ''  # what is missing, in words; empty: nothing

    @property
    def episode(self) -> int:
        """Number of the episode, 0 before the first."""
        return self.steps[-1].episode if self.steps else 0

    @property
    def last(self) -> int:
        """Step of the newest state, -1 before the first."""
        return self.steps[-1].step if self.steps else -1

    def add(self, step: GameStep) -> None:
        """Take the next state; step 0 or another episode begins anew."""
        if step.step == 0 or step.episode != self.episode:
            self.steps, self.broken = [], ''
            if step.step != 0:
                self.broken = f'the first {step.step} steps of episode {step.episode} are missing'
        elif step.step != self.last + 1:
            self.broken = self.broken or (
                f'step {step.step} of episode {step.episode} came after step {self.last}'
            )
        self.steps.append(step)
