"""
The Pac-Man options of the paper, and one for the fruit, as reference options.

The options of the paper are in table 1 of Subramanian, Isbell and Thomaz (2011). Options are
evaluated in many games at once; one state is a batch of one. When the game is over, no option can
start and all have ended.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from humanopts_env.arrays import Flags
from humanopts_env.domains.pacman.features import steps_after, steps_to
from humanopts_env.domains.pacman.rules import (
    ATE_FOOD,
    ATE_FRUIT,
    ATE_GHOST,
    ATE_PILL,
    PacManBatch,
    Rules,
)
from humanopts_env.domains.pacman.state import PacManState
from humanopts_env.domains.reference import JudgedOption, Judgement

if TYPE_CHECKING:
    from humanopts_env.domains.pacman.domain import PacMan
    from humanopts_env.domains.pacman.games import PacManGames

CLOSEST_FOOD = 'go to the closest food'
AVOID_GHOST = 'avoid ghost'
NEAREST_PILL = 'go to the nearest power pellet'
EAT_GHOST = 'eat the ghost'
TO_FRUIT = 'go to the fruit'
DANGER = 4  # maximum steps to a dangerous ghost that is avoided


@dataclass(frozen=True)
class PacManOption(JudgedOption):
    """A ``ReferenceOption`` of Pac-Man: go to the nearest object of a kind, or away from it."""

    rules: Rules
    name: str
    features: tuple[str, ...]
    definition: str
    thing: str  # one of THINGS
    meal: int  # ends when this was eaten; 0: moves away from the object while it is near

    def judge_states(self, states: Sequence[PacManState]) -> Judgement:
        """Evaluate N states in one batch."""
        return self.judge(PacManBatch.from_states(self.rules, states))

    def judge_games(self, games: 'PacManGames') -> Judgement:
        """Evaluate the states of N games."""
        return self.judge(games.batch)

    def judge(self, batch: PacManBatch) -> Judgement:
        """Evaluate N games; the option has ended if it cannot start or its meal was eaten."""
        far = self.rules.paths.far
        steps = steps_to(batch, self.thing, batch.pacman)
        if self.meal:
            starts = steps < far
            best = steps_after(batch, self.thing, far) < steps[:, None]
        else:
            starts, after = steps <= DANGER, steps_after(batch, self.thing, -1)
            best = after == after.max(axis=1, keepdims=True)
        starts &= ~batch.over
        return Judgement(starts, ~starts | (batch.ate & self.meal > 0), best & starts[:, None])

    def reached(self, state: PacManState) -> bool:
        """Return whether the option has ended, and not only because the game is over."""
        return bool(self.goal(PacManBatch.from_states(self.rules, [state]))[0])

    def goal(self, batch: PacManBatch) -> Flags:
        """Return (N,): ``reached`` in N games."""
        found: Flags = self.judge(batch).termination & (~batch.over | (batch.ate & self.meal > 0))
        return found


# Name, definition, thing, meal, features, and the prefixes of features for a domain with positions
# only.
OPTIONS: tuple[tuple[str, str, str, int, tuple[str, ...], tuple[str, ...]], ...] = (
    (
        CLOSEST_FOOD,
        'Starts anywhere; takes a shortest path to the nearest food; ends when food has been '
        'eaten.',
        'food',
        ATE_FOOD,
        ('food_direction', 'ate'),
        ('pacman', 'food', 'ate'),
    ),
    (
        AVOID_GHOST,
        f'Starts where a dangerous ghost is at most {DANGER} steps away; moves to where the '
        'nearest one is then farthest away; ends when none is that near any more.',
        'danger',
        0,
        ('danger_direction', 'danger_distance', 'legal_moves'),
        ('pacman', 'ghost'),
    ),
    (
        NEAREST_PILL,
        'Starts where a power pill is left; takes a shortest path to the nearest one; ends '
        'when one has been eaten.',
        'pill',
        ATE_PILL,
        ('pill_direction', 'ate'),
        ('pacman', 'pill', 'ate'),
    ),
    (
        EAT_GHOST,
        'Starts where a ghost is scared; takes a shortest path to the nearest scared one; '
        'ends when one has been eaten, or when none is scared any more.',
        'prey',
        ATE_GHOST,
        ('prey_direction', 'ate'),
        ('pacman', 'ghost', 'ate'),
    ),
    (
        TO_FRUIT,
        'Starts while there is fruit; takes a shortest path to it; ends when it has been '
        'eaten or is gone.',
        'fruit',
        ATE_FRUIT,
        ('fruit_direction', 'ate'),
        ('pacman', 'fruit', 'ate'),
    ),
)


def reference_options(domain: 'PacMan') -> dict[str, PacManOption]:
    """Return the Pac-Man options of the paper's table 1 by name, and the one for the fruit."""
    names = [feature.name for feature in domain.features]
    found = {}
    for name, definition, thing, meal, used, beginnings in OPTIONS:
        if not domain.has_all_features:
            used = tuple(feature for feature in names if feature.startswith(beginnings))
        found[name] = PacManOption(domain.rules, name, used, definition, thing, meal)
    return found
