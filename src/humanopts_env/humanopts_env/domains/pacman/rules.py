"""
Pac-Man's rules, one game at a time; ``batch`` plays many at once by the same rules.

A step, in this order:

1. Pac-Man moves; into a wall he stays. He meets the ghosts in his cell.
2. Unless that cost a life, he eats what is in his cell. With the last food the game is won.
3. Ghosts move: dangerous ones at every step, scared ones when the steps that are left to them are
   even. They meet Pac-Man if they come to his cell. Since he moves first, nobody slips past.

Meeting a scared ghost eats it: it is home at once, and dangerous. Meeting a dangerous one costs a
life, and everyone goes back to where the maze put them; food, pills and fruit stay.

A pill scares all ghosts: they hold still for the step in which it is eaten, may then turn, and
move away from Pac-Man for 40 steps. Fruit is there for 60 steps after the 30th and the 65th food.

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
from humanopts_env.domains.pacman.state import FRUIT_STEPS, Ghost, PacManState, SCARED_STEPS
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
        fed, done = self._move_pacman(state, move)
        return fed if done else self._move_ghosts(fed, draws)

    def can_follow(self, state: PacManState, move: int, successor: PacManState) -> bool:
        """Tell whether some draws lead from a state that is not over to another."""
        fed, done = self._move_pacman(state, move)
        if done:
            return fed == successor
        choices = [
            {self._move(ghost, fed.pacman, draw): draw for draw in range(DRAWS)}.values()
            for ghost in fed.ghosts
        ]
        return any(self._move_ghosts(fed, draws) == successor for draws in product(*choices))

    def _move_pacman(self, state: PacManState, move: int) -> tuple[PacManState, bool]:
        """Do parts 1 and 2 of a step, and tell whether it is done with that."""
        pacman = int(self.paths.step[state.pacman, move])
        moved = replace(state, pacman=pacman, fruit=max(state.fruit - 1, 0), ate=0)
        met, caught = self._meet(moved)
        if caught:
            return self._lose(met), True
        fed = self._eat(met, fruit_here=state.fruit > 0 and pacman == self.maze.fruit)
        return fed, not fed.food

    def _move_ghosts(self, state: PacManState, draws: Sequence[int]) -> PacManState:
        """Do part 3 of a step."""
        pacman = [state.pacman] * len(draws)
        moved = replace(state, ghosts=tuple(map(self._move, state.ghosts, pacman, draws)))
        met, caught = self._meet(moved)
        return self._lose(met) if caught else met

    def _meet(self, state: PacManState) -> tuple[PacManState, bool]:
        """Eat the scared ghosts in Pac-Man's cell, and tell whether a dangerous one is there."""
        here = [ghost.cell == state.pacman for ghost in state.ghosts]
        prey = [met and ghost.scared > 0 for met, ghost in zip(here, state.ghosts)]
        caught = any(met and not eaten for met, eaten in zip(here, prey))
        if not any(prey):
            return state, caught
        ghosts = tuple(
            Ghost(home) if eaten else ghost
            for eaten, ghost, home in zip(prey, state.ghosts, self.maze.homes)
        )
        score = state.score + GHOST_POINTS * sum(prey)
        return replace(state, ghosts=ghosts, score=score, ate=state.ate | ATE_GHOST), caught

    def _lose(self, state: PacManState) -> PacManState:
        """Take a life, and put everyone back."""
        ghosts = tuple(Ghost(home) for home in self.maze.homes)
        return replace(state, pacman=self.maze.start, ghosts=ghosts, lives=state.lives - 1)

    def _eat(self, state: PacManState, *, fruit_here: bool) -> PacManState:
        """Eat what is in Pac-Man's cell."""
        maze = self.maze
        food, pills, fruit, ghosts = state.food, state.pills, state.fruit, state.ghosts
        score, ate = state.score, state.ate
        if fruit_here:
            fruit, score, ate = 0, score + FRUIT_POINTS, ate | ATE_FRUIT
        food &= ~_bit(maze.food, state.pacman)
        if food != state.food:
            score, ate = score + FOOD_POINTS, ate | ATE_FOOD
            if len(maze.food) - food.bit_count() in FRUIT_AFTER:
                fruit = FRUIT_STEPS
        pills &= ~_bit(maze.pills, state.pacman)
        if pills != state.pills:
            score, ate = score + PILL_POINTS, ate | ATE_PILL
            ghosts = tuple(Ghost(ghost.cell, STAY, SCARED_STEPS + 1) for ghost in ghosts)
        return replace(
            state, food=food, pills=pills, fruit=fruit, ghosts=ghosts, score=score, ate=ate
        )

    def _move(self, ghost: Ghost, pacman: int, draw: int) -> Ghost:
        """Move one ghost, or let it hold still, and count its fear down."""
        scared = max(ghost.scared - 1, 0)
        if ghost.scared % 2:
            return replace(ghost, scared=scared)
        where = (ghost.cell, ghost.heading)
        if ghost.scared:
            mask = self.paths.away[(*where, pacman)]
        elif draw < self.chase_draws:
            mask = self.paths.towards[(*where, pacman)]
        else:
            mask = self.paths.allowed[where]
        move = int(PICKS[mask, draw])
        return Ghost(int(self.paths.step[ghost.cell, move]), move, scared)


def _bit(cells: tuple[int, ...], cell: int) -> int:
    """Return the mask of a cell in a list of cells; 0 where it is not in it."""
    return 1 << cells.index(cell) if cell in cells else 0
