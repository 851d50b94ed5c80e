"""
Many games of Pac-Man at once for planning from samples: play, state abstractions, sampled games.

The abstraction for options has buckets of the distances, times and numbers that decide which
option is worth starting. "Arrival" at a cell is the fewest steps in which a dangerous ghost can
reach it. Dangerous ghosts do not turn round unless they must, so a ghost that has just passed
arrives later than its distance says. The risk of an option is the arrival at the cell of its first
step, where 1 may cost a life at once. The finer abstraction for primitive actions has the walls
around Pac-Man, and the direction of each thing that is near enough to matter.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.pacman.features import (
    FeatureReader,
    nearest_key,
    safety_after,
    SOUGHT,
)
from humanopts_env.domains.pacman.paths import HAS_MOVE, MOVES, Paths, STAY
from humanopts_env.domains.pacman.rules import PacManBatch, Rules
from humanopts_env.domains.pacman.state import PacManState
from humanopts_env.domains.tabular import read_only
from humanopts_env.games import Chance, Steps
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from humanopts_env.domains.pacman.domain import PacMan

AFAR = 1000  # stands for the distance of what is not there, or farther away
LONGEST = 300  # steps that are played before a state is drawn
CHANGES = 0.1  # probability of a new aim at a step
WANTS = ('food', 'food', 'pill', 'prey', None)  # aims, each equally likely; None: random moves
_AIMS = np.array([SOUGHT.index(want) if want else len(SOUGHT) for want in WANTS])


PLANNING_FEATURES = {  # numbers in buckets: value k holds ``edges[k - 1] <= number < edges[k]``
    'danger': (2, 3, 4, 6, AFAR),  # arrival where Pac-Man is
    'danger_to_food': (2, 3, 4, 6),  # arrival after the first step to the nearest food
    'danger_to_pill': (2, 3, 4),
    'danger_to_prey': (2, 3, 4),
    'danger_in_flight': (2, 3, 4, 6),  # after the step farthest from dangerous ghosts
    'food_distance': (2, 3, 5, 9),
    'pill_distance': (2, 4, 7, 11, AFAR),
    'prey_distance': (2, 4, 7, 11, AFAR),  # nearest scared ghost
    'prey_time': (0, 3, 8),  # steps scared beyond those to reach it
    'danger_to_fruit': (2, 3, 4),
    'fruit_distance': (4, 10, AFAR),
    'food_left': (6, 36),
    'pills_left': (1, 2),
    'lives': (2,),
}
_BUCKETS = np.array(  # (P, AFAR + 2) bucket of each number from -1 to AFAR
    [
        np.searchsorted(edges, range(-1, AFAR + 1), side='right')
        for edges in PLANNING_FEATURES.values()
    ],
    dtype=np.int32,
)
_BUCKET_OF_0 = np.arange(len(_BUCKETS))[:, None] * _BUCKETS.shape[1] + 1


class PacManGames:
    """Games of Pac-Man; rewards are points."""

    def __init__(self, domain: 'PacMan', batch: PacManBatch) -> None:
        self.domain, self.batch = domain, batch

    def __len__(self) -> int:
        return len(self.batch)

    def features(self) -> Rows:
        return self.domain.read_features(self.batch)

    def over(self) -> Flags:
        return self.batch.over

    def step(self, actions: Ints, chance: Chance) -> Steps:
        if isinstance(chance, np.random.Generator):
            draws = self.batch.draws(chance)
        else:
            each = [self.batch.rules.draws(rng) for rng in chance]
            draws = np.array(each, dtype=np.intp).reshape(len(each), -1).T
        return Steps(self.batch.step(actions, draws).astype(np.float64), self.batch.over)

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        self.batch.restart(games)

    def take(self, games: Ints) -> 'PacManGames':
        return PacManGames(self.domain, self.batch.take(games))

    def states(self) -> list[PacManState]:
        return self.batch.states()

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        """Return whether the maze is cleared, and the lives that are left."""
        return {'cleared': self.batch.food_left == 0, 'lives left': self.batch.lives}

    def planning_features(self) -> NDArray[np.int32]:
        return planning_features(self.batch)


def planning_features(batch: PacManBatch) -> NDArray[np.int32]:
    """Return the buckets of every game, (N, P), in the order of PLANNING_FEATURES."""
    tables, here, none = batch.tables, batch.pacman, batch.tables.nothing
    from_here, is_fruit = here * len(tables.is_food), batch.fruit > 0
    ghosts = tables.way.take(from_here + batch.ghosts)  # (G, N)
    hunted = np.where(batch.scared > 0, ghosts, none)
    keys = np.stack(
        [
            nearest_key(tables.food_move, here, batch.food_taken),
            nearest_key(tables.pill_move, here, batch.pills_taken),
            hunted.min(axis=0, initial=none),
            tables.way.take(from_here + np.where(is_fruit, batch.fruit_at, here)),
        ]
    )
    is_there, steps = keys < none, keys >> tables.low_bits
    moves = np.empty((5, len(batch)), dtype=np.intp)
    moves[:4] = np.where(is_there, keys & tables.low, STAY)
    moves[4] = safety_after(batch).argmax(axis=1)
    cells = tables.step.take(here * (STAY + 1) + moves)
    arrival = _arrival(batch, np.concatenate((here[None], cells)))  # (6, N)
    np.copyto(arrival[1:], 0, where=moves == STAY)
    to_hunt = (hunted >> tables.low_bits == steps[2]) & is_there[2]
    fear = np.where(to_hunt, batch.scared, 0).max(axis=0, initial=0)
    known = np.empty((len(PLANNING_FEATURES), len(batch)), dtype=np.intp)
    known[:4], known[9], known[4] = arrival[:4], arrival[4], arrival[5]
    known[[5, 6, 7, 10]] = np.where(is_there, steps, AFAR)
    known[8] = np.where(is_there[2], np.maximum(fear - steps[2], -1), -1)
    np.copyto(known[10], AFAR, where=~is_fruit)
    known[11], known[13] = batch.food_left, batch.lives
    known[12] = 0
    for taken in batch.pills_taken.T:
        known[12] += taken == 0
    np.minimum(known, AFAR, out=known)
    known += _BUCKET_OF_0
    values: NDArray[np.int32] = _BUCKETS.take(known)
    return values.T


@lru_cache(maxsize=8)
def arrival_steps(paths: Paths) -> NDArray[np.int16]:
    """
    Return the fewest steps in which a dangerous ghost can be in a cell, by dynamic programming.

    :return: (C, 5, C) from each cell with each heading to each cell; AFAR where it never can.
    """
    cells = np.arange(len(paths.step))
    steps = np.full((len(cells), 5, len(cells)), AFAR, dtype=np.int16)
    steps[cells, :, cells] = 0
    while True:
        onward = np.minimum(steps[paths.step[:, :4], range(4)] + 1, AFAR).astype(np.int16)
        found = steps.copy()
        for heading in range(5):
            may = HAS_MOVE[paths.allowed[:, heading], :, None]
            soonest = np.where(may, onward, AFAR).min(axis=1)
            np.minimum(steps[:, heading], soonest, out=found[:, heading])
        if (found == steps).all():
            return read_only(steps)
        steps = found


def _arrival(batch: PacManBatch, cells: Ints) -> NDArray[np.int16]:
    """Return the fewest steps (K, N) in which a dangerous ghost can be in K cells (K, N)."""
    steps = arrival_steps(batch.rules.paths)  # (C, 5, C)
    ghosts = (batch.ghosts * steps.shape[1] + batch.headings) * steps.shape[2]  # (G, N)
    soonest = steps.ravel().take(ghosts[:, None] + cells)  # (G, K, N)
    np.copyto(soonest, AFAR, where=batch.scared[:, None] > 0)
    found: NDArray[np.int16] = soonest.min(axis=0, initial=AFAR)
    return found


def sample_games(rules: Rules, rng: np.random.Generator, count: int) -> PacManBatch:
    """
    Draw states that games pass through, none of them over.

    Each game is played for a number of steps drawn uniformly below LONGEST, and begins again where
    it ends. Pac-Man has an aim for a while: he goes towards the nearest food, pill or scared
    ghost, or moves at random, which he also does where his aim is not in the maze.

    :param count: number of games.
    """
    length, want = rng.integers(LONGEST, size=count), rng.integers(len(WANTS), size=count)
    read, games = _reader(rules), PacManBatch.begin(rules, count)
    order = np.argsort(length, kind='stable')  # games that are drawn first go first
    drawn = np.searchsorted(length[order], np.arange(LONGEST), side='right').tolist()
    for step in range(length.max(initial=-1) + 1):
        change = rng.random(count)
        want = np.where(change < CHANGES, rng.integers(len(WANTS), size=count), want)
        at_random = rng.integers(len(MOVES), size=count)
        draws = rules.batch_draws(rng, count)
        batch, playing = games.after(drawn[step]), order[drawn[step] :]
        move = read.first_moves(batch, _AIMS[want.take(playing)])
        move = np.where(move < len(MOVES), move, at_random.take(playing))
        batch.step(move, draws[:, playing])
        over = batch.over.nonzero()[0]
        if over.size:
            batch.restart(over)
    return games.take(np.argsort(order))


@lru_cache(maxsize=8)
def _reader(rules: Rules) -> FeatureReader:
    return FeatureReader(rules)
