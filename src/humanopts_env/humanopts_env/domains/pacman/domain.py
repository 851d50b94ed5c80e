"""
Pac-Man as a domain.

Subramanian, Isbell and Thomaz (2011), section 3: a maze, food, two power pills, two ghosts, fruit
and three lives. The rules are in ``rules``.
"""

from collections.abc import Collection, Mapping, Sequence

from humanopts_env.arrays import Floats, Rows
from humanopts_env.board import Board
from humanopts_env.domains.base import (
    Action,
    BoardSlice,
    check_choice,
    check_whole,
    Domain,
    DomainError,
    Feature,
    Outcome,
    Parameter,
    shown_values,
    Transitions,
)
from humanopts_env.domains.capabilities import (
    Baselines,
    move_effect,
    StepEffect,
    TeachingDefaults,
)
from humanopts_env.domains.pacman import state as notation
from humanopts_env.domains.pacman.baselines import pacman_baselines
from humanopts_env.domains.pacman.board import board_of_features, board_of_state, EXPLANATION
from humanopts_env.domains.pacman.features import (
    ALL,
    FEATURE_LISTS,
    FeatureReader,
    in_paper,
    pacman_features,
    pacman_groups,
)
from humanopts_env.domains.pacman.games import PacManGames, sample_games
from humanopts_env.domains.pacman.maze import load_maze, maze_names
from humanopts_env.domains.pacman.paths import HAS_MOVE, MOVES, STAY
from humanopts_env.domains.pacman.reference import (
    AVOID_GHOST,
    CLOSEST_FOOD,
    EAT_GHOST,
    NEAREST_PILL,
    TO_FRUIT,
)
from humanopts_env.domains.pacman.rules import FRUIT_AFTER, GHOST_RULES, PacManBatch, Rules
from humanopts_env.domains.pacman.state import eaten_names, PacManState
from humanopts_env.domains.search_space import plain_cell_name, plain_space, SearchSpace
import numpy as np
from numpy.typing import NDArray

KEYS = ('up', 'left', 'right', 'down')  # in the order of MOVES
MAX_LIVES, MAX_STEPS = 9, 1_000_000
# The options taught by the paper's participants (section 7), and one more.
DEMO_OPTIONS = (CLOSEST_FOOD, AVOID_GHOST, NEAREST_PILL, EAT_GHOST)
DEMO_OPTIONS_WITH_FRUIT = (*DEMO_OPTIONS, TO_FRUIT)
PRIMITIVE_COLUMNS = (  # for plans with primitive actions: nearby objects
    *('legal_moves', 'food_direction', 'food_distance:2,3,5,9'),
    *('danger_direction', 'danger_distance:2,3,4,5,7'),
    *('prey_direction', 'prey_distance:3,6,13', 'pill_direction', 'pill_distance:3,9'),
)
MEALS = {'food': 'food', 'power pill': 'a power pill', 'fruit': 'the fruit', 'ghost': 'a ghost'}


class PacMan(Domain[PacManState]):
    """
    Pac-Man in any maze, a ``Domain``.

    A move into a wall is allowed and has no effect.
    """

    def __init__(
        self,
        maze: str = 'gardens',
        ghosts: str = 'random',
        lives: int = 3,
        max_steps: int = 1000,
        features: str = ALL,
    ) -> None:
        """
        Create the game.

        :param maze: name of a maze in this package, path of a file in Berkeley's notation, or its
            text. ``parameters`` never contain a path, so that they give the same maze on another
            machine.
        :param ghosts: 'random': dangerous ghosts move at random; 'chase': they move towards
            Pac-Man with probability 0.8.
        :param lives: number of lives at the start, 1 to 9.
        :param max_steps: maximum number of steps per episode; longer ones are truncated.
        :param features: 'directions' for all features, or 'paper' for those named in the paper.
            ``parameters`` omits 'directions', the value for files and bags without it.
        :raises MazeError: the maze is unknown or cannot be played.
        :raises DomainError: another parameter is out of range.
        """
        if not isinstance(maze, str):
            raise DomainError(f'maze is {maze!r}, but must be text')
        check_choice('ghosts', ghosts, GHOST_RULES)
        check_choice('features', features, FEATURE_LISTS)
        check_whole('lives', lives, 1, MAX_LIVES)
        check_whole('max_steps', max_steps, 1, MAX_STEPS)
        self.rules = Rules(load_maze(maze), ghosts, lives)
        self.read_all_features = FeatureReader(self.rules)
        self.name = 'pacman'
        self.parameters: Mapping[str, Parameter] = {
            'maze': maze if maze in maze_names() else self.rules.maze.text,
            'ghosts': ghosts,
            'lives': lives,
            'max_steps': max_steps,
            **({} if features == ALL else {'features': features}),
        }
        every = pacman_features(self.rules)
        self.has_all_features = features == ALL
        self._listed = [k for k, one in enumerate(every) if features == ALL or in_paper(one.name)]
        self.features: Sequence[Feature] = tuple(every[k] for k in self._listed)
        self.feature_groups = pacman_groups(self.features)
        self.actions: Sequence[Action] = tuple(
            Action(name, key, f'go one cell {name}') for name, key in zip(MOVES, KEYS)
        )
        self.gamma = 0.985  # plans score less with 0.97, a shorter horizon
        self.max_steps = max_steps
        self.explanation = EXPLANATION
        self.primitive_columns = PRIMITIVE_COLUMNS if features == ALL else ()
        all_fruit = len(self.rules.maze.food) > max(FRUIT_AFTER)  # otherwise fruit is too rare
        self.teaching = TeachingDefaults(DEMO_OPTIONS_WITH_FRUIT if all_fruit else DEMO_OPTIONS)

    def reset(self, rng: np.random.Generator) -> PacManState:
        """Return the only start state: Pac-Man and all ghosts in their first cells."""
        return self.rules.start()

    def step(
        self, state: PacManState, action: int, rng: np.random.Generator
    ) -> Outcome[PacManState]:
        """Take one primitive action, with one random draw per ghost."""
        if not 0 <= action < len(MOVES):
            raise DomainError(f'pacman has no action {action}; it has 0 to {len(MOVES) - 1}')
        if self.is_over(state):
            why = 'the maze is cleared' if state.lives else 'the last life is lost'
            raise DomainError(f'{why}, so no step can be taken')
        after = self.rules.advance(state, action, self.rules.draws(rng))
        return Outcome(after, float(after.score - state.score), self.is_over(after))

    def is_over(self, state: PacManState) -> bool:
        return self.rules.is_over(state)

    def can_follow(self, state: PacManState, action: int, successor: PacManState) -> bool:
        if self.is_over(state) or not 0 <= action < len(MOVES):
            return False
        return self.rules.can_follow(state, action, successor)

    def feature_values(self, state: PacManState) -> Floats:
        values: Floats = self.listed(self.read_all_features(self.rules.game_at(state)))[0]
        return values

    def listed(self, rows: Rows) -> Rows:
        """Select the columns (N, F) of the domain's own features from those of all features."""
        return rows if self.has_all_features else rows[:, self._listed]

    def encode(self, state: PacManState) -> str:
        return notation.encode(self.rules.maze, state)

    def decode(self, text: str) -> PacManState:
        return notation.decode(self.rules.maze, self.rules.lives, text)

    def sample_states(self, rng: np.random.Generator, count: int) -> list[PacManState]:
        """Draw states that are not over, from games played with several aims."""
        return sample_games(self.rules, rng, count).states()

    def board(self, state: PacManState, shown: Collection[str] | None = None) -> Board:
        if shown is None:
            return board_of_state(self.rules.maze, state, self.rules.lives)
        return board_of_features(self.rules.maze, shown_values(self, state, shown))

    def step_effect(self, state: PacManState, action: int, successor: PacManState) -> StepEffect:
        """Return the effect of a step: Pac-Man's move, his meals, and a lost life."""
        to = int(self.rules.paths.step[state.pacman, action])
        meals = [f'ate {MEALS[name]}' for name in eaten_names(successor.ate)]
        if successor.lives < state.lives:
            left = f'{successor.lives} left' if successor.lives else 'it was the last'
            return StepEffect(' and '.join([*meals, f'lost a life: {left}']))
        if not successor.food:
            meals.append('cleared the maze')
        if meals:
            return StepEffect(' and '.join(meals))
        if to == state.pacman:
            return StepEffect('wall: Pac-Man stayed', changed=False)
        return move_effect(MOVES[action], MOVES[action])

    def action_mask(self, state: PacManState) -> NDArray[np.int8]:
        """Return the mask, (A,): 1 for moves not blocked by a wall."""
        mask: NDArray[np.int8] = HAS_MOVE[self.rules.paths.legal[state.pacman]].astype(np.int8)
        return mask

    def games(self, states: Sequence[PacManState]) -> PacManGames:
        return PacManGames(self, PacManBatch.from_states(self.rules, states))

    def search_space(self) -> SearchSpace:
        """Return the cells of the maze and the moves between them, without the ghosts."""
        maze, moves = self.rules.maze, self.rules.paths.step[:, :STAY, None].astype(np.int32)
        transitions = Transitions(
            moves, np.ones(moves.shape), np.zeros(moves.shape), np.zeros(moves.shape, np.bool_)
        )
        places = ('pacman_row', 'pacman_col')
        columns = [k for k, feature in enumerate(self.features) if feature.name in places]
        rows = np.zeros((len(maze.cells), len(self.features)))
        rows[:, columns] = maze.cells
        cells = np.full((maze.rows, maze.cols), -1, dtype=np.int32)
        cells[tuple(np.transpose(maze.cells))] = range(len(maze.cells))
        over = np.zeros(len(maze.cells), dtype=np.bool_)
        names = [plain_cell_name(cell) for cell in maze.cells]
        board = BoardSlice('the maze', cells)
        return plain_space(transitions, over, ~over, rows, columns, names, board)

    def baselines(self) -> Baselines:
        return pacman_baselines(self)
