"""
Pac-Man's rules, for many games at once; one game is a batch of one.

A step, in this order:

1. Pac-Man and the ghosts move at the same time; the ghosts react to his cell before the move. A
   move into a wall has no effect.
2. Pac-Man eats food, a pill or fruit in his cell.
3. He meets the ghosts that are now in his cell, or have changed places with him. He eats the
   scared ones; they are home at once, and dangerous. A dangerous one costs him a life, unless the
   last food was just eaten: Pac-Man and all ghosts return to their first cells; food, pills and
   fruit stay.
4. The times of scared ghosts and of fruit go down by one step.

A pill scares all ghosts for 40 steps. They may turn back once, then move away from Pac-Man at half
speed: in steps in which the time that is left is even. After the 30th and the 65th food, fruit
lies for 60 steps in the cell of the remaining food that is nearest to the middle.

All chance is in one draw for each ghost and step, a whole number below DRAWS, whether the ghost
moves or not. A chasing ghost follows a shortest path towards Pac-Man with draws below CHASE_DRAWS,
and otherwise moves like a random one. Where k moves are equally good, the draw picks among them
with equal shares.

N games, G ghosts, C cells, K food, P pills; one array for each part of the state. Rare events
(meeting a ghost, eating a pill, fruit) are computed only for the games in which they happen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.pacman.maze import Maze
from humanopts_env.domains.pacman.paths import HAS_MOVE, maze_paths, Paths, STAY
from humanopts_env.domains.pacman.state import (
    FRUIT_STEPS,
    Ghost,
    HEADINGS,
    NO_CELL,
    PacManState,
    SCARED_STEPS,
)
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

Taken = NDArray[np.unsignedinteger]

FOOD_POINTS, PILL_POINTS, FRUIT_POINTS, GHOST_POINTS = 10, 50, 100, 200
ATE_FOOD, ATE_PILL, ATE_FRUIT, ATE_GHOST = 1, 2, 4, 8  # bits of PacManState.ate
FRUIT_AFTER = (30, 65)  # food eaten
DRAWS, CHASE_DRAWS = 60, 48  # 48 / 60 = 0.8; both, and their difference, divide by 1 to 4
GHOST_RULES = ('random', 'chase')
OF_GHOSTS = ('ghosts', 'headings', 'scared')  # arrays of a batch with one row for each ghost


def _picks() -> NDArray[np.uint8]:
    """Return (16, DRAWS): the move that a draw picks from a mask."""
    picks = np.full((16, DRAWS), STAY, dtype=np.uint8)
    for mask in range(1, 16):
        moves = np.flatnonzero(HAS_MOVE[mask])
        chased = moves[np.arange(CHASE_DRAWS) * len(moves) // CHASE_DRAWS]
        rest = DRAWS - CHASE_DRAWS
        picks[mask] = [*chased, *moves[np.arange(rest) * len(moves) // rest]]
    return read_only(picks)


PICKS = _picks()


@dataclass(frozen=True, eq=False)
class Tables:
    """The maze as flat arrays, so that each quantity is one look-up."""

    step: Ints  # (C * 5,) cell after a move
    allowed: NDArray[np.uint8]  # (C * 5,) moves of a ghost by cell and heading
    towards: NDArray[np.uint8]  # (C * 5 * C,) and by Pac-Man's cell
    away: NDArray[np.uint8]
    picks: NDArray[np.intp]  # (16 * DRAWS,) move of a draw from a mask
    food_at: Ints  # (C,) index of the food in a cell; K: none
    pill_at: Ints  # (C,) index of the pill in a cell; P: none
    homes: Ints  # (G, 1)


def _tables(maze: Maze, paths: Paths) -> Tables:
    """Lay the maze out for steps of many games."""
    places = []
    for items in (maze.food, maze.pills):
        at = np.full(len(maze.cells), len(items), dtype=np.intp)
        at[list(items)] = range(len(items))
        places.append(read_only(at))
    return Tables(
        step=paths.step.ravel(),
        allowed=paths.allowed.ravel(),
        towards=paths.towards.ravel(),
        away=paths.away.ravel(),
        picks=read_only(PICKS.astype(np.intp).ravel()),
        food_at=places[0],
        pill_at=places[1],
        homes=read_only(np.array(maze.homes, dtype=np.intp).reshape(-1, 1)),
    )


@dataclass(frozen=True)
class Rules:
    """One maze, and how its ghosts move."""

    maze: Maze
    ghosts: str = 'random'  # one of GHOST_RULES
    lives: int = 3

    @cached_property
    def paths(self) -> Paths:
        """Moves and shortest paths of the maze."""
        return maze_paths(self.maze)

    @cached_property
    def tables(self) -> Tables:
        """The maze laid out for steps of many games."""
        return _tables(self.maze, self.paths)

    @property
    def chase_draws(self) -> int:
        """The number below which a draw makes a dangerous ghost chase."""
        return CHASE_DRAWS if self.ghosts == 'chase' else 0

    def start(self) -> PacManState:
        """Return the first state of every game."""
        return PacManBatch(self).states()[0]

    def is_over(self, state: PacManState) -> bool:
        """Return whether the food is all eaten, or the last life lost."""
        return state.food == 0 or state.lives == 0

    def draws(self, rng: np.random.Generator) -> list[int]:
        """Draw the chance of one step of one game, (G,)."""
        numbers: list[int] = rng.integers(DRAWS, size=len(self.maze.homes)).tolist()
        return numbers

    def advance(self, state: PacManState, move: int, draws: Sequence[int]) -> PacManState:
        """
        Take one step from a state that is not over; the points are the difference in score.

        :param draws: (G,) one number below DRAWS for each ghost.
        """
        batch = PacManBatch.from_states(self, [state])
        batch.step(np.array([move]), np.array([draws], dtype=np.intp).T)
        return batch.states()[0]

    def can_follow(self, state: PacManState, move: int, successor: PacManState) -> bool:
        """Return whether some draws lead from a state that is not over to another."""
        now = PacManBatch.from_states(self, [state])
        probe = now.take(np.zeros(DRAWS, dtype=np.intp))
        every = np.broadcast_to(np.arange(DRAWS), probe.ghosts.shape)
        probe.move_ghosts(probe.pacman, np.ones(DRAWS, dtype=np.bool_), every)
        different = [
            np.unique(place, return_index=True)[1]
            for place in probe.ghosts * len(HEADINGS) + probe.headings
        ]
        draws = np.array(list(product(*different)), dtype=np.intp)
        after = now.take(np.zeros(len(draws), dtype=np.intp))
        after.step(np.full(len(draws), move), draws.T)
        return successor in after.states()


class PacManBatch:
    """
    N games of the same rules.

    Food and pills that are taken are marked with ``Paths.far``, others with 0, so that a bitwise
    or with distances keeps the distances of those that are left. Both arrays have one more entry
    for cells with nothing to take, marked with ``far - 1``: nearer than all that is taken, and
    farther than all that is left.

    :ivar pacman: (N,) cells.
    :ivar ghosts: (G, N) cells.
    :ivar headings: (G, N) last moves; STAY: none.
    :ivar scared: (G, N) steps for which each ghost is still scared.
    :ivar food_taken: (N, K + 1).
    :ivar pills_taken: (N, P + 1).
    :ivar food_left: (N,) number of food left.
    :ivar fruit: (N,) steps for which the fruit is still there.
    :ivar fruit_at: (N,) cell of the fruit; meaningless where there is none.
    :ivar lives: (N,).
    :ivar score: (N,) points.
    :ivar ate: (N,) masks of the last step's meals.
    """

    pacman: Ints
    ghosts: Ints
    headings: Ints
    scared: Ints
    food_taken: Taken
    pills_taken: Taken
    food_left: Ints
    fruit: Ints
    fruit_at: Ints
    lives: Ints
    score: Ints
    ate: Ints

    def __init__(self, rules: Rules, count: int = 1) -> None:
        """
        Begin games.

        :param count: number of games, N.
        """
        maze, groups = rules.maze, len(rules.maze.homes)
        self.rules = rules
        self.tables = rules.tables
        far = rules.paths.far
        self.pacman = np.full(count, maze.start, dtype=np.intp)
        self.ghosts = np.repeat(self.tables.homes, count, axis=1)
        self.headings = np.full((groups, count), STAY, dtype=np.intp)
        self.scared = np.zeros((groups, count), dtype=np.intp)
        for name, items in (('food_taken', maze.food), ('pills_taken', maze.pills)):
            taken = np.zeros((count, len(items) + 1), dtype=rules.paths.distance.dtype)
            taken[:, -1] = far - 1
            setattr(self, name, taken)
        self.food_left = np.full(count, len(maze.food), dtype=np.intp)
        self.fruit = np.zeros(count, dtype=np.intp)
        self.fruit_at = np.full(count, NO_CELL, dtype=np.intp)
        self.lives = np.full(count, rules.lives, dtype=np.intp)
        self.score = np.zeros(count, dtype=np.intp)
        self.ate = np.zeros(count, dtype=np.intp)

    @classmethod
    def from_states(cls, rules: Rules, states: Sequence[PacManState]) -> 'PacManBatch':
        """Return games that stand at given states."""
        batch = cls.__new__(cls)
        batch.rules, batch.tables = rules, rules.tables
        numbers = [(s.pacman, s.fruit, s.fruit_at, s.lives, s.score, s.ate) for s in states]
        columns = np.array(numbers, dtype=np.intp).reshape(-1, 6).T.copy()
        batch.pacman, batch.fruit, batch.fruit_at, batch.lives, batch.score, batch.ate = columns
        ghosts = [[(g.cell, g.heading, g.scared) for g in state.ghosts] for state in states]
        shape = len(states), len(rules.maze.homes), 3
        each = np.array(ghosts, dtype=np.intp).reshape(shape).transpose(2, 1, 0).copy()
        batch.ghosts, batch.headings, batch.scared = each
        batch.food_taken = _taken(rules, len(rules.maze.food), [state.food for state in states])
        batch.pills_taken = _taken(rules, len(rules.maze.pills), [state.pills for state in states])
        batch.food_left = (batch.food_taken == 0).sum(axis=1)
        return batch

    def __len__(self) -> int:
        """Return the number of games."""
        return len(self.pacman)

    @property
    def over(self) -> Flags:
        """(N,) whether each game is over."""
        done: Flags = (self.food_left == 0) | (self.lives == 0)
        return done

    def states(self) -> list[PacManState]:
        """Return the state of every game."""
        ghosts = np.stack((self.ghosts, self.headings, self.scared), axis=2).swapaxes(0, 1)
        fruit_at = np.where(self.fruit > 0, self.fruit_at, NO_CELL)
        parts = (self.fruit, fruit_at, self.lives, self.score, self.ate)
        return [
            PacManState(pacman, tuple(Ghost(*ghost) for ghost in row), food, pills, *rest)
            for pacman, row, food, pills, rest in zip(
                self.pacman.tolist(),
                ghosts.tolist(),
                _get_bits(self.food_taken),
                _get_bits(self.pills_taken),
                zip(*(part.tolist() for part in parts)),
            )
        ]

    def take(self, games: NDArray[Any]) -> 'PacManBatch':
        """Return copies of chosen games: their indices (M,), in any order and number."""
        chosen = PacManBatch.__new__(PacManBatch)
        chosen.rules, chosen.tables = self.rules, self.tables
        for name in PacManBatch.__annotations__:
            value = getattr(self, name)
            setattr(chosen, name, value[:, games] if name in OF_GHOSTS else value[games])
        return chosen

    def put(self, games: NDArray[Any], source: 'PacManBatch') -> None:
        """Set chosen games, by their indices (M,), each once, to the M games of another batch."""
        for name in PacManBatch.__annotations__:
            at = (slice(None), games) if name in OF_GHOSTS else games
            getattr(self, name)[at] = getattr(source, name)

    def restart(self, games: NDArray[Any]) -> None:
        """Begin chosen games again, by their indices (M,)."""
        if len(games):
            self.put(games, PacManBatch(self.rules, len(games)))

    def draws(self, rng: np.random.Generator) -> Ints:
        """Return the random draws of one step, (G, N)."""
        return rng.integers(DRAWS, size=self.ghosts.shape, dtype=np.uint8).astype(np.intp)

    def step(self, moves: NDArray[np.integer], draws: NDArray[np.integer]) -> Ints:
        """
        Take one step in every game that is not over.

        :param moves: (N,) of Pac-Man, 0..3.
        :param draws: (G, N) from ``draws``.
        :return: (N,) points earned.
        """
        live, before = ~self.over, self.score.copy()
        pacman, ghosts = self.pacman, self.ghosts
        self.pacman = self.tables.step[pacman * 5 + np.where(live, moves, STAY)]
        self.move_ghosts(pacman, live, draws)
        self.ate *= ~live
        self._eat(live)
        met: Flags = self.ghosts == self.pacman
        met |= (self.ghosts == pacman) & (ghosts == self.pacman)
        met &= live
        self._meet(met)
        self.scared -= (self.scared > 0) & live
        self.fruit -= (self.fruit > 0) & live
        return self.score - before

    def _meet(self, met: Flags) -> None:
        """Eat scared ghosts among those that Pac-Man meets (G, N); take lives for others."""
        games = np.flatnonzero(met.any(axis=0))
        if not games.size:
            return
        met = met[:, games]
        prey = met & (self.scared[:, games] > 0)
        caught = (met & ~prey).any(axis=0) & (self.food_left[games] > 0)
        eaten = prey.sum(axis=0)
        self.score[games] += GHOST_POINTS * eaten
        self.ate[games] |= np.where(eaten, ATE_GHOST, 0)
        self._send_home(games, prey | caught)
        lost = games[caught]
        self.pacman[lost] = self.rules.maze.start
        self.lives[lost] -= 1

    def _send_home(self, games: Ints, which: Flags) -> None:
        """Move ghosts (G, M) of some games (M,) to their first cells."""
        ghost, at = which.nonzero()
        self.ghosts[ghost, games[at]] = self.tables.homes[ghost, 0]
        self.headings[ghost, games[at]] = STAY
        self.scared[ghost, games[at]] = 0

    def _eat(self, live: Flags) -> None:
        """Eat the food, pill or fruit in Pac-Man's cell."""
        at_fruit: Flags = (self.pacman == self.fruit_at) & (self.fruit > 0) & live
        if at_fruit.any():
            self._eat_fruit(at_fruit.nonzero()[0])
        fed = self._take(self.food_taken, self.tables.food_at, live)
        self.food_left -= fed
        self.score += FOOD_POINTS * fed
        self.ate |= ATE_FOOD * fed
        for after in FRUIT_AFTER:
            left = len(self.rules.maze.food) - after
            reached: Flags = fed & (self.food_left == left)
            if left > 0 and reached.any():
                self._lay_fruit(reached.nonzero()[0])
        games = self._take(self.pills_taken, self.tables.pill_at, live).nonzero()[0]
        if not games.size:
            return
        self.score[games] += PILL_POINTS
        self.ate[games] |= ATE_PILL
        self.scared[:, games] = SCARED_STEPS + 1
        self.headings[:, games] = STAY

    def _lay_fruit(self, games: Ints) -> None:
        """Lay fruit on the food that is left nearest to the middle."""
        maze = self.rules.maze
        there = self.food_taken[games][:, maze.from_middle] == 0
        cells = np.array(maze.food)[list(maze.from_middle)]
        self.fruit_at[games] = cells[there.argmax(axis=1)]
        self.fruit[games] = FRUIT_STEPS + 1  # one is counted down in this step

    def _eat_fruit(self, games: Ints) -> None:
        self.fruit[games] = 0
        self.score[games] += FRUIT_POINTS
        self.ate[games] |= ATE_FRUIT

    def _take(self, taken: Taken, number_at: Ints, live: Flags) -> Flags:
        """Take the food or pill in Pac-Man's cell; return (N,) whether there was one."""
        width = taken.shape[1]
        place = number_at[self.pacman]
        place += np.arange(0, taken.size, width)
        flat = taken.reshape(-1)
        found: Flags = (flat[place] == 0) & live
        flat[place[found]] = self.rules.paths.far
        return found

    def move_ghosts(self, pacman: Ints, live: Flags, draws: NDArray[np.integer]) -> None:
        """Move the ghosts in reaction to Pac-Man's cell before the step."""
        tables, count = self.tables, len(self.rules.maze.cells)
        where = self.ghosts * 5 + self.headings
        masks = tables.allowed[where]
        if self.rules.chase_draws:
            ghost, game = (draws < self.rules.chase_draws).nonzero()
            masks[ghost, game] = tables.towards[where[ghost, game] * count + pacman[game]]
        ghost, game = self.scared.nonzero()
        if ghost.size:
            masks[ghost, game] = tables.away[where[ghost, game] * count + pacman[game]]
        move = tables.picks[masks * np.intp(DRAWS) + draws]
        moving = live & (self.scared & 1 == 0)
        np.copyto(self.headings, move, where=moving)
        self.ghosts = tables.step[self.ghosts * 5 + np.where(moving, move, STAY)]


def _taken(rules: Rules, count: int, masks: Sequence[int]) -> Taken:
    """Return (N, count + 1): the marks of taken things, from the masks of those that are left."""
    far, width = rules.paths.far, (count + 7) // 8
    packed = np.frombuffer(b''.join(m.to_bytes(width, 'little') for m in masks), dtype=np.uint8)
    bits = np.unpackbits(packed.reshape(len(masks), width), axis=1, bitorder='little')
    taken = np.full((len(masks), count + 1), far - 1, dtype=rules.paths.distance.dtype)
    taken[:, :count] = np.where(bits[:, :count], 0, far)
    return taken


def _get_bits(taken: Taken) -> list[int]:
    packed = np.packbits(taken[:, :-1] == 0, axis=1, bitorder='little')
    return [int.from_bytes(row.tobytes(), 'little') for row in packed]
