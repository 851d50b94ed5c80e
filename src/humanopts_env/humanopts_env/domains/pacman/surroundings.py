"""Distances from Pac-Man to the nearest thing of each kind, in many games at once."""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.domains.pacman.batch import PacManBatch, Taken
from humanopts_env.domains.pacman.paths import Masks
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is nearest of each kind in N games, and the first moves of all shortest ways there."""

    food: NDArray[np.intp]  # (N,) steps; ``far`` where there is none
    pill: NDArray[np.intp]
    danger: NDArray[np.intp]  # dangerous ghost
    prey: NDArray[np.intp]  # scared ghost
    fear: NDArray[np.intp]  # (N,) for how long the nearest scared ghost is scared
    to_food: Masks  # (N,)
    to_pill: Masks
    to_prey: Masks
    food_at: NDArray[
        np.intp
    ]  # (N,) cell of the nearest, the first of several; any if there is none
    pill_at: NDArray[np.intp]
    far: int


def look_around(batch: PacManBatch) -> Surroundings:
    """Measure the distances in every game."""
    paths, maze = batch.rules.paths, batch.rules.maze
    food, food_at, to_food = _nearest(batch, maze.food, batch.food_taken)
    pill, pill_at, to_pill = _nearest(batch, maze.pills, batch.pills_taken)
    steps = paths.distance[batch.ghosts, batch.pacman].astype(np.intp)  # (G, N)
    scared = batch.scared > 0
    danger = np.where(scared, paths.far, steps).min(axis=0, initial=paths.far)
    hunted = np.where(scared, steps, paths.far)
    prey = hunted.min(axis=0, initial=paths.far)
    nearest = scared & (hunted == prey)
    first = np.where(nearest, paths.shortest[batch.pacman, batch.ghosts], 0)
    return Surroundings(
        food=food,
        pill=pill,
        danger=danger,
        prey=prey,
        fear=np.where(nearest, batch.scared, 0).max(axis=0, initial=0),
        to_food=to_food,
        to_pill=to_pill,
        to_prey=np.bitwise_or.reduce(first, axis=0).astype(np.uint8),
        food_at=food_at,
        pill_at=pill_at,
        far=paths.far,
    )


def _nearest(
    batch: PacManBatch, cells: Sequence[int], taken: Taken
) -> tuple[NDArray[np.intp], NDArray[np.intp], Masks]:
    """Return steps to the nearest thing that is there, its cell, and moves to all as near."""
    paths, items = batch.rules.paths, [*cells, 0]  # the last column of ``taken`` is no thing
    steps = paths.distance[:, items][batch.pacman] | taken
    at = steps[:, :-1].argmin(axis=1) if cells else np.zeros(len(batch), dtype=np.intp)
    least = np.where(taken[:, :-1] == 0, steps[:, :-1], paths.far).min(axis=1, initial=paths.far)
    nearest = (steps == least[:, None]) & (taken == 0)
    first = np.where(nearest, paths.shortest[:, items][batch.pacman], 0)
    masks: Masks = np.bitwise_or.reduce(first, axis=1).astype(np.uint8)
    return least.astype(np.intp), np.array(items)[at], masks
