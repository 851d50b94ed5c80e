"""
Many games of Pac-Man for planning from samples, and the state abstractions that it sees.

The one for options is that of ``planning_features``. The finer one, for primitive actions, has
where walls are, and the way to each thing, where it is near enough to matter.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

from humanopts_env.domains.capabilities import Abstraction
from humanopts_env.domains.pacman.batch import PacManBatch
from humanopts_env.domains.pacman.features import DIRECTIONS, FeatureReader
from humanopts_env.domains.pacman.planning_features import (
    CONTEXT,
    PLANNING_FEATURES,
    planning_features,
)
from humanopts_env.domains.pacman.state import PacManState
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from humanopts_env.domains.pacman.domain import PacMan

Ints = NDArray[np.intp]
N_DIRECTIONS = len(DIRECTIONS)
FAR = 1000  # more than any bucket of a distance that is one
# For primitive actions: the first distance of each bucket but the nearest. In the last one the
# direction is left out, but for food.
NEAR_DANGER, NEAR_SECOND, NEAR_PREY, NEAR_PILL = (2, 3, 4, 5, 7), (3, 5), (3, 6, 13), (3, 9)
NEAR_FOOD = (2, 3, 5, 9)


class PacManGames:
    """The ``BatchGames`` of Pac-Man."""

    def __init__(self, domain: 'PacMan') -> None:
        """Prepare the tables of a maze."""
        self.domain = domain
        self._rules = domain.rules
        self._read = FeatureReader(domain.rules)
        self._column = {name: column for column, name in enumerate(self._read.names)}

    def batch_reset(self, count: int, rng: np.random.Generator) -> PacManBatch:
        """Begin games."""
        return PacManBatch(self._rules, count)

    def batch_of(self, states: Sequence[PacManState]) -> PacManBatch:
        """Return games that stand at given states."""
        return PacManBatch.from_states(self._rules, states)

    def batch_take(self, batch: PacManBatch, games: Ints) -> PacManBatch:
        """Return copies of chosen games, by their indices (M,)."""
        return batch.take(games)

    def batch_put(self, batch: PacManBatch, games: Ints, source: PacManBatch) -> None:
        """Set chosen games, by their indices (M,), each once, to the M games of another batch."""
        batch.put(games, source)

    def batch_step(self, batch: PacManBatch, actions: Ints, rng: np.random.Generator) -> Ints:
        """Take one step in every game that is not over, in place; return the points (N,)."""
        return batch.step(actions, batch.draws(rng))

    def batch_over(self, batch: PacManBatch) -> NDArray[np.bool_]:
        """Return (N,): whether each game is over."""
        return batch.over

    def batch_features(self, batch: PacManBatch) -> NDArray[np.int32]:
        """Return (N, F): all features."""
        return self._read(batch)

    def batch_outcome(self, batch: PacManBatch) -> Mapping[str, NDArray[Any]]:
        """Return whether the maze is cleared, and the lives that are left."""
        return batch_outcome(batch)

    def abstraction(self, *, fine: bool) -> Abstraction:
        """
        Return the abstract features that there are.

        For options the context is what is left to gain, and the mixture what is near.
        """
        if fine:
            near = (NEAR_DANGER, NEAR_SECOND, NEAR_PREY, NEAR_PILL)
            ways = [len(edges) * N_DIRECTIONS + 1 for edges in near]
            return Abstraction((16, N_DIRECTIONS, len(NEAR_FOOD) + 1, *ways))
        names = [feature.name for feature in PLANNING_FEATURES]
        return Abstraction(
            sizes=tuple(feature.count for feature in PLANNING_FEATURES),
            context=tuple(c for c, name in enumerate(names) if name in CONTEXT),
            mixture=tuple(c for c, name in enumerate(names) if name not in (*CONTEXT, 'lives')),
        )

    def abstract_features(
        self, batch: PacManBatch, rows: NDArray[np.int32], *, fine: bool
    ) -> NDArray[np.int32]:
        """Return (N, P): the values, from 0."""
        if not fine:
            return planning_features(batch)
        values: list[NDArray[Any]] = [
            self._of(rows, 'legal_moves'),
            self._of(rows, 'food_direction'),
            np.searchsorted(NEAR_FOOD, self._of(rows, 'food_distance'), side='right'),
            *self._dangers(batch, rows),
            self._prey(batch, rows),
            self._way(rows, 'pill', NEAR_PILL),
        ]
        return np.stack(values, axis=1).astype(np.int32)

    def _of(self, rows: NDArray[np.int32], name: str) -> NDArray[np.int32]:
        return rows[:, self._column[name]]

    def _way(self, rows: NDArray[np.int32], thing: str, near: tuple[int, ...]) -> Ints:
        """Return the direction of a thing and the bucket of its distance as one number (N,)."""
        direction = self._of(rows, f'{thing}_direction')
        return _near(direction, self._of(rows, f'{thing}_distance'), near)

    def _prey(self, batch: PacManBatch, rows: NDArray[np.int32]) -> Ints:
        """Return the way to the nearest scared ghost, while there is time to come to it."""
        away = self._of(rows, 'prey_distance')
        fear = batch.scared.max(axis=0, initial=0)
        return _near(self._of(rows, 'prey_direction'), np.where(away > fear, FAR, away), NEAR_PREY)

    def _dangers(self, batch: PacManBatch, rows: NDArray[np.int32]) -> tuple[Ints, Ints]:
        """Return the ways to the nearest dangerous ghost and to the one after that."""
        ghosts = [f'ghost_{number + 1}' for number in range(len(batch.ghosts))]
        away = np.full((len(rows), len(ghosts) + 2), FAR)
        direction = np.zeros((len(rows), len(ghosts) + 2), dtype=np.int32)
        for column, (ghost, scared) in enumerate(zip(ghosts, batch.scared)):
            away[:, column] = np.where(scared > 0, FAR, self._of(rows, f'{ghost}_distance'))
            direction[:, column] = self._of(rows, f'{ghost}_direction')
        first, second = np.argsort(away, axis=1, kind='stable')[:, :2].T
        game = np.arange(len(rows))
        return (
            _near(direction[game, first], away[game, first], NEAR_DANGER),
            _near(direction[game, second], away[game, second], NEAR_SECOND),
        )


def batch_outcome(batch: PacManBatch) -> Mapping[str, NDArray[Any]]:
    """Return what is reported of games beside their score."""
    return {'cleared': batch.food_left == 0, 'lives left': batch.lives}


def _near(direction: NDArray[Any], away: NDArray[Any], near: tuple[int, ...]) -> Ints:
    """Return direction and bucket as one number, without the direction in the last bucket."""
    bucket = np.searchsorted(near, away, side='right')
    return np.where(
        bucket < len(near), bucket * N_DIRECTIONS + direction, len(near) * N_DIRECTIONS
    )
