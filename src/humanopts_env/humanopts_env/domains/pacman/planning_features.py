"""
A coarse view of many games, for planning: what decides which option is worth starting.

Distances, times and numbers are put in buckets. "Arrival" at a cell is in how many steps a
dangerous ghost can be there, if it wants to: dangerous ghosts do not turn round unless they must,
so that one that has just passed is farther away than its distance says. What an option risks is
told by the arrival at the cell that its first step leads to, where 1 may cost a life at once.
"""

from dataclasses import dataclass
from functools import lru_cache

from humanopts_env.domains.pacman.batch import Ints, PacManBatch
from humanopts_env.domains.pacman.paths import FIRST_MOVE, HAS_MOVE, Masks, Paths, STAY
from humanopts_env.domains.pacman.surroundings import look_around, Surroundings
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

AFAR = 1000  # more than any bucket of a distance that is one; what is not there is farther


@dataclass(frozen=True, slots=True)
class Bucketed:
    """A number in buckets: value k holds ``edges[k - 1] <= number < edges[k]``."""

    name: str
    edges: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many values it has."""
        return len(self.edges) + 1


PLANNING_FEATURES = (
    Bucketed('danger', (2, 3, 4, 6, AFAR)),  # arrival where Pac-Man is
    Bucketed('danger_to_food', (2, 3, 4, 6)),  # arrival after the first step to the nearest food
    Bucketed('danger_to_pill', (2, 3, 4)),
    Bucketed('danger_to_prey', (2, 3, 4)),
    Bucketed('danger_in_flight', (2, 3, 4, 6)),  # after the step farthest from dangerous ghosts
    Bucketed('food_distance', (2, 3, 5, 9)),
    Bucketed('pill_distance', (2, 4, 7, 11, AFAR)),
    Bucketed('prey_distance', (2, 4, 7, 11, AFAR)),  # nearest scared ghost
    Bucketed('prey_time', (0, 3, 8)),  # for how much longer than the way there it is scared
    Bucketed('fruit_distance', (10,)),
    Bucketed('food_left', (6, 36)),
    Bucketed('pills_left', (1, 2)),
    Bucketed('lives', (2,)),
)
CONTEXT = ('food_left', 'pills_left')  # what is left to gain, rather than what is near


def planning_features(batch: PacManBatch, seen: Surroundings | None = None) -> NDArray[np.int32]:
    """
    Return the buckets of every game.

    :param seen: what ``look_around`` found, if that is known already.
    :return: (N, P), columns as in PLANNING_FEATURES.
    """
    seen = seen or look_around(batch)
    paths, here = batch.rules.paths, batch.pacman
    prey = _or_afar(seen.prey, seen)
    fruit = paths.distance[here, np.where(batch.fruit > 0, batch.fruit_at, here)].astype(np.intp)
    numbers = (
        _arrival(batch, here),
        _after(batch, seen.to_food),
        _after(batch, seen.to_pill),
        _after(batch, seen.to_prey),
        _arrival(batch, _refuge(batch)),
        seen.food,
        _or_afar(seen.pill, seen),
        prey,
        np.where(prey < AFAR, seen.fear - seen.prey, -1),
        np.where(batch.fruit > 0, fruit, AFAR),
        batch.food_left,
        (batch.pills_taken == 0).sum(axis=1),
        batch.lives,
    )
    values = np.empty((len(batch), len(PLANNING_FEATURES)), dtype=np.int32)
    for column, (feature, number) in enumerate(zip(PLANNING_FEATURES, numbers, strict=True)):
        values[:, column] = np.searchsorted(feature.edges, number, side='right')
    return values


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


def _arrival(batch: PacManBatch, cell: Ints) -> Ints:
    """Return in how many steps the soonest dangerous ghost can be in a cell (N,)."""
    steps = arrival_steps(batch.rules.paths)[batch.ghosts, batch.headings, cell].astype(np.intp)
    soonest: Ints = np.where(batch.scared > 0, AFAR, steps).min(axis=0, initial=AFAR)
    return soonest


def _after(batch: PacManBatch, ways: Masks) -> Ints:
    """Return the arrival after the first of some moves (N,), 0 where there is none."""
    move = FIRST_MOVE[ways]
    return np.where(move < STAY, _arrival(batch, batch.rules.paths.step[batch.pacman, move]), 0)


def _refuge(batch: PacManBatch) -> Ints:
    """Return the cell a step away that is farthest from the nearest dangerous ghost, (N,)."""
    paths = batch.rules.paths
    after = paths.step[batch.pacman, :4]  # (N, 4)
    steps = paths.distance[batch.ghosts[:, :, None], after].astype(np.intp)  # (G, N, 4)
    steps = np.where(batch.scared[:, :, None] > 0, AFAR, steps).min(axis=0, initial=AFAR)
    legal = HAS_MOVE[paths.legal[batch.pacman]]
    best = np.where(legal, steps, -1).argmax(axis=1)
    refuge: Ints = after[np.arange(len(batch)), best]
    return refuge


def _or_afar(steps: Ints, seen: Surroundings) -> Ints:
    return np.where(steps < seen.far, steps, AFAR)
