"""
Pac-Man's rules, for many games at once; one game is a batch of one.

Order of events in a step:

1. Pac-Man and the ghosts move at the same time; the ghosts react to his cell before the move. A
   move into a wall has no effect.
2. Pac-Man eats food, a pill or fruit in his cell.
3. He meets the ghosts that are now in his cell or have swapped cells with him. He eats the scared
   ones; they are immediately home and dangerous again. A dangerous ghost costs him a life, unless
   he has just eaten the last food: Pac-Man and all ghosts return to their start cells; food, pills
   and fruit stay.
4. The times of scared ghosts and of fruit decrease by one step.

A pill scares all ghosts for 40 steps. They may turn back once, then move away from Pac-Man at half
speed: in steps with an even remaining time. After the 30th and the 65th food, fruit appears in the
cell of the remaining food nearest to the middle, for 60 steps.

The only randomness is one draw per ghost and step, a whole number below DRAWS, whether the ghost
moves or not. A chasing ghost follows a shortest path towards Pac-Man with draws below CHASE_DRAWS,
and otherwise moves like a random one. If k moves are equally good, the draw selects each of them
with equal probability.

Axes: N games, G ghosts, C cells, K food, P pills. There is one array per part of the state. Rare
events (meeting a ghost, eating a pill, fruit) are computed only in the games where they happen.
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

Keys = NDArray[np.unsignedinteger]

FOOD_POINTS, PILL_POINTS, FRUIT_POINTS, GHOST_POINTS = 10, 50, 100, 200
ATE_FOOD, ATE_PILL, ATE_FRUIT, ATE_GHOST = 1, 2, 4, 8  # bits of PacManState.ate
FRUIT_AFTER = (30, 65)  # amounts of food eaten
DRAWS, CHASE_DRAWS = 60, 48  # 48 / 60 = 0.8; both and their difference are divisible by 1 to 4
GHOST_RULES = ('random', 'chase')
ONE_GAME = np.zeros(1, dtype=np.intp)


def _picks() -> NDArray[np.uint8]:
    """Return the move selected from a mask by a draw, (16, DRAWS)."""
    picks = np.full((16, DRAWS), STAY, dtype=np.uint8)
    for mask in range(1, 16):
        moves = np.flatnonzero(HAS_MOVE[mask])
        chased = moves[np.arange(CHASE_DRAWS) * len(moves) // CHASE_DRAWS]
        rest = DRAWS - CHASE_DRAWS
        picks[mask] = [*chased, *moves[np.arange(rest) * len(moves) // rest]]
    return read_only(picks)


PICKS = _picks()


class Tables:
    """The maze as flat read-only arrays, so that each quantity is one look-up."""

    def __init__(self, maze: Maze, paths: Paths) -> None:
        food, pills = len(maze.food), len(maze.pills)
        left = np.arange(food + 1)
        self.step = paths.step.ravel()  # (C * 5,) cell after a move
        self.allowed = paths.allowed.ravel()  # (C * 5,) moves of a ghost by cell and heading
        self.towards = paths.towards.ravel()  # (C * 5 * C,) also by Pac-Man's cell
        self.away = paths.away.ravel()
        self.picks = PICKS.astype(np.intp).ravel()  # (16 * DRAWS,) move by mask and draw
        # (C,) index in ``PacManBatch.taken`` of the food or pill in a cell; K: none
        self.item_at = np.full(len(maze.cells), food, dtype=np.intp)
        self.item_at[list(maze.food)] = range(food)
        self.item_at[list(maze.pills)] = range(food + 1, food + 1 + pills)
        self.is_food = self.item_at < food  # (C,) whether there is food in a cell
        # (K + 1,) whether fruit appears, by amount of food left
        self.lays_fruit = np.isin(food - left, FRUIT_AFTER) & (left > 0)
        # (K,) food by its distance from the middle, and its cells
        self.from_middle = np.array(maze.from_middle, dtype=np.intp)
        self.middle_cells = np.array(maze.food, dtype=np.intp)[self.from_middle]
        # A key is a distance and, in its lowest bits, the number of a food or pill, so that the
        # smallest key gives both for the nearest one. (C, K + 1) and (C, P + 1) keys by cell
        self.low_bits = (max(food, pills) + 1).bit_length()
        self.low = (1 << self.low_bits) - 1  # all of these bits
        small = np.iinfo(np.uint16).max >> self.low_bits >= paths.far
        kind: Any = np.uint16 if small else np.uint32
        keys = np.pad(paths.distance.astype(kind) << self.low_bits, ((0, 0), (0, 1)))
        self.food, self.pills = (
            keys[:, [*cells, -1]] | np.append(np.arange(len(cells), dtype=kind), kind(0))
            for cells in (maze.food, maze.pills)
        )
        # (K + P + 2,) marks of a game with nothing left
        self.all_taken = np.full(food + pills + 2, np.iinfo(kind).max, dtype=kind)
        self.nothing = self.all_taken[0] >> self.low_bits << self.low_bits  # above all keys
        self.all_taken[[food, -1]] = self.nothing | food, self.nothing | pills
        self.homes = np.array(maze.homes, dtype=np.intp)  # (G,)
        for table in vars(self).values():
            if isinstance(table, np.ndarray):
                table.setflags(write=False)


@dataclass(frozen=True)
class Rules:
    """One maze and the behaviour of its ghosts."""

    maze: Maze
    ghosts: str = 'random'  # one of GHOST_RULES
    lives: int = 3

    @cached_property
    def paths(self) -> Paths:
        """Moves and shortest paths of the maze."""
        return maze_paths(self.maze)

    @cached_property
    def tables(self) -> Tables:
        """The tables of the maze for steps of many games."""
        return Tables(self.maze, self.paths)

    @property
    def chase_draws(self) -> int:
        """The threshold below which a draw makes a dangerous ghost chase."""
        return CHASE_DRAWS if self.ghosts == 'chase' else 0

    def start(self) -> PacManState:
        """Return the first state of every game."""
        maze = self.maze
        return PacManState(
            pacman=maze.start,
            ghosts=tuple(Ghost(home) for home in maze.homes),
            food=(1 << len(maze.food)) - 1,
            pills=(1 << len(maze.pills)) - 1,
            fruit=0,
            fruit_at=NO_CELL,
            lives=self.lives,
            score=0,
            ate=0,
        )

    @cached_property
    def first_game(self) -> 'PacManBatch':
        """A batch of one new game, which must not be changed."""
        return PacManBatch.from_states(self, [self.start()])

    def is_over(self, state: PacManState) -> bool:
        """Return whether all food is eaten or the last life is lost."""
        return state.food == 0 or state.lives == 0

    def draws(self, rng: np.random.Generator) -> list[int]:
        """Draw the random numbers for one step of one game, (G,)."""
        return [int(rng.integers(DRAWS)) for _ in self.maze.homes]

    def batch_draws(self, rng: np.random.Generator, count: int) -> Ints:
        """Draw the random numbers for one step of N games, (G, N)."""
        shape = len(self.maze.homes), count
        return rng.integers(DRAWS, size=shape, dtype=np.uint8).astype(np.intp)

    def advance(self, state: PacManState, move: int, draws: Sequence[int]) -> PacManState:
        """
        Take one step from a state that is not over; the points are the difference in score.

        :param draws: (G,) one number below DRAWS per ghost.
        """
        game = self.game_at(state).take(ONE_GAME)
        game.step(np.array([move]), np.array([draws], dtype=np.intp).T)
        after = game.states()[0]
        self._latest[:] = [(after, game)]
        return after

    def game_at(self, state: PacManState) -> 'PacManBatch':
        """Return a batch of one game in a state, which must not be changed."""
        for after, game in self._latest:
            if after is state:
                return game
        return PacManBatch.from_states(self, [state])

    @cached_property
    def _latest(self) -> list[tuple[PacManState, 'PacManBatch']]:
        """The result of the latest ``advance``, kept because building its batch is slow."""
        return []

    def can_follow(self, state: PacManState, move: int, successor: PacManState) -> bool:
        """Return whether some draws lead from a state that is not over to another."""
        now = self.game_at(state)
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

    Taken food and pills are marked with the largest number, others with 0, so that a bitwise or
    with the keys of ``Tables`` keeps only the keys of remaining items. Both have an additional
    entry for cells without an item: its mark lies between the keys and the largest number, and its
    lowest bits are the entry's own number.

    All arrays are views of ``numbers`` and ``taken``, and change in place.

    :ivar pacman: (N,) cells.
    :ivar ghosts: (G, N) cells.
    :ivar headings: (G, N) last moves; STAY: none.
    :ivar scared: (G, N) remaining scared steps of each ghost.
    :ivar timers: (G + 1, N) ``scared`` and ``fruit``, which decrease by one per step.
    :ivar food_taken: (N, K + 1) marks of food.
    :ivar pills_taken: (N, P + 1) marks of pills.
    :ivar food_left: (N,) number of food left.
    :ivar fruit: (N,) remaining steps of the fruit.
    :ivar fruit_at: (N,) cell of the fruit; undefined without fruit.
    :ivar lives: (N,) remaining lives.
    :ivar score: (N,) points.
    :ivar ate: (N,) masks of the last step's meals.
    """

    def __init__(self, rules: Rules, numbers: Ints, taken: Keys) -> None:
        """
        Take ownership of the arrays of games, which are modified in place.

        :param numbers: (7 + 3 * G, N) pacman, food_left, fruit_at, lives, score, ate; then G rows
            each of ghosts, headings and scared; then fruit.
        :param taken: (N, K + P + 2) ``food_taken``, then ``pills_taken``.
        """
        self.rules, self.tables = rules, rules.tables
        self.numbers, self.taken = numbers, taken
        groups, food = len(rules.maze.homes), len(rules.maze.food)
        self.pacman, self.food_left, self.fruit_at, self.lives, self.score, self.ate = numbers[:6]
        self.ghosts = numbers[6 : 6 + groups]
        self.headings = numbers[6 + groups : 6 + 2 * groups]
        self.timers = numbers[6 + 2 * groups :]
        self.scared, self.fruit = self.timers[:groups], self.timers[groups]
        self.food_taken, self.pills_taken = taken[:, : food + 1], taken[:, food + 1 :]

    @classmethod
    def begin(cls, rules: Rules, count: int = 1) -> 'PacManBatch':
        """
        Start new games.

        :param count: number of games, N.
        """
        return rules.first_game.take(np.zeros(count, dtype=np.intp))

    @classmethod
    def from_states(cls, rules: Rules, states: Sequence[PacManState]) -> 'PacManBatch':
        """Return games in given states."""
        count, food = len(states), len(rules.maze.food)
        rows = [
            (
                *(s.pacman, s.food.bit_count(), s.fruit_at, s.lives, s.score, s.ate),
                *[ghost.cell for ghost in s.ghosts],
                *[ghost.heading for ghost in s.ghosts],
                *[ghost.scared for ghost in s.ghosts],
                s.fruit,
            )
            for s in states
        ]
        numbers = np.array(rows, dtype=np.intp).reshape(count, 7 + 3 * len(rules.maze.homes))
        all_taken = rules.tables.all_taken
        width = (len(all_taken) + 7) // 8
        masks = [(s.food | s.pills << food + 1).to_bytes(width, 'little') for s in states]
        packed = np.frombuffer(b''.join(masks), dtype=np.uint8).reshape(count, width)
        left = np.unpackbits(packed, axis=1, count=len(all_taken), bitorder='little')
        return cls(rules, numbers.T.copy(), np.where(left, all_taken.dtype.type(0), all_taken))

    def __len__(self) -> int:
        return len(self.pacman)

    @property
    def over(self) -> Flags:
        """Whether each game is over, (N,)."""
        done: Flags = ~np.logical_and(self.food_left, self.lives)
        return done

    def states(self) -> list[PacManState]:
        """Return the state of every game."""
        groups, food = self.ghosts.shape[0], len(self.rules.maze.food)
        packed = np.packbits(self.taken == 0, axis=1, bitorder='little')
        states = []
        for row, bits in zip(self.numbers.T.tolist(), packed):
            pacman, _, fruit_at, lives, score, ate, *ghosts, fruit = row
            each = zip(ghosts[:groups], ghosts[groups : 2 * groups], ghosts[2 * groups :])
            left = int.from_bytes(bits.tobytes(), 'little')
            states.append(
                PacManState(
                    pacman=pacman,
                    ghosts=tuple(Ghost(*ghost) for ghost in each),
                    food=left & (1 << food) - 1,
                    pills=left >> food + 1,
                    fruit=fruit,
                    fruit_at=fruit_at if fruit else NO_CELL,
                    lives=lives,
                    score=score,
                    ate=ate,
                )
            )
        return states

    def take(self, games: NDArray[Any]) -> 'PacManBatch':
        """Return copies of the games with indices (M,), in any order, possibly repeated."""
        taken = self.taken.take(games, axis=0)
        return PacManBatch(self.rules, self.numbers.take(games, axis=1), taken)

    def after(self, first: int) -> 'PacManBatch':
        """Return a view of the games starting with number ``first``."""
        return PacManBatch(self.rules, self.numbers[:, first:], self.taken[first:])

    def restart(self, games: NDArray[Any]) -> None:
        """Restart the games with indices (M,)."""
        self.numbers[:, games] = self.rules.first_game.numbers
        self.taken[games] = self.rules.first_game.taken

    def draws(self, rng: np.random.Generator) -> Ints:
        """Return the random draws of one step, (G, N)."""
        return self.rules.batch_draws(rng, len(self))

    def step(self, moves: NDArray[np.integer], draws: NDArray[np.integer]) -> Ints:
        """
        Take one step in every game that is not over.

        :param moves: (N,) moves of Pac-Man, 0..3.
        :param draws: (G, N) result of ``draws``.
        :return: (N,) points earned.
        """
        live = ~self.over
        score, pacman, ghosts = self.score.copy(), self.pacman.copy(), self.ghosts.copy()
        np.copyto(self.pacman, self.tables.step.take(pacman * 5 + moves), where=live)
        self.move_ghosts(pacman, live, draws)
        np.copyto(self.ate, 0, where=live)
        self._eat(live)
        met: Flags = self.ghosts == self.pacman
        met |= (self.ghosts == pacman) & (ghosts == self.pacman)
        met &= live
        self._meet(met)
        self.timers -= (self.timers > 0) & live
        points: Ints = self.score - score
        return points

    def _meet(self, met: Flags) -> None:
        """Eat the scared ghosts that Pac-Man meets, (G, N); others cost a life."""
        if not met.any():
            return
        games = np.flatnonzero(met.any(axis=0))
        met = met[:, games]
        prey = met & (self.scared[:, games] > 0)
        caught = (met & ~prey).any(axis=0) & (self.food_left[games] > 0)
        eaten = prey.sum(axis=0)
        self.score[games] += GHOST_POINTS * eaten
        self.ate[games] |= np.where(eaten, ATE_GHOST, 0)
        ghost, at = (prey | caught).nonzero()
        home = ghost, games[at]
        self.ghosts[home], self.headings[home] = self.tables.homes[ghost], STAY
        self.scared[home] = 0
        lost = games[caught]
        self.pacman[lost] = self.rules.maze.start
        self.lives[lost] -= 1

    def _eat(self, live: Flags) -> None:
        """Eat the food, pill or fruit in Pac-Man's cell."""
        at_fruit = ((self.pacman == self.fruit_at) & (self.fruit > 0) & live).nonzero()[0]
        if at_fruit.size:
            self.fruit[at_fruit] = 0
            self.score[at_fruit] += FRUIT_POINTS
            self.ate[at_fruit] |= ATE_FRUIT
        item = self.tables.item_at.take(self.pacman)
        item += np.arange(0, self.taken.size, self.taken.shape[1])
        taken = self.taken.reshape(-1)
        games = ((taken.take(item) == 0) & live).nonzero()[0]
        if games.size:
            taken[item[games]] = np.iinfo(taken.dtype).max
            food = self.tables.is_food.take(self.pacman.take(games))
            self._eat_food(games[food])
            pill = games[~food]
            self.score[pill] += PILL_POINTS
            self.ate[pill] |= ATE_PILL
            self.scared[:, pill] = SCARED_STEPS + 1
            self.headings[:, pill] = STAY

    def _eat_food(self, games: Ints) -> None:
        """Eat food; at certain amounts left, put fruit on the food nearest to the middle."""
        tables = self.tables
        self.food_left[games] -= 1
        self.score[games] += FOOD_POINTS
        self.ate[games] |= ATE_FOOD
        reached = games[tables.lays_fruit[self.food_left[games]]]
        if reached.size:
            there = self.taken.take(reached, axis=0).take(tables.from_middle, axis=1) == 0
            self.fruit_at[reached] = tables.middle_cells.take(there.argmax(axis=1))
            self.fruit[reached] = FRUIT_STEPS + 1  # this step already counts down by one

    def move_ghosts(self, pacman: Ints, live: Flags, draws: NDArray[np.integer]) -> None:
        """Move the ghosts in reaction to Pac-Man's cell before the step."""
        tables, count = self.tables, len(self.rules.maze.cells)
        cells = self.ghosts * 5
        where = cells + self.headings
        masks = tables.allowed.take(where)
        if self.rules.chase_draws:
            ghost, game = (draws < self.rules.chase_draws).nonzero()
            masks[ghost, game] = tables.towards[where[ghost, game] * count + pacman[game]]
        ghost, game = self.scared.nonzero()
        moving = live
        if ghost.size:
            masks[ghost, game] = tables.away[where[ghost, game] * count + pacman[game]]
            moving = live & (self.scared & 1 == 0)
        move = tables.picks.take(np.multiply(masks, DRAWS, dtype=np.intp) + draws)
        np.copyto(self.headings, move, where=moving)
        np.copyto(self.ghosts, tables.step.take(cells + move), where=moving)
