"""
A coarse view of many games, for planning: what decides which option is worth starting.

Distances, times and numbers are put in buckets. "Margin" is how many steps later than Pac-Man the
nearest dangerous ghost can be at a thing, by shortest paths; 0 where there is no such thing.
"""

from dataclasses import dataclass

from humanopts_env.domains.pacman.batch import Ints, PacManBatch
from humanopts_env.domains.pacman.surroundings import look_around, Surroundings
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
    Bucketed('danger_distance', (2, 3, 4, 5, 7, 10, AFAR)),  # nearest dangerous ghost
    Bucketed('second_danger_distance', (3, 5, 8, AFAR)),  # the one after that
    Bucketed('prey_distance', (2, 4, 7, 11, AFAR)),  # nearest scared ghost
    Bucketed('fear_left', (1, 6, 13, 25)),  # of that ghost
    Bucketed('pill_distance', (2, 4, 7, 11, AFAR)),
    Bucketed('pill_margin', (0, 2, 5)),
    Bucketed('food_distance', (2, 3, 5, 9)),
    Bucketed('food_margin', (0, 2, 4)),
    Bucketed('food_left', (1, 6, 16, 41, 71)),
    Bucketed('lives', (1, 2, 3)),
)


def planning_features(batch: PacManBatch, seen: Surroundings | None = None) -> NDArray[np.int32]:
    """
    Return the buckets of every game.

    :param seen: what ``look_around`` found, if that is known already.
    :return: (N, P), columns as in PLANNING_FEATURES.
    """
    seen = seen or look_around(batch)
    numbers = (
        *_two_nearest(batch, seen),
        _or_afar(seen.prey, seen),
        seen.fear,
        _or_afar(seen.pill, seen),
        _margin(batch, seen.pill, seen.pill_at, seen),
        seen.food,
        _margin(batch, seen.food, seen.food_at, seen),
        batch.food_left,
        batch.lives,
    )
    values = np.empty((len(batch), len(PLANNING_FEATURES)), dtype=np.int32)
    for column, (feature, number) in enumerate(zip(PLANNING_FEATURES, numbers, strict=True)):
        values[:, column] = np.searchsorted(feature.edges, number, side='right')
    return values


def planning_keys(values: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return one number for each row of ``planning_features`` (N, P), alike for alike rows."""
    shape = [feature.count for feature in PLANNING_FEATURES]
    keys: NDArray[np.int64] = np.ravel_multi_index(tuple(values.T), shape).astype(np.int64)
    return keys


def _two_nearest(batch: PacManBatch, seen: Surroundings) -> tuple[Ints, Ints]:
    """Return the steps to the nearest two dangerous ghosts."""
    steps = batch.rules.paths.distance[batch.ghosts, batch.pacman].astype(np.intp)
    steps = np.where(batch.scared > 0, AFAR, steps)
    none = np.full((2, len(batch)), AFAR, dtype=np.intp)
    first, second, *_ = np.sort(np.concatenate((steps, none)), axis=0)
    return first, second


def _or_afar(steps: Ints, seen: Surroundings) -> Ints:
    return np.where(steps < seen.far, steps, AFAR)


def _margin(batch: PacManBatch, steps: Ints, cell: Ints, seen: Surroundings) -> Ints:
    """Return by how much Pac-Man is sooner in a cell than the nearest dangerous ghost."""
    theirs = batch.rules.paths.distance[batch.ghosts, cell].astype(np.intp)
    theirs = np.where(batch.scared > 0, seen.far, theirs).min(axis=0, initial=seen.far)
    return np.where(steps < seen.far, theirs - steps, 0)
