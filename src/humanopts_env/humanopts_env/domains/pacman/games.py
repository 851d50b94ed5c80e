"""
Many games of Pac-Man at once: play, planning features, sampled states.

Planning features are buckets of the distances, times and numbers that decide which option is worth
starting. The "arrival" at a cell is the fewest steps in which a dangerous ghost can reach it. Such
ghosts only turn back if they must, so one that has just passed arrives later than its distance
suggests. The risk of an option is the arrival at the cell of its first step; an arrival of 1 may
immediately cost a life.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.pacman.features import (
    fear_of_prey,
    FeatureReader,
    steps_after,
    THINGS,
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

AFAR = 1000  # distance of an object that is absent or farther away
MAX_PLAYED = 300  # steps before a sampled state
CHANGES = 0.1  # probability of a new aim per step
AIMS = ('food', 'pill', 'prey', 'fruit')  # possible targets of Pac-Man
WANTS = ('food', 'food', 'pill', 'prey', None)  # aims, each equally likely; None: random moves


PLANNING_FEATURES = {  # edges of buckets: in bucket k, ``edges[k - 1] <= number < edges[k]``
    'danger': (2, 3, 4, 6, AFAR),  # arrival at Pac-Man's cell
    'danger_to_food': (2, 3, 4, 6),  # arrival after the first step to the nearest food
    'danger_to_pill': (2, 3, 4),
    'danger_to_prey': (2, 3, 4),
    'danger_in_flight': (2, 3, 4, 6),  # after the step farthest from dangerous ghosts
    'food_distance': (2, 3, 5, 9),
    'pill_distance': (2, 4, 7, 11, AFAR),
    'prey_distance': (2, 4, 7, 11, AFAR),  # nearest scared ghost
    'prey_time': (0, 3, 8),  # scared steps left after reaching it
    'danger_to_fruit': (2, 3, 4),
    'fruit_distance': (4, 10, AFAR),
    'food_left': (6, 36),
    'pills_left': (1, 2),
    'lives': (2,),
}
BUCKETS = np.array(  # (P, AFAR + 2) bucket of each number from -1 to AFAR
    [
        np.searchsorted(edges, range(-1, AFAR + 1), side='right')
        for edges in PLANNING_FEATURES.values()
    ],
    dtype=np.int32,
)
FIRST_BUCKETS = np.arange(1, BUCKETS.size, BUCKETS.shape[1])[:, None]  # (P, 1) indices of number 0


class PacManGames:
    """Games of Pac-Man; rewards are points."""

    def __init__(self, domain: 'PacMan', batch: PacManBatch) -> None:
        self.domain, self.batch = domain, batch
        self._rows: Rows | None = None  # all features, until the next step

    def __len__(self) -> int:
        return len(self.batch)

    def features(self) -> Rows:
        return self.domain.listed(self._all_features())

    def _all_features(self) -> Rows:
        if self._rows is None:
            self._rows = self.domain.read_all_features(self.batch)
        return self._rows

    def over(self) -> Flags:
        return self.batch.over

    def step(self, actions: Ints, chance: Chance) -> Steps:
        self._rows = None
        if isinstance(chance, np.random.Generator):
            draws = self.batch.draws(chance)
        else:
            each = [self.batch.rules.draws(rng) for rng in chance]
            draws = np.array(each, dtype=np.intp).reshape(self.batch.ghosts.shape[::-1]).T
        return Steps(self.batch.step(actions, draws).astype(np.float64), self.batch.over)

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        self._rows = None
        self.batch.restart(games)

    def take(self, games: Ints) -> 'PacManGames':
        return PacManGames(self.domain, self.batch.take(games))

    def states(self) -> list[PacManState]:
        return self.batch.states()

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        """Return whether the maze is cleared, and the remaining lives."""
        return {'cleared': self.batch.food_left == 0, 'lives left': self.batch.lives}

    def planning_features(self) -> NDArray[np.int32]:
        """Return the buckets of every game, (N, P), in the order of PLANNING_FEATURES."""
        batch, paths = self.batch, self.batch.rules.paths
        column = dict(zip(self.domain.read_all_features.names, self._all_features().T))
        moves = [np.minimum(column[f'{thing}_direction'], STAY).astype(np.intp) for thing in AIMS]
        moves.append(steps_after(batch, 'danger', -1).argmax(axis=1))  # flight
        cells = paths.step.ravel().take(batch.pacman * (STAY + 1) + moves)
        arrival = _arrival(batch, np.concatenate((batch.pacman[None], cells)))
        fear = fear_of_prey(batch)
        known = {
            'danger': arrival[0],
            'danger_in_flight': arrival[-1],
            'prey_time': np.maximum(fear - np.where(fear, column['prey_distance'], 1), -1),
            'food_left': batch.food_left,
            'pills_left': (batch.pills_taken == 0).sum(axis=1),
            'lives': batch.lives,
        }
        for thing, move, soonest in zip(AIMS, moves, arrival[1:]):
            known[f'danger_to_{thing}'] = np.where(move == STAY, 0, soonest)
            known[f'{thing}_distance'] = np.where(move == STAY, AFAR, column[f'{thing}_distance'])
        numbers = np.array([known[name] for name in PLANNING_FEATURES], dtype=np.intp)
        return BUCKETS.take(np.minimum(numbers, AFAR) + FIRST_BUCKETS).T


@lru_cache(maxsize=8)
def arrival_steps(paths: Paths) -> NDArray[np.int16]:
    """
    Return the fewest steps for a dangerous ghost to reach a cell, by dynamic programming.

    :return: (C, 5, C) from each cell with each heading to each cell; AFAR if unreachable.
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
    """Return the fewest steps, (K, N), for a dangerous ghost to reach K cells, (K, N)."""
    steps = arrival_steps(batch.rules.paths)  # (C, 5, C)
    ghosts = (batch.ghosts * steps.shape[1] + batch.headings) * steps.shape[2]  # (G, N)
    soonest = steps.ravel().take(ghosts[:, None] + cells)  # (G, K, N)
    np.copyto(soonest, AFAR, where=batch.scared[:, None] > 0)
    found: NDArray[np.int16] = soonest.min(axis=0, initial=AFAR)
    return found


def sample_games(rules: Rules, rng: np.random.Generator, count: int) -> PacManBatch:
    """
    Draw states of games in progress, none of them over.

    Each game is played for a number of steps drawn uniformly below MAX_PLAYED, and restarted when
    it ends. Pac-Man keeps an aim for a while: he goes towards the nearest food, pill or scared
    ghost, or moves at random. He also does so if his aim is not in the maze.

    :param count: number of games.
    """
    length, want = rng.integers(MAX_PLAYED, size=count), rng.integers(len(WANTS), size=count)
    read, games = FeatureReader(rules), PacManBatch.begin(rules, count)
    things = [list(THINGS).index(want) if want else -1 for want in WANTS]
    order = np.argsort(length, kind='stable')  # shortest games first
    drawn = np.searchsorted(length[order], np.arange(MAX_PLAYED), side='right').tolist()
    for step in range(length.max(initial=-1) + 1):
        change = rng.random(count)
        want = np.where(change < CHANGES, rng.integers(len(WANTS), size=count), want)
        at_random = rng.integers(len(MOVES), size=count)
        draws = rules.batch_draws(rng, count)
        batch, playing = games.after(drawn[step]), order[drawn[step] :]
        at = np.take(things, want.take(playing))
        move = read.first_moves(batch)[at, np.arange(len(at))].astype(np.intp)
        move = np.where((at >= 0) & (move < len(MOVES)), move, at_random.take(playing))
        batch.step(move, draws[:, playing])
        over = batch.over.nonzero()[0]
        if over.size:
            batch.restart(over)
    return games.take(np.argsort(order))
