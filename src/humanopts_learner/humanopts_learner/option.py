"""Options: initiation set (I), policy (pi) and termination condition (beta)."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol, runtime_checkable

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.option import Option as Option  # the protocol of all options
import numpy as np


class Mode(Enum):
    """How option probabilities become decisions in execution; models are always greedy."""

    GREEDY = 'greedy'  # most likely action; ends where beta >= 0.5
    SAMPLED = 'sampled'  # random draws


@runtime_checkable
class StochasticOption(Option, Protocol):
    """An option with probabilities."""

    def action_probabilities(self, rows: Rows) -> Floats:
        """Return (N, A): pi of every action in each state."""

    def initiation_probability(self, rows: Rows) -> Floats:
        """Return (N,): the probability that each state is in I."""

    def termination_probability(self, rows: Rows) -> Floats:
        """Return (N,): beta of each state."""


@dataclass(frozen=True)
class PrimitiveOption:
    """A primitive action as a one-step option that can start anywhere."""

    name: str  # action:NAME
    index: int  # action index
    n_actions: int
    max_steps: int = 1

    def can_start(self, rows: Rows) -> Flags:
        return np.ones(len(rows), dtype=np.bool_)

    def action(self, rows: Rows) -> Ints:
        return np.full(len(rows), self.index)

    def ends(self, rows: Rows) -> Flags:
        return np.ones(len(rows), dtype=np.bool_)

    def action_probabilities(self, rows: Rows) -> Floats:
        return np.tile(np.eye(self.n_actions)[self.index], (len(rows), 1))

    def initiation_probability(self, rows: Rows) -> Floats:
        return np.ones(len(rows))

    def termination_probability(self, rows: Rows) -> Floats:
        return np.ones(len(rows))


@dataclass(frozen=True)
class DrawnOption:
    """An option with decisions drawn from its probabilities."""

    option: StochasticOption
    rng: np.random.Generator

    @property
    def name(self) -> str:
        return self.option.name

    @property
    def max_steps(self) -> int:
        return self.option.max_steps

    def can_start(self, rows: Rows) -> Flags:
        return self.option.can_start(rows)

    def action(self, rows: Rows) -> Ints:
        shares = self.option.action_probabilities(rows)
        drawn = [self.rng.choice(shares.shape[1], p=each) for each in shares]
        return np.array(drawn, dtype=np.intp)

    def ends(self, rows: Rows) -> Flags:
        draws = 1.0 - self.rng.random(len(rows))  # never 0
        return self.option.termination_probability(rows) >= draws
