"""
Settings that were found by hand for Pac-Man's default maze.

They were searched for with the reference options and interrupted execution, on other seeds than
those that anything is reported with.
"""

from dataclasses import dataclass

from humanopts_learner.planning.sampled.plan import Sampling


@dataclass(frozen=True)
class Tuned:
    """How to plan from samples, and how far ahead."""

    gamma: float
    sampling: Sampling


TUNED = {  # by the rule of the ghosts
    'random': Tuned(
        0.985, Sampling(rounds=8, explore=0.1, pooling=300.0, penalty=30.0, margin=30.0)
    ),
    'chase': Tuned(
        0.985, Sampling(rounds=8, explore=0.1, pooling=1000.0, penalty=0.0, margin=5.0)
    ),
}
