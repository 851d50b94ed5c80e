"""The baselines of plans in Pac-Man, and a hand-written rule over its reference options."""

from functools import partial
from typing import TYPE_CHECKING

from humanopts_env.arrays import Ints
from humanopts_env.domains.capabilities import Baselines
from humanopts_env.domains.pacman.features import fear_of_prey, steps_to
from humanopts_env.domains.pacman.games import PacManGames
from humanopts_env.domains.pacman.reference import (
    AVOID_GHOST,
    CLOSEST_FOOD,
    EAT_GHOST,
    NEAREST_PILL,
    PacManOption,
    reference_options,
    TO_FRUIT,
)
from humanopts_env.domains.pacman.rules import GHOST_RULES
import numpy as np

if TYPE_CHECKING:
    from humanopts_env.domains.pacman.domain import PacMan

TOO_NEAR = 3  # steps to a dangerous ghost at which the hand-written rule flees
PAPER_OPTIONS = (CLOSEST_FOOD, AVOID_GHOST, NEAREST_PILL)  # Subramanian et al., section 7


def pacman_baselines(domain: 'PacMan') -> Baselines:
    """Return the baselines in one variant of the game."""
    return Baselines(
        variants={f'ghosts={rule}': {'ghosts': rule} for rule in GHOST_RULES},
        paper_options=PAPER_OPTIONS,
        heuristic=partial(hand_written_rule, reference_options(domain)),
    )


def hand_written_rule(options: dict[str, PacManOption], games: PacManGames) -> Ints:
    """
    Return the first best move of the option that the rule chooses, (N,).

    The rule is: eat a scared ghost that can be caught in time, unless a dangerous one is near;
    else, if a dangerous ghost is too near, go to a power pill that is nearer; else go to fruit
    that can be reached in time, unless a dangerous ghost is near; else avoid a ghost that is too
    near; else go to the closest food.

    Of 23 positions and conditions of the clause for fruit, these scored best over both ghost
    rules, in 1,000 games with a seed that no reported result uses.
    """
    batch = games.batch
    danger, prey, pill, fruit = (
        steps_to(batch, thing, batch.pacman) for thing in ('danger', 'prey', 'pill', 'fruit')
    )
    in_turn = {
        EAT_GHOST: (prey <= fear_of_prey(batch)) & (danger > 2),
        NEAREST_PILL: (danger <= TOO_NEAR) & (pill < TOO_NEAR),
        TO_FRUIT: (fruit <= batch.fruit) & (danger > 2),
        AVOID_GHOST: danger <= TOO_NEAR,
        CLOSEST_FOOD: np.ones_like(batch.over),
    }
    judged = [options[name].judge(batch) for name in in_turn]
    usable = [said.initiation & holds for said, holds in zip(judged, in_turn.values())]
    chosen = np.argmax(usable, axis=0)
    best = np.stack([said.optimal for said in judged])[chosen, range(len(chosen))]
    move: Ints = best.argmax(axis=1)
    return move
