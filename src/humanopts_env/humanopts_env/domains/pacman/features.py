"""
The features of Pac-Man, and the nearest object of each kind, in many games at once.

The nearest object has the shortest path; of several, it is the first, row by row. A direction is
the first move of a shortest path; of several, the first in the order of moves. For an absent
object (no pill is left, no ghost is scared), row, column, direction and distance have their last
value, "none".

There are two feature lists. ``ALL`` also has directions, which reveal a policy: "go to the closest
food" takes the first move of a shortest path, and a few demonstrations suffice to learn it. They
have the same meaning in every maze. ``PAPER`` has the features named by Subramanian, Isbell and
Thomaz (2011, section 3): positions and the remaining scared time of ghosts. A policy over
positions must be demonstrated cell by cell, and is specific to one maze. The meals of the last
step are in both lists, since no other feature shows that food was eaten.
"""

from collections.abc import Sequence
from functools import cached_property

from humanopts_env.arrays import Ints, Rows
from humanopts_env.domains.base import Feature, FeatureKind, subset_names
from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.domains.pacman.paths import FIRST_MOVE, HAS_MOVE, MOVES, STAY
from humanopts_env.domains.pacman.rules import Keys, PacManBatch, Rules
from humanopts_env.domains.pacman.state import EATEN, SCARED_STEPS
import numpy as np
from numpy.typing import NDArray

DIRECTIONS = (*MOVES, 'here', 'none')
NOWHERE = STAY + 1  # index of 'none'
ALL, PAPER = 'directions', 'paper'  # feature lists
FEATURE_LISTS = (ALL, PAPER)
THINGS = {  # prefix of feature names: words for people
    'food': 'the nearest food',
    'pill': 'the nearest power pill',
    'fruit': 'the fruit',
    'danger': 'the nearest dangerous ghost',
    'prey': 'the nearest scared ghost',
}
STEPS, NUMBER, FIRST = 16, 3, 7  # bits of a key: shifts of steps and number; mask of the move
FEW = 9  # maximum number of objects with keys compared one by one


def in_paper(name: str) -> bool:
    """Return whether a feature is in the list ``PAPER``."""
    return name.endswith(('_row', '_col', '_scared')) or name == 'ate'


def pacman_features(rules: Rules) -> tuple[Feature, ...]:
    """Return all features, in the order of ``FeatureReader``."""
    rows, cols = rules.maze.rows, rules.maze.cols
    features = [*Feature.place('pacman', 'Pac-Man', rows, cols)]
    for number in range(1, len(rules.maze.homes) + 1):
        name, words = f'ghost_{number}', f'ghost {number}'
        features += Feature.place(name, words, rows, cols)
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
        features += Feature.place(name, THINGS[name], rows, cols, 'none')
        features += _way(rules, name, THINGS[name])
    for name in ('danger', 'prey'):
        features += _way(rules, name, THINGS[name])
    return (
        *features,
        Feature.nominal('ate', 'what the last step ate', subset_names(EATEN, ' and ', 'nothing')),
        Feature.nominal('legal_moves', 'which moves no wall blocks', subset_names(MOVES, ' and ')),
    )


GROUPS = {  # words: prefixes of feature names
    'Pac-Man': ('pacman_', 'legal_'),
    'the ghosts': ('ghost_', 'danger_', 'prey_'),
    'the food': ('food_',),
    'the power pills': ('pill_',),
    'the fruit': ('fruit_',),
}


def pacman_groups(features: Sequence[Feature]) -> tuple[FeatureGroup, ...]:
    """Return the groups of the features of a game."""
    names = [feature.name for feature in features]
    groups = (
        FeatureGroup(words, tuple(name for name in names if name.startswith(beginnings)))
        for words, beginnings in GROUPS.items()
    )
    return tuple(group for group in groups if len(group.features) > 1)


def _way(rules: Rules, name: str, words: str) -> list[Feature]:
    away, count = f'how many steps away {words} is', rules.paths.longest + 1
    begins = f'which way a shortest path to {words} begins'
    return [
        Feature.nominal(f'{name}_direction', begins, DIRECTIONS),
        Feature.number(f'{name}_distance', away, count, 'none'),
    ]


class FeatureReader:
    """Computes all features of many games at once, with precomputed tables of a maze."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        maze, paths, groups = rules.maze, rules.paths, len(rules.maze.homes)
        count, none = len(maze.cells), paths.longest + 1  # the distance to an absent object
        # Cell C is the cell of an absent object.
        self._place = np.array([*maze.cells, (maze.rows, maze.cols)], dtype=np.int32).T.copy()
        first = np.pad(FIRST_MOVE[paths.shortest], ((0, 0), (0, 1)), constant_values=NOWHERE)
        steps = np.pad(paths.distance.astype(np.int32), ((0, 0), (0, 1)), constant_values=none)
        # (C * (C + 1),) keys: steps, room for the number of a ghost, and the first move
        self._way = (steps << STEPS | first).ravel().astype(np.int32)
        self._no_way = np.int32(none << STEPS | NOWHERE)
        self._ghosts = (np.arange(groups, dtype=np.int32) << NUMBER)[:, None]
        self._food, self._pills = np.array([*maze.food, count]), np.array([*maze.pills, count])
        self._legal = paths.legal.astype(np.int32)
        # indices of the row and direction features of each object: ghosts, then THINGS
        rows = [2 + 5 * ghost for ghost in range(groups)]
        rows += [2 + 5 * groups + 4 * thing for thing in range(3)]
        self._rows = np.array(rows)
        self._directions = np.append(self._rows + 2, [rows[-1] + 4, rows[-1] + 6])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(feature.name for feature in pacman_features(self.rules))

    def __call__(self, batch: PacManBatch) -> Rows:
        """Return the features of every game, (N, F)."""
        groups, (cells, ways) = len(batch.ghosts), self._ways(batch)
        out = np.empty((len(self.names), len(batch)))
        out[:2] = self._place.take(batch.pacman, axis=1)
        for axis in range(2):
            out[self._rows + axis] = self._place[axis].take(cells)
        out[self._directions] = ways & FIRST
        out[self._directions + 1] = ways >> STEPS
        out[self._rows[:groups] + 4] = batch.scared
        out[-2] = batch.ate
        out[-1] = self._legal.take(batch.pacman)
        return out.T

    def first_moves(self, batch: PacManBatch) -> NDArray[np.int32]:
        """Return (T, N): the direction of each of ``THINGS``."""
        moves: NDArray[np.int32] = self._ways(batch)[1][len(batch.ghosts) :] & FIRST
        return moves

    def _ways(self, batch: PacManBatch) -> tuple[Ints, NDArray[np.int32]]:
        """Return the cells (G + 3, N) and the keys (G + T, N) of ghosts and ``THINGS``."""
        here, tables, groups = batch.pacman, batch.tables, len(batch.ghosts)
        food = nearest_key(tables.food, here, batch.food_taken)
        pill = nearest_key(tables.pills, here, batch.pills_taken)
        cells = np.empty((groups + 3, len(batch)), dtype=np.intp)
        cells[:groups] = batch.ghosts
        cells[groups] = self._food.take(food & tables.low)
        cells[groups + 1] = self._pills.take(pill & tables.low)
        cells[groups + 2] = np.where(batch.fruit > 0, batch.fruit_at, self._place.shape[1] - 1)
        ways = np.empty((groups + len(THINGS), len(batch)), dtype=np.int32)
        ways[:-2] = self._way.take(here * self._place.shape[1] + cells)
        scared, ghosts = batch.scared > 0, ways[:groups] | self._ghosts
        for thing, chosen in ((-2, ~scared), (-1, scared)):
            ways[thing] = np.where(chosen, ghosts, self._no_way).min(axis=0, initial=self._no_way)
        return cells, ways


def nearest_key(keys: Keys, cells: Ints, taken: Keys) -> Keys:
    """
    Return the key of the nearest remaining object, (..., N).

    :param keys: (C, K + 1) of ``Tables``.
    :param cells: (..., N) start cells.
    :param taken: (N, K + 1) marks of ``PacManBatch``.
    """
    if keys.shape[1] < FEW:  # short rows of keys: one column at a time
        left = keys.T.take(cells, axis=1)
        marks = taken.T if cells.ndim == 1 else taken.T[:, None]
        least: Keys = np.bitwise_or(left, marks, out=left).min(axis=0)
    else:
        left = keys.take(cells, axis=0)
        least = np.bitwise_or(left, taken, out=left).min(axis=-1)
    return least


def steps_to(batch: PacManBatch, thing: str, cells: Ints) -> Ints:
    """
    Return the steps from cells to the nearest object of a kind, (..., N); ``far`` if none.

    :param thing: one of ``THINGS``.
    :param cells: start cells, (..., N).
    """
    paths, tables = batch.rules.paths, batch.tables
    steps = np.full(cells.shape, paths.far, dtype=np.intp)
    items = {
        'food': (tables.food, batch.food_taken),
        'pill': (tables.pills, batch.pills_taken),
    }
    if thing in items:
        keys, taken = items[thing]
        np.minimum(nearest_key(keys, cells, taken) >> tables.low_bits, paths.far, out=steps)
        return steps
    if thing == 'fruit':
        places, there = batch.fruit_at[None], batch.fruit[None] > 0
    else:
        places, there = batch.ghosts, (batch.scared > 0) == (thing == 'prey')
    for place, is_there in zip(places, there):
        way = paths.distance.ravel().take(cells * len(paths.step) + place)
        np.minimum(steps, np.where(is_there, way, paths.far), out=steps)
    return steps


def steps_after(batch: PacManBatch, thing: str, wall: int) -> Ints:
    """
    Return the steps to the nearest object of a kind after each move, (N, 4).

    :param wall: value for moves blocked by a wall.
    """
    paths = batch.rules.paths
    after = steps_to(batch, thing, paths.step[batch.pacman, :STAY].T).T
    after[~HAS_MOVE[paths.legal[batch.pacman]]] = wall
    return after


def fear_of_prey(batch: PacManBatch) -> Ints:
    """Return the remaining scared steps of the nearest scared ghost, (N,); 0 if none."""
    paths, scared = batch.rules.paths, batch.scared > 0
    steps = np.where(scared, paths.distance[batch.pacman, batch.ghosts], paths.far)
    nearest = scared & (steps == steps.min(axis=0, initial=paths.far))
    fear: Ints = np.where(nearest, batch.scared, 0).max(axis=0, initial=0)
    return fear
