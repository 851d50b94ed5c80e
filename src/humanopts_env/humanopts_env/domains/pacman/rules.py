"""
Pac-Man's rules, one game at a time; ``batch`` plays many at once by the same rules.

A step, in this order:

1. Pac-Man and the ghosts move at once; ghosts go by where he was. A move into a wall goes nowhere.
2. Pac-Man eats what is in his cell.
3. He meets the ghosts that are now in his cell, or have changed places with him. He eats the
   scared ones; they are home at once, and dangerous. A dangerous one costs him a life, unless the
   last food was just eaten: everyone goes back to where the maze put them; the rest stays.
4. Fear and fruit are one step nearer to their end.

A pill scares all ghosts for 40 steps. They may turn back once, then move away from Pac-Man, at
half speed: while the steps that are left to them are even. After the 30th and the 65th food, fruit
is for 60 steps where food is left that is nearest to the middle.

All chance is in one draw for each ghost and step, a whole number below DRAWS, whether it moves or
not. A chasing ghost goes a shortest way towards Pac-Man with draws below CHASE_DRAWS, else as a
random one. Where k moves are equally good, the draw picks among them with equal shares.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

from humanopts_env.domains.pacman.maze import Maze
from humanopts_env.domains.pacman.paths import HAS_MOVE, maze_paths, Paths, STAY
from humanopts_env.domains.pacman.state import (
    FRUIT_STEPS,
    Ghost,
    NO_CELL,
    PacManState,
    SCARED_STEPS,
)
from humanopts_env.domains.tabular import read_only
import numpy as np
from numpy.typing import NDArray

FOOD_POINTS, PILL_POINTS, FRUIT_POINTS, GHOST_POINTS = 10, 50, 100, 200
ATE_FOOD, ATE_PILL, ATE_FRUIT, ATE_GHOST = 1, 2, 4, 8  # bits of PacManState.ate
FRUIT_AFTER = (30, 65)  # food eaten
DRAWS, CHASE_DRAWS = 60, 48  # 48 / 60 = 0.8; both, and their difference, divide by 1 to 4
GHOST_RULES = ('random', 'chase')


def _picks() -> NDArray[np.uint8]:
    """Return (16, 60): the move that a draw picks from a mask."""
    picks = np.full((16, DRAWS), STAY, dtype=np.uint8)
    for mask in range(1, 16):
        moves = np.flatnonzero(HAS_MOVE[mask])
        chased = moves[np.arange(CHASE_DRAWS) * len(moves) // CHASE_DRAWS]
        rest = DRAWS - CHASE_DRAWS
        picks[mask] = [*chased, *moves[np.arange(rest) * len(moves) // rest]]
    return read_only(picks)


PICKS = _picks()


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

    @property
    def chase_draws(self) -> int:
        """Draws below this make a dangerous ghost chase."""
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

    def is_over(self, state: PacManState) -> bool:
        """Tell whether the maze is cleared of food, or the last life lost."""
        return state.food == 0 or state.lives == 0

    def advance(self, state: PacManState, move: int, draws: Sequence[int]) -> PacManState:
        """
        Take one step from a state that is not over; the points are the difference in score.

        :param draws: (G,) one number below DRAWS for each ghost.
        """
        pacman = int(self.paths.step[state.pacman, move])
        moved = map(self._move, state.ghosts, [state.pacman] * len(draws), draws)
        fed = replace(state, pacman=pacman, ghosts=tuple(moved), ate=0)
        for eat in (self._eat_fruit, self._eat_food, self._eat_pill):
            fed = eat(fed)
        met, caught = self._meet(state, fed)
        return self._lose(met) if caught and met.food else _count_down(met)

    def can_follow(self, state: PacManState, move: int, successor: PacManState) -> bool:
        """Tell whether some draws lead from a state that is not over to another."""
        choices = [
            {self._move(ghost, state.pacman, draw): draw for draw in range(DRAWS)}.values()
            for ghost in state.ghosts
        ]
        return any(self.advance(state, move, draws) == successor for draws in product(*choices))

    def _meet(self, before: PacManState, state: PacManState) -> tuple[PacManState, bool]:
        """Eat the scared ghosts that Pac-Man meets, and tell whether he meets a dangerous one."""
        here = [
            ghost.cell == state.pacman
            or (ghost.cell == before.pacman and was.cell == state.pacman)
            for was, ghost in zip(before.ghosts, state.ghosts)
        ]
        prey = [met and ghost.scared > 0 for met, ghost in zip(here, state.ghosts)]
        ghosts = tuple(
            Ghost(home) if eaten else ghost
            for eaten, ghost, home in zip(prey, state.ghosts, self.maze.homes)
        )
        score = state.score + GHOST_POINTS * sum(prey)
        ate = state.ate | (ATE_GHOST if any(prey) else 0)
        return replace(state, ghosts=ghosts, score=score, ate=ate), here != prey

    def _lose(self, state: PacManState) -> PacManState:
        """Take a life, and put everyone back."""
        ghosts = tuple(Ghost(home) for home in self.maze.homes)
        lost = replace(state, pacman=self.maze.start, ghosts=ghosts, lives=state.lives - 1)
        return _count_down(lost)

    def _eat_fruit(self, state: PacManState) -> PacManState:
        if state.pacman != state.fruit_at:
            return state
        score, ate = state.score + FRUIT_POINTS, state.ate | ATE_FRUIT
        return replace(state, fruit=0, fruit_at=NO_CELL, score=score, ate=ate)

    def _eat_food(self, state: PacManState) -> PacManState:
        maze = self.maze
        food = state.food & ~_bit(maze.food, state.pacman)
        if food == state.food:
            return state
        score, ate = state.score + FOOD_POINTS, state.ate | ATE_FOOD
        fed = replace(state, food=food, score=score, ate=ate)
        if not food or len(maze.food) - food.bit_count() not in FRUIT_AFTER:
            return fed
        middle = next(k for k in maze.from_middle if food >> k & 1)
        return replace(
            fed, fruit=FRUIT_STEPS + 1, fruit_at=maze.food[middle]
        )  # one is counted now

    def _eat_pill(self, state: PacManState) -> PacManState:
        pills = state.pills & ~_bit(self.maze.pills, state.pacman)
        if pills == state.pills:
            return state
        score, ate = state.score + PILL_POINTS, state.ate | ATE_PILL
        ghosts = tuple(Ghost(ghost.cell, STAY, SCARED_STEPS + 1) for ghost in state.ghosts)
        return replace(state, pills=pills, ghosts=ghosts, score=score, ate=ate)

    def _move(self, ghost: Ghost, pacman: int, draw: int) -> Ghost:
        """Move one ghost, or let it hold still."""
        where = (ghost.cell, ghost.heading)
        if ghost.scared % 2:
            return ghost
        if ghost.scared:
            mask = self.paths.away[(*where, pacman)]
        elif draw < self.chase_draws:
            mask = self.paths.towards[(*where, pacman)]
        else:
            mask = self.paths.allowed[where]
        move = int(PICKS[mask, draw])
        return replace(ghost, cell=int(self.paths.step[ghost.cell, move]), heading=move)


def _count_down(state: PacManState) -> PacManState:
    """Bring fear and fruit one step nearer to their end."""
    ghosts = tuple(replace(ghost, scared=max(ghost.scared - 1, 0)) for ghost in state.ghosts)
    fruit = max(state.fruit - 1, 0)
    return replace(
        state, ghosts=ghosts, fruit=fruit, fruit_at=state.fruit_at if fruit else NO_CELL
    )


def _bit(cells: tuple[int, ...], cell: int) -> int:
    """Return the mask of a cell in a list of cells; 0 where it is not in it."""
    return 1 << cells.index(cell) if cell in cells else 0
