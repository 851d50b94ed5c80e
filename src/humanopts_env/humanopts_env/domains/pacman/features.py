"""
The features of Pac-Man, and the nearest thing of each kind, in many games at once.

"Nearest" is by steps of a shortest path; among several it is the first, row by row. A direction is
the first move of a shortest path, the first in the order of moves where there are several. A thing
that is absent (no pill is left, no ghost is scared) has the last value of row, column, direction
and distance, "none".

There are two lists. Directions hand a policy over: the first move of a shortest path is what
"go to the closest food" does, and a few demonstrations are enough to copy it; they mean the same
in every maze. ``PAPER`` has what Subramanian, Isbell and Thomaz (2011, section 3) name: positions
and how long ghosts are scared. A policy over positions has to be shown cell by cell, and belongs
to one maze. What the last step ate is in both: nothing else tells that food was eaten.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

from humanopts_env.arrays import Flags
from humanopts_env.domains.base import Feature, FeatureKind
from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.domains.pacman.paths import FIRST_MOVE, HAS_MOVE, Masks, MOVES, Paths, STAY
from humanopts_env.domains.pacman.rules import PacManBatch, Rules, Taken
from humanopts_env.domains.pacman.state import eaten_names, SCARED_STEPS
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

DIRECTIONS = (*MOVES, 'here', 'none')
NOWHERE = STAY + 1  # index of the last
ALL, PAPER = 'directions', 'paper'  # lists of features
FEATURE_LISTS = (ALL, PAPER)
THINGS = {  # prefix of feature names: what it is to a person
    'food': 'the nearest food',
    'pill': 'the nearest power pill',
    'fruit': 'the fruit',
    'danger': 'the nearest dangerous ghost',
    'prey': 'the nearest scared ghost',
}
SOUGHT = ('food', 'pill', 'prey')  # among them
DANGEROUS_AND_SCARED = read_only(np.array([[False], [True]]))


def in_paper(name: str) -> bool:
    """Return whether a feature is in the list ``PAPER``."""
    return name.endswith(('_row', '_col', '_scared')) or name == 'ate'


def pacman_features(rules: Rules) -> tuple[Feature, ...]:
    """Return all features, in the order of ``FeatureReader``."""
    features = _place(rules, 'pacman', 'Pac-Man', can_miss=False)
    for number in range(1, len(rules.maze.homes) + 1):
        name, words = f'ghost_{number}', f'ghost {number}'
        features += _place(rules, name, words, can_miss=False)
        features += _way(rules, name, words)
        features.append(
            Feature(
                f'{name}_scared',
                f'whether and for how long {words} is scared',
                FeatureKind.ORDINAL,
                ('no', '1 step', *(f'{n} steps' for n in range(2, SCARED_STEPS + 1))),
            )
        )
    for name in ('food', 'pill', 'fruit'):
        features += _place(rules, name, THINGS[name], can_miss=True)
        features += _way(rules, name, THINGS[name])
    for name in ('danger', 'prey'):
        features += _way(rules, name, THINGS[name])
    return (
        *features,
        Feature(
            'ate', 'what the last step ate', FeatureKind.NOMINAL, _sets(eaten_names, 'nothing')
        ),
        Feature(
            'legal_moves',
            'which moves no wall blocks',
            FeatureKind.NOMINAL,
            _sets(lambda mask: [m for bit, m in enumerate(MOVES) if mask >> bit & 1], 'none'),
        ),
    )


GROUPS = {  # in words: the beginnings of the names of their features
    'Pac-Man': ('pacman_', 'legal_'),
    'the ghosts': ('ghost_', 'danger_', 'prey_'),
    'the food': ('food_',),
    'the power pills': ('pill_',),
    'the fruit': ('fruit_',),
}


def pacman_groups(features: Sequence[Feature]) -> tuple[FeatureGroup, ...]:
    """Return the groups of the features that a game has."""
    names = [feature.name for feature in features]
    groups = (
        FeatureGroup(words, tuple(name for name in names if name.startswith(beginnings)))
        for words, beginnings in GROUPS.items()
    )
    return tuple(group for group in groups if len(group.features) > 1)


def _place(rules: Rules, name: str, words: str, *, can_miss: bool) -> list[Feature]:
    none = ('none',) if can_miss else ()
    return [
        Feature(
            f'{name}_{axis}',
            f'which {long} {words} is in',
            FeatureKind.ORDINAL,
            (*map(str, range(count)), *none),
        )
        for axis, long, count in (
            ('row', 'row', rules.maze.rows),
            ('col', 'column', rules.maze.cols),
        )
    ]


def _way(rules: Rules, name: str, words: str) -> list[Feature]:
    farthest = rules.paths.longest
    return [
        Feature(
            f'{name}_direction',
            f'which way a shortest path to {words} begins',
            FeatureKind.NOMINAL,
            DIRECTIONS,
        ),
        Feature(
            f'{name}_distance',
            f'how many steps away {words} is',
            FeatureKind.ORDINAL,
            (*map(str, range(farthest + 1)), 'none'),
        ),
    ]


def _sets(names: Callable[[int], list[str]], empty: str) -> tuple[str, ...]:
    return tuple(' and '.join(names(mask)) or empty for mask in range(16))


@dataclass(frozen=True)
class _Nearest:
    """Distances from each cell to each of K things, and their cells."""

    distance: NDArray[np.unsignedinteger]  # (C, K + 1), 0 in the last entry
    cells: NDArray[np.intp]  # (K + 1,), the last entry, C, stands for none


class FeatureReader:
    """Computes all features of many games at once, with tables that it prepares for a maze."""

    def __init__(self, rules: Rules) -> None:
        """Prepare the tables of a maze."""
        self.rules = rules
        maze, paths = rules.maze, rules.paths
        self.far = paths.far
        self.none = paths.longest + 1  # the value of a distance to nothing
        count = len(maze.cells)
        # One more cell, C, stands for nothing at all.
        self._place = np.array([*maze.cells, (maze.rows, maze.cols)], dtype=np.int32)
        first = np.full((count, count + 1), NOWHERE, dtype=np.int32)
        first[:, :count] = FIRST_MOVE[paths.shortest]
        steps = np.full((count, count + 1), self.none, dtype=np.int32)
        steps[:, :count] = paths.distance
        way = np.stack((first, steps), axis=2)
        place = np.broadcast_to(self._place, (count, count + 1, 2))
        self._place_and_way = np.concatenate((place, way), axis=2).reshape(
            -1, 4
        )  # (C * (C + 1), 4)
        self._direction = first.ravel()
        self._food, self._pills = self._search(maze.food), self._search(maze.pills)
        self._distance = paths.distance.ravel()
        self._legal = paths.legal.astype(np.int32)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(feature.name for feature in pacman_features(self.rules))

    def __call__(self, batch: PacManBatch) -> NDArray[np.int32]:
        """Return the features of every game, (N, F)."""
        out = np.empty((len(batch), len(self.names)), dtype=np.int32)
        groups, here = len(batch.ghosts), batch.pacman
        seen = self._look(batch)
        out[:, :2] = self._place.take(here, axis=0)
        column = 2
        for thing in range(groups):
            out[:, column : column + 4] = seen[thing]
            out[:, column + 4] = batch.scared[thing]
            column += 5
        for thing in range(groups, groups + 3):
            out[:, column : column + 4] = seen[thing]
            column += 4
        for thing in range(groups + 3, groups + 5):
            out[:, column : column + 2] = seen[thing, :, 2:]
            column += 2
        out[:, column] = batch.ate
        out[:, column + 1] = self._legal.take(here)
        return out

    def first_moves(self, batch: PacManBatch, sought: NDArray[np.integer]) -> NDArray[np.int32]:
        """
        Return the direction of one thing in each game, (N,).

        :param sought: (N,) indices into ``SOUGHT``; another number: of nothing.
        """
        here = batch.pacman
        food, pill = (sought == 0).nonzero()[0], (sought == 1).nonzero()[0]
        cells = np.full(len(batch), len(self._place) - 1, dtype=np.intp)
        if food.size:
            taken = batch.food_taken.take(food, axis=0)
            cells[food] = self._find(self._food, here.take(food), taken)
        if pill.size:
            taken = batch.pills_taken.take(pill, axis=0)
            cells[pill] = self._find(self._pills, here.take(pill), taken)
        if batch.scared.any():
            np.copyto(cells, self._nearest_ghosts(batch)[1], where=sought == 2)
        way: NDArray[np.int32] = self._direction.take(here * len(self._place) + cells)
        return way

    def _look(self, batch: PacManBatch) -> NDArray[np.int32]:
        """Return row, column, direction and distance of ghosts and THINGS, (G + 5, N, 4)."""
        groups, here, none = len(batch.ghosts), batch.pacman, len(self._place) - 1
        cells = np.empty((groups + len(THINGS), len(batch)), dtype=np.intp)
        cells[:groups] = batch.ghosts
        cells[groups] = self._find(self._food, here, batch.food_taken)
        cells[groups + 1] = self._find(self._pills, here, batch.pills_taken)
        cells[groups + 2] = np.where(batch.fruit > 0, batch.fruit_at, none)
        cells[groups + 3 :] = self._nearest_ghosts(batch)
        seen: NDArray[np.int32] = self._place_and_way.take(here * len(self._place) + cells, axis=0)
        return seen

    def _find(
        self, items: _Nearest, here: NDArray[np.intp], taken: NDArray[np.unsignedinteger]
    ) -> NDArray[np.intp]:
        """Return the cell of the nearest thing that is not taken; C where there is none."""
        nearest = _distances_left(items.distance, here, taken).argmin(axis=1)
        found: NDArray[np.intp] = items.cells.take(nearest)
        return found

    def _nearest_ghosts(self, batch: PacManBatch) -> NDArray[np.intp]:
        """Return the cells of the nearest dangerous and scared ghost, (2, N); C: there is none."""
        none = len(self._place) - 1
        best = np.full((2, len(batch)), none, dtype=np.intp)
        least = np.full((2, len(batch)), self.far, dtype=self._distance.dtype)
        distance = self._distance.take(batch.pacman * none + batch.ghosts)
        scared = batch.scared > 0
        for ghost, cells in enumerate(batch.ghosts):
            nearer = (scared[ghost] == DANGEROUS_AND_SCARED) & (distance[ghost] < least)
            np.copyto(best, cells, where=nearer)
            np.copyto(least, distance[ghost], where=nearer)
        return best

    def _search(self, items: Sequence[int]) -> _Nearest:
        """Prepare the search for the nearest of some things."""
        count = len(self.rules.maze.cells)
        distance = np.zeros((count, len(items) + 1), dtype=self.rules.paths.distance.dtype)
        distance[:, :-1] = self.rules.paths.distance[:, list(items)]
        return _Nearest(read_only(distance), np.array([*items, count], dtype=np.intp))


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The nearest thing of each kind in N games, and the first moves of shortest paths to it."""

    food: NDArray[np.intp]  # (N,) steps; ``far`` where there is none
    pill: NDArray[np.intp]
    danger: NDArray[np.intp]  # dangerous ghost
    prey: NDArray[np.intp]  # scared ghost
    fear: NDArray[np.intp]  # (N,) steps for which the nearest scared ghost is scared
    to_food: Masks  # (N,)
    to_pill: Masks
    to_prey: Masks
    far: int


def look_around(batch: PacManBatch) -> Surroundings:
    """Measure the distances in every game."""
    paths, maze = batch.rules.paths, batch.rules.maze
    food, to_food = _nearest_things(batch, maze.food, batch.food_taken)
    pill, to_pill = _nearest_things(batch, maze.pills, batch.pills_taken)
    way = batch.pacman * len(paths.step) + batch.ghosts  # (G, N); equally far in both directions
    steps = paths.distance.ravel().take(way).astype(np.intp)
    scared = batch.scared > 0
    danger = np.where(scared, paths.far, steps).min(axis=0, initial=paths.far)
    hunted = np.where(scared, steps, paths.far)
    prey = hunted.min(axis=0, initial=paths.far)
    nearest = scared & (hunted == prey)
    first = np.where(nearest, paths.shortest.ravel().take(way), 0)
    return Surroundings(
        food=food,
        pill=pill,
        danger=danger,
        prey=prey,
        fear=np.where(nearest, batch.scared, 0).max(axis=0, initial=0),
        to_food=to_food,
        to_pill=to_pill,
        to_prey=np.bitwise_or.reduce(first, axis=0).astype(np.uint8),
        far=paths.far,
    )


def _nearest_things(
    batch: PacManBatch, cells: Sequence[int], taken: Taken
) -> tuple[NDArray[np.intp], Masks]:
    """Return steps to the nearest thing left, and first moves to all as near."""
    paths = batch.rules.paths
    if not cells:
        none = np.zeros(len(batch), dtype=np.intp)
        return none + paths.far, none.astype(np.uint8)
    distance, shortest = _to_things(paths, tuple(cells))
    steps = _distances_left(distance, batch.pacman, taken[:, :-1])
    least = steps.min(axis=1)
    nearest = steps == least[:, None]
    first = shortest.take(batch.pacman, axis=0)
    first *= nearest.view(np.uint8)
    masks: Masks = np.bitwise_or.reduce(first, axis=1)
    masks[least == paths.far] = 0
    return least.astype(np.intp), masks


def _distances_left(
    distance: NDArray[np.unsignedinteger], here: NDArray[np.intp], taken: Taken
) -> NDArray[np.unsignedinteger]:
    """
    Return the steps to each thing, (N, K); ``far`` where it is taken.

    :param distance: (C, K) from each cell to each thing.
    :param here: (N,) cells.
    :param taken: (N, K) marks: ``far`` where it is taken.
    """
    steps = distance.take(here, axis=0)
    np.bitwise_or(steps, taken, out=steps)
    return steps


@lru_cache(maxsize=8)
def _to_things(paths: Paths, cells: tuple[int, ...]) -> tuple[NDArray[np.unsignedinteger], Masks]:
    """Return the distance (C, K) from each cell to each thing, and the first moves to it."""
    columns = list(cells)
    return read_only(paths.distance[:, columns]), read_only(paths.shortest[:, columns])


def flight(batch: PacManBatch) -> Flags:
    """Return (N, 4): the legal moves after which the nearest dangerous ghost is farthest."""
    paths = batch.rules.paths
    after = paths.step.T[:STAY].take(batch.pacman, axis=1)  # (4, N)
    ways = batch.ghosts[:, None] * len(paths.step) + after  # (G, 4, N)
    steps = paths.distance.ravel().take(ways).astype(np.int32)
    np.copyto(steps, paths.far, where=batch.scared[:, None] > 0)
    least = steps.min(axis=0, initial=paths.far)
    legal = HAS_MOVE.T.take(paths.legal.take(batch.pacman), axis=1)
    np.copyto(least, -1, where=~legal)
    best: Flags = least == least.max(axis=0)
    return best.T
