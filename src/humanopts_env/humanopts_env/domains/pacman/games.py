"""
Many games of Pac-Man at once for planning from samples: play, state abstractions, sampled games.

The abstraction for options has buckets of the distances, times and numbers that decide which
option is worth starting. "Arrival" at a cell is the fewest steps in which a dangerous ghost can
reach it. Dangerous ghosts do not turn round unless they must, so a ghost that has just passed
arrives later than its distance says. The risk of an option is the arrival at the cell of its first
step, where 1 may cost a life at once. The finer abstraction for primitive actions has the walls
around Pac-Man, and the direction of each thing that is near enough to matter.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.capabilities import Abstraction, BatchGames
from humanopts_env.domains.pacman.features import (
    DIRECTIONS,
    FeatureReader,
    FIRST,
    nearest_key,
    NUMBER,
    safety_after,
    SOUGHT,
    STEPS,
)
from humanopts_env.domains.pacman.paths import HAS_MOVE, MOVES, Paths, STAY
from humanopts_env.domains.pacman.rules import DRAWS, PacManBatch, Rules
from humanopts_env.domains.pacman.state import PacManState
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from humanopts_env.domains.pacman.domain import PacMan

AFAR = 1000  # stands for the distance of what is not there, or farther away
N_DIRECTIONS = len(DIRECTIONS)
# For primitive actions: the first distance of each bucket but the nearest. In the last bucket the
# direction is left out, but for food.
NEAR = {'danger': (2, 3, 4, 5, 7), 'second': (3, 5), 'prey': (3, 6, 13), 'pill': (3, 9)}
NEAR_FOOD = (2, 3, 5, 9)
LONGEST = 300  # steps that are played before a state is drawn
CHANGES = 0.1  # probability of a new aim at a step
WANTS = ('food', 'food', 'pill', 'prey', None)  # aims, each equally likely; None: random moves
_AIMS = np.array([SOUGHT.index(want) if want else len(SOUGHT) for want in WANTS])


ABSTRACT_FEATURES = {  # numbers in buckets: value k holds ``edges[k - 1] <= number < edges[k]``
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
        for edges in ABSTRACT_FEATURES.values()
    ],
    dtype=np.int32,
)
_BUCKET_OF_0 = np.arange(len(_BUCKETS))[:, None] * _BUCKETS.shape[1] + 1
CONTEXT = ('food_left', 'pills_left')  # remaining points, not things nearby
_BUCKET_OF_FOOD = np.searchsorted(NEAR_FOOD, range(AFAR + 1), side='right')
_WAYS = {  # (AFAR + 1) * N_DIRECTIONS numbers of a distance and a direction
    thing: np.minimum(
        np.searchsorted(edges, range(AFAR + 1), side='right')[:, None] * N_DIRECTIONS
        + range(N_DIRECTIONS),
        len(edges) * N_DIRECTIONS,
    ).ravel()
    for thing, edges in NEAR.items()
}


class PacManGames(BatchGames):
    """Games of Pac-Man; rewards are points."""

    def __init__(self, domain: 'PacMan') -> None:
        self.domain = domain
        self._rules = domain.rules
        self._read_all = domain.read_all_features
        self._column = {name: column for column, name in enumerate(self._read_all.names)}

    def batch_reset(self, count: int, rng: np.random.Generator) -> PacManBatch:
        return PacManBatch.begin(self._rules, count)

    def batch_of(self, states: Sequence[PacManState]) -> PacManBatch:
        return PacManBatch.from_states(self._rules, states)

    def batch_states(self, batch: PacManBatch) -> list[PacManState]:
        return batch.states()

    def batch_take(self, batch: PacManBatch, games: Ints) -> PacManBatch:
        return batch.take(games)

    def batch_put(self, batch: PacManBatch, games: Ints, source: PacManBatch) -> None:
        batch.put(games, source)

    def batch_step(self, batch: PacManBatch, actions: Ints, rng: np.random.Generator) -> Ints:
        return batch.step(actions, batch.draws(rng))

    def batch_step_each(
        self, batch: PacManBatch, actions: Ints, rngs: Sequence[np.random.Generator]
    ) -> Ints:
        draws = [self._rules.draws(rng) for rng in rngs]
        return batch.step(actions, np.array(draws, dtype=np.intp).reshape(len(draws), -1).T)

    def draws_ahead(self, rng: np.random.Generator, steps: int) -> Ints:
        return rng.integers(DRAWS, size=(steps, len(self._rules.maze.homes)))

    def batch_step_drawn(self, batch: PacManBatch, actions: Ints, draws: Ints) -> Ints:
        return batch.step(actions, draws.T)

    def batch_over(self, batch: PacManBatch) -> Flags:
        return batch.over

    def batch_features(self, batch: PacManBatch) -> Rows:
        return self.domain.read_features(batch)

    def batch_outcome(self, batch: PacManBatch) -> Mapping[str, NDArray[Any]]:
        """Return whether the maze is cleared, and the lives that are left."""
        return {'cleared': batch.food_left == 0, 'lives left': batch.lives}

    def abstraction(self, *, fine: bool) -> Abstraction:
        """
        Return the abstract features.

        For options, the context is the remaining points, and the mixture the things nearby.
        """
        if fine:
            ways = [len(edges) * N_DIRECTIONS + 1 for edges in NEAR.values()]
            return Abstraction((16, N_DIRECTIONS, len(NEAR_FOOD) + 1, *ways))
        return Abstraction(
            sizes=tuple(len(edges) + 1 for edges in ABSTRACT_FEATURES.values()),
            context=tuple(c for c, name in enumerate(ABSTRACT_FEATURES) if name in CONTEXT),
            mixture=tuple(
                c for c, name in enumerate(ABSTRACT_FEATURES) if name not in (*CONTEXT, 'lives')
            ),
        )

    def abstract_features(
        self, batch: PacManBatch, rows: Rows, *, fine: bool
    ) -> NDArray[np.int32]:
        if not fine:
            return abstract_features(batch)
        if not self.domain.has_all_features:
            rows = self._read_all(batch)
        values = np.empty((7, len(rows)), dtype=np.int32)
        values[0] = self._of(rows, 'legal_moves')
        values[1] = self._of(rows, 'food_direction')
        values[2] = _BUCKET_OF_FOOD.take(self._of(rows, 'food_distance'), mode='clip')
        values[3:5] = self._dangers(batch, rows)
        values[5] = self._way(rows, 'prey', self._prey(batch, rows))
        values[6] = self._way(rows, 'pill', self._of(rows, 'pill_distance'))
        return values.T

    def _of(self, rows: Rows, name: str) -> NDArray[np.int32]:
        return rows[:, self._column[name]].astype(np.int32)

    def _way(self, rows: Rows, thing: str, away: NDArray[Any]) -> Ints:
        """Return the direction of a thing and the bucket of its distance as one number (N,)."""
        key = away * N_DIRECTIONS + self._of(rows, f'{thing}_direction')
        found: Ints = _WAYS[thing].take(key, mode='clip')
        return found

    def _prey(self, batch: PacManBatch, rows: Rows) -> NDArray[Any]:
        """Return steps (N,) to the nearest scared ghost that can be reached while it is scared."""
        away = self._of(rows, 'prey_distance')
        return np.where(away > batch.scared.max(axis=0, initial=0), AFAR, away)

    def _dangers(self, batch: PacManBatch, rows: Rows) -> list[Ints]:
        """Return the ways to the nearest and the second nearest dangerous ghost."""
        none = AFAR << STEPS
        keys = np.empty(batch.ghosts.shape, dtype=np.int32)
        for ghost, (key, scared) in enumerate(zip(keys, batch.scared)):
            name = f'ghost_{ghost + 1}'
            np.left_shift(self._of(rows, f'{name}_distance'), STEPS, out=key)
            key |= ghost << NUMBER | self._of(rows, f'{name}_direction')
            np.copyto(key, none, where=scared > 0)
        found = []
        for thing in ('danger', 'second'):
            least = keys.min(axis=0, initial=none)
            found.append(_WAYS[thing].take((least >> STEPS) * N_DIRECTIONS + (least & FIRST)))
            np.copyto(keys, none, where=keys == least)
        return found


def abstract_features(batch: PacManBatch) -> NDArray[np.int32]:
    """Return the buckets of every game, (N, P), in the order of ABSTRACT_FEATURES."""
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
    known = np.empty((len(ABSTRACT_FEATURES), len(batch)), dtype=np.intp)
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


def sample_games(rules: Rules, rngs: Sequence[np.random.Generator], count: int) -> PacManBatch:
    """
    Draw samples of states that games pass through, none of them over.

    Each game is played for a number of steps drawn uniformly below LONGEST, and begins again where
    it ends. Pac-Man has an aim for a while: he goes towards the nearest food, pill or scared
    ghost, or moves at random, which he also does where his aim is not in the maze.

    :param rngs: one for each sample, K; each is drawn from as if it were the only one.
    :param count: number of states of a sample.
    :return: N games, ``count`` for each of the K samples in order.
    """
    shape = len(rngs), count
    length, want = np.empty((2, *shape), dtype=np.intp)
    for sample, rng in enumerate(rngs):
        length[sample] = rng.integers(LONGEST, size=count)
        want[sample] = rng.integers(len(WANTS), size=count)
    read, games = _reader(rules), PacManBatch.begin(rules, length.size)
    order = np.argsort(length, axis=None, kind='stable')  # games that are drawn first go first
    drawn = np.searchsorted(length.ravel()[order], np.arange(LONGEST), side='right').tolist()
    last = length.max(axis=1, initial=-1).tolist()  # step of each sample
    change, others, at_random = np.zeros(shape), np.zeros_like(want), np.zeros_like(want)
    draws = np.zeros((len(rules.maze.homes), *shape), dtype=np.intp)
    for step in range(max(last, default=-1) + 1):
        for sample in [at for at, its_last in enumerate(last) if step <= its_last]:
            rng = rngs[sample]
            change[sample] = rng.random(count)
            others[sample] = rng.integers(len(WANTS), size=count)
            at_random[sample] = rng.integers(len(MOVES), size=count)
            draws[:, sample] = rules.batch_draws(rng, count)
        want = np.where(change < CHANGES, others, want)
        batch, playing = games.after(drawn[step]), order[drawn[step] :]
        move = read.first_moves(batch, _AIMS[want.take(playing)])
        move = np.where(move < len(MOVES), move, at_random.take(playing))
        batch.step(move, draws.reshape(len(draws), length.size)[:, playing])
        over = batch.over.nonzero()[0]
        if over.size:
            batch.restart(over)
    return games.take(np.argsort(order))


@lru_cache(maxsize=8)
def _reader(rules: Rules) -> FeatureReader:
    return FeatureReader(rules)
