"""
Settings that were found by hand for Pac-Man's default maze.

They were searched for on other seeds than those that anything is reported with.
"""

from dataclasses import dataclass

from humanopts_learner.planning.sampled.plan import Sampling


@dataclass(frozen=True)
class Tuned:
    """How to plan from samples, and how far ahead."""

    gamma: float
    sampling: Sampling


TUNED_MOVES = Tuned(0.95, Sampling(rounds=16))  # primitive actions, with either rule of the ghosts
TUNED_BOTH = Tuned(  # and options beside them, interrupted
    0.95, Sampling(rounds=16, pooling=30.0, reluctance=15.0, margin=5.0)
)
TUNED = {  # options that are interrupted, by the rule of the ghosts; with the reference options
    'random': Tuned(
        0.985,
        Sampling(rounds=8, explore=0.1, min_samples=2, penalty=30.0, pooling=300.0, margin=30.0),
    ),
    'chase': Tuned(
        0.985, Sampling(rounds=8, explore=0.1, min_samples=2, pooling=1000.0, margin=5.0)
    ),
}
