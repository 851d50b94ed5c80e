"""States from all parts of the game, from the rules alone."""

from humanopts_env.domains.pacman.batch import PacManBatch
from humanopts_env.domains.pacman.features import FeatureReader
from humanopts_env.domains.pacman.paths import MOVES
from humanopts_env.domains.pacman.rules import Rules
import numpy as np

LONGEST = 300  # steps that are played before a state is drawn
CHANGES = 0.1  # probability of wanting something else at a step
WANTS = ('food', 'food', 'pill', 'prey', None)  # each as often; None: to move at random


def sample_games(rules: Rules, rng: np.random.Generator, count: int) -> PacManBatch:
    """
    Draw states that games come to, none of them over.

    Each game is played for a number of steps drawn uniformly below LONGEST, and begins again
    where it ends. For a while at a time Pac-Man goes towards the nearest food, pill or scared
    ghost, or moves at random, as he does where what he wants is not there.

    :param count: how many, N.
    """
    batch, drawn, read = PacManBatch(rules, count), PacManBatch(rules, count), FeatureReader(rules)
    columns = np.array([read.names.index(f'{want}_direction') for want in WANTS if want])
    length = rng.integers(LONGEST, size=count)
    want = rng.integers(len(WANTS), size=count)
    for step in range(int(length.max(initial=-1)) + 1):
        ready = np.flatnonzero(length == step)
        drawn.put(ready, batch.take(ready))
        want = np.where(rng.random(count) < CHANGES, rng.integers(len(WANTS), size=count), want)
        wanted = np.append(read(batch)[:, columns], np.full((count, 1), len(MOVES)), axis=1)
        move = wanted[np.arange(count), want]
        move = np.where(move < len(MOVES), move, rng.integers(len(MOVES), size=count))
        batch.step(move, batch.draws(rng))
        batch.restart(np.flatnonzero(batch.over))
    return drawn
